"""Description of a scene's tree together with the trees of its influence areas."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from wrt.accelerators.projected_bvh import ProjectedBvh
from wrt.kernels.validation import convert_fields
from wrt.tables import one_of

if TYPE_CHECKING:
    from wrt.accelerators.tree_descriptions import Bvh
    from wrt.builders import tree as common
    from wrt.builders.bvh.bvh_config import BvhConfig
    from wrt.builders.influence.influence_area import InfluenceArea
    from wrt.builders.triangle_boxes import TriangleBoxes

TOP_LEVELS = ("auto", "octree", "kdtree", "array")

MAX_ARRAY_AREAS = 16
"""Largest number of areas that are searched as an array, which is then faster than an octree
(notebooks/records/2026-11-21-influence-areas.md).
"""


@dataclass(frozen=True, kw_only=True)
class RayAwareBvh:
    """A bounding volume hierarchy for the whole scene, and one for the rays of each influence area (Falcone 2024).

        below = dict(position=(0, 0, 9), direction=(0, 0, -1), width=4, height=3, depth=9)
        scene = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=[wrt.known_rays.PlaneInfluenceArea(**below)]))

    A ray that starts in an area and is aligned with the area's rays is first traced through the area's tree, which holds
    the triangles that touch the area. It is traced through the whole scene's tree only if it leaves the area without a hit
    before it ends. Hits are bit for bit those of any other accelerator. Only closest-hit and occlusion queries use areas;
    counts and lists of all hits use the whole scene's tree.

    Attributes:
        areas: 1 to 65,534 `wrt.known_rays.PlaneInfluenceArea` and `wrt.known_rays.PointInfluenceArea`; a ray belongs to the
            first that contains it. Areas that no triangle touches are left out. A point area accepts rays that start at its
            apex, not only beyond its near plane.
        tolerance: largest angle between a ray and the area's ray through its origin, in degrees, in [0, 90).
        top_level: how the area of a ray is found: "octree", "kdtree", "array", or "auto": an array of up to 16 areas, else
            an octree.
        depth: largest number of octree levels below the root, 1 to 8; a kd-tree has up to three times as many.
        whole: the whole scene's tree, a `wrt.Bvh`; None for `wrt.Bvh()`.
        local: the areas' trees: a `wrt.Bvh`, or a `wrt.known_rays.ProjectedBvh` whose areas are replaced by the tree's area;
            None for `wrt.known_rays.ProjectedBvh(areas=[area])`. They get the width of the whole scene's tree.

    Raises:
        TypeError: `areas`, `whole` or `local` holds something else.
        ValueError: no area or too many, an unknown top level, or a value out of range.

    `wrt.Scene` raises a ValueError for an octree or kd-tree of more than 1 GB (thousands of large areas at depth 8); use fewer
    levels or an array.

    References: falcone-2024.
    """

    kind: ClassVar[str] = "bvh"

    areas: Sequence[InfluenceArea]
    tolerance: float = 1.0
    top_level: str = "auto"
    depth: int = 5
    whole: Bvh | None = None
    local: Bvh | ProjectedBvh | None = None

    def __post_init__(self) -> None:
        from wrt.accelerators.tree_descriptions import Bvh
        from wrt.builders.influence.area_top_level import MAX_AREAS, MAX_DEPTH
        from wrt.builders.influence.projected_cost import check_areas

        object.__setattr__(self, "areas", check_areas(self.areas))
        convert_fields(self)
        if len(self.areas) > MAX_AREAS:
            raise ValueError(f"areas holds {len(self.areas)} areas; at most {MAX_AREAS} are supported")
        if not isinstance(self.whole, Bvh | None):
            raise TypeError(f"whole must be a wrt.Bvh, not {type(self.whole).__name__}")
        if not isinstance(self.local, Bvh | ProjectedBvh | None):
            raise TypeError(f"local must be a wrt.Bvh or a wrt.known_rays.ProjectedBvh, not {type(self.local).__name__}")
        if not 0.0 <= self.tolerance < 90.0:
            raise ValueError(f"tolerance is {self.tolerance}; it must be in [0, 90), in degrees")
        one_of(TOP_LEVELS, self.top_level, "top_level")
        if not 1 <= self.depth <= MAX_DEPTH:
            raise ValueError(f"depth is {self.depth}; it must be from 1 to {MAX_DEPTH}, or use top_level='array'")
        object.__setattr__(self, "whole", self.whole or Bvh())

    @property
    def octree_depth(self) -> int:
        """Largest number of octree levels below the root, also if a kd-tree takes its place; 0 for an array."""
        is_array = len(self.areas) <= MAX_ARRAY_AREAS if self.top_level == "auto" else self.top_level == "array"
        return 0 if is_array else self.depth

    def config(self, width: int) -> BvhConfig:
        """The configuration of the whole scene's tree; `width` is used where the description leaves it open."""
        return self.whole.config(width)

    def build(self, triangles: TriangleBoxes, width: int) -> common.Bvh:
        """Builds the whole scene's tree over `triangles`, on their device; width: as in `config`."""
        return self.whole.build(triangles, width)

    def build_local(self, area: InfluenceArea, triangles: TriangleBoxes, width: int) -> common.Bvh:
        """Builds the tree of an area over some triangles, on their device; width: of its nodes and leaf blocks."""
        local = self.local or ProjectedBvh(areas=(area,))
        if isinstance(local, ProjectedBvh):
            local = replace(local, areas=(area,), shares=None)
        return replace(local, width=width).build(triangles, width)

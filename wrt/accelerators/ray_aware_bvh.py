"""Description of a scene's tree together with trees for its influence areas."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from wrt.accelerators.projected_bvh import ProjectedBvh
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.accelerators.accelerator import Bvh
    from wrt.builders import tree as common
    from wrt.builders.bvh.bvh_config import BvhConfig
    from wrt.builders.influence.influence_area import InfluenceArea
    from wrt.builders.triangle_boxes import TriangleBoxes

TOP_LEVELS = ("auto", "octree", "array")

MOST_IN_ARRAY = 16
"""Areas of an array. With 1, 3 and 20 areas of the atrium it took 9 to 30 ns a ray, an octree 20 to 90."""


@dataclass(frozen=True, kw_only=True)
class RayAwareBvh:
    """A bounding volume hierarchy for the whole scene and one for each influence area, made for the area's rays.

        light = wrt.PlaneInfluenceArea(position=..., direction=..., width=..., height=..., depth=...)
        scene = wrt.Scene(mesh, accelerator=wrt.RayAwareBvh(areas=[light]))

    A ray that starts in an area and runs along its rays asks the area's tree first, over the triangles that touch the area, and
    the whole scene's tree only if it leaves the area without a hit and has some way left. Hits are those of any other
    accelerator, to the bit. Only closest hits and occlusion ask areas; counts and all hits take the whole scene's tree.

    Attributes:
        areas: 1 to 65,534 `wrt.PlaneInfluenceArea` and `wrt.PointInfluenceArea`; the first that fits a ray is asked. Those that
            no triangle touches are left out. A point area takes rays from its apex on, not only from its near plane.
        tolerance: greatest angle between a ray and the area's ray through its origin, in degrees, in [0, 90).
        top_level: "octree", or "array": how the area of a ray is found; "auto" for an array of up to 16 areas.
        depth: levels of the octree below its root at most, 1 to 8.
        whole: the whole scene's tree, a `wrt.Bvh`; None for `wrt.Bvh()`.
        local: the areas' trees: a `wrt.Bvh`, or a `wrt.ProjectedBvh` whose areas are replaced by the tree's own one; None for
            `wrt.ProjectedBvh(areas=[area])`. They get the width of the whole scene's.

    Raises:
        TypeError: `areas`, `whole` or `local` holds something else.
        ValueError: no area or too many, an unknown top level, or a value out of its range.

    An octree that would take more than 1 GB (thousands of large areas at depth 8) is refused by `wrt.Scene`, with a ValueError;
    fewer levels or an array take less.
    """

    kind: ClassVar[str] = "bvh"

    areas: Sequence[InfluenceArea]
    tolerance: float = 1.0
    top_level: str = "auto"
    depth: int = 5
    whole: Bvh | None = None
    local: Bvh | ProjectedBvh | None = None

    def __post_init__(self) -> None:
        from wrt.accelerators.accelerator import Bvh
        from wrt.builders.influence.area_top_level import MAX_AREAS, MAX_DEPTH
        from wrt.builders.influence.projected_cost import check_areas

        object.__setattr__(self, "areas", check_areas(self.areas))
        if len(self.areas) > MAX_AREAS:
            raise ValueError(f"areas holds {len(self.areas)} areas; at most {MAX_AREAS} have numbers")
        if not isinstance(self.whole, Bvh | None):
            raise TypeError(f"whole must be a wrt.Bvh, not {type(self.whole).__name__}")
        if not isinstance(self.local, Bvh | ProjectedBvh | None):
            raise TypeError(f"local must be a wrt.Bvh or a wrt.ProjectedBvh, not {type(self.local).__name__}")
        if not 0.0 <= self.tolerance < 90.0:
            raise ValueError(f"tolerance is {self.tolerance}; it must be from 0 up to, not including, 90 degrees")
        lookup(dict.fromkeys(TOP_LEVELS), self.top_level, "top_level")
        if not 1 <= self.depth <= MAX_DEPTH:
            raise ValueError(f"depth is {self.depth}; it must be from 1 to {MAX_DEPTH}, or use top_level='array'")
        object.__setattr__(self, "whole", self.whole or Bvh())

    @property
    def octree_depth(self) -> int:
        """Levels of the octree below its root at most, 0 for an array."""
        is_array = len(self.areas) <= MOST_IN_ARRAY if self.top_level == "auto" else self.top_level == "array"
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

"""Description of a bounding volume hierarchy for rays with known directions."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Any, ClassVar

from wrt.kernels.validation import as_numbers, convert_fields
from wrt.tables import lookup, one_of

if TYPE_CHECKING:
    from wrt.builders import tree as common
    from wrt.builders.bvh.known_rays_config import ProjectedConfig
    from wrt.builders.bvh.phases.split_axes import AxisChoice
    from wrt.builders.influence.influence_area import InfluenceArea
    from wrt.builders.triangle_boxes import TriangleBoxes

COSTS = ("pah", "sah")


@dataclass(frozen=True, kw_only=True)
class ProjectedBvh:
    """A wide bounding volume hierarchy for the rays of influence areas (Falcone 2024).

    It holds all triangles, so any ray gets its hits; rays of the areas get them with the least work.
    `ProjectedBvh.published` has the costs and thresholds of the thesis.

    Attributes:
        areas: `wrt.known_rays.PlaneInfluenceArea` and `wrt.known_rays.PointInfluenceArea`, at least one.
        shares: share of the rays of each area; None: equal shares.
        cost: "pah": boxes are weighted by projected area; "sah": by surface area, so that the areas affect only `axes`.
        others: share of rays in all directions, in [0, 1], for "pah"; it decides where projected areas are 0.
        axes: "facing", "longest", "in_turn", "all", or a `wrt.builders.bvh.phases.split_axes.AxisChoice` with its own
            thresholds.
        width: children of a node and triangles tested at once, 2, 4, 8 or 16; None for the vector width of the device.
        traversal_cost: cost of visiting a node.
        block_cost: cost of testing one block of `width` triangles; None for the default of `wrt.Bvh`.
        triangle_cost: cost of testing one triangle, in place of blocks; None for blocks.
        bins: bins along an axis, 2 to 40.
        max_leaf_triangles: largest number of triangles in a leaf, 1 to 63; None for a default by width.
        leaf_cost, leaf_area, leaf_probability: a node becomes a leaf if its cost, area or hit probability is at most this,
            and it has no more triangles than a leaf may have.
        max_depth: largest depth of the binary tree, if possible; None for the depth that traversals support.
        aware_depth: depth of the binary tree from which nodes are split by surface area along the longest side; None for
            never.
        subset: share of the triangles, in (0, 1], drawn at random, over which the upper levels are built; the others are then
            inserted (Tessari et al. 2023, suggested in section 7.2). 1 for all triangles.
        spatial_splits: most additional references to triangles, as a share of their number, from 0 to 4. A triangle that
            straddles a plane may be in both children, clipped, where this costs less (Stich et al. 2009, suggested in section
            7.2), and if the tree costs less. 0 for none. The build and counts of all hits take longer, and a moved scene builds
            such a tree anew (notebooks/records/2026-11-23-spatial-splits-and-compact-subtrees.md).

    Raises:
        TypeError: `areas` holds something else.
        ValueError: an unknown cost or axis choice, a value out of range, or both `subset` and `spatial_splits`.

    References: falcone-2024; stich-2009; tessari-2023.
    """

    kind: ClassVar[str] = "bvh"

    areas: tuple[InfluenceArea, ...]
    shares: tuple[float, ...] | None = None
    cost: str = "pah"
    others: float = 1e-3
    axes: str | AxisChoice = "all"
    width: int | None = None
    traversal_cost: float = 1.0
    block_cost: float | None = None
    triangle_cost: float | None = None
    bins: int = 16
    max_leaf_triangles: int | None = None
    leaf_cost: float = 0.0
    leaf_area: float = 0.0
    leaf_probability: float = 0.0
    max_depth: int | None = None
    aware_depth: int | None = None
    subset: float = 1.0
    spatial_splits: float = 0.0

    def __post_init__(self) -> None:
        from wrt.builders.influence.projected_cost import check_areas

        object.__setattr__(self, "areas", check_areas(self.areas))
        convert_fields(self)
        if self.shares is not None:
            object.__setattr__(self, "shares", tuple(as_numbers("shares", self.shares, (None,), finite=False).tolist()))
        one_of(COSTS, self.cost, "cost")
        if self.block_cost is not None and self.triangle_cost is not None:
            raise ValueError("block_cost and triangle_cost are both given; leave one out: leaves have one cost")
        self.config(width=8)

    @classmethod
    def published(cls, areas: tuple[InfluenceArea, ...], **changes: Any) -> ProjectedBvh:
        """The thesis' configuration: binary nodes, cost 1 for a box and 1.2 for a triangle, two triangles in a leaf, 40 bins
        along an axis, axes that face away from the rays, no other rays.

        areas: as in the class; changes: other attributes, by name.
        """
        costs: dict[str, Any] = {"width": 2, "traversal_cost": 2.0, "triangle_cost": 1.2, "max_leaf_triangles": 2}
        return cls(areas=areas, **costs | {"axes": "facing", "bins": 40, "others": 0.0} | changes)

    def config(self, width: int) -> ProjectedConfig:
        """The builder's configuration; `width` is used where the description leaves it open."""
        from wrt.builders.bvh.bvh_config import BvhConfig
        from wrt.builders.bvh.known_rays_config import NodeRules, ProjectedConfig
        from wrt.builders.bvh.phases.split_axes import AXIS_CHOICES
        from wrt.builders.cost import SurfaceAreaCost
        from wrt.builders.influence.projected_cost import RayDistribution

        width = width if self.width is None else self.width
        block, unit = (0.5 if width >= 8 else 1.5) if self.block_cost is None else self.block_cost, None
        if self.triangle_cost is not None:
            block, unit = self.triangle_cost, 1
        costs = SurfaceAreaCost(traversal=self.traversal_cost, block=block, width=width, unit=unit)
        return ProjectedConfig(
            bvh=BvhConfig(costs, bins=self.bins, max_leaf_triangles=self.max_leaf_triangles, subset=self.subset, large=inf),
            rays=RayDistribution(self.areas, self.shares, self.others if self.cost == "pah" else 1.0),
            axes=lookup(AXIS_CHOICES, self.axes, "axes") if isinstance(self.axes, str) else self.axes,
            nodes=NodeRules(
                leaf_cost=self.leaf_cost,
                leaf_area=self.leaf_area,
                leaf_probability=self.leaf_probability,
                max_depth=self.max_depth,
                aware_depth=self.aware_depth,
            ),
            spatial_splits=self.spatial_splits,
        )

    def build(self, triangles: TriangleBoxes, width: int) -> common.Bvh:
        """Builds the tree over `triangles`, on their device; `width` is used where the description leaves it open."""
        from wrt.builders.bvh.projected_binned import build
        from wrt.builders.bvh.spatial.spatial_build import build as build_splitting

        return (build_splitting if self.spatial_splits > 0.0 else build)(triangles, self.config(width))

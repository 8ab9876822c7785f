"""Descriptions of kd-trees and bounding volume hierarchies: what to build, not the built tree."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, ClassVar

from wrt.kernels.validation import convert_fields
from wrt.tables import lookup

if TYPE_CHECKING:
    import warp as wp

    from wrt.builders import tree as common
    from wrt.builders.bvh.bvh_config import BvhConfig
    from wrt.builders.kdtree import BuilderCapabilities, KdTreeBuilder
    from wrt.builders.kdtree.kdtree_config import KdTreeConfig
    from wrt.builders.kdtree.lazy.given_clusters import MeshBoxes
    from wrt.builders.kdtree.lazy.lazy_kdtree import LazyKdTree
    from wrt.builders.triangle_boxes import TriangleBoxes


def able_to(capability: BuilderCapabilities) -> Callable[[KdTreeBuilder], bool]:
    """Whether a builder has a capability."""
    return lambda builder: capability in builder.capabilities


@dataclass(frozen=True, kw_only=True)
class KdTree:
    """A kd-tree built with the surface area heuristic (SAH).

    Attributes:
        builder: key in `wrt.builders.kdtree.KDTREE_BUILDERS`.
        width: triangles tested at once, 1, 2, 4, 8 or 16; None for the vector width of the device.
        traversal_cost: cost of visiting an inner node.
        block_cost: cost of testing one block of `width` triangles.
        empty_factor: factor on the cost of a split that cuts off empty space, in (0, 1].
        max_depth: largest depth, at most 64; None for a bound that grows with the logarithm of the triangle count.
        bad_splits: how many splits on a path may increase the cost.
        termination: when a split is bad, a key in `wrt.builders.tree.TERMINATIONS`: "cost", "automatic" or "fixed".
        leaf_triangles: a node with at most this many triangles becomes a leaf.
        least_size: a node whose longest side is at most this share of the scene's longest side becomes a leaf; in [0, 1).
        mailbox: whether the cost assumes mailboxing, by which rays test a triangle in several leaves once.
        axis: "longest" or "round_robin": the axis that the builders `spatial_median` and `object_median` split; the others
            try all three.
        split_clipping: whether triangles that straddle a plane are clipped to the cells on both sides. The tree usually has
            fewer references and a lower cost, and takes longer to build. All builders support it.
            Counts and inside tests are then exact for rays that start within about 20 scene sizes of the scene.
        searched_axes: "all", "longest" or "mixed": the axes on which the builder `adaptive_sampling` takes samples: all three,
            the node's longest one, or that in nodes of more than 1,000 triangles. The other builders take "all" only.
        resamplings: 1 to 4: how often the builder `adaptive_sampling` takes more samples where the least cost may be.
        median_levels: 0 to 12: how many levels the builder `binned` splits at the median of the triangles, which balances the
            work of threads and costs tracing speed.
        cost_model: "surface_area", or "blocking": the cost then takes into account that rays end at triangles
            (`wrt.builders.cost`). The builders `binned`, `adaptive_sampling`, `sorting_sweep` and `naive` support it.
        cell_tests: "none", "leaves" or "nodes": whether triangles, and not only their boxes, are tested against the leaves of
            the finished tree, or against all cells while it is built. `split_clipping` does more than either.
        empty_space: "priced", "early", "late" or "both": empty space is cut off at a lower price (`empty_factor`); large slabs
            also before other planes are tried, and slabs of leaves when the tree is finished. `sweep`, `sorting_sweep`,
            `naive`, `adaptive_sampling` and the builders of medians support "early" and "both".
        layout: key in `wrt.builders.kdtree.LAYOUTS`: the order of nodes in memory that the traversal "single"
            walks for closest and any hits, in a copy beside the builder's own, which is depth first. Saved with a scene.
        hierarchy: "grid", "meshes", "previous" or "groups": from what the builder `lazy` starts: from triangles sorted into a
            grid, from the boxes of the scene's meshes, in updates from the clusters of the previous frame, or from the boxes of
            nested sequences of meshes (`wrt.moving.nested_meshes`), opened where rays go. The other builders take "grid" only.

    Raises:
        ValueError: an unknown builder, axis or other name, a value out of its range, or a builder that does not support an
            option. Trees that are built lazily are never finished, so they take none of the passes of the end.
    """

    kind: ClassVar[str] = "kdtree"

    builder: str = "in_place"
    width: int | None = None
    traversal_cost: float = 1.0
    block_cost: float = 0.5
    empty_factor: float = 0.8
    max_depth: int | None = None
    bad_splits: int = 1
    termination: str = "cost"
    leaf_triangles: int = 0
    least_size: float = 0.0
    mailbox: bool = False
    axis: str = "longest"
    split_clipping: bool = False
    searched_axes: str = "all"
    resamplings: int = 1
    median_levels: int = 0
    cost_model: str = "surface_area"
    cell_tests: str = "none"
    empty_space: str = "priced"
    layout: str = "depth_first"
    hierarchy: str = "grid"

    def __post_init__(self) -> None:
        from wrt.builders.cost import COST_MODELS
        from wrt.builders.kdtree import KDTREE_BUILDERS, LAYOUTS, NATIVE, BuilderCapabilities

        convert_fields(self)
        lookup(KDTREE_BUILDERS, self.builder, "builder")
        lookup(LAYOUTS, self.layout, "layout")
        lookup(COST_MODELS, self.cost_model, "cost_model")
        config = self.config(width=8)
        self._require("split_clipping", self.split_clipping, "off", able_to(BuilderCapabilities.CLIPS))
        self._require("searched_axes", self.searched_axes != "all", "out", able_to(BuilderCapabilities.CHOOSES_AXES))
        self._require("resamplings", self.resamplings != 1, "out", able_to(BuilderCapabilities.CHOOSES_AXES))
        self._require("median_levels", self.median_levels != 0, "out", able_to(BuilderCapabilities.CLUSTERS))
        self._require(
            f"hierarchy={self.hierarchy!r}", self.hierarchy != "grid", "out", lambda builder: builder.start is not None
        )
        self._require(f"cost_model={self.cost_model!r}", self.ends_rays, "out", able_to(BuilderCapabilities.ANY_COST))
        self._require(f"cell_tests={self.cell_tests!r}", self.cell_tests == "nodes", "out", able_to(BuilderCapabilities.CLIPS))
        self._require(f"empty_space={self.empty_space!r}", config.cuts_early, "out", able_to(BuilderCapabilities.CUTS_EARLY))
        for name, plain in (("cell_tests", "none"), ("empty_space", "priced"), ("layout", NATIVE)):
            value = getattr(self, name)
            self._require(f"{name}={value!r}", value != plain, "out", lambda builder: builder.start is None)
        if self.ends_rays and self.mailbox:
            raise ValueError("cost_model='blocking' does not know mailboxes; leave mailbox off, or cost_model out")

    def _require(self, option: str, wanted: bool, without: str, able: Callable[[KdTreeBuilder], bool]) -> None:
        """Refuses an option that the builder does not support."""
        from wrt.builders.kdtree import KDTREE_BUILDERS

        if wanted and not able(KDTREE_BUILDERS[self.builder]):
            names = ", ".join(name for name, builder in KDTREE_BUILDERS.items() if able(builder))
            raise ValueError(f"builder {self.builder!r} does not support {option}; choose from {names}, or leave it {without}")

    @property
    def ends_rays(self) -> bool:
        """Whether the cost takes into account that rays end."""
        return self.cost_model == "blocking"

    def config(self, width: int) -> KdTreeConfig:
        """The builder's configuration; `width` is used where the description leaves it open."""
        from wrt.builders.cost import SurfaceAreaCost
        from wrt.builders.kdtree.kdtree_config import KdTreeConfig
        from wrt.builders.tree import StopRules

        cost = SurfaceAreaCost(
            traversal=self.traversal_cost,
            block=self.block_cost,
            width=width if self.width is None else self.width,
            empty_factor=self.empty_factor,
            mailbox=self.mailbox,
        )
        stop = StopRules(self.max_depth, self.bad_splits, self.termination, self.leaf_triangles, self.least_size)
        names = {field.name for field in fields(KdTreeConfig)} - {"cost", "stop"}
        return KdTreeConfig(cost, stop, **{name: getattr(self, name) for name in names})

    def config_for(self, triangles: TriangleBoxes, width: int) -> KdTreeConfig:
        """The builder's configuration for a mesh, of which some costs depend on the triangles; width: as in `config`."""
        config = self.config(width)
        if not self.ends_rays:
            return config
        return replace(config, cost=replace(config.cost, occluder=triangles.mean_area))

    def build(self, triangles: TriangleBoxes, width: int) -> common.KdTree:
        """Builds the tree over `triangles`, on their device; `width` is used where the description leaves it open."""
        from wrt.builders.kdtree import KDTREE_BUILDERS, NATIVE

        config = self.config_for(triangles, width)
        tree = KDTREE_BUILDERS[self.builder].build(triangles, config)
        if config.cuts_late or config.cell_tests == "leaves":
            from wrt.builders.classics.kdtree.postprocess.postprocess import postprocess

            tree = postprocess(tree, triangles, config)
        if self.layout != NATIVE:
            from wrt.builders.classics.kdtree.node_layouts import with_layout

            tree = with_layout(tree, self.layout)
        return tree

    @property
    def takes_groups(self) -> bool:
        """Whether the tree is built from how meshes are nested (`hierarchy`)."""
        return self.hierarchy == "groups"

    @property
    def is_lazy(self) -> bool:
        """Whether the tree is built lazily, as rays visit it."""
        from wrt.builders.kdtree import KDTREE_BUILDERS

        return KDTREE_BUILDERS[self.builder].start is not None

    def start(
        self,
        triangles: TriangleBoxes,
        width: int,
        device: wp.Device,
        meshes: MeshBoxes | None = None,
        previous: LazyKdTree | None = None,
    ) -> LazyKdTree:
        """Starts a lazily built tree over `triangles` on `device`; width: as in `config`; meshes, previous: see `hierarchy`."""
        from wrt.builders.kdtree import KDTREE_BUILDERS

        return KDTREE_BUILDERS[self.builder].start(triangles, self.config(width), device, meshes, previous)  # type: ignore[call-arg]


@dataclass(frozen=True, kw_only=True)
class Bvh:
    """A wide bounding volume hierarchy built with the surface area heuristic (SAH).

    Attributes:
        builder: key in `wrt.builders.bvh.BVH_BUILDERS`.
        width: children of a node and triangles tested at once, 2, 4, 8 or 16; None for the vector width of the device.
        traversal_cost: cost of visiting a node.
        block_cost: cost of testing one block of `width` triangles; None for 0.5 with 8 lanes or more, whose blocks are
            mostly full, else 1.5.
        bins: bins along an axis, 2 to 40, for builders that bin.
        max_leaf_triangles: largest number of triangles in a leaf, 1 to 63; None for a default by width, and for 2 on CUDA.
        reinsertion: rounds of reinsertion, 0 to 1000, each of which moves subtrees to where they cost less; three reach
            most of the gain. Since "binned" divides by size, rays seldom become faster, and builds take several times as
            long. Scanned meshes keep the builder's tree. With "hploc" rays do become faster, in any mesh. None for 0, and for
            8 with "hploc" on CUDA, but not for builds by `update`.
        subset: share of the triangles, in (0, 1], drawn at random, over which the builder "binned" makes the upper levels; the
            others are then inserted (Tessari et al. 2023). 1 for all triangles.

    Raises:
        ValueError: an unknown builder, a value out of its range, or a subset with the builder "sweep".
    """

    kind: ClassVar[str] = "bvh"

    builder: str = "binned"
    width: int | None = None
    traversal_cost: float = 1.0
    block_cost: float | None = None
    bins: int = 16
    max_leaf_triangles: int | None = None
    reinsertion: int | None = None
    subset: float = 1.0

    def __post_init__(self) -> None:
        from wrt.builders.bvh import BVH_BUILDERS

        convert_fields(self)
        lookup(BVH_BUILDERS, self.builder, "builder")
        if self.subset != 1.0 and self.builder != "binned":
            raise ValueError(f"builder {self.builder!r} does not support a subset; use 'binned', or leave subset out")
        self.config(width=8)

    def config(self, width: int) -> BvhConfig:
        """The builder's configuration; `width` is used where the description leaves it open."""
        from wrt.builders.bvh.bvh_config import BvhConfig
        from wrt.builders.cost import SurfaceAreaCost

        width = width if self.width is None else self.width
        block_cost = (0.5 if width >= 8 else 1.5) if self.block_cost is None else self.block_cost
        cost = SurfaceAreaCost(traversal=self.traversal_cost, block=block_cost, width=width)
        return BvhConfig(cost, self.bins, self.max_leaf_triangles, self.reinsertion or 0, self.subset)

    def build(self, triangles: TriangleBoxes, width: int) -> common.Bvh:
        """Builds the tree over `triangles`, on their device; `width` is used where the description leaves it open."""
        from wrt.builders.bvh import BVH_BUILDERS

        return BVH_BUILDERS[self.builder].build(triangles, self.config(width))

    def kernels(self, triangles: int, width: int) -> list[wp.Kernel]:
        """One kernel of each module that a build of this many triangles needs; width: as in `config`."""
        from wrt.builders.bvh import BVH_BUILDERS, small_mesh_build
        from wrt.builders.bvh.small_mesh_build import run_steps

        few = [run_steps] if self.may_be_few and triangles <= small_mesh_build.MAX_TRIANGLES else []
        return [*few, *BVH_BUILDERS[self.builder].kernels(self.config(width), triangles)]

    @property
    def may_be_few(self) -> bool:
        """Whether trees of few triangles are built by `wrt.builders.bvh.small_mesh_build`."""
        return type(self) is Bvh and self.builder == "binned" and not self.reinsertion and self.subset == 1.0

"""Kd-tree builders: one file per method, and the tables of all builders and of all orders of nodes.

**Contract.** A builder is a function `build(triangles, config) -> KdTree`. It takes the boxes of the triangles
(`wrt.builders.triangle_boxes.TriangleBoxes`), and the cost model and stop rules as a frozen `KdTreeConfig`. It returns a tree
in the layout of `wrt.kernels.layout.kdtree_nodes`, with the time of each phase. The root's box is that of the triangles. A
triangle is listed in every leaf whose interior its box meets. A triangle in a splitting plane is listed on the side that the
split chose.

To add a builder, write its file and add one line to `KDTREE_BUILDERS`. The tests, the command line and the benchmarks read the
table. Builders that "auto" does not choose are in `wrt.builders.classics`; their modules are imported when they build.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Flag, auto

import warp as wp

from wrt.builders.core.late_import import classic
from wrt.builders.kdtree import binned, in_place
from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.lazy import lazy_kdtree as lazy
from wrt.builders.tree import KdTree
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.layout.kdtree_nodes import MAX_INDEX


class BuilderCapabilities(Flag):
    """What a kd-tree builder can do if the config asks for it, and which planes it finds."""

    NONE = 0
    CLIPS = auto()
    """It clips triangles to cells."""
    MIN_COST = auto()
    """It finds the plane of least cost in a node of few triangles, among all planes at which a box begins or ends; without it,
    it chooses planes by another rule and leaves only the decision to stop to the cost."""
    ANY_COST = auto()
    """It evaluates a plane once, with its final counts, so that the cost need not increase with them
    (`wrt.builders.cost.COST_MODELS`)."""
    CUTS_EARLY = auto()
    """It cuts off large empty slabs first."""
    CLUSTERS = auto()
    """It splits the first levels at medians."""
    CHOOSES_AXES = auto()
    """It takes adaptive samples: on the axes, and in as many scans, as the config says."""


def never(_: KdTreeConfig) -> bool:
    """`KdTreeBuilder.on_cuda` of builders whose threads pass many triangles each, which suits cores."""
    return False


@dataclass(frozen=True)
class KdTreeBuilder:
    """A method of building a kd-tree.

    Attributes:
        name: key in `KDTREE_BUILDERS`.
        paper: authors, title, year.
        build: (boxes, config) -> tree.
        capabilities: what it can do.
        max_triangles: largest mesh in tests and benchmarks, because larger ones take too long; the builder accepts any size.
        start: (boxes, config, device of the rays) -> a tree that is built on demand; None if the tree is built at once.
        on_cuda: (config) -> whether the tree of a scene on CUDA is built there; if not, it is built on the CPU and copied.
    """

    name: str
    paper: str
    build: Callable[[TriangleBoxes, KdTreeConfig], KdTree]
    capabilities: BuilderCapabilities = BuilderCapabilities.NONE
    max_triangles: int = MAX_INDEX
    start: Callable[[TriangleBoxes, KdTreeConfig, wp.Device], lazy.LazyKdTree] | None = None
    on_cuda: Callable[[KdTreeConfig], bool] = never


WALD_HAVRAN = "Wald, Havran: On building fast kd-trees for ray tracing, and on doing that in O(N log N) (2006)"

CHOI = "Choi et al.: Parallel SAH k-D tree construction (2010)"

FUSSELL = "Fussell, Subramanian: Fast ray tracing using k-d trees (1988)"

MIN_COST = BuilderCapabilities.CLIPS | BuilderCapabilities.MIN_COST
ANY_COST = MIN_COST | BuilderCapabilities.ANY_COST
MEDIANS = BuilderCapabilities.CLIPS | BuilderCapabilities.CUTS_EARLY
"""What several builders can do: those that find the plane of least cost; those of them that accept any cost; and those that
split at medians."""

KDTREE_BUILDERS: dict[str, KdTreeBuilder] = {
    builder.name: builder
    for builder in (
        KdTreeBuilder("in_place", f"{CHOI}, in-place", in_place.build, MIN_COST, on_cuda=in_place.is_by_levels),
        KdTreeBuilder("nested", f"{CHOI}, nested", classic("kdtree.nested.nested"), MIN_COST),
        KdTreeBuilder(
            "binned",
            "Shevtsov, Soupikov, Kapustin: Highly parallel fast KD-tree construction (2007)",
            binned.build,
            ANY_COST | BuilderCapabilities.CLUSTERS,
        ),
        KdTreeBuilder(
            "streaming",
            "Popov, Guenther, Seidel, Slusallek: Experiences with streaming construction of SAH KD-trees (2006)",
            classic("kdtree.streaming"),
            MIN_COST,
        ),
        KdTreeBuilder(
            "adaptive_sampling",
            "Hunt, Mark, Stoll: Fast kd-tree construction with an adaptive error-bounded heuristic (2006)",
            classic("kdtree.adaptive_sampling"),
            ANY_COST | BuilderCapabilities.CUTS_EARLY | BuilderCapabilities.CHOOSES_AXES,
        ),
        KdTreeBuilder(
            "lazy",
            "Hunt, Mark, Fussell: Fast and lazy build of acceleration structures from scene hierarchies (2007)",
            lazy.build,
            MIN_COST,
            start=lazy.start,
        ),
        KdTreeBuilder(
            "sweep", f"{WALD_HAVRAN}, O(N log N)", classic("kdtree.sweep"), MIN_COST | BuilderCapabilities.CUTS_EARLY
        ),
        KdTreeBuilder(
            "sorting_sweep",
            f"{WALD_HAVRAN}, O(N log^2 N)",
            classic("kdtree.sorting_sweep"),
            ANY_COST | BuilderCapabilities.CUTS_EARLY,
        ),
        KdTreeBuilder(
            "naive",
            f"{WALD_HAVRAN}, O(N^2)",
            classic("kdtree.naive"),
            ANY_COST | BuilderCapabilities.CUTS_EARLY,
            max_triangles=5000,
        ),
        KdTreeBuilder(
            "between_medians",
            "MacDonald, Booth: Heuristics for ray tracing using space subdivision (1990)",
            classic("kdtree.between_medians"),
            MEDIANS,
        ),
        KdTreeBuilder("spatial_median", FUSSELL, classic("kdtree.medians", "build_spatial"), MEDIANS),
        KdTreeBuilder("object_median", FUSSELL, classic("kdtree.medians", "build_object"), MEDIANS),
    )
}

NATIVE = "depth_first"
"""The order in which builders write nodes; in that order a left child needs no index, and nodes are not in pairs."""

LAYOUTS: dict[str, Callable] = {
    name: classic("kdtree.node_layouts", f"place_{name}")
    for name in ("random", "breadth_first", NATIVE, "subtrees", "pages", "van_emde_boas")
}
"""Name -> (unpacked tree) -> (nodes,) position of each inner node's left child, an even number from 2 on; the root is at 0."""

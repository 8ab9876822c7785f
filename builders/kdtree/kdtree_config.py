"""Configuration of a build of a kd-tree."""

from dataclasses import dataclass, field

from wrt.builders.cost import SplitCost, SurfaceAreaCost
from wrt.builders.tree import StopLimits, StopRules
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.layout.kdtree_nodes import MAX_INDEX

LONGEST = "longest"
ROUND_ROBIN = "round_robin"
AXES = {LONGEST: "the node's longest axis", ROUND_ROBIN: "x, y, z in turn, level by level"}
"""The axis of a median split, by name."""

ALL_AXES = "all"
SEARCHED_AXES = {
    ALL_AXES: "all three",
    LONGEST: "the node's longest axis, and the others if no plane on it divides the node",
    "mixed": "the longest axis in nodes of more than 1,000 triangles, all three in the others",
}
"""The axes on which adaptive samples are taken, by name."""

CELL_TESTS = {
    "none": "only boxes decide which cells a triangle is in",
    "leaves": "triangles that do not meet a leaf are removed from the finished tree",
    "nodes": "triangles that do not meet a node are left out while the tree is built",
}
"""Where triangles themselves are tested against cells, by name."""

PRICED, EARLY, LATE, BOTH = "priced", "early", "late", "both"
EMPTY_SPACE = {
    PRICED: "planes that cut off empty space cost less, by a factor, and compete with all others",
    EARLY: "a large empty slab of a node is cut off before other planes are tried",
    LATE: "empty slabs of the leaves of the finished tree are cut off if that lowers the cost",
    BOTH: "early and late",
}
"""How empty space is cut off, by name. All but the first are in addition to it."""

GRID, MESHES, PREVIOUS, GROUPS = "grid", "meshes", "previous", "groups"
HIERARCHIES = {
    GRID: "triangles are sorted into the cells of a grid",
    MESHES: "the meshes of the scene and their boxes, as long as these divide it; else as grid",
    PREVIOUS: "the clusters of the previous frame, as long as they have not grown too much; in the first frame as grid",
    GROUPS: "groups of groups of meshes and their boxes, opened where rays go, as long as these divide the scene; else as grid",
}
"""The hierarchy of boxes from which a lazy tree is built, by name."""

MAX_RESAMPLINGS = 4
"""Most scans of a node after the first; each of them leaves fewer intervals."""

MAX_MEDIAN_LEVELS = 12
"""Most levels that are split at medians."""

MIXED_FROM = 1000
"""Triangles above which only the longest axis is searched with "mixed"."""


@dataclass(frozen=True)
class KdTreeConfig:
    """Cost model and stop rules, the same for every kd-tree builder.

    Attributes:
        cost: the cost of splits and leaves.
        stop: when a node becomes a leaf.
        axis: key in `AXES`, for builders that split at a median; the others try all axes.
        split_clipping: whether triangles are clipped to the cells that contain them, for builders that support it (`clipping`).
        searched_axes: key in `SEARCHED_AXES`, for the builder that takes adaptive samples.
        resamplings: scans after the first, 1 to `MAX_RESAMPLINGS`, for the builder that takes adaptive samples.
        median_levels: levels that are split at the median of the triangles before costs decide, 0 to `MAX_MEDIAN_LEVELS`, for
            the builder that bins.
        cell_tests: key in `CELL_TESTS`; builders carry out "nodes", and `wrt.builders.classics.kdtree.postprocess` "leaves".
        empty_space: key in `EMPTY_SPACE`; builders carry out "early", and `wrt.builders.classics.kdtree.postprocess` "late".
        hierarchy: key in `HIERARCHIES`, for the lazy builder.

    Raises:
        ValueError: a number out of its range, unknown axis or axes, tests of cells, way to cut off empty space or hierarchy, or
            tests of cells in addition to clipping.
    """

    cost: SurfaceAreaCost = field(default_factory=SurfaceAreaCost)
    stop: StopRules = field(default_factory=StopRules)
    axis: str = LONGEST
    split_clipping: bool = False
    searched_axes: str = ALL_AXES
    resamplings: int = 1
    median_levels: int = 0
    cell_tests: str = "none"
    empty_space: str = PRICED
    hierarchy: str = GRID

    def __post_init__(self) -> None:
        if self.axis not in AXES:
            raise ValueError(f"axis is {self.axis!r}; choose from {', '.join(AXES)}")
        if self.searched_axes not in SEARCHED_AXES:
            raise ValueError(f"searched_axes is {self.searched_axes!r}; choose from {', '.join(SEARCHED_AXES)}")
        for name, max_value, min_value in (("resamplings", MAX_RESAMPLINGS, 1), ("median_levels", MAX_MEDIAN_LEVELS, 0)):
            if not min_value <= getattr(self, name) <= max_value:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be from {min_value} to {max_value}")
        if self.cell_tests not in CELL_TESTS:
            raise ValueError(f"cell_tests is {self.cell_tests!r}; choose from {', '.join(CELL_TESTS)}")
        if self.empty_space not in EMPTY_SPACE:
            raise ValueError(f"empty_space is {self.empty_space!r}; choose from {', '.join(EMPTY_SPACE)}")
        if self.hierarchy not in HIERARCHIES:
            raise ValueError(f"hierarchy is {self.hierarchy!r}; choose from {', '.join(HIERARCHIES)}")
        if self.split_clipping and self.cell_tests != "none":
            raise ValueError("split_clipping tests triangles against all cells already; leave cell_tests out, or clipping off")

    def rules(self, triangles: TriangleBoxes) -> tuple[SplitCost, StopLimits]:
        """Cost model and stop rules of a build from these triangles, for kernels."""
        return self.cost.struct(), self.stop.limits(triangles.count, triangles.size)

    @property
    def tests_nodes(self) -> bool:
        """Whether a build tests triangles that straddle a plane against both children's cells."""
        return self.split_clipping or self.cell_tests == "nodes"

    @property
    def cuts_early(self) -> bool:
        """Whether a build cuts off large empty slabs before it searches for planes."""
        return self.empty_space in (EARLY, BOTH)

    @property
    def cuts_late(self) -> bool:
        """Whether empty slabs of the finished tree's leaves are cut off."""
        return self.empty_space in (LATE, BOTH)

    @property
    def longest_from(self) -> int:
        """Triangles of a node from which on only its longest axis is searched (`searched_axes`)."""
        return {ALL_AXES: MAX_INDEX + 1, LONGEST: 0}.get(self.searched_axes, MIXED_FROM + 1)

"""References as a node's list: the common part of builders that scan a node's triangles instead of sorting them.

A node has one list, of the references (`wrt.builders.triangle_references`) of its triangles, in the order of their ids.
Partition moves every reference to the side or sides of the plane on which its box lies, and computes the boxes of both sides in
the same pass. The counts of a split may be estimates (bins, samples); those of the children are counted here, by the plane
itself.
"""

from functools import cache

import warp as wp

from wrt.builders.core.subtrees import Frame, Parts, Task
from wrt.builders.cost import Split
from wrt.builders.triangle_references import write_order
from wrt.kernels.layout.struct_arrays import with_known_layout
from wrt.kernels.runtime import native


@wp.struct
class SearchRules:
    """Options of searches. Each search uses some of them."""

    bins: int
    """Bins per axis."""
    sampled: int
    """Triangles of a node from which on only a sample of them is counted; 0: all are counted."""
    round_robin: bool
    """Whether the split axis alternates by level; otherwise the longest axis is split."""
    longest_from: int
    """Triangles of a node from which on only its longest axis is searched."""
    resamplings: int
    """Scans after the first, for searches by adaptive samples."""


@wp.struct
class ReferenceLists:
    """Lists of all tasks, each in its own range, and memory for the search."""

    reference: wp.array(dtype=float)
    """8 floats per entry."""
    counter: wp.array2d(dtype=int)
    """(tasks, counters) bins of each task."""
    value: wp.array2d(dtype=float)
    """(tasks, values) scratch of each task's search."""
    rules: SearchRules
    vertices: wp.array(dtype=wp.vec3)
    """The mesh, for builds that clip."""
    faces: wp.array(dtype=wp.vec3i)
    pad: float
    """Enlargement of cells and boxes for clipping, in scene units."""
    shrinks: bool
    """Whether clipped triangles get the boxes of their parts."""


@with_known_layout
@wp.struct
class Sides:
    """Result of a partition of a range: counts and boxes on both sides of the plane."""

    left: int
    right: int
    left_low: wp.vec3
    left_high: wp.vec3
    right_low: wp.vec3
    right_high: wp.vec3


@native.func_native(
    "scan.h",
    "const float* from = references.data + (size_t)begin * 8;\n"
    "wrt::measure_sides(from, count, axis, position, planar_left, sides);",
)
def measure_sides(
    references: wp.array(dtype=float),
    begin: int,
    count: int,
    axis: int,
    position: float,
    planar_left: bool,
    sides: wp.ref[Sides],
):
    """Counts the references of a range on both sides of a plane, and computes their boxes."""


@native.func_native(
    "scan.h",
    "const float* from = references.data + (size_t)begin * 8;\n"
    "float *left = target.data + (size_t)to_left * 8, *right = target.data + (size_t)to_right * 8;\n"
    "wrt::move_range(from, count, split.axis, split.position, split.planar_left, left, right, sides);",
)
def move_range(
    references: wp.array(dtype=float),
    begin: int,
    count: int,
    split: Split,
    target: wp.array(dtype=float),
    to_left: int,
    to_right: int,
    sides: wp.ref[Sides],
):
    """Moves a range to the two sides of a plane, in order. If the target is the source, one side may begin where the range
    begins: it is compacted in place."""


@wp.func
def set_list(frame: wp.ref[Frame], first: int, count: int, inner_low: wp.vec3, inner_high: wp.vec3):
    """Sets the list of a node."""
    frame.first[0] = first
    frame.count[0] = count
    frame.triangles = count
    frame.inner_low = wp.max(frame.low, inner_low)
    frame.inner_high = wp.min(frame.high, inner_high)


@wp.func
def keep_lists(lists: ReferenceLists, split: Split, sides: Sides, left: wp.ref[Frame], right: wp.ref[Frame]):
    """Gives the children what was moved."""
    set_list(left, left.first[0], sides.left, sides.left_low, sides.left_high)
    set_list(right, right.first[0], sides.right, sides.right_low, sides.right_high)


@cache
def partition_by(finish: wp.Function) -> wp.Function:
    """The phases "classify" and "partition", in one pass over the references; finish: as `keep_lists`, sets the lists of both
    children, which begin at their `first`."""

    @wp.func
    def partition(lists: ReferenceLists, task: Task, frame: Frame, split: Split, left: wp.ref[Frame], right: wp.ref[Frame]):
        append_left = split.left < split.right
        begin = frame.first[0]
        left.first[0] = wp.where(append_left, frame.top, begin)
        right.first[0] = wp.where(append_left, begin, frame.top)
        sides = Sides()
        source = lists.reference
        move_range(source, begin, frame.count[0], split, source, left.first[0], right.first[0], sides)
        finish(lists, split, sides, left, right)
        top = frame.top + wp.where(append_left, left.triangles, right.triangles)
        # no waiting node has lists behind `top`; those of the right child, or of one further up, are in front of it
        left.top = top
        right.top = wp.where(append_left, frame.top, top)

    return partition


partition = partition_by(keep_lists)
"""By the boxes of triangles."""


@wp.func
def emit_leaf(lists: ReferenceLists, task: Task, frame: Frame, parts: Parts, begin: int):
    """Phase "emit" of a leaf: lists the node's triangles by id."""
    write_order(lists.reference, frame.first[0], frame.count[0], parts.primitive, begin)

"""A few instances move: all that changes on the host is written by one call.

Maps, boxes, placements and the boxes of the nodes above are so little work that Python around it takes longer than the work.
`wrt.instances.few_moves` copies the old arrays and calls this kernel once.
"""

import warp as wp

from wrt.kernels.layout.instance_maps import Placement
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.traversal.two_level.instance_bounds import (
    BoundedInstances,
    CoverPoints,
    bound_instance,
    inverse_map,
    linear_part,
)

EXTREMES = 8
"""Numbers that say where all boxes are: lowest x, y, z, highest x, y, z, the greatest norm, the least size."""

NODES = wp.constant(8)
"""Place of the surface of the boxes of nodes, after those numbers."""

INSTANCES = wp.constant(9)
"""Place of the surface of the boxes of instances."""


@wp.struct
class Moves:
    """M instances that move, and the frame of the scene."""

    rows: wp.array(dtype=int)
    """(M,) their numbers."""
    transforms: wp.array(dtype=wp.mat44d)
    masks: wp.array(dtype=wp.uint32)
    center: wp.vec3d
    """Of the scene."""
    rounding: wp.float64
    """By which boxes are widened before they become float32."""


@wp.struct
class BoxTree:
    """The upper level on the host (`wrt.builders.bvh.instance_forest`): nodes of W children."""

    bounds: wp.array(dtype=float)
    """(nodes * 6 W,) boxes of the children."""
    leaf_first: wp.array(dtype=int)
    """(N + 1,) first of each instance's `leaf_places`."""
    leaf_places: wp.array(dtype=int)
    """Lanes in which instances are, as node W + lane."""
    above_first: wp.array(dtype=int)
    """(nodes + 1,) first of each node's `above_places`."""
    above_places: wp.array(dtype=int)
    """Lanes in which nodes are. A node has a greater number than those above it."""
    touched: wp.array(dtype=wp.uint8)
    """(nodes,) zeros."""
    width: int
    """W."""


@wp.func_native("""
    const int down = upwards ? 1 : -1;
    const int bits = __builtin_bit_cast(int, value);
    return value == 0.0f ? __builtin_bit_cast(float, upwards ? 1 : (int)0x80000001u)
        : __builtin_bit_cast(float, value > 0.0f ? bits + down : bits - down);
""")
def next_float(value: float, upwards: bool) -> float:
    """The next float32 above or below a finite one."""


@wp.func
def lane_box(tree: BoxTree, node: int, axis: int):
    """Lowest (axis 0 to 2) or highest (3 to 5) coordinate of all children of a node."""
    begin = (node * 6 + axis) * tree.width
    found = tree.bounds[begin]
    for lane in range(1, tree.width):
        other = tree.bounds[begin + lane]
        if (axis < 3 and other < found) or (axis >= 3 and other > found):
            found = other
    return found


@wp.func
def refit(tree: BoxTree):
    """Computes the boxes above the touched nodes."""
    for step in range(tree.touched.shape[0]):
        node = tree.touched.shape[0] - 1 - step
        if tree.touched[node] != wp.uint8(0):
            for k in range(tree.above_first[node], tree.above_first[node + 1]):
                place = tree.above_places[k]
                above = place / tree.width
                for axis in range(6):
                    tree.bounds[(above * 6 + axis) * tree.width + place % tree.width] = lane_box(tree, node, axis)
                tree.touched[above] = wp.uint8(1)


@wp.func
def surface(tree: BoxTree, places: wp.array(dtype=int)):
    """Half the surface of the boxes of some lanes together."""
    total = wp.float64(0.0)
    for k in range(places.shape[0]):
        node = places[k] / tree.width
        begin = node * 6 * tree.width + places[k] % tree.width
        size = wp.vec3d()
        for axis in range(3):
            low = wp.float64(tree.bounds[begin + axis * tree.width])
            size[axis] = wp.float64(tree.bounds[begin + (axis + 3) * tree.width]) - low
        total += size[0] * size[1] + size[1] * size[2] + size[2] * size[0]
    return total


@exact_kernel
def move_instances(
    first: int,
    moves: Moves,
    cover: CoverPoints,
    bounded: BoundedInstances,
    table: wp.array(dtype=Placement),
    low: wp.array(dtype=wp.vec3),
    high: wp.array(dtype=wp.vec3),
    tree: BoxTree,
    extremes: wp.array(dtype=wp.float64),
):
    """Writes what changes when instances move. Item: all of them, in turn.

    bounded, table, low, high, tree.bounds: copies of the old arrays. low, high: (N,) boxes as float32, rounded outwards.
    extremes: (`EXTREMES` + 2,) of all boxes, and their surfaces.
    """
    count = table.shape[0]
    for k in range(moves.rows.shape[0]):
        i = moves.rows[k]
        placement = table[i]
        placement.to_scene = linear_part(moves.transforms[k])
        placement.to_object = inverse_map(placement.to_scene)
        bound_instance(moves.transforms[k], placement.to_object, placement.geometry, cover, i, bounded)
        placement.origin = bounded.origin[i] - moves.center
        placement.mask = moves.masks[k]
        table[i] = placement
        lowest = wp.vec3()
        highest = wp.vec3()
        for axis in range(3):
            center = moves.center[axis]
            lowest[axis] = next_float(wp.float32(bounded.corners[axis * count + i] - (center + moves.rounding)), False)
            upper = bounded.corners[(axis + 3) * count + i] - (center - moves.rounding)
            highest[axis] = next_float(wp.float32(upper), True)
        low[i] = lowest
        high[i] = highest
        for leaf in range(tree.leaf_first[i], tree.leaf_first[i + 1]):
            place = tree.leaf_places[leaf]
            node = place / tree.width
            for axis in range(3):
                tree.bounds[(node * 6 + axis) * tree.width + place % tree.width] = lowest[axis]
                tree.bounds[(node * 6 + axis + 3) * tree.width + place % tree.width] = highest[axis]
            tree.touched[node] = wp.uint8(1)
    refit(tree)
    for axis in range(6):
        found = bounded.corners[axis * count]
        for i in range(1, count):
            other = bounded.corners[axis * count + i]
            if (axis < 3 and other < found) or (axis >= 3 and other > found):
                found = other
        extremes[axis] = found
    worst = wp.float64(0.0)
    smallest = wp.float64(wp.inf)
    for i in range(count):
        worst = wp.max(worst, bounded.norms[i])
        size = wp.float64(0.0)
        for axis in range(3):
            size = wp.max(size, bounded.corners[(axis + 3) * count + i] - bounded.corners[axis * count + i])
        smallest = wp.min(smallest, size)
    extremes[6] = worst
    extremes[7] = smallest
    extremes[NODES] = surface(tree, tree.above_places)
    extremes[INSTANCES] = surface(tree, tree.leaf_places)

"""Which leaf of a BVH reports a crossing, if a triangle is in several leaves.

**Problem.** After spatial splits (`wrt.builders.bvh.spatial.spatial_build`) a triangle is in several leaves, whose boxes are
around its parts. The boxes overlap a little, and those of other triangles in the leaves enlarge them, so a ray may find the
same crossing in two leaves.

**Idea.** As in a kd-tree (`wrt.kernels.traversal.crossings`): of the places that list the triangle, the first whose leaf has an
interval on the ray that contains the t of the hit owns the crossing. All leaves that might be the owner are below boxes that
contain t, so a search from the root with the range [t, t] finds them. The walk visits all of them: its range contains t.

**Cost.** A search around a point of the ray for each crossing
(notebooks/records/2026-11-23-spatial-splits-and-compact-subtrees.md).
"""

from functools import cache

import warp as wp

from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.unchecked import load_int, store_int
from wrt.kernels.simd.box_lanes import intersected_boxes
from wrt.kernels.simd.boxes import RaySlabs
from wrt.kernels.simd.lanes import lanes, lowest_bit
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


@cache
def owns_shared(width: int, levels: int) -> wp.Function:
    """`wp.func(tree, triangles, slot, slabs, t) -> bool`: whether the place `slot` of a leaf reports the crossing at t of the
    triangle that it lists.

    Args:
        width: children of a node and triangles of a block, at least 2.
        levels: greatest number of inner nodes on a path.
    """
    test_boxes, Lanes, room = intersected_boxes(width), lanes(width), levels * (width - 1) + 1

    @wp.func
    def owns(tree: WideNodes, triangles: TriangleBlocks, slot: int, slabs: wp.ref[RaySlabs], t: float):
        waiting = wp.zeros(shape=(room,), dtype=int)
        store_int(waiting, 0, 0)
        size = int(1)
        first = bool(True)
        inside = bool(False)  # a leaf is tested whether or not its own part of the ray contains t
        primitive = triangles.primitive[slot]
        while size > 0 and first:
            size -= 1
            node = load_int(waiting, size)
            entry = Lanes()
            mask = test_boxes(tree.bounds, node, slabs, t, t, entry)
            while mask != wp.uint32(0):
                child = load_int(tree.child, node * wp.static(width) + lowest_bit(mask))
                mask = mask & (mask - wp.uint32(1))
                if child >= 0:
                    store_int(waiting, size, child)
                    size += 1
                else:
                    place = bvh.first_block(child) * wp.static(width)
                    end = place + bvh.leaf_triangles(child)
                    inside = inside or (place <= slot and slot < end)
                    end = wp.min(end, slot)
                    while place < end:
                        if triangles.primitive[place] == primitive:
                            first = False
                        place += 1
        return first and inside

    return owns

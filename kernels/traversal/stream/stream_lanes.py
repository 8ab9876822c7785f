"""The lane loops of streams: lists of rays, filtered by boxes and planes, and their compaction.

The arithmetic is that of `wrt.kernels.simd.boxes`: `slab_interval` for the boxes of a wide node, `cross_plane` for the plane of
a kd-tree's node.

A list is compacted without branches: every number is written to the end of the new list, and the end advances only past those
that stay. With AVX-512 one instruction does that for 16 numbers. With AVX2 eight numbers at a time are permuted, by an index
vector that a table holds for each of the 256 masks. (The instructions pdep and pext make the same vector, but take tens of
cycles on Zen 1 and 2.) All methods write up to 16 numbers past the end, so every list has `LIST_LANES` spare elements. A list
may be compacted in place, because the writes never pass the reads.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.runtime import native
from wrt.kernels.traversal.stream.stream_candidates import PAIRS, Pairs
from wrt.kernels.traversal.stream.stream_kernel import LIST_LANES, stream_ray


@wp.struct
class RayIntervals:
    """A list of rays of a stream, or a stack of lists, with the interval of t in which each ray is in the list's node."""

    rays: wp.array(dtype=int)
    """Numbers of the rays in the stream."""
    entry: wp.array(dtype=float)
    leave: wp.array(dtype=float)


@wp.func_native("list.rays = rays; list.entry = entry; list.leave = leave;")
def set_arrays(
    list: wp.ref[RayIntervals], rays: wp.array(dtype=int), entry: wp.array(dtype=float), leave: wp.array(dtype=float)
):
    """Makes a list use local arrays; Warp assigns them to no field of a struct."""


@cache
def filter_boxes(width: int, triangle_test: str, order: int) -> wp.Function:
    """`func(tree, node, rays, words, listed, keys, row, leaves) -> survivors`.

    Filters the list of `listed[1]` words, from words[listed[0]] on, by the W boxes of a node. A ray is active in a child if its
    interval, up to its best hit, meets the child's box; the bit of the child is then set in the ray's word above its number.
    Words without a bit are removed in place. keys[row ..] become keys of the inner children that a ray meets: of the ray that
    enters first (`NEAR`), of the one that enters last, in reverse (`FAR`), or the number of the lane (`NONE`). `leaves` becomes
    the bits of the leaves that a ray meets.
    """
    StreamRay = stream_ray(triangle_test)
    arguments = "tree.bounds.data, tree.child.data, node, rays.data, words.data + listed[0], listed[1], keys.data + row, leaves"

    @native.func_native("stream.h", f"return wrt::filter_boxes<{width}, wrt::Order({order})>({arguments});")
    def filter_boxes_native(
        tree: wp.ref[WideNodes],
        node: int,
        rays: wp.array(dtype=StreamRay),
        words: wp.array(dtype=int),
        listed: wp.vec2i,
        keys: wp.array(dtype=int),
        row: int,
        leaves: wp.ref[wp.uint32],
    ) -> int: ...

    return filter_boxes_native


@cache
def list_leaves(width: int) -> wp.Function:
    """`func(children, node, words, first, count, leaves, listed, pairs) -> int`: lists the pairs of a node's leaves, and of the
    rays of its list from number `listed` on that meet them.

    leaves: bits of the leaves. It stops when `pairs` may become full, and continues when it is called again. Returns the number
    of pairs.
    """

    arguments = "children.data, node, words.data + first, count, leaves, listed, pairs.rays.c, pairs.leaves.c"

    @native.func_native("stream.h", f"return wrt::list_leaves<{width}, {PAIRS}>({arguments});")
    def list_leaves_native(
        children: wp.array(dtype=int),
        node: int,
        words: wp.array(dtype=int),
        first: int,
        count: int,
        leaves: wp.uint32,
        listed: wp.ref[int],
        pairs: wp.ref[Pairs],
    ) -> int: ...

    return list_leaves_native


@native.func_native("stream.h", f"return wrt::collect_words<{LIST_LANES}>(words.data + first, count, lanes);")
def collect_words(words: wp.array(dtype=int), first: int, count: int, lanes: wp.uint32) -> int:
    """Appends those words of a list whose rays are active in one of these children behind the list; returns their number.

    lanes: bits of the children.
    """


@cache
def next_child(width: int) -> wp.Function:
    """`func(keys, row, last) -> key`: the least of W keys above `last`.

    Keys are never removed from the row, because a vector load just after a store to one of its lanes waits for the store.
    """

    @native.func_native("box.h", f"return wrt::next_key<{width}>(keys.data + row, last);")
    def next_child_native(keys: wp.array(dtype=int), row: int, last: int) -> int: ...

    return next_child_native


@cache
def filter_plane(triangle_test: str) -> wp.Function:
    """`func(axis, position, rays, list, count, stack, top, far_count) -> near count`.

    Filters a list of rays with one sign along the axis (`RayIntervals`) by a plane. The rays of the near child replace the
    list, those of the far child are written to the stack from `top` on. The formulas are those of the step of
    `wrt.kernels.traversal.single.single_kdtree`.
    """
    StreamRay = stream_ray(triangle_test)

    arguments = "axis, position, rays.data, list, count, stack, top, far_count"

    @native.func_native("stream.h", f"return wrt::filter_plane<{LIST_LANES}>({arguments});")
    def filter_plane_native(
        axis: int,
        position: float,
        rays: wp.array(dtype=StreamRay),
        list: wp.ref[RayIntervals],
        count: int,
        stack: wp.ref[RayIntervals],
        top: int,
        far_count: wp.ref[int],
    ) -> int: ...

    return filter_plane_native


@cache
def filter_hits(triangle_test: str) -> wp.Function:
    """`func(rays, stack, top, count, list) -> count`: pops a list from the stack.

    Rays whose best hit lies before their entry are removed, and the other intervals are clipped to the best hit.
    """
    StreamRay = stream_ray(triangle_test)

    @native.func_native("stream.h", f"return wrt::filter_hits<{LIST_LANES}>(rays.data, stack, top, count, list);")
    def filter_hits_native(
        rays: wp.array(dtype=StreamRay),
        stack: wp.ref[RayIntervals],
        top: int,
        count: int,
        list: wp.ref[RayIntervals],
    ) -> int: ...

    return filter_hits_native

"""The lane loops of streams: lists of rays (`wrt.kernels.traversal.stream.stream_lists`), filtered by boxes and planes.

The arithmetic is that of `wrt.kernels.simd.boxes`: `slab_interval` for the boxes of a wide node, `cross_plane` for the plane of
a kd-tree's node.
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.box_lanes import NO_CHILD_CONSTANT
from wrt.kernels.simd.lanes import FOR_LANES
from wrt.kernels.traversal.stream.stream_kernel import RAY_BITS, stream_ray
from wrt.kernels.traversal.stream.stream_lists import BLOCK_LANES, LISTS, PAIRS, Pairs, RayIntervals

exact_module(__name__)

NONE, NEAR, FAR = range(3)
"""Which child of a node comes first: any, the nearest, the farthest."""

_FILTER_BOXES = """
    const float* box = &bounds.data[(size_t)node * (6 * W)];
    const int* child = &children.data[(size_t)node * W];
    int* list = words.data + first;
    int* key = keys.data + row;
    int least[W];
    unsigned are_leaves = 0, reached = 0;
    for (int i = 0; i < W; ++i) { least[i] = NO_CHILD; are_leaves |= child[i] < 0 ? 1u << i : 0u; }
    // read as volatile where registers have 8 lanes: Clang would make a vector of the three signs, and take it apart again
    auto wrt_sign = [](const float& x) {
        return W < 16 ? *(const volatile int*)&x >> 31 : __builtin_bit_cast(int, x) >> 31;
    };
    int kept = 0;
    for (int j = 0; j < count; ++j) {
        const int k = list[j] & RAY;
        const auto& ray = rays.data[k];
        const float ix = ray.slabs.inverse.c[0], iy = ray.slabs.inverse.c[1], iz = ray.slabs.inverse.c[2];
        const float* const inverse = ray.slabs.inverse.c;
        const int sx = wrt_sign(inverse[0]) & 3 * W, sy = wrt_sign(inverse[1]) & 3 * W, sz = wrt_sign(inverse[2]) & 3 * W;
        const float *near_x = box + sx, *near_y = box + W + sy, *near_z = box + 2 * W + sz;
        const float *far_x = box + 3 * W - sx, *far_y = box + 4 * W - sy, *far_z = box + 5 * W - sz;
        const float in_x = ray.slabs.origin_in.c[0], in_y = ray.slabs.origin_in.c[1], in_z = ray.slabs.origin_in.c[2];
        const float out_x = ray.slabs.origin_out.c[0], out_y = ray.slabs.origin_out.c[1], out_z = ray.slabs.origin_out.c[2];
        const float t_min = ray.t_min, t_max = ray.best.t;
        int hit[L] = {};
        WRT_FOR_LANES(i) {
            float enter = t_min, leave = t_max, t;
            t = (near_x[i] - in_x) * ix; enter = t > enter ? t : enter;
            t = (near_y[i] - in_y) * iy; enter = t > enter ? t : enter;
            t = (near_z[i] - in_z) * iz; enter = t > enter ? t : enter;
            t = (far_x[i] - out_x) * ix; leave = t < leave ? t : leave;
            t = (far_y[i] - out_y) * iy; leave = t < leave ? t : leave;
            t = (far_z[i] - out_z) * iz; leave = t < leave ? t : leave;
            hit[i] = enter <= leave ? -1 : 0;
            if (ORDER != NONE) {
                const int entry = __builtin_bit_cast(int, enter);
                int order = ((ORDER == FAR ? 0x7f7fffff - entry : entry) & -W) | i;
                order = enter <= leave ? order : NO_CHILD;
                least[i] = order < least[i] ? order : least[i];
            }
        }
        const unsigned bits = wrt_bits(hit);
        list[kept] = (int)(bits << RAY_BITS) | k;
        kept += bits != 0u;
        reached |= bits;
    }
    const unsigned inner = reached & ~are_leaves;
    for (int i = 0; i < W; ++i) { key[i] = inner >> i & 1u ? (ORDER == NONE ? i : least[i]) : NO_CHILD; }
    leaves = reached & are_leaves;
    return kept;
"""


@cache
def filter_boxes(width: int, triangle_test: str, order: int) -> wp.Function:
    """`func(bounds, children, node, rays, words, first, count, keys, row, leaves) -> survivors`.

    Filters the list words[first .. first + count - 1] by the W boxes of a node. A ray is active in a child if its interval, up
    to its best hit, meets the child's box; the bit of the child is then set in the ray's word above its number. Words without a
    bit are removed in place. keys[row ..] become keys of the inner children that a ray meets: of the ray that enters first
    (`NEAR`), of the one that enters last, in reverse (`FAR`), or the number of the lane (`NONE`). `leaves` becomes the bits of
    the leaves that a ray meets.
    """
    StreamRay = stream_ray(triangle_test)
    constants = f"{FOR_LANES}    constexpr int W = {width}, RAY_BITS = {RAY_BITS}, RAY = (1 << RAY_BITS) - 1;\n"
    constants += f"    constexpr int NO_CHILD = {NO_CHILD_CONSTANT}, ORDER = {order}, NONE = {NONE}, FAR = {FAR};\n"

    @wp.func_native(constants + BLOCK_LANES + _FILTER_BOXES)
    def filter_boxes_native(
        bounds: wp.array(dtype=float),
        children: wp.array(dtype=int),
        node: int,
        rays: wp.array(dtype=StreamRay),
        words: wp.array(dtype=int),
        first: int,
        count: int,
        keys: wp.array(dtype=int),
        row: int,
        leaves: wp.ref[wp.uint32],
    ) -> int: ...

    return filter_boxes_native


_LIST_LEAVES = """
    const int* child = &children.data[(size_t)node * W];
    const int* list = words.data + first;
    int leaf[L] = {}, paired = 0, j = listed;
    for (int c = 0; c < W; ++c) { leaf[c] = child[c]; }
    for (; j < count && paired <= PAIRS; ++j) {
        const int word = list[j], k = word & ((1 << RAY_BITS) - 1);
        WRT_FOR(L, i) { pairs.rays.c[paired + i] = k; }
        paired += wrt_append(pairs.leaves.c + paired, leaf, (unsigned)word >> RAY_BITS & leaves);
    }
    listed = j;
    return paired;
"""


@cache
def list_leaves(width: int) -> wp.Function:
    """`func(children, node, words, first, count, leaves, listed, pairs) -> int`: lists the pairs of a node's leaves, and of the
    rays of its list from number `listed` on that meet them.

    leaves: bits of the leaves. It stops when `pairs` may become full, and continues when it is called again. Returns the number
    of pairs.
    """

    @wp.func_native(
        f"{FOR_LANES}    constexpr int W = {width}, PAIRS = {PAIRS}, RAY_BITS = {RAY_BITS};{BLOCK_LANES}{_LIST_LEAVES}"
    )
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


@wp.func_native(
    LISTS
    + """
    const int* list = words.data + first;
    int* to = words.data + first + count;
    int size = 0;
    for (int f = 0; f < count; f += L) {
        int flag[L];
        WRT_FOR(L, i) { flag[i] = (int)((unsigned)list[f + i] >> RAY_BITS & lanes) & (f + i < count ? -1 : 0); }
        size += wrt_append(to + size, list + f, wrt_bits(flag));
    }
    return size;
"""
)
def collect_words(words: wp.array(dtype=int), first: int, count: int, lanes: wp.uint32) -> int:
    """Appends those words of a list whose rays are active in one of these children behind the list; returns their number.

    lanes: bits of the children.
    """
    ...


_NEXT_CHILD = """
    const int* key = keys.data + row;
    int nearest = NO_CHILD;
    WRT_FOR_LANES(i) { const int k = key[i] > last ? key[i] : NO_CHILD; nearest = k < nearest ? k : nearest; }
    return nearest;
"""


@cache
def next_child(width: int) -> wp.Function:
    """`func(keys, row, last) -> key`: the least of W keys above `last`.

    Keys are never removed from the row, because a vector load just after a store to one of its lanes waits for the store.
    """

    @wp.func_native(f"{FOR_LANES}    constexpr int W = {width}, NO_CHILD = {NO_CHILD_CONSTANT};{_NEXT_CHILD}")
    def next_child_native(keys: wp.array(dtype=int), row: int, last: int) -> int: ...

    return next_child_native


_FILTER_PLANE = """
    int *near_ray = list.rays.data, *near_from = (int*)list.entry.data, *near_to = (int*)list.leave.data;
    int *far_ray = stack.rays.data + top, *far_from = (int*)stack.entry.data + top, *far_to = (int*)stack.leave.data + top;
    int near_size = 0, far_size = 0;
    for (int f = 0; f < count; f += L) {
        int ray[L], from[L], to[L], to_near[L], from_far[L], near_flag[L], far_flag[L];
        WRT_FOR(L, i) {
            const int here = f + i < count ? -1 : 0, k = near_ray[f + i] & here;
            const float entry_i = wp::cast<float>(near_from[f + i]), leave_i = wp::cast<float>(near_to[f + i]);
            const float inverse = rays.data[k].slabs.inverse.c[axis];
            float before = (position - rays.data[k].slabs.origin_out.c[axis]) * inverse;
            float behind = (position - rays.data[k].slabs.origin_in.c[axis]) * inverse;
            before = before < leave_i ? before : leave_i;
            behind = behind > entry_i ? behind : entry_i;
            const bool visit_near = entry_i <= before;
            ray[i] = k;
            from[i] = wp::cast<int>(entry_i); to[i] = wp::cast<int>(leave_i);
            to_near[i] = wp::cast<int>(before); from_far[i] = wp::cast<int>(behind);
            near_flag[i] = visit_near ? here : 0;
            far_flag[i] = (!visit_near | (behind <= leave_i)) ? here : 0;
        }
        const unsigned near_bits = wrt_bits(near_flag), far_bits = wrt_bits(far_flag);
        wrt_append(near_ray + near_size, ray, near_bits);
        wrt_append(near_from + near_size, from, near_bits);
        near_size += wrt_append(near_to + near_size, to_near, near_bits);
        wrt_append(far_ray + far_size, ray, far_bits);
        wrt_append(far_from + far_size, from_far, far_bits);
        far_size += wrt_append(far_to + far_size, to, far_bits);
    }
    far_count = far_size;
    return near_size;
"""


@cache
def filter_plane(triangle_test: str) -> wp.Function:
    """`func(axis, position, rays, list, count, stack, top, far_count) -> near count`.

    Filters a list of rays with one sign along the axis (`RayIntervals`) by a plane. The rays of the near child replace the
    list, those of the far child are written to the stack from `top` on. The formulas are those of the step of
    `wrt.kernels.traversal.single.single_kdtree`.
    """
    StreamRay = stream_ray(triangle_test)

    @wp.func_native(LISTS + _FILTER_PLANE)
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


_FILTER_HITS = """
    const int* far_ray = stack.rays.data + top;
    const float *far_entry = stack.entry.data + top, *far_leave = stack.leave.data + top;
    int *near_ray = list.rays.data, *near_from = (int*)list.entry.data, *near_to = (int*)list.leave.data;
    int size = 0;
    for (int f = 0; f < count; f += L) {
        int ray[L], from[L], to[L], flag[L];
        WRT_FOR(L, i) {
            const int here = f + i < count ? -1 : 0, k = far_ray[f + i] & here;
            const float entry_i = far_entry[f + i], leave_i = far_leave[f + i];
            const float best = rays.data[k].best.t;
            ray[i] = k;
            from[i] = wp::cast<int>(entry_i);
            to[i] = wp::cast<int>(leave_i < best ? leave_i : best);
            flag[i] = entry_i <= best ? here : 0;
        }
        const unsigned bits = wrt_bits(flag);
        wrt_append(near_ray + size, ray, bits);
        wrt_append(near_from + size, from, bits);
        size += wrt_append(near_to + size, to, bits);
    }
    return size;
"""


@cache
def filter_hits(triangle_test: str) -> wp.Function:
    """`func(rays, stack, top, count, list) -> count`: pops a list from the stack.

    Rays whose best hit lies before their entry are removed, and the other intervals are clipped to the best hit.
    """
    StreamRay = stream_ray(triangle_test)

    @wp.func_native(LISTS + _FILTER_HITS)
    def filter_hits_native(
        rays: wp.array(dtype=StreamRay),
        stack: wp.ref[RayIntervals],
        top: int,
        count: int,
        list: wp.ref[RayIntervals],
    ) -> int: ...

    return filter_hits_native

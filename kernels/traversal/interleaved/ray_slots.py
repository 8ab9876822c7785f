"""Slots: the rays that take turns, the nodes where they are, and the loops that move them through inner nodes.

A slot is one cache line with the numbers of a ray that box tests need, and its place in the tree. The others wait in the
stream. Every slot has a stack of keys and a stack of children, `DEPTH` words behind it. At the bottom is a key that is less
than any and an empty child, so that a stack is never popped without a result.

Slots are listed by what they do next: test the boxes of an inner node, or leave the loop. All lists are filled without
branches, by writing every slot behind the end of both, and advancing one.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.bvh_nodes import EMPTY_LANE, WideNodes
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.lanes import BITS, FOR_LANES, lane_bits
from wrt.kernels.traversal.interleaved.child_order import push_sorted
from wrt.kernels.traversal.stream.stream_kernel import stream_ray
from wrt.kernels.traversal.stream.stream_lists import APPEND, Pairs
from wrt.kernels.traversal.traversal_config import CLOSEST, TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS

exact_module(__name__)

SLOTS = 64
"""Rays that take turns (notebooks/records/2026-11-22-interleaved-rays.md). At most `PAIRS` of
`wrt.kernels.traversal.stream.stream_lists`."""

LINE = 16
"""Words of a cache line."""

SPARE = 16
"""Words that a push may write beyond the children that it pushes."""


def stack_depth(config: TraversalConfig) -> int:
    """Words of a stack: the bottom, and all children that a path can push."""
    return config.stack.levels * (config.width - 1) + 2 + SPARE


def stack_stride(config: TraversalConfig) -> int:
    """Words from one slot's stacks to the next: an odd number of cache lines, so that the bottoms of all stacks, which are used
    most, are spread over the sets of a cache."""
    return (-(-2 * stack_depth(config) // LINE) | 1) * LINE


def slot_words(config: TraversalConfig) -> int:
    """Ints of memory for `walk_to_leaves`."""
    lists = 6
    return LINE + SLOTS * (LINE + config.width + stack_stride(config) + lists)


_MEMORY = """
    struct Slot { float inverse[3], in[3], out[3], t_min, t_max; int near[3], node, top; };
    int* const first_line = (int*)(((size_t)memory.data + 63) & ~(size_t)63);
    Slot* const slots = (Slot*)first_line;
    int* const keys = first_line + (sizeof(Slot) / 4) * SLOTS;
    int* const stacks = keys + W * SLOTS;
    int *const inner = stacks + STRIDE * SLOTS, *const outer = inner + SLOTS, *const at_leaf = outer + SLOTS;
    int *const idle = at_leaf + SLOTS, *const masks = idle + SLOTS, *const ray_of = masks + SLOTS;
    int inners = 0, outers = 0, leaves = 0, idles = 0, following = next;
"""
"""C++: the slots. `inner`: those before an inner node; `outer`: those before a leaf or at the end, after this pass; `at_leaf`:
those before a leaf; `idle`: those without a ray."""

_MOVES = """
    auto wrt_move = [&](int number, int word, int top) {
        Slot& slot = slots[number];
        slot.top = top;
        slot.node = word;
        const char* const node = (const char*)tree.bounds.data + (size_t)(word & ~(word >> 31)) * (24 * W);
        WRT_UNROLLED for (int b = 0; b < 24 * W; b += 64) { WRT_FETCH(node + b); }
        const int inside = word >= 0 ? 1 : 0;
        inner[inners] = number; inners += inside;
        outer[outers] = number; outers += 1 - inside;
    };
    auto wrt_pop = [&](int number, int top) {
        if (ORDERED) {
            const int limit = __builtin_bit_cast(int, slots[number].t_max) | (W - 1);  // a key has a lane in those bits
            while (stacks[top] > limit) --top;
        }
        wrt_move(number, stacks[top + DEPTH], top);
    };
    auto wrt_start = [&](int number) {
        Slot& slot = slots[number];
        const auto& ray = rays.data[following];
        for (int a = 0; a < 3; ++a) {
            slot.inverse[a] = ray.slabs.inverse.c[a];
            slot.in[a] = ray.slabs.origin_in.c[a]; slot.out[a] = ray.slabs.origin_out.c[a];
            slot.near[a] = ray.slabs.inverse.c[a] < 0.0f ? 3 * W : 0;
        }
        slot.t_min = ray.t_min; slot.t_max = ray.best.t + 0.0f;
        slot.node = 0; slot.top = number * STRIDE + 1;
        ray_of[number] = following++;
        inner[inners++] = number;
    };
    auto wrt_sort_out = [&]() {
        WRT_SCALAR for (int j = 0; j < outers; ++j) {
            const int number = outer[j], word = slots[number].node, ends = word == EMPTY ? 1 : 0;
            const char* const leaf = (const char*)records.data + (size_t)(~word >> 6) * (4 * COMPONENTS * W);
            WRT_UNROLLED for (int b = 0; b < 36 * W; b += 64) { WRT_FETCH(leaf + b); }
            at_leaf[leaves] = number; pairs.rays.c[leaves] = ray_of[number]; pairs.leaves.c[leaves] = word; leaves += 1 - ends;
            idle[idles] = number; idles += ends;
        }
        outers = 0;
        for (;;) {
            while (following < count && !(rays.data[following].best.t >= 0.0f)) ++following;  // invalid rays
            if (idles == 0 || following >= count) break;
            wrt_start(idle[--idles]);
        }
    };
"""
"""C++: `wrt_move` lists a slot before a child, `wrt_pop` before the next child of its stack, `wrt_start` before the root with
the next ray. `wrt_sort_out` lists what has left the loop, as pairs to be tested or as idle, and starts rays."""

_BEGIN = """
    if (next == 0) {
        for (int s = 0; s < SLOTS; ++s) {
            stacks[s * STRIDE] = (int)0x80000000; stacks[s * STRIDE + DEPTH] = EMPTY;
            idle[idles++] = s;
        }
    } else {
        WRT_SCALAR for (int j = 0; j < waiting; ++j) {
            const int number = at_leaf[j];
            Slot& slot = slots[number];
            slot.t_max = rays.data[ray_of[number]].best.t + 0.0f;  // turns -0 into +0: as an integer, -0 is less than any key
            wrt_pop(number, !ORDERED && slot.t_max < 0.0f ? number * STRIDE : slot.top - 1);
        }
    }
    wrt_sort_out();
"""
"""C++: all slots are idle, or their leaves have been tested."""

_PASSES = """
    while (inners > 0) {
        const int listed = inners;
        visited += listed;
        WRT_SCALAR for (int j = 0; j < listed; ++j) {
            const Slot& slot = slots[inner[j]];
            const float* box = tree.bounds.data + (size_t)slot.node * (6 * W);
            WRT_FETCH(tree.child.data + (size_t)slot.node * W);
            const float ix = slot.inverse[0], iy = slot.inverse[1], iz = slot.inverse[2];
            const int sx = slot.near[0], sy = slot.near[1], sz = slot.near[2];
            const float *near_x = box + sx, *near_y = box + W + sy, *near_z = box + 2 * W + sz;
            const float *far_x = box + 3 * W - sx, *far_y = box + 4 * W - sy, *far_z = box + 5 * W - sz;
            const float in_x = slot.in[0], in_y = slot.in[1], in_z = slot.in[2];
            const float out_x = slot.out[0], out_y = slot.out[1], out_z = slot.out[2];
            const float t_min = slot.t_min, t_max = slot.t_max;
            int* const key = keys + W * j;
            int met[L] = {};
            WRT_FOR_LANES(i) {
                float enter = t_min, leave = t_max, t;
                t = (near_x[i] - in_x) * ix; enter = t > enter ? t : enter;
                t = (near_y[i] - in_y) * iy; enter = t > enter ? t : enter;
                t = (near_z[i] - in_z) * iz; enter = t > enter ? t : enter;
                t = (far_x[i] - out_x) * ix; leave = t < leave ? t : leave;
                t = (far_y[i] - out_y) * iy; leave = t < leave ? t : leave;
                t = (far_z[i] - out_z) * iz; leave = t < leave ? t : leave;
                const int order = (__builtin_bit_cast(int, enter) & -W) | i;
                if (ORDERED) key[i] = enter <= leave ? order : -1;
                met[i] = enter <= leave ? -1 : 0;
            }
            masks[j] = (int)wrt_bits(met);
        }
        inners = 0;
        WRT_SCALAR for (int j = 0; j < listed; ++j) {
            const int number = inner[j], top = slots[number].top;
            const int* const child = tree.child.data + (size_t)slots[number].node * W;
            const unsigned mask = (unsigned)masks[j];
            PUSH
        }
        wrt_sort_out();
    }
    next = following;
    waiting = leaves;
    return leaves;
"""
"""C++: passes over the slots before inner nodes, until there are none. Box tests and pushes are loops of their own: short, so
that the processor works on several slots at a time."""

_PUSH_ORDERED = "wrt_pop(number, top + wrt_push(keys + W * j, mask, child, stacks + top) - 1);"

_PUSH_UNORDERED = """
            int word[L] = {};
            for (int i = 0; i < W; ++i) word[i] = child[i];
            // one child is visited next, the others are pushed: a load just after the store of a vector would wait for it
            const int first = *(mask ? child + wrt_lowest_bit(mask | 0x80000000u) : stacks + DEPTH + top - 1);
            wrt_move(number, first, top - (mask ? 0 : 1) + wrt_append(stacks + DEPTH + top, word, mask & (mask - 1u)));
"""


@cache
def walk_to_leaves(config: TraversalConfig) -> wp.Function:
    """`func(tree, records, rays, count, memory, next, waiting, visited, pairs) -> int`: moves all slots to leaves.

    Returns the number of pairs (ray, leaf) that it has listed, one for each ray that takes turns; 0 if the rays 0 .. count - 1
    of the stream are done. Called again, after the pairs have been tested, it goes on.

    Args (of the function): memory: `slot_words(config)` ints. next: number of rays started, initially 0. waiting: number of
    slots at leaves. visited: number of nodes visited so far, increased.
    """
    StreamRay = stream_ray(config.triangle_test)
    width, ordered = config.width, int(config.query == CLOSEST)
    head = f"""{FOR_LANES}{BITS}
    constexpr int W = {width}, SLOTS = {SLOTS}, EMPTY = {int(EMPTY_LANE)};
    constexpr int DEPTH = {stack_depth(config)}, STRIDE = {stack_stride(config)};
    constexpr int COMPONENTS = {TRIANGLE_TESTS[config.triangle_test].record.components};
    constexpr bool ORDERED = {ordered};
#if defined(__AVX512F__) && !defined(__CUDA_ARCH__)
    constexpr int L = 16;
#else
    constexpr int L = (W + 7) / 8 * 8;
#endif
{lane_bits("L")}{push_sorted(width) if ordered else APPEND}"""
    passes = _PASSES.replace("PUSH", _PUSH_ORDERED if ordered else _PUSH_UNORDERED)

    @wp.func_native(head + _MEMORY + _MOVES + _BEGIN + passes)
    def walk_native(
        tree: wp.ref[WideNodes],
        records: wp.array(dtype=float),
        rays: wp.array(dtype=StreamRay),
        count: int,
        memory: wp.array(dtype=int),
        next: wp.ref[int],
        waiting: wp.ref[int],
        visited: wp.ref[int],
        pairs: wp.ref[Pairs],
    ) -> int: ...

    return walk_native

"""Slots: the rays that take turns, the nodes where they are, and the loops that move them through inner nodes.

A slot has the numbers of a ray that box tests need (`wrt.kernels.traversal.interleaved.slot_boxes`), and its place in the tree.
The others wait in the stream. Every slot has a stack of children and, for closest hits, a stack of their keys `DEPTH` words
behind it. At the bottom is an empty child, and a key that is less than any, so that a stack is never popped without a result.

Slots before inner nodes are listed, by where they are in memory, with the words of their nodes. A pass tests the boxes of these
nodes, then replaces each word by the next child: short loops, so that the processor works on several slots at a time. Then the
list is partitioned, a vector at a time and without a branch: those before inner nodes stay, the others leave it. Leaves are
listed as pairs of a ray and a block of triangles, to be tested when no slot is before an inner node.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.bvh_nodes import EMPTY_LANE, MAX_LEAF_TRIANGLES, WideNodes
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.lanes import FOR_LANES
from wrt.kernels.traversal.interleaved.child_order import push_reversed, push_sorted
from wrt.kernels.traversal.interleaved.slot_boxes import MEET, SET_SLOT, SLOT, SLOT_WORDS
from wrt.kernels.traversal.stream.stream_kernel import RAY_BITS, stream_ray
from wrt.kernels.traversal.stream.stream_lists import BLOCK_LANES
from wrt.kernels.traversal.traversal_config import CLOSEST, TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS

exact_module(__name__)

SLOTS = 64
"""Rays that take turns (notebooks/records/2026-11-22-interleaved-rays.md)."""

LINE = 16
"""Words of a cache line."""

SPARE = 16
"""Words that may be written beyond the end of a list or a stack."""

LISTS = 7
"""Lists of `SLOTS` words."""


def stack_depth(config: TraversalConfig) -> int:
    """Words of a stack: the bottom, and all children that a path can push."""
    return config.stack.levels * (config.width - 1) + 2 + SPARE


def stack_stride(config: TraversalConfig) -> int:
    """Words from one slot to the next, with its stacks: an odd number of cache lines, so that the bottoms of all stacks,
    which are used most, are spread over the sets of a cache."""
    stacks = 2 if config.query == CLOSEST else 1
    return (-(-(SLOT_WORDS + stacks * stack_depth(config)) // LINE) | 1) * LINE


def slot_words(config: TraversalConfig) -> int:
    """Ints of memory for `walk_to_leaves`."""
    keys = config.width if config.query == CLOSEST else 0
    return LINE + SLOTS * (keys + stack_stride(config)) + LISTS * (SLOTS + SPARE)


def leaf_blocks(width: int) -> int:
    """Greatest number of blocks in a leaf."""
    return -(-MAX_LEAF_TRIANGLES // width)


def pair_room(width: int) -> int:
    """Pairs (ray, block) for which `walk_to_leaves` needs room."""
    return (SLOTS + 1) * leaf_blocks(width)


_MEMORY = f"""{SLOT}
    constexpr int BOTTOM = {SLOT_WORDS};
    int* const stacks = (int*)(((size_t)memory.data + 63) & ~(size_t)63);
    char* const slots = (char*)stacks;
    int* const keys = stacks + STRIDE * SLOTS;
    int *const listed = keys + (ORDERED ? W * SLOTS : 0), *const words = listed + LIST, *const masks = words + LIST;
    int *const outer = masks + LIST, *const outer_words = outer + LIST, *const at_leaf = outer_words + LIST;
    int* const idle = at_leaf + LIST;
    int inners = 0, outers = 0, leaves = 0, idles = 0, paired = 0, following = next;
    auto wrt_slot = [&](int place) -> Slot& {{ return *(Slot*)(slots + (size_t)(unsigned)place); }};
"""
"""C++: the slots, each followed by its stacks, and their lists. A slot's place is in bytes. `listed`: those before an inner
node, or before whatever they come to next; `words`: their nodes; `outer`, `outer_words`: those that have left that list;
`at_leaf`: those before a leaf; `idle`: those without a ray."""

_MOVES = """
    auto wrt_fetch_node = [&](int word) {
        const char* const node = (const char*)tree.bounds.data + (size_t)(unsigned)(word & ~(word >> 31)) * (24 * W);
        WRT_UNROLLED for (int b = 0; b < 24 * W; b += 64) { WRT_FETCH(node + b); }
    };
    auto wrt_pop = [&](Slot& slot, int top) {
        if (ORDERED) {
            const int limit = __builtin_bit_cast(int, slot.t_max) | (W - 1);  // a key has a lane in those bits
            while (stacks[top] > limit) --top;
        }
        slot.top = top;
        return stacks[top + CHILDREN];
    };
    auto wrt_partition = [&](int count) {
        inners = 0;
        for (int j = 0; j < count; j += L) {
            int leaf[L];
            WRT_FOR(L, i) { leaf[i] = words[j + i] < 0 ? -1 : 0; }
            const unsigned here = count - j < L ? (1u << (count - j)) - 1u : (1u << L) - 1u;
            const unsigned out = wrt_bits(leaf) & here, in = here & ~out;
            wrt_append(outer + outers, listed + j, out);
            outers += wrt_append(outer_words + outers, words + j, out);
            wrt_append(listed + inners, listed + j, in);
            inners += wrt_append(words + inners, words + j, in);
        }
    };
    auto wrt_start = [&](int place) {
        Slot& slot = wrt_slot(place);
        const auto& ray = rays.data[following];
        const float* const slabs = (const float*)&ray;
        wrt_set_boxes(slot, slabs, slabs + 3, slabs + 6);
        slot.t_min = ray.t_min; slot.t_max = ray.best.t + 0.0f;
        slot.top = place / 4 + BOTTOM + 1;
        slot.ray = following;
        START
        ++following;
    };
    auto wrt_settle = [&]() {
        WRT_SCALAR for (int j = 0; j < outers; ++j) {
            const int place = outer[j], word = outer_words[j], ends = word == EMPTY ? 1 : 0;
            const int block = (int)((unsigned)~word >> 6), blocks = ((~word & 63) + W - 1) / W, ray = wrt_slot(place).ray;
            const char* const leaf = (const char*)records.data + (size_t)block * (4 * COMPONENTS * W);
            WRT_UNROLLED for (int b = 0; b < 36 * W; b += 64) { WRT_FETCH(leaf + b); }
            at_leaf[leaves] = place; leaves += 1 - ends;
            idle[idles] = place; idles += ends;
            int own[BLOCKS], all[BLOCKS];
            WRT_FOR(BLOCKS, i) { own[i] = ray; all[i] = block + i; }
            WRT_COPY(pairs.data + paired, own); WRT_COPY(pairs.data + ROOM + paired, all);
            paired += blocks;
            if (COUNTING) triangles += ~word & 63;
        }
        outers = 0;
        while (idles > 0 && following < count) wrt_start(idle[--idles]);
    };
    auto wrt_settle_all = [&]() { do wrt_settle(); while (outers > 0); };
"""
"""C++: `wrt_pop` takes the next child from a stack, `wrt_partition` divides the list, `wrt_start` puts the next ray before the
root, or, where the order of children is free, before one of its children. `wrt_settle_all` lists the leaves of the slots that
have left the list, and starts rays in those that are idle."""

_BEGIN = """
    if (next == 0) {
        for (int s = 0; s < SLOTS; ++s) {
            int* const stack = stacks + s * STRIDE + BOTTOM;
            stack[0] = (int)0x80000000; stack[CHILDREN] = EMPTY;
            idle[idles++] = s * 4 * STRIDE;
        }
    } else {
        WRT_SCALAR for (int j = 0; j < waiting; ++j) {
            const int place = at_leaf[j];
            Slot& slot = wrt_slot(place);
            const float t = rays.data[slot.ray].best.t + 0.0f;  // turns -0 into +0: as an integer, -0 is less than any key
            if (ORDERED) slot.t_max = t;
            const int word = wrt_pop(slot, slot.top - 1), next_word = !ORDERED && t < 0.0f ? EMPTY : word;
            wrt_fetch_node(next_word);
            listed[j] = place; words[j] = next_word;
        }
        wrt_partition(waiting);
    }
    wrt_settle_all();
"""
"""C++: all slots are idle, or their leaves have been tested."""

_PASSES = """
    while (inners > 0) {
        visited += inners;
        WRT_SCALAR for (int j = 0; j < inners; ++j) {
            const size_t node = (unsigned)words[j];
            WRT_FETCH(tree.child.data + node * W);
            float entry[W];
            int met[L] = {};
            wrt_meet(wrt_slot(listed[j]), (const char*)tree.bounds.data + node * (24 * W), entry, met);
            if (ORDERED) {
                int* const key = keys + W * j;
                WRT_FOR_LANES(i) { key[i] = met[i] ? (__builtin_bit_cast(int, entry[i]) & -W) | i : -1; }
            }
            masks[j] = (int)wrt_bits(met);
        }
        WRT_SCALAR for (int j = 0; j < inners; ++j) {
            Slot& slot = wrt_slot(listed[j]);
            const int* const child = tree.child.data + (size_t)(unsigned)words[j] * W;
            const unsigned mask = (unsigned)masks[j];
            const int top = slot.top;
            PUSH
            words[j] = word;
            wrt_fetch_node(word);
        }
        wrt_partition(inners);
        wrt_settle_all();
    }
    next = following;
    waiting = leaves;
    return paired;
"""
"""C++: passes over the slots before inner nodes, until there are none."""

_PUSH_ORDERED = "const int word = wrt_pop(slot, top + wrt_push(keys + W * j, mask, child, stacks + top) - 1);"

_PUSH_UNORDERED = """
            wrt_push(stacks + top, child, mask);
            slot.top = top - 1 + wrt_count_bits(mask);
            const int word = stacks[slot.top];
"""

_START_ORDERED = "words[inners] = 0; listed[inners++] = place;"

_START_UNORDERED = """
        const unsigned mask = (unsigned)list.data[following] >> RAY_BITS;
        wrt_push(stacks + slot.top, tree.child.data, mask);
        slot.top += wrt_count_bits(mask) - 1;
        const int word = stacks[slot.top], leaf = word < 0 ? 1 : 0;
        wrt_fetch_node(word);
        ++visited;  // the root
        words[inners] = word; listed[inners] = place; inners += 1 - leaf;
        outer_words[outers] = word; outer[outers] = place; outers += leaf;
"""


@cache
def walk_to_leaves(config: TraversalConfig) -> wp.Function:
    """`func(tree, records, rays, list, count, memory, next, waiting, visited, triangles, pairs) -> int`: moves all slots to
    leaves.

    Returns the number of pairs (ray, block) that it has listed, for the rays that take turns; 0 if the rays 0 .. count - 1 of
    the stream are done. Called again, after the pairs have been tested, it goes on.

    Args (of the function): list: words of the rays: the root's children that they meet
        (`wrt.kernels.traversal.stream.stream_root`). memory: `slot_words(config)` ints. next: number of rays started, initially
        0. waiting: number of slots at leaves. visited: number of nodes visited so far, increased. triangles: number of
        triangles in the leaves visited so far, increased if the configuration has counters. pairs: 2 `pair_room(width)` ints:
        the rays of the pairs, then their blocks.
    """
    StreamRay = stream_ray(config.triangle_test)
    width, ordered = config.width, int(config.query == CLOSEST)
    head = f"""{FOR_LANES}
    enum {{ W = {width} }};
    constexpr int SLOTS = {SLOTS}, LIST = {SLOTS + SPARE}, EMPTY = {int(EMPTY_LANE)};
    constexpr int BLOCKS = {leaf_blocks(width)}, ROOM = {pair_room(width)};
    constexpr int DEPTH = {stack_depth(config)}, STRIDE = {stack_stride(config)}, CHILDREN = {"DEPTH" if ordered else 0};
    constexpr int COMPONENTS = {TRIANGLE_TESTS[config.triangle_test].record.components};
    constexpr int RAY_BITS = {RAY_BITS};
    constexpr bool ORDERED = {ordered}, COUNTING = {int(config.counters)};
{BLOCK_LANES}{push_sorted(width) if ordered else push_reversed(width)}"""
    passes = _PASSES.replace("PUSH", _PUSH_ORDERED if ordered else _PUSH_UNORDERED)
    moves = _MOVES.replace("START", _START_ORDERED if ordered else _START_UNORDERED)

    @wp.func_native(head + _MEMORY + SET_SLOT + MEET + moves + _BEGIN + passes)
    def walk_native(
        tree: wp.ref[WideNodes],
        records: wp.array(dtype=float),
        rays: wp.array(dtype=StreamRay),
        list: wp.array(dtype=int),
        count: int,
        memory: wp.array(dtype=int),
        next: wp.ref[int],
        waiting: wp.ref[int],
        visited: wp.ref[int],
        triangles: wp.ref[int],
        pairs: wp.array(dtype=int),
    ) -> int: ...

    return walk_native

"""The lane loops of streams: rays as they are loaded, and lists filtered by boxes and planes, against one ray at a time."""

from functools import cache

import numpy as np
import pytest
import warp as wp
from support.packet_loops import OPTIONS, Packets, PlainRays, make_packets, plain_rays

from wrt.kernels.layout.bvh_nodes import EMPTY_LANE, WideNodes
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.simd.box_lanes import NO_CHILD_CONSTANT
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.stream.stream_candidates import Pairs, load_pair
from wrt.kernels.traversal.stream.stream_kernel import FAR, LIST_LANES, NEAR, NONE, RAY_BITS, stream_ray
from wrt.kernels.traversal.stream.stream_lanes import (
    RayIntervals,
    collect_words,
    filter_boxes,
    filter_hits,
    filter_plane,
    list_leaves,
    next_child,
    set_arrays,
)
from wrt.kernels.traversal.stream.stream_load import load_root, load_stream

pytestmark = pytest.mark.width

StreamRay = stream_ray("woop")
SIZE, STREAMS = 605, 10
"""Rays of a stream, no multiple of 16, and their number."""

FULL, SMALL = 608, 304
"""Rays for which there is room: for all, and for half of them."""

ROOM = 2 * SIZE + 2 * LIST_LANES
LOAD, ROOT, NODE, PLANE, HITS = range(5)
WIDTHS = {NONE: 8, NEAR: 16, FAR: 8}
"""Children of the nodes whose children come in this order."""


@wp.struct
class Lists:
    """What the loops read and write, a row a stream."""

    rays: RayBatch
    low: wp.vec3
    high: wp.vec3
    stream: wp.array2d(dtype=StreamRay)
    words: wp.array2d(dtype=int)
    sizes: wp.array(dtype=int)
    trees: wp.array(dtype=WideNodes)
    """A tree of one node a stream."""
    keys: wp.array2d(dtype=int)
    pairs: wp.array2d(dtype=wp.vec2i)
    answers: wp.array2d(dtype=int)
    axes: wp.array(dtype=int)
    positions: wp.array(dtype=float)
    entry: wp.array2d(dtype=float)
    leave: wp.array2d(dtype=float)
    far_rays: wp.array2d(dtype=int)
    far_entry: wp.array2d(dtype=float)
    far_leave: wp.array2d(dtype=float)


@cache
def loops(order: int) -> wp.Kernel:
    """The loops, for children in this order; which one is `stage`. Item: a stream."""
    width = WIDTHS[order]
    load, load_small = load_stream("woop", FULL), load_root("woop", SMALL, width, order)
    filter_node, pairs_of, following = filter_boxes(width, "woop", order), list_leaves(width), next_child(width)
    split, pop = filter_plane("woop"), filter_hits("woop")

    def run(lists: Lists, stage: int):
        i = wp.tid()
        stream, words, keys, size = lists.stream[i], lists.words[i], lists.keys[i], lists.sizes[i]
        near, stack = RayIntervals(), RayIntervals()
        set_arrays(near, words, lists.entry[i], lists.leave[i])
        set_arrays(stack, lists.far_rays[i], lists.far_entry[i], lists.far_leave[i])
        leaves = wp.uint32(0)
        begin, kept = i * SIZE, int(0)
        end = wp.min(begin + SIZE, lists.rays.count)
        if stage == LOAD:
            lists.answers[i, 0] = load(lists.rays, begin, end, lists.low, lists.high, stream, kept)
            lists.answers[i, 1] = kept
        elif stage == ROOT:
            tree = lists.trees[i]
            lists.answers[i, 0] = load_small(lists.rays, wp.vec2i(begin, end), tree, stream, words, keys, leaves, kept)
            lists.answers[i, 1] = kept
            lists.answers[i, 2] = wp.int(leaves)
        elif stage == PLANE:
            behind = int(0)
            lists.answers[i, 0] = split(lists.axes[i], lists.positions[i], stream, near, size, stack, 5, behind)
            lists.answers[i, 1] = behind
        elif stage == HITS:
            lists.answers[i, 0] = pop(stream, stack, 5, size, near)
        else:
            tree = lists.trees[i]
            survivors = filter_node(tree, 0, stream, words, wp.vec2i(0, size), keys, 0, leaves)
            listed, total = int(0), int(0)
            while listed < survivors:
                pairs = Pairs()
                for p in range(pairs_of(tree.child, 0, words, 0, survivors, leaves, listed, pairs)):
                    leaf = int(0)
                    ray = load_pair(pairs, p, leaf)
                    lists.pairs[i, total] = wp.vec2i(ray, leaf)
                    total += 1
            lists.answers[i, 0] = total
            lists.answers[i, 1] = survivors
            lists.answers[i, 2] = wp.int(leaves)
            lists.answers[i, 3] = collect_words(words, 0, survivors, wp.uint32(1) << wp.uint32(i % wp.static(width)))
            lists.answers[i, 4] = following(keys, 0, keys[(i + 1) % wp.static(width)])

    return wp.kernel(run, **OPTIONS)


@pytest.fixture
def packets(device) -> Packets:
    """The rays of packets, with origins of their own."""
    return make_packets(PacketLayout(32, 8, False, "woop"), STREAMS * SIZE // 32, device)


@pytest.fixture
def plain(packets) -> PlainRays:
    """Stream by stream, the last of them not full."""
    rays = plain_rays(packets)
    room = STREAMS * SIZE - rays.number.size
    fields = (rays.number, rays.ray, rays.slabs, rays.state, rays.slack, rays.slack)
    rows = [np.concatenate([x.ravel(), np.zeros(room, x.dtype)]).reshape(STREAMS, SIZE) for x in fields]
    rows[0].ravel()[packets.loop.rays.count :] = -1
    return PlainRays(*rows)


@pytest.fixture
def lists(packets, plain, device) -> Lists:
    """Loaded streams, whose lists hold all good rays, shuffled; beyond them is what a loop may read but must not use."""
    made, rng = Lists(), np.random.default_rng(4)
    made.rays, made.low, made.high = packets.loop.rays, packets.loop.low, packets.loop.high
    made.stream = wp.zeros((STREAMS, FULL), dtype=StreamRay, device=device)
    words = rng.integers(0, 10, (STREAMS, ROOM))
    for i, valid in enumerate(plain.valid):
        words[i, : valid.sum()] = rng.permutation(np.flatnonzero(valid))
    made.sizes = wp.array(plain.valid.sum(axis=1), dtype=int, device=device)
    made.words = wp.array(words, dtype=int, device=device)
    made.answers = wp.zeros((STREAMS, 5), dtype=int, device=device)
    wp.launch(loops(NEAR), STREAMS, [made, LOAD], device=device)
    put_back(made)
    return made


def put_back(lists: Lists) -> np.ndarray:
    """(STREAMS, SIZE) bool, which rays are in the streams; moves them from where they are to their numbers."""
    stream, kept = lists.stream.numpy(), lists.answers.numpy()[:, 1]
    placed, found = np.zeros_like(stream), np.zeros((STREAMS, SIZE), dtype=bool)
    for i, count in enumerate(kept):
        number = stream[i, :count]["number"]
        assert (np.diff(number) > 0).all()
        placed[i, number] = stream[i, :count]
        found[i, number] = True
    lists.stream.assign(placed)
    return found


def set_best(lists: Lists, best: np.ndarray) -> None:
    """Gives rays best hits at other t."""
    stream = lists.stream.numpy().copy()
    stream["best"]["t"][:, :SIZE] = best
    lists.stream.assign(stream)


def bits(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values).view(np.int32)


def check_loaded(got: np.ndarray, plain: PlainRays, chosen: np.ndarray) -> None:
    """Every number of the chosen rays has the bits of the ray that is loaded alone, and none of them has a hit."""
    for name in plain.slabs.dtype.names:
        np.testing.assert_array_equal(bits(got["slabs"][name])[chosen], bits(plain.slabs[name])[chosen], err_msg=name)
    for name in plain.state.dtype.names:
        np.testing.assert_array_equal(bits(got["state"][name])[chosen], bits(plain.state[name])[chosen], err_msg=name)
    t_min = plain.ray["t_min"] + np.float32(0.0)  # not -0
    np.testing.assert_array_equal(bits(got["t_min"])[chosen], bits(t_min)[chosen])
    best = got["best"][chosen]
    np.testing.assert_array_equal(best["t"], plain.ray["t_max"][chosen])
    assert (best["primitive"] == -1).all()
    assert not best["u"].any()
    assert not best["v"].any()


def test_loaded(lists, plain):
    """The good rays are loaded, one after the other; the others are left out."""
    there = plain.number >= 0
    assert 0.5 < plain.valid[there].mean() < 0.95
    answers = lists.answers.numpy()
    np.testing.assert_array_equal(answers[:, 0], there.sum(axis=1))
    np.testing.assert_array_equal(answers[:, 1], plain.valid.sum(axis=1))
    check_loaded(lists.stream.numpy()[:, :SIZE], plain, plain.valid)


def random_nodes(rng: np.random.Generator, width: int) -> tuple[np.ndarray, np.ndarray]:
    """(STREAMS, 6, W) boxes in the scene, with an unused lane each, and their children, of which some are leaves."""
    corners = rng.integers(-4, 5, (2, STREAMS, 3, width)) / 8.0
    boxes = np.concatenate([corners.min(axis=0), corners.max(axis=0)], axis=1).astype(np.float32)
    boxes[:, :3, -1], boxes[:, 3:, -1] = np.inf, -np.inf
    children = rng.integers(2, 1000, (STREAMS, width)) * rng.choice([1, -1], (STREAMS, width))
    return boxes, children.astype(np.int32)


def set_nodes(lists: Lists, boxes: np.ndarray, children: np.ndarray, device: wp.Device) -> list[WideNodes]:
    """Gives each stream a tree of one node; the trees must be kept."""
    trees = [WideNodes() for _ in boxes]
    for tree, box, child in zip(trees, boxes, children, strict=True):
        tree.bounds, tree.child = wp.array(box.ravel(), dtype=float, device=device), wp.array(child, dtype=int, device=device)
        tree.low, tree.high = lists.low, lists.high
    lists.trees = wp.array(trees, dtype=WideNodes, device=device)
    lists.keys = wp.full(children.shape, 7, dtype=int, device=device)
    return trees


def expected_keys(enter: np.ndarray, met: np.ndarray, leaf: np.ndarray, order: int) -> np.ndarray:
    """(W,) keys of the children of a node: `enter` (N, W) where rays meet them, and `met` whether they do."""
    width = leaf.size
    entry = {NONE: np.zeros_like(bits(enter)), NEAR: bits(enter), FAR: 0x7F7FFFFF - bits(enter)}[order]
    keys = np.where(met, (entry & -width) | np.arange(width), NO_CHILD_CONSTANT)
    return np.where(leaf, NO_CHILD_CONSTANT, keys.min(axis=0, initial=NO_CHILD_CONSTANT))


def bit_sum(flags: np.ndarray) -> np.ndarray:
    """Bits of flags, the first the lowest, over the last axis."""
    return (flags << np.arange(flags.shape[-1])).sum(axis=-1)


@pytest.mark.parametrize("order", WIDTHS)
def test_root(lists, plain, order, device):
    """Rays that miss the root's children are left out, until the stream is full; the others are listed as in any node."""
    width = WIDTHS[order]
    boxes, children = random_nodes(np.random.default_rng(2), width)
    boxes[::2] *= 0.1  # few rays meet the children of these roots
    boxes[np.isnan(boxes)] = 0.0
    children[:, -1] = EMPTY_LANE
    trees = set_nodes(lists, boxes, children, device)
    wp.launch(loops(order), STREAMS, [lists, ROOT], device=device)
    del trees  # the kernel has run
    words, keys, answers, found = lists.words.numpy(), lists.keys.numpy(), lists.answers.numpy(), put_back(lists)
    enter, leave = plain.meeting(boxes)
    enter = enter + np.float32(0.0)  # not -0
    met = (enter <= leave) & plain.valid[..., None]
    met[..., -1] = False
    filled = 0
    for i in range(STREAMS):
        place = kept = 0
        expected = np.zeros(SIZE, dtype=bool)
        here = (plain.number[i] >= 0).sum()
        while place < here and kept <= SMALL - LIST_LANES:
            group = slice(place, min(place + LIST_LANES, here))
            expected[group] = met[i, group].any(axis=-1)
            kept += expected[group].sum()
            place += LIST_LANES
        filled += place < here
        own, leaf = met[i, expected], children[i] < 0
        np.testing.assert_array_equal(answers[i, :3], (min(place, here), kept, bit_sum(own.any(axis=0) & leaf)))
        np.testing.assert_array_equal(found[i], expected)
        np.testing.assert_array_equal(words[i, :kept], (bit_sum(own) << RAY_BITS | np.arange(kept)).astype(np.int32))
        np.testing.assert_array_equal(keys[i], expected_keys(enter[i, expected], own, leaf, order))
    assert 0 < filled < STREAMS
    assert (plain.valid & ~met.any(axis=-1)).any()
    check_loaded(lists.stream.numpy()[:, :SIZE], plain, found)


@pytest.mark.parametrize("order", WIDTHS)
def test_boxes(lists, plain, order, device):
    """The rays that go on with the children that they meet, keys, and pairs with leaves, list by list."""
    width = WIDTHS[order]
    boxes, children = random_nodes(np.random.default_rng(width), width)
    trees = set_nodes(lists, boxes, children, device)
    lists.pairs = wp.zeros((STREAMS, SIZE * width), dtype=wp.vec2i, device=device)
    before = lists.words.numpy().copy()
    done = np.random.default_rng(5).random(plain.valid.shape) < 0.1
    set_best(lists, np.where(done, -np.inf, plain.ray["t_max"]))
    wp.launch(loops(order), STREAMS, [lists, NODE], device=device)
    del trees  # the kernel has run
    words, keys, pairs, answers = (x.numpy() for x in (lists.words, lists.keys, lists.pairs, lists.answers))

    enter, leave = plain.meeting(boxes)
    enter = enter + np.float32(0.0)  # not -0
    meets = (enter <= leave) & ~done[..., None]
    assert 0.05 < meets.mean() < 0.8
    assert (answers[:, 0] > 256).any()  # pairs that ran out of room on the way
    for i in range(STREAMS):
        listed = before[i, : lists.sizes.numpy()[i]]
        leaf, met = children[i] < 0, meets[i, listed]
        expected = [(k, children[i, c]) for k, row in zip(listed, met, strict=True) for c in np.flatnonzero(row & leaf)]
        np.testing.assert_array_equal(pairs[i, : answers[i, 0]], np.reshape(expected, (-1, 2)))
        of_children = bit_sum(met)
        kept = (of_children << RAY_BITS | listed)[of_children > 0].astype(np.int32)
        active = (of_children << RAY_BITS | listed)[met[:, i % width]].astype(np.int32)
        row = expected_keys(enter[i, listed], met, leaf, order)
        following = min(row[row > row[(i + 1) % width]], default=NO_CHILD_CONSTANT)
        counts = len(kept), bit_sum(met.any(axis=0) & leaf), len(active), following
        np.testing.assert_array_equal(answers[i, 1:], counts)
        np.testing.assert_array_equal(words[i, : len(kept)], kept)
        np.testing.assert_array_equal(words[i, len(kept) : len(kept) + len(active)], active)
        np.testing.assert_array_equal(keys[i], row)


def test_planes_and_best_hits(lists, plain, device):
    """Rays of one sign go to the near child, the far one or both, with their intervals; from the stack, those not done."""
    rng = np.random.default_rng(9)
    axes, positions = rng.integers(0, 3, STREAMS), np.float32(rng.integers(-4, 5, STREAMS) / 8.0)
    with np.errstate(invalid="ignore"):
        back = np.take_along_axis(plain.slabs["inverse"], axes[:, None, None], 2)[..., 0] < 0
    words, sizes = lists.words.numpy().copy(), np.zeros(STREAMS, dtype=np.int32)
    for i in range(STREAMS):
        chosen = np.flatnonzero(plain.valid[i] & (back[i] == i % 2))
        sizes[i], words[i, : len(chosen)] = len(chosen), rng.permutation(chosen)
    shape = words.shape
    entry = rng.random(shape).astype(np.float32)
    leave = entry + rng.choice([0.0, 0.5, 2.0], shape).astype(np.float32)
    lists.words, lists.sizes = wp.array(words, dtype=int, device=device), wp.array(sizes, dtype=int, device=device)
    lists.entry, lists.leave = wp.array(entry, dtype=float, device=device), wp.array(leave, dtype=float, device=device)
    lists.far_rays = wp.full(shape, -1, dtype=int, device=device)
    lists.far_entry, lists.far_leave = (wp.zeros(shape, dtype=float, device=device) for _ in range(2))
    lists.axes, lists.positions = wp.array(axes, dtype=int, device=device), wp.array(positions, dtype=float, device=device)
    wp.launch(loops(NEAR), STREAMS, [lists, PLANE], device=device)
    near = lists.answers.numpy()[:, 0].copy()
    behind = lists.answers.numpy()[:, 1].copy()
    got = {
        name: getattr(lists, name).numpy().copy() for name in ("words", "entry", "leave", "far_rays", "far_entry", "far_leave")
    }
    both = 0
    for i, size in enumerate(sizes):
        ray, first, last = words[i, :size], entry[i, :size], leave[i, :size]
        slabs = plain.slabs[i, ray]
        with np.errstate(invalid="ignore"):
            out, into = (
                (positions[i] - slabs[name][:, axes[i]]) * slabs["inverse"][:, axes[i]] for name in ("origin_out", "origin_in")
            )
        out, into = np.where(out < last, out, last), np.where(into > first, into, first)
        to_near = first <= out
        to_far = ~to_near | (into <= last)
        both += (to_near & to_far).sum()
        places = slice(0, near[i]), slice(5, 5 + behind[i])
        for name, values in (("words", ray), ("entry", first), ("leave", out)):
            np.testing.assert_array_equal(got[name][i, places[0]], values[to_near], err_msg=name)
        for name, values in (("far_rays", ray), ("far_entry", into), ("far_leave", last)):
            np.testing.assert_array_equal(got[name][i, places[1]], values[to_far], err_msg=name)
    assert 0.02 < both / sizes.sum() < 0.9

    best = rng.choice(np.float32([-np.inf, 0.5, 1.0, np.inf]), (STREAMS, SIZE))
    set_best(lists, best)
    lists.sizes = wp.array(behind, dtype=int, device=device)
    wp.launch(loops(NEAR), STREAMS, [lists, HITS], device=device)
    left = lists.answers.numpy()[:, 0]
    assert 0.2 < left.sum() / behind.sum() < 0.9
    for i in range(STREAMS):
        ray, first, last = (got[name][i, 5 : 5 + behind[i]] for name in ("far_rays", "far_entry", "far_leave"))
        taken = first <= best[i, ray]
        for name, values in (("words", ray), ("entry", first), ("leave", np.minimum(last, best[i, ray]))):
            np.testing.assert_array_equal(getattr(lists, name).numpy()[i, : left[i]], values[taken], err_msg=name)

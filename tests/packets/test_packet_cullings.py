"""Cullings: packet x W triangles and packet x W boxes against their twins in plain Warp, and frusta against float64."""

from functools import cache

import numpy as np
import pytest
import warp as wp
from support.packet_loops import BLOCKS, LOAD, OPTIONS, TWIN_OPTIONS, Loop, Packets, PlainRays, loops, make_packets, plain_rays
from support.scalar_cullings import (
    corner_rays_keep,
    enter_frustum,
    every_ray_keeps,
    frustum_keeps,
    interval_keeps,
    side_planes_keep,
    vertex_keeps,
)

from wrt.kernels.simd.box_lanes import NO_CHILD_CONSTANT
from wrt.kernels.traversal.packet import CULLINGS
from wrt.kernels.traversal.packet.core.packet_cells import enter_box
from wrt.kernels.traversal.packet.rays.packet_bounds import MAX_FEW_RAYS, PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import load_corners

pytestmark = pytest.mark.width

LAYOUTS = [PacketLayout(64, 16, True, "woop"), PacketLayout(32, 8, False, "woop")]
START, TRIANGLES, BOXES, LEAF = range(4)
NONE, INTERVAL, LEAF_BOXES, CORNER_RAYS, FRUSTUM, VERTEX, TRANSIENT, TWO_PLANE, ENTRY_EXIT = range(len(CULLINGS))
VERTICES = load_corners(TRIANGLE_TESTS["woop"].record.components)
FRUSTA = ("frustum", "two_plane", "transient_frustum")
ERROR = 40.0 / 16.0
"""What the lines of a frustum may err by, in slacks: 40 u reach (`wrt.kernels.classics.culling.inverse_frustum`)."""


@cache
def culling_loops(layout: PacketLayout) -> wp.Kernel:
    """All loops of all cullings. Item: a packet; `stage` is a hundred times one of those above, and a place in the table."""
    keep0, keep1, keep2, keep3, keep4, keep5, keep6, keep7, keep8 = (each.triangles(layout) for each in CULLINGS.values())
    none, interval, separated = (CULLINGS[name].boxes(layout) for name in ("none", "interval", "frustum"))
    slopes, planes = CULLINGS["frustum"].start(layout), CULLINGS["two_plane"].start(layout)
    transient, leaf = CULLINGS["transient_frustum"].start(layout), CULLINGS["transient_frustum"].leaf(layout)
    reaching, beside = CULLINGS["leaf_boxes"].leaf(layout), CULLINGS["entry_exit"].leaf(layout)

    @wp.func
    def keep(culling: int, records: wp.array(dtype=float), block: int, bounds: wp.ref[PacketBounds]):
        if culling == 0:
            return keep0(records, block, bounds)
        elif culling == 1:
            return keep1(records, block, bounds)
        elif culling == 2:
            return keep2(records, block, bounds)
        elif culling == 3:
            return keep3(records, block, bounds)
        elif culling == 4:
            return keep4(records, block, bounds)
        elif culling == 5:
            return keep5(records, block, bounds)
        elif culling == 6:
            return keep6(records, block, bounds)
        elif culling == 7:
            return keep7(records, block, bounds)
        return keep8(records, block, bounds)

    @wp.func
    def start(culling: int, low: wp.vec3, high: wp.vec3, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]):
        if culling == FRUSTUM or culling == ENTRY_EXIT:  # noqa: SIM109 - a kernel knows no `in`
            slopes(low, high, packet, bounds)
        elif culling == TWO_PLANE:
            planes(low, high, packet, bounds)
        elif culling == TRANSIENT:
            transient(low, high, packet, bounds)

    def run(loop: Loop, stage: int):
        i = wp.tid()
        culling = stage % 100
        bounds = loop.bounds[i]
        packet = loop.packets[i]
        block = loop.blocks[i, 0]
        if bounds.active > 0:
            if stage / 100 == START:
                start(culling, loop.low, loop.high, packet, bounds)
            elif stage / 100 == TRIANGLES:
                for j in range(loop.columns):
                    loop.answers[i, j] = int(keep(culling, loop.triangles.records, loop.blocks[i, j], bounds))
            elif stage == BOXES * 100 + NONE:
                loop.answers[i, 0] = none(loop.boxes, block, packet, bounds, loop.keys[i], 0)
            elif stage == BOXES * 100 + INTERVAL or stage == BOXES * 100 + LEAF_BOXES:
                loop.answers[i, 0] = interval(loop.boxes, block, packet, bounds, loop.keys[i], 0)
            elif stage / 100 == BOXES:
                loop.answers[i, 0] = separated(loop.boxes, block, packet, bounds, loop.keys[i], 0)
            elif stage == LEAF * 100 + TRANSIENT:
                loop.answers[i, 0] = leaf(loop.boxes, block, loop.answers[i, 1], packet, bounds)
            elif stage == LEAF * 100 + LEAF_BOXES:
                loop.answers[i, 0] = reaching(loop.boxes, block, loop.answers[i, 1], packet, bounds)
            elif stage == LEAF * 100 + ENTRY_EXIT:
                loop.answers[i, 0] = beside(loop.boxes, block, loop.answers[i, 1], packet, bounds)
        loop.bounds[i] = bounds

    return wp.kernel(run, **OPTIONS)


@wp.kernel(**TWIN_OPTIONS)
def twins(loop: Loop, culling: int, shared_origin: bool):
    """What `culling_loops` decides, in plain Warp. Item: a packet; for each of its blocks and each lane."""
    i = wp.tid()
    bounds = loop.bounds[i]
    for j in range(loop.columns):
        kept = int(0)
        for lane in range(loop.lanes):
            corners = VERTICES(loop.triangles.records, loop.blocks[i, j] * loop.lanes + lane, loop.lanes)
            keep = bool(False)
            if culling == NONE:
                keep = every_ray_keeps(bounds, corners)
            elif culling == INTERVAL or culling == LEAF_BOXES or (culling == CORNER_RAYS and not shared_origin):  # noqa: SIM109
                keep = interval_keeps(bounds, corners)
            elif culling == CORNER_RAYS:
                keep = corner_rays_keep(bounds, corners)
            elif culling == FRUSTUM or culling == ENTRY_EXIT:  # noqa: SIM109 - a kernel knows no `in`
                keep = frustum_keeps(bounds, corners)
            elif culling == VERTEX:
                keep = vertex_keeps(bounds, corners)
            else:
                keep = side_planes_keep(bounds, corners)
            kept = kept | wp.where(keep, 1 << lane, 0)
        loop.answers[i, loop.columns + j] = kept
    for lane in range(loop.lanes):
        first = loop.blocks[i, 0] * 6 * loop.lanes + lane
        low = wp.vec3()
        high = wp.vec3()
        for axis in range(3):
            low[axis] = loop.boxes[first + axis * loop.lanes]
            high[axis] = loop.boxes[first + (3 + axis) * loop.lanes]
        loop.intervals[i, lane] = enter_box(bounds, low, high)
        if bounds.frame >= 0:
            loop.frusta[i, lane] = enter_frustum(bounds, low, high)


def run(packets: Packets, stage: int, culling: str) -> None:
    """One loop of one culling."""
    packets.run(culling_loops(packets.layout), stage * 100 + list(CULLINGS).index(culling))


def run_twins(packets: Packets, culling: str) -> None:
    """The twins, by the bounds as they are."""
    number = list(CULLINGS).index(culling)
    wp.launch(twins, packets.count, [packets.loop, number, packets.layout.shared_origin], device=packets.device)


@pytest.fixture(params=LAYOUTS, ids=["shared", "own"])
def packets(request, device) -> Packets:
    """Loaded packets, and as nodes the boxes of the triangles of blocks, some widened, but within the scene."""
    made = make_packets(request.param, 250, device)
    width, loop = made.layout.width, made.loop
    corners = loop.triangles.records.numpy().reshape(-1, 3, 3, width)
    rng = np.random.default_rng(2)
    ends = np.float32(loop.low)[:, None], np.float32(loop.high)[:, None]
    wide = rng.choice([0.0, 0.05, 0.4], (len(corners), 1, width)) * (ends[1] - ends[0]).max()
    low, high = np.maximum(corners.min(axis=1) - wide, ends[0]), np.minimum(corners.max(axis=1) + wide, ends[1])
    unused = np.isnan(low)
    boxes = np.concatenate([np.where(unused, np.inf, low), np.where(unused, -np.inf, high)], axis=1)
    loop.boxes = wp.array(boxes.ravel().astype(np.float32), dtype=float, device=device)
    loop.keys = wp.zeros((made.count, width), dtype=int, device=device)
    loop.intervals = wp.zeros((made.count, width), dtype=wp.vec2, device=device)
    loop.frusta = wp.zeros((made.count, width), dtype=wp.vec2, device=device)
    made.run(loops(made.layout), LOAD)
    return made


def meeting(packets: Packets, plain: PlainRays) -> tuple[np.ndarray, np.ndarray]:
    """(enter, leave) of each ray in each box of its packet's node, (packets, P, W)."""
    boxes = packets.loop.boxes.numpy().reshape(-1, 6, packets.layout.width)
    return plain.meeting(boxes[packets.loop.blocks.numpy()[:, 0]])


def leaf_lanes(packets: Packets) -> np.ndarray:
    """(packets,) the child of its node that is a packet's leaf."""
    return np.random.default_rng(3).integers(0, packets.layout.width, packets.count)


def started(packets: Packets, plain: PlainRays, culling: str) -> np.ndarray:
    """Sets the packets up, and for a leaf if the culling looks at leaves; the packets that triangles are culled for."""
    run(packets, START, culling)
    if culling not in ("transient_frustum", "leaf_boxes"):
        return packets.bounds()["active"] > 0
    answers = packets.loop.answers.numpy().copy()
    answers[:, 1] = leaf_lanes(packets)
    packets.loop.answers.assign(answers)
    run(packets, LEAF, culling)
    return (packets.bounds()["active"] > 0) & (packets.loop.answers.numpy()[:, 0] > MAX_FEW_RAYS)


def kept_lanes(packets: Packets, culling: str, there: np.ndarray) -> np.ndarray:
    """(packets, BLOCKS, W) whether triangles are kept, by the loop and by its twin."""
    run(packets, TRIANGLES, culling)
    run_twins(packets, culling)
    answers = packets.loop.answers.numpy()[there]
    np.testing.assert_array_equal(answers[:, :BLOCKS], answers[:, BLOCKS : 2 * BLOCKS])
    return (answers[:, :BLOCKS, None] >> np.arange(packets.layout.width) & 1) != 0


@pytest.mark.parametrize("culling", CULLINGS)
def test_triangles(packets, culling):
    """The loop keeps the triangles that its twin keeps, and whatever any ray hits within its range."""
    plain = plain_rays(packets)
    there = started(packets, plain, culling)
    lanes = kept_lanes(packets, culling, there)
    if culling not in ("transient_frustum", "leaf_boxes"):  # they leave out rays beside a leaf's box, and so its triangles
        t = plain.candidates[there][..., 0]
        ray = plain.ray[there][..., None, None]
        hit = (t >= ray["t_min"]) & (t <= ray["t_max"]) & plain.valid[there][..., None, None]
        assert hit.any()
        assert lanes[hit.any(axis=1)].all()
    used = packets.ids[packets.loop.blocks.numpy()[there]] >= 0
    assert lanes[used].any()
    assert culling == "none" or not lanes[used].all()
    bounds = packets.bounds().copy()
    for name in ("slack", "margin"):  # so wide that they decide; no ray would
        bounds[name] *= 20_000.0
    packets.loop.bounds.assign(bounds)
    assert (kept_lanes(packets, culling, there) >= lanes).all()


@pytest.mark.parametrize("culling", ["none", "interval", "frustum", "two_plane"])
def test_boxes(packets, culling):
    """Keys are those of the twin's entry; no ray enters earlier, and none meets a box without a key.

    Some rays have a negative t_min, and so are not active: without culling, one such ray once hid boxes from all others.
    """
    plain = plain_rays(packets)
    there = started(packets, plain, culling)
    run(packets, BOXES, culling)
    run_twins(packets, culling)
    enter, leave = meeting(packets, plain)
    meets = enter <= leave
    if culling == "none":
        entry = np.where(meets, enter, np.float32(np.inf)).min(axis=1) + np.float32(0.0)  # not -0
        met = meets.any(axis=1)
    else:
        intervals = packets.loop.intervals.numpy()
        if culling in FRUSTA:
            framed = packets.bounds()["frame"] >= 0
            assert 0.1 < framed[there].mean() < 1.0
            intervals = np.where(framed[:, None, None], packets.loop.frusta.numpy(), intervals)
        entry, met = intervals[..., 0], intervals[..., 0] <= intervals[..., 1]
    lane = np.arange(packets.layout.width)
    bits = np.ascontiguousarray(entry).view(np.int32)
    expected = np.where(met, (bits & -packets.layout.width) | lane, NO_CHILD_CONSTANT)[there]
    got = packets.loop.keys.numpy()[there]
    np.testing.assert_array_equal(got, expected)
    np.testing.assert_array_equal(packets.loop.answers.numpy()[there, 0], expected.min(axis=1))
    assert 0.02 < met[there].mean() < 0.95
    assert (meets.any(axis=1) <= met)[there].all()
    first = np.where(meets, enter, np.float32(np.inf)).min(axis=1)[there]
    reached = np.isfinite(first)
    assert (((got & -packets.layout.width).view(np.float32) <= first) | ~reached).all()


def check_frustum(bounds: np.ndarray, plain: PlainRays, counts: np.ndarray, tight: bool) -> None:
    """All rays that count are between the four lines at both ends of the frustum, to within `ERROR`; float64.

    tight: whether the lines go through the extreme points of the rays at both ends; if not, they widen from the near one.
    """
    turned = (bounds["frame"][:, None, None] + np.arange(3)) % 3
    origin, direction = (
        np.take_along_axis(np.float64(plain.ray[name]), np.broadcast_to(turned, plain.ray[name].shape), -1)
        for name in ("origin", "direction")
    )
    slack, forward = bounds["slack"].astype(np.float64)[:, None], bounds["forward"][:, None]
    with np.errstate(invalid="ignore"):
        assert (np.sign(direction[..., 0]) == forward)[counts].all()
        begin = (origin[..., 0] - bounds["near_plane"][:, None]) * forward
        near = np.zeros_like(begin) if tight else np.maximum(begin, 0.0)
        far = np.minimum(bounds["depth"].astype(np.float64)[:, None], slack * 2.0**22)  # it may have no end
        for depth in (near, np.maximum(far, near)):
            for a in range(2):
                place = origin[..., 1 + a] + direction[..., 1 + a] / np.abs(direction[..., 0]) * (depth - begin)
                low, high = (bounds[f"side_{e}"][:, a, None] + bounds[f"rise_{e}"][:, a, None] * depth for e in ("low", "high"))
                inside = np.stack([place - low, high - place]) / slack
                assert (inside[:, counts] >= -ERROR).all()
                assert not tight or (np.where(counts, inside, np.inf).min(axis=2) <= ERROR).all()
    assert (bounds["margin"] >= 2.0 * ERROR * slack[:, 0]).all()


def check_planes(packets: Packets, bounds: np.ndarray, lane: np.ndarray, framed: np.ndarray) -> None:
    """The two planes of a leaf's frustum are beyond its box by what a hit may lie beside it at least, the slack."""
    bounds, lane = bounds[framed], lane[framed]
    axis, forward = bounds["frame"], bounds["forward"]
    boxes = packets.loop.boxes.numpy().reshape(-1, 2, 3, packets.layout.width)[packets.loop.blocks.numpy()[framed, 0]]
    faces = (boxes[np.arange(len(lane)), :, axis, lane] - bounds["near_plane"][:, None]) * forward[:, None]
    assert (faces.min(axis=1) >= bounds["slack"]).all()
    assert (faces.max(axis=1) <= bounds["depth"] - bounds["slack"]).all()


def check_few(packets: Packets, meet: np.ndarray, there: np.ndarray) -> None:
    """How many rays meet a leaf, and which if they are few; meet: (packets, P) whether a ray does."""
    active, few = packets.bounds()["active"] > 0, packets.bounds()["few"]
    count = meet.sum(axis=1)
    np.testing.assert_array_equal(packets.loop.answers.numpy()[active, 0], count[active])
    np.testing.assert_array_equal(there, active & (count > MAX_FEW_RAYS))
    listed = np.flatnonzero((count > 0) & (count <= MAX_FEW_RAYS))
    assert len(listed) > 0
    for packet in listed:
        np.testing.assert_array_equal(few[packet, : count[packet]], np.flatnonzero(meet[packet]))


def rays_at_leaves(packets: Packets, plain: PlainRays) -> tuple[np.ndarray, np.ndarray]:
    """(packets, P) whether a ray meets the box of the packet's leaf, and (packets, 1) the leaf's lane."""
    enter, leave = meeting(packets, plain)
    lane = leaf_lanes(packets)[:, None, None]
    meet = np.take_along_axis(enter <= leave, np.broadcast_to(lane, (*enter.shape[:2], 1)), 2)[..., 0]
    return meet, lane[:, 0]


def test_rays_at_leaves(packets):
    plain = plain_rays(packets)
    there = started(packets, plain, "leaf_boxes")
    check_few(packets, rays_at_leaves(packets, plain)[0], there)


@pytest.mark.parametrize("culling", FRUSTA)
def test_frusta(packets, culling):
    """Frusta hold the rays: of the whole packet, or those that meet a leaf's box, which are listed if they are few."""
    plain = plain_rays(packets)
    there = started(packets, plain, culling)
    counts, bounds = plain.valid, packets.bounds()
    if culling == "transient_frustum":
        counts, lane = rays_at_leaves(packets, plain)
        check_few(packets, counts, there)
        check_planes(packets, bounds, lane[:, 0], there & (bounds["frame"] >= 0))
    axes = bounds["main_axes"]
    framed = there & (bounds["frame"] >= 0)
    assert 0.1 < framed.mean() < 1.0
    assert (1 << bounds["frame"][framed] == axes[framed]).all()
    check_frustum(bounds[framed], plain[framed], counts[framed], culling != "frustum")


def test_entries_behind_exits(packets):
    """A leaf is skipped if all rays enter its slab along one axis after they have left that along another."""
    plain = plain_rays(packets)
    run(packets, START, "entry_exit")
    answers = packets.loop.answers.numpy().copy()
    lane = answers[:, 1] = leaf_lanes(packets)
    packets.loop.answers.assign(answers)
    run(packets, LEAF, "entry_exit")
    there = packets.bounds()["active"] > 0
    skipped = packets.loop.answers.numpy()[:, 0] == 0
    boxes = packets.loop.boxes.numpy().reshape(-1, 2, 3, packets.layout.width)[packets.loop.blocks.numpy()[:, 0]]
    low, high = (np.take_along_axis(boxes[:, end], lane[:, None, None], 2)[:, None, :, 0] for end in (0, 1))
    slabs = plain.slabs
    back = slabs["inverse"] < 0
    with np.errstate(all="ignore"):
        entry = (np.where(back, high, low) - slabs["origin_in"]) * slabs["inverse"]
        leave = (np.where(back, low, high) - slabs["origin_out"]) * slabs["inverse"]
    entry, leave = np.where(np.isnan(entry), -np.inf, entry), np.where(np.isnan(leave), np.inf, leave)
    first = np.where(plain.valid[..., None], entry, np.inf).min(axis=1)
    last = np.where(plain.valid[..., None], leave, -np.inf).max(axis=1)
    expected = np.any([first[:, a] > last[:, b] for a in range(3) for b in range(3) if a != b], axis=0)
    np.testing.assert_array_equal(skipped[there], expected[there])
    enter, end = (np.take_along_axis(values, lane[:, None, None], 2)[..., 0] for values in meeting(packets, plain))
    assert not (enter <= end)[there & skipped].any()
    assert 0.02 < skipped[there].mean() < 1.0

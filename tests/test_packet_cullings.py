"""Cullings: packet x W triangles and packet x W boxes against their twins in plain Warp, and frusta against float64."""

from functools import cache

import numpy as np
import pytest
import warp as wp
from packet_loops import BLOCKS, MESHES, OPTIONS, Loop, Packets, PlainRays, make_packets, plain_rays

from wrt.kernels.box_lanes import NO_CHILD_CONSTANT
from wrt.kernels.packet import CULLINGS
from wrt.kernels.packet.bounds import PacketBounds
from wrt.kernels.packet.cells import enter_box
from wrt.kernels.packet.layout import PacketLayout
from wrt.kernels.packet.load import load_packet
from wrt.kernels.packet.twins import (
    corner_rays_keep,
    enter_frustum,
    every_ray_keeps,
    frustum_keeps,
    interval_keeps,
    side_planes_keep,
    vertex_keeps,
)
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.records import load_corners

LAYOUTS = [PacketLayout(64, 16, True, "woop"), PacketLayout(32, 8, False, "woop")]
LOAD, START, TRIANGLES, BOXES, LEAF = range(5)
NONE, INTERVAL, CORNER_RAYS, FRUSTUM, VERTEX, TRANSIENT, TWO_PLANE = range(len(CULLINGS))
VERTICES = load_corners(TRIANGLE_TESTS["woop"].record.components)
FRUSTA = ("frustum", "two_plane", "transient_frustum")
ERROR = 40.0 / 16.0
"""What the lines of a frustum may err by, in slacks: 40 u reach (`wrt.kernels.packet.frustum`)."""


@cache
def loops(layout: PacketLayout) -> wp.Kernel:
    """All loops of all cullings. Item: a packet; `stage` is a hundred times one of those above, and a place in the table."""
    cullings, packet_rays, load = list(CULLINGS.values()), layout.rays, load_packet(layout)
    keep0, keep1, keep2, keep3, keep4, keep5, keep6 = (culling.triangles(layout) for culling in cullings)
    none, interval, separated = (CULLINGS[name].boxes(layout) for name in ("none", "interval", "frustum"))
    slopes, planes = CULLINGS["frustum"].start(layout), CULLINGS["two_plane"].start(layout)
    transient, leaf = CULLINGS["transient_frustum"].start(layout), CULLINGS["transient_frustum"].leaf(layout)

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
        return keep6(records, block, bounds)

    @wp.func
    def start(culling: int, low: wp.vec3, high: wp.vec3, packet: wp.array(dtype=float), bounds: wp.ref[PacketBounds]):
        if culling == FRUSTUM:
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
        if stage == LOAD:
            load(loop.rays, i * wp.static(packet_rays), loop.low, loop.high, packet, bounds)
        elif bounds.active > 0:
            if stage / 100 == START:
                start(culling, loop.low, loop.high, packet, bounds)
            elif stage / 100 == TRIANGLES:
                for j in range(loop.columns):
                    loop.answers[i, j] = int(keep(culling, loop.triangles.records, loop.blocks[i, j], bounds))
            elif stage == BOXES * 100 + NONE:
                loop.answers[i, 0] = none(loop.boxes, block, packet, bounds, loop.keys[i], 0)
            elif stage == BOXES * 100 + INTERVAL:
                loop.answers[i, 0] = interval(loop.boxes, block, packet, bounds, loop.keys[i], 0)
            elif stage / 100 == BOXES:
                loop.answers[i, 0] = separated(loop.boxes, block, packet, bounds, loop.keys[i], 0)
            elif stage == LEAF * 100 + TRANSIENT:
                loop.answers[i, 0] = leaf(loop.boxes, block, loop.answers[i, 1], packet, bounds)
        loop.bounds[i] = bounds

    return wp.kernel(run, **OPTIONS)


@wp.kernel(**OPTIONS)
def twins(loop: Loop, culling: int, shared_origin: bool):
    """What `loops` decides, in plain Warp. Item: a packet; for each of its blocks and each lane."""
    i = wp.tid()
    bounds = loop.bounds[i]
    for j in range(loop.columns):
        kept = int(0)
        for lane in range(loop.lanes):
            corners = VERTICES(loop.triangles.records, loop.blocks[i, j] * loop.lanes + lane, loop.lanes)
            keep = bool(False)
            if culling == NONE:
                keep = every_ray_keeps(bounds, corners)
            elif culling == INTERVAL or (culling == CORNER_RAYS and not shared_origin):
                keep = interval_keeps(bounds, corners)
            elif culling == CORNER_RAYS:
                keep = corner_rays_keep(bounds, corners)
            elif culling == FRUSTUM:
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
    packets.run(loops(packets.layout), stage * 100 + list(CULLINGS).index(culling))


def run_twins(packets: Packets, culling: str) -> None:
    """The twins, by the bounds as they are."""
    number = list(CULLINGS).index(culling)
    wp.launch(twins, packets.count, [packets.loop, number, packets.layout.shared_origin], device=packets.device)


@pytest.fixture(params=MESHES)
def mesh(request):
    return MESHES[request.param]()


@pytest.fixture(params=LAYOUTS, ids=["shared", "own"])
def packets(request, mesh, device) -> Packets:
    """Loaded packets, and as nodes the boxes of the triangles of blocks, some widened."""
    made = make_packets(mesh, request.param, 120, device)
    width, loop = made.layout.width, made.loop
    corners = loop.triangles.records.numpy().reshape(-1, 3, 3, width)
    rng = np.random.default_rng(2)
    wide = rng.choice([0.0, 0.05, 0.4], (len(corners), 1, width)) * (np.float32(loop.high) - np.float32(loop.low)).max()
    low, high = corners.min(axis=1) - wide, corners.max(axis=1) + wide
    unused = np.isnan(low)
    boxes = np.concatenate([np.where(unused, np.inf, low), np.where(unused, -np.inf, high)], axis=1)
    loop.boxes = wp.array(boxes.ravel().astype(np.float32), dtype=float, device=device)
    loop.keys = wp.zeros((made.count, width), dtype=int, device=device)
    loop.intervals = wp.zeros((made.count, width), dtype=wp.vec2, device=device)
    loop.frusta = wp.zeros((made.count, width), dtype=wp.vec2, device=device)
    made.run(loops(made.layout), LOAD)
    return made


def meeting(packets: Packets, plain: PlainRays) -> tuple[np.ndarray, np.ndarray]:
    """(enter, leave) of each ray in each box of its packet's node, (packets, P, W), as `slab_interval` within its range."""
    width = packets.layout.width
    boxes = packets.loop.boxes.numpy().reshape(-1, 2, 3, width)[packets.loop.blocks.numpy()[:, 0]]
    enter = np.where(plain.valid, plain.ray["t_min"], np.float32(np.inf))[..., None].repeat(width, axis=2)
    leave = np.where(plain.valid, plain.ray["t_max"], np.float32(-np.inf))[..., None].repeat(width, axis=2)
    with np.errstate(invalid="ignore", over="ignore"):
        for axis in range(3):
            inverse, slabs = plain.slabs["inverse"][..., axis, None], plain.slabs
            low, high = (boxes[:, None, end, axis] for end in (0, 1))
            near = (np.where(inverse < 0, high, low) - slabs["origin_in"][..., axis, None]) * inverse
            far = (np.where(inverse < 0, low, high) - slabs["origin_out"][..., axis, None]) * inverse
            enter, leave = np.where(near > enter, near, enter), np.where(far < leave, far, leave)
    return enter, leave


def started(packets: Packets, plain: PlainRays, culling: str) -> np.ndarray:
    """Sets the packets up, and for a leaf if the culling looks at leaves; the packets with rays to go on with."""
    run(packets, START, culling)
    if not CULLINGS[culling].needs_boxes:
        return packets.bounds()["active"] > 0
    lane = np.random.default_rng(3).integers(0, packets.layout.width, packets.count)
    answers = packets.loop.answers.numpy().copy()
    answers[:, 1] = lane
    packets.loop.answers.assign(answers)
    run(packets, LEAF, culling)
    return (packets.bounds()["active"] > 0) & (packets.loop.answers.numpy()[:, 0] != 0)


@pytest.mark.parametrize("culling", CULLINGS)
def test_triangles(packets, culling):
    """The loop keeps the triangles that its twin keeps, and whatever any ray hits within its range."""
    plain = plain_rays(packets)
    there = started(packets, plain, culling)
    run(packets, TRIANGLES, culling)
    run_twins(packets, culling)
    width = packets.layout.width
    answers = packets.loop.answers.numpy()[there]
    kept, twin = answers[:, :BLOCKS], answers[:, BLOCKS : 2 * BLOCKS]
    np.testing.assert_array_equal(kept, twin)
    lanes = (kept[..., None] >> np.arange(width) & 1) != 0
    if not CULLINGS[culling].needs_boxes:  # a leaf's frustum is for the triangles in its box
        t = plain.candidates[there][..., 0]
        ray = plain.ray[there][..., None, None]
        hit = (t >= ray["t_min"]) & (t <= ray["t_max"]) & plain.valid[there][..., None, None]
        assert hit.any()
        assert lanes[hit.any(axis=1)].all()
    used = packets.ids[packets.loop.blocks.numpy()[there]] >= 0
    assert lanes[used].any()
    assert culling == "none" or not lanes[used].all()


@pytest.mark.parametrize("culling", ["none", "interval", "frustum", "two_plane"])
def test_boxes(packets, culling):
    """Keys are those of the twin's entry; no ray enters earlier, and none meets a box without a key."""
    plain = plain_rays(packets)
    there = started(packets, plain, culling)
    run(packets, BOXES, culling)
    run_twins(packets, culling)
    enter, leave = meeting(packets, plain)
    meets = enter <= leave
    if culling == "none":
        entry = np.where(meets, enter, np.inf).min(axis=1).astype(np.float32)
        met = meets.any(axis=1)
    else:
        intervals = packets.loop.intervals.numpy()
        if culling in FRUSTA:
            framed = packets.bounds()["frame"] >= 0
            assert 0.1 < framed[there].mean() < 1.0
            intervals = np.where(framed[:, None, None], packets.loop.frusta.numpy(), intervals)
        entry, met = intervals[..., 0], intervals[..., 0] <= intervals[..., 1]
    lane = np.arange(packets.layout.width)
    bits = (np.ascontiguousarray(entry) + np.float32(0.0)).view(np.int32)
    expected = np.where(met, (bits & -packets.layout.width) | lane, NO_CHILD_CONSTANT)[there]
    got = packets.loop.keys.numpy()[there]
    np.testing.assert_array_equal(got, expected)
    np.testing.assert_array_equal(packets.loop.answers.numpy()[there, 0], expected.min(axis=1))
    assert 0.02 < met[there].mean() < 0.95
    assert (meets.any(axis=1) <= met)[there].all()
    first = np.where(meets, enter, np.float32(np.inf)).min(axis=1)[there]
    reached = np.isfinite(first)
    assert (((got & -packets.layout.width).view(np.float32) <= first) | ~reached).all()

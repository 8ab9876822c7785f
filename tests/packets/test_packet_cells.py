"""Packets in the cells of a kd-tree: all rays at once, and each ray in lanes, against the step of one ray after the other."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
import warp as wp
from support.packet_loops import LOAD, OPTIONS, Loop, Packets, PlainRays, bits, loops, make_packets, plain_rays

from wrt.kernels.classics.traversal.omnidirectional import enter_cell, split_cell
from wrt.kernels.traversal.packet.core.packet_cells import cross_plane, enter_box
from wrt.kernels.traversal.packet.leaves.packet_block import active_lanes
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

pytestmark = pytest.mark.width

SHARED, OWN = PacketLayout(64, 16, True, "woop"), PacketLayout(32, 8, False, "woop")
CROSS, ENTER, SPLIT, COUNT = range(4)


@wp.struct
class Cells:
    """Cells and planes, one a packet, and what the loops make of them."""

    low: wp.array(dtype=wp.vec3)
    high: wp.array(dtype=wp.vec3)
    axis: wp.array(dtype=int)
    position: wp.array(dtype=float)
    rays: wp.array2d(dtype=float)
    """(packets, 2 P) entry of each ray, then leave."""
    interval: wp.array(dtype=wp.vec2)
    """In which any ray may be in the cell."""
    crossed: wp.array(dtype=wp.vec3)
    answers: wp.array(dtype=int)


@cache
def cell_loops() -> wp.Kernel:
    """The loops over cells, for both layouts. Item: a packet."""
    enter_shared, split_shared, count_shared = enter_cell(SHARED), split_cell(SHARED), active_lanes(SHARED)
    enter_own, split_own, count_own = enter_cell(OWN), split_cell(OWN), active_lanes(OWN)

    def run(loop: Loop, cells: Cells, stage: int, shared: bool):
        i = wp.tid()
        bounds, packet, rays = loop.bounds[i], loop.packets[i], cells.rays[i]
        axis, position, records = cells.axis[i], cells.position[i], loop.triangles.records
        if stage == CROSS:
            interval = enter_box(bounds, cells.low[i], cells.high[i])
            cells.interval[i] = interval
            cells.crossed[i] = cross_plane(bounds, axis, position, interval[0], interval[1])
        elif stage == ENTER:
            if shared:
                cells.answers[i] = enter_shared(packet, bounds, cells.low[i], cells.high[i], rays)
            else:
                cells.answers[i] = enter_own(packet, bounds, cells.low[i], cells.high[i], rays)
        elif stage == SPLIT:
            if shared:
                cells.answers[i] = split_shared(packet, bounds, axis, position, rays)
            else:
                cells.answers[i] = split_own(packet, bounds, axis, position, rays)
        elif shared:
            cells.answers[i] = count_shared(records, loop.blocks[i, 0], loop.masks[i, 0], packet, bounds)
        else:
            cells.answers[i] = count_own(records, loop.blocks[i, 0], loop.masks[i, 0], packet, bounds)

    return wp.kernel(run, **OPTIONS)


@dataclass
class Case:
    """Loaded packets that have an active ray, each with a cell and a plane through it."""

    packets: Packets
    cells: Cells
    plain: PlainRays
    boxes: np.ndarray
    """(packets, 6) the cells."""
    some: np.ndarray
    """(packets,) whether any ray is active."""

    def run(self, stage: int) -> None:
        """One of the loops on all packets."""
        inputs = [self.packets.loop, self.cells, stage, self.packets.layout.shared_origin]
        wp.launch(cell_loops(), self.packets.count, inputs, device=self.packets.device)

    @property
    def answers(self) -> np.ndarray:
        return self.cells.answers.numpy()

    def inside(self) -> tuple[np.ndarray, np.ndarray]:
        """(packets, P) entry and leave of the rays."""
        return tuple(np.split(self.cells.rays.numpy().copy(), 2, axis=1))

    def crossing(self, entry: np.ndarray, leave: np.ndarray) -> tuple[np.ndarray, ...]:
        """By `cross_plane` of one ray: whether its near child is the right one, when it leaves it, and enters the other."""
        axis, slabs = self.cells.axis.numpy()[:, None, None], self.plain.slabs
        inverse, into, out = (
            np.take_along_axis(slabs[name], axis, 2)[..., 0] for name in ("inverse", "origin_in", "origin_out")
        )
        position = self.cells.position.numpy()[:, None]
        with np.errstate(invalid="ignore", over="ignore"):
            before, behind = (position - out) * inverse, (position - into) * inverse
            return inverse < 0, np.where(before < leave, before, leave), np.where(behind > entry, behind, entry)


@pytest.fixture(params=[SHARED, OWN], ids=["shared", "own"])
def case(request, device) -> Case:
    """Cells on a grid, on whose planes origins lie too."""
    packets, rng = make_packets(request.param, 250, device), np.random.default_rng(6)
    packets.run(loops(request.param), LOAD)
    corners = np.sort(rng.integers(-4, 5, (packets.count, 2, 3)) / 8.0, axis=1).astype(np.float32)
    axis = rng.integers(0, 3, packets.count)
    cells = Cells()
    cells.low, cells.high = (wp.array(corners[:, end], dtype=wp.vec3, device=device) for end in (0, 1))
    middle = corners.mean(axis=1)[np.arange(packets.count), axis]
    cells.axis = wp.array(axis, dtype=int, device=device)
    cells.position = wp.array(middle.astype(np.float32), dtype=float, device=device)
    cells.rays = wp.zeros((packets.count, 2 * request.param.rays), dtype=float, device=device)
    cells.interval = wp.zeros(packets.count, dtype=wp.vec2, device=device)
    cells.crossed = wp.zeros(packets.count, dtype=wp.vec3, device=device)
    cells.answers = wp.zeros(packets.count, dtype=int, device=device)
    plain = plain_rays(packets)
    return Case(packets, cells, plain, corners.reshape(-1, 6), plain.valid.any(axis=1))


def test_lanes_in_cells(case):
    """Each ray's interval in a cell is that of the slab test, and in the child that the packet goes on to that of its step."""
    case.run(ENTER)
    entry, leave = case.inside()
    inside = entry <= leave
    first, last = (x[..., 0] for x in case.plain.meeting(case.boxes[..., None]))
    good = case.plain.ray["t_min"] > -np.inf  # a ray from there is not active, but in [-inf, -inf] may be anywhere
    np.testing.assert_array_equal(inside[good], (first <= last)[good])
    assert 0.1 < inside.mean() < 0.9
    for got, expected in ((entry, first), (leave, last)):
        np.testing.assert_array_equal(bits(got)[inside & good], bits(expected)[inside & good])
    np.testing.assert_array_equal(case.answers, inside.sum(axis=1))

    right_first, before, behind = case.crossing(entry, leave)
    near, far = inside & (entry <= before), inside & (behind <= leave)
    right, left = np.where(right_first, near, far), np.where(right_first, far, near)
    prefer = np.where(near & far, np.where(right_first, 1, -1), 0).sum(axis=1) > 0
    case.run(SPLIT)
    both = left.any(axis=1) & right.any(axis=1)
    go_right = np.where(both, prefer, right.any(axis=1))
    np.testing.assert_array_equal(case.answers, go_right + 2 * both)
    assert 0.1 < both.mean() < 0.9
    to_near = right_first == go_right[:, None]
    visits = np.where(go_right[:, None], right, left)
    got_entry, got_leave = case.inside()
    np.testing.assert_array_equal(got_entry <= got_leave, visits)
    np.testing.assert_array_equal(bits(got_entry)[visits], bits(np.where(to_near, entry, behind))[visits])
    np.testing.assert_array_equal(bits(got_leave)[visits], bits(np.where(to_near, before, leave))[visits])


def test_planes(case):
    """No ray is in the first child later, or in the second one sooner, than bounds say, which rays of one sign fix."""
    case.run(CROSS)
    sign, near_leave, far_entry = np.moveaxis(case.cells.crossed.numpy(), 1, 0)[..., None]
    bounds, interval = case.packets.bounds(), case.cells.interval.numpy()
    entry, leave = (x[..., 0] for x in case.plain.meeting(case.boxes[..., None]))
    right_first, before, behind = case.crossing(entry, leave)
    with np.errstate(invalid="ignore"):
        near, far = (entry <= leave) & (entry <= before), (entry <= leave) & (behind <= leave)
    in_order = right_first == (sign < 0)  # rays whose near child is the packet's first
    assert (before <= near_leave)[near & in_order].all()
    assert (behind >= far_entry)[far & in_order].all()
    assert (leave <= near_leave)[far & ~in_order].all()
    assert (entry >= far_entry)[near & ~in_order].all()

    at = np.arange(len(bounds)), case.cells.axis.numpy()
    mixed = np.isnan(bounds["inverse_large"][at])
    one, position = case.some & ~mixed, case.cells.position.numpy()
    with np.errstate(invalid="ignore"):
        out, into = ((position - bounds[name][at]) for name in ("origin_out", "origin_in"))
        last = np.fmax(*(out * bounds[name][at] for name in ("inverse_large", "inverse_small")))
        first = np.fmin(*(into * bounds[name][at] for name in ("inverse_large", "inverse_small")))
    np.testing.assert_array_equal(near_leave[one, 0], np.fmin(last, interval[:, 1])[one])
    np.testing.assert_array_equal(far_entry[one, 0], np.fmax(first, interval[:, 0])[one])
    mixed &= case.some
    assert mixed.any()
    assert (near_leave[mixed] == -np.inf).any() or (far_entry[mixed] == np.inf).any()  # a child that nobody visits


def test_active_lanes(case):
    """Pairs of an active ray and a triangle of the mask whose box it meets."""
    packets, width = case.packets, case.packets.layout.width
    masks = packets.loop.masks.numpy().copy()
    masks[:, 0] &= ((packets.ids[packets.loop.blocks.numpy()[:, 0]] >= 0) << np.arange(width)).sum(axis=1).astype(np.uint32)
    packets.loop.masks.assign(masks)
    case.run(COUNT)
    corners = packets.loop.triangles.records.numpy().reshape(-1, 3, 3, width)[packets.loop.blocks.numpy()[:, 0]]
    boxes = np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)
    asked = (masks[:, :1] >> np.arange(width) & 1) != 0
    enter, leave = case.plain.meeting(boxes)
    np.testing.assert_array_equal(case.answers, ((enter <= leave) & asked[:, None]).sum(axis=(1, 2)))
    assert case.answers.any()

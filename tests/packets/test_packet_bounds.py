"""Bounds of packets, of parts of them and of tiles, against plain minima and maxima over the rays."""

from functools import cache

import numpy as np
import pytest
import warp as wp
from support.packet_loops import LOAD, OPTIONS, Loop, Packets, PlainRays, loops, make_packets, plain_rays
from support.selection import slow

from wrt.kernels.traversal.packet.core.packet_splitting import DONE, MAX_PARTS, SINGLE_RAY, activate_part, finish_part
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.packet_load import bound_rays

pytestmark = pytest.mark.width

SHARED, OWN = PacketLayout(64, 16, True, "woop"), PacketLayout(32, 8, False, "woop")
TILE, TAKE, SETTLE = range(3)
PARTS = 4
"""Parts that a packet has before one of them is taken and settled."""


@cache
def bounding_loops() -> wp.Kernel:
    """The loops that bound rays anew. Item: a packet, with origins of its own where it parts."""
    activate, finish = activate_part(OWN), finish_part(OWN)

    def run(loop: Loop, stage: int, rays: int):
        i = wp.tid()
        bounds = loop.bounds[i]
        if stage == TILE:
            bound_rays(loop.rays, i * rays, rays, loop.low, loop.high, bounds)
        elif stage == TAKE:
            activate(loop.packets[i], bounds, 1)
        elif stage == SETTLE:
            loop.answers[i, 0] = finish(loop.packets[i], bounds, 1, loop.answers[i, 0], loop.answers[i, 1] != 0)
        loop.bounds[i] = bounds

    return wp.kernel(run, **OPTIONS)


def run(packets: Packets, stage: int) -> None:
    """One of those loops."""
    wp.launch(bounding_loops(), packets.count, [packets.loop, stage, packets.layout.rays], device=packets.device)


@pytest.fixture(params=[OWN, *slow(SHARED)], ids=["own", "shared"])
def packets(request, device) -> Packets:
    return make_packets(request.param, 200, device)


def ends(values: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest over the rays that count, of each packet; +-inf if none does."""
    return np.where(counts, values, np.inf).min(axis=1), np.where(counts, values, -np.inf).max(axis=1)


def check_ranges(bounds: np.ndarray, plain: PlainRays, active: np.ndarray) -> None:
    """What is bounded by the numbers of the rays themselves."""
    some = active.any(axis=1)
    np.testing.assert_array_equal(bounds["active"], active.sum(axis=1))
    assert some.any()
    assert not some.all()
    plain_ends = [ends(plain.ray["t_min"], active)[0], ends(plain.ray["t_max"], active)[1], ends(plain.slack, active)[1]]
    for name, expected in zip(("t_min", "t_max", "slack"), plain_ends, strict=True):
        np.testing.assert_array_equal(bounds[name][some], expected[some], err_msg=name)
    mixed_axes = np.zeros(len(bounds), dtype=int)
    for axis in range(3):
        inverse, low, high = plain.slabs["inverse"][..., axis], *ends(plain.ray["origin"][..., axis], active)
        least, most = ends(inverse, active)
        back, mixed, slack = most < 0, (least < 0) & ~(most < 0), bounds["slack"]
        mixed_axes += mixed
        expected = {
            "backward": back,
            "inverse_large": np.where(mixed, np.nan, np.where(back, least, most)),
            "inverse_small": np.where(mixed, np.nan, np.where(back, most, least)),
            "forward_small": np.where(mixed, ends(inverse, active & ~(inverse < 0))[0], 0.0),
            "backward_small": np.where(mixed, ends(inverse, active & (inverse < 0))[1], 0.0),
            "origin_low": low,
            "origin_high": high,
            "origin_in": np.where(back, low.astype(np.float32) - slack, high.astype(np.float32) + slack),
            "origin_out": np.where(back, high.astype(np.float32) + slack, low.astype(np.float32) - slack),
        }
        for name, values in expected.items():
            np.testing.assert_array_equal(bounds[name][some, axis], values[some].astype(np.float32), err_msg=f"{name} {axis}")
    np.testing.assert_array_equal(bounds["mixed_axes"][some], mixed_axes[some])
    assert {0, 1} <= set(mixed_axes[some])


def slopes_of(plain: PlainRays, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Against an axis a packet: float32 slopes (packets, P, 2) of the rays, and the origins, turned, that axis first."""
    turned = (axis[:, None, None] + np.arange(3)) % 3
    with np.errstate(all="ignore"):
        direction = np.take_along_axis(plain.ray["direction"], np.broadcast_to(turned, plain.ray["direction"].shape), -1)
        return direction[..., 1:] / direction[..., :1], np.take_along_axis(
            plain.ray["origin"], np.broadcast_to(turned, direction.shape), -1
        )


def check_main_axis(bounds: np.ndarray, plain: PlainRays, active: np.ndarray, exact: bool, least_slack: float) -> None:
    """Main axes that occur and, where there is one, slopes and where the lines go through the plane, in float64.

    exact: whether bounds are those of the rays; if not, they may be wider, and a packet need not have a main axis.
    least_slack: by how many slacks the plane's rectangle is widened at least.
    """
    with np.errstate(invalid="ignore"):
        main = np.abs(plain.ray["direction"]).argmax(axis=-1)
    occur = np.bitwise_or.reduce(np.where(active, 1 << main, 0), axis=1)
    some = active.any(axis=1)
    assert (bounds["main_axes"][some] & occur[some] == occur[some]).all()
    one = some & np.isin(bounds["main_axes"], (1, 2, 4))
    if exact:
        np.testing.assert_array_equal(bounds["main_axes"][some], occur[some])
        np.testing.assert_array_equal(bounds["passes"][some], occur[some])
    assert 0.1 < one.mean() < 1.0
    bounds, active, plain = bounds[one], active[one], plain[one]
    axis = np.log2(bounds["main_axes"]).astype(int)
    slopes, origin = slopes_of(plain, axis)
    slopes = np.where(active[..., None], slopes, 0.0)
    along = np.arange(len(bounds)), axis
    assert ((bounds["plane"] >= bounds["origin_low"][along]) & (bounds["plane"] <= bounds["origin_high"][along])).all()
    depth = np.where(active[..., None], np.float64(origin[..., :1]) - bounds["plane"][:, None, None], 0.0)
    through = origin[..., 1:] - np.float64(slopes) * depth
    slack = bounds["slack"].astype(np.float64)
    for a in range(2):
        low, high = ends(slopes[..., a], active)
        cross_low, cross_high = ends(through[..., a], active)
        if exact:
            np.testing.assert_array_equal(bounds["slope_low"][:, a], low.astype(np.float32))
            np.testing.assert_array_equal(bounds["slope_high"][:, a], high.astype(np.float32))
        assert (bounds["slope_low"][:, a] <= low).all()
        assert (bounds["slope_high"][:, a] >= high).all()
        widened = np.stack([cross_low - bounds["through_low"][:, a], bounds["through_high"][:, a] - cross_high]) / slack
        assert (widened >= least_slack).all()
        if exact:
            assert (widened <= least_slack + 0.5).all()


def test_packets(packets):
    plain = plain_rays(packets)
    packets.run(loops(packets.layout), LOAD)
    bounds = packets.bounds()
    check_ranges(bounds, plain, plain.valid)
    check_main_axis(bounds, plain, plain.valid, True, 0.0 if packets.layout.shared_origin else 0.75)


def test_tiles(packets):
    """Bounds that no packet was loaded for: as tight for all but slopes, which follow from the ends of the directions."""
    plain = plain_rays(packets)
    run(packets, TILE)
    bounds = packets.bounds()
    check_ranges(bounds, plain, plain.valid)
    check_main_axis(bounds, plain, plain.valid, False, 0.75)


def test_parts(device):
    """A part that is taken is bounded as if it were all; settled, its rays are done, halved or alone, and all others back."""
    packets = make_packets(OWN, 200, device)
    plain, rng = plain_rays(packets), np.random.default_rng(1)
    packets.run(loops(OWN), LOAD)
    part = np.where(plain.valid, rng.choice([DONE, SINGLE_RAY, 1, 1, 2, 3], plain.valid.shape), DONE)
    packets.change(part=part)
    before = packets.components()
    run(packets, TAKE)
    taken, active = packets.components(), part == 1
    np.testing.assert_array_equal(taken["t"], np.where(active, before["t"], -np.inf))
    bounds = packets.bounds()
    check_ranges(bounds, plain, active)
    check_main_axis(bounds, plain, active, True, 0.75)

    over = active & (rng.random(active.shape) < 0.2)  # found any hit
    packets.change(t=np.where(over, -np.inf, taken["t"]))
    completed, parts = rng.integers(0, 2, packets.count), rng.choice([PARTS, MAX_PARTS - 1], packets.count)
    answers = packets.loop.answers.numpy().copy()
    answers[:, 0], answers[:, 1] = parts, completed
    packets.loop.answers.assign(answers)
    run(packets, SETTLE)
    got, made = packets.components(), packets.loop.answers.numpy()[:, 0]
    np.testing.assert_array_equal(got["t"], np.where(over, -np.inf, before["t"]))
    low, high = bounds["origin_low"], bounds["origin_high"]
    axis = (high - low).argmax(axis=1)
    at = np.arange(packets.count), axis
    middle = low[at] + np.float32(0.5) * (high[at] - low[at])
    halved = (completed == 0) & (parts == PARTS) & (low[at] < middle) & (middle < high[at])
    some = active.any(axis=1)
    np.testing.assert_array_equal(made[some], 2 * halved[some])
    assert 0.1 < halved.mean() < 0.5
    start = np.take_along_axis(plain.ray["origin"], axis[:, None, None], -1)[..., 0]
    half = np.where(halved[:, None], parts[:, None] + (start >= middle[:, None]), SINGLE_RAY)
    settled = np.where(over | (completed != 0)[:, None], DONE, half)
    np.testing.assert_array_equal(got["part"], np.where(active, settled, part))

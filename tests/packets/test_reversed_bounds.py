"""Bounds of packets as seen from where their rays end: which packets get them, and that no box is lost that a ray meets."""

from functools import cache

import numpy as np
import pytest
import warp as wp
from support.packet_loops import OPTIONS

from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.simd.boxes import SLACK
from wrt.kernels.traversal.packet.core.packet_splitting import activate_part, finish_part
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.packet_load import finish_packet, load_packet
from wrt.kernels.traversal.packet.rays.reversed_bounds import reverse_bounds

pytestmark = pytest.mark.width

RAYS = 32
LOW, HIGH = np.full(3, -1.5), np.full(3, 1.5)
"""The scene."""

LIGHT = np.array([0.9, 1.2, 0.8])


@cache
def bounding_kernel(part: int = 0) -> wp.Kernel:
    """Loads a packet, halves it if a `part` of it is asked for, and reverses its bounds. Item: a packet."""
    layout = PacketLayout(RAYS, 8, False, "woop")
    load, finish = load_packet(layout, slopes=False, later=True, ends=True), finish_packet(layout)
    reverse, size = reverse_bounds(layout), layout.size
    halve, activate = finish_part(layout), activate_part(layout, slopes=False, ends=True)

    def run(
        rays: RayBatch, low: wp.vec3, high: wp.vec3, loaded: wp.array(dtype=PacketBounds), found: wp.array(dtype=PacketBounds)
    ):
        packet = wp.zeros(shape=(size,), dtype=float)
        bounds = PacketBounds()
        load(rays, wp.tid() * wp.static(RAYS), low, high, packet, bounds)
        if wp.static(part > 0):
            finish(low, high, packet, bounds)
            halve(packet, bounds, 0, 1, False)
            activate(packet, bounds, wp.static(part))
        loaded[wp.tid()] = bounds
        reverse(low, high, bounds)
        found[wp.tid()] = bounds

    return wp.kernel(run, **OPTIONS)


def bounds_of(
    origins: np.ndarray, directions: np.ndarray, t_min: np.ndarray, t_max: np.ndarray, part: int = 0
) -> tuple[np.ndarray, ...]:
    """Bounds of packets (N, RAYS, ...), or of one of their halves, after loading, and after reversing."""
    device, count = wp.get_device("cpu"), len(origins)
    rays = RayBatch()
    rays.count, rays.origin_stride, rays.direction_stride, rays.t_min_stride, rays.t_max_stride = count * RAYS, 1, 1, 1, 1
    rays.origins, rays.directions = (wp.array(x.reshape(-1, 3), dtype=wp.vec3, device=device) for x in (origins, directions))
    rays.t_min, rays.t_max = (wp.array(x.ravel(), dtype=float, device=device) for x in (t_min, t_max))
    loaded, found = (wp.zeros(count, dtype=PacketBounds, device=device) for _ in range(2))
    wp.launch(bounding_kernel(part), count, [rays, wp.vec3(*LOW), wp.vec3(*HIGH), loaded, found], device=device)
    return loaded.numpy(), found.numpy()


def rays_to(target: np.ndarray, count: int, spread: float) -> tuple[np.ndarray, np.ndarray]:
    """Packets of rays from neighbouring points to a point for each ray, all of one sign along each axis."""
    rng = np.random.default_rng(1)
    middle = rng.uniform(-1.0, 0.4, (count, 1, 3))
    origins = (middle + rng.uniform(-spread, spread, (count, RAYS, 3))).astype(np.float32)
    return origins, (target - origins).astype(np.float32)


def ranges(origins: np.ndarray, begin: float, end: float) -> tuple[np.ndarray, np.ndarray]:
    shape = origins.shape[:2]
    return np.full(shape, begin, np.float32), np.full(shape, end, np.float32)


def test_rays_that_end_at_a_light_are_seen_from_it():
    origins, directions = rays_to(LIGHT, 50, 0.1)
    loaded, found = bounds_of(origins, directions, *ranges(origins, 0.25, 1.0))
    np.testing.assert_array_equal(found["backward"], 1 - loaded["backward"])
    for end in ("origin_in", "origin_out"):
        assert np.abs(found[end] - LIGHT).max() < 1e-4
    assert not found["t_min"].any()
    assert (found["t_max"] >= 0.75).all()
    assert (found["t_max"] < 0.75001).all()
    for kept in ("origin_low", "origin_high", "active", "mixed_axes"):
        np.testing.assert_array_equal(found[kept], loaded[kept])


@pytest.mark.parametrize("part", [0, 1, 2])
def test_ends_are_those_of_the_active_rays(part):
    origins, directions = rays_to(LIGHT, 50, 0.1)
    rng = np.random.default_rng(3)
    end = rng.uniform(0.1, 0.9, origins.shape[:2]).astype(np.float32)
    begin = end * rng.uniform(0.0, 1.0, end.shape).astype(np.float32)
    loaded, _ = bounds_of(origins, directions, begin, end, part)
    low, high = origins.min(axis=1), origins.max(axis=1)
    axis = (high - low).argmax(axis=1)
    along, middle = (x[np.arange(50), ..., axis] for x in (origins, low + np.float32(0.5) * (high - low)))
    active = np.stack([along == along, along < middle[:, None], along >= middle[:, None]])[part]
    np.testing.assert_array_equal(loaded["active"], active.sum(axis=1))
    ends = origins + end[..., None] * directions
    np.testing.assert_allclose(loaded["end_low"], np.where(active[..., None], ends, np.inf).min(axis=1), rtol=0, atol=1e-6)
    np.testing.assert_allclose(loaded["end_high"], np.where(active[..., None], ends, -np.inf).max(axis=1), rtol=0, atol=1e-6)
    np.testing.assert_array_equal(loaded["t_min"], np.where(active, begin, np.inf).min(axis=1))
    np.testing.assert_array_equal(loaded["t_max"], np.where(active, end, -np.inf).max(axis=1))


def test_components_that_count_as_zero_move_no_end():
    """Directions of 2^-126: what is smaller counts as 0, however far the ray goes."""
    origins, _ = rays_to(LIGHT, 20, 0.1)
    directions = np.broadcast_to(np.float32(2.0**-126) * np.float32([1.0, 0.9, -0.5]), origins.shape)
    loaded, _ = bounds_of(origins, np.ascontiguousarray(directions), *ranges(origins, 0.0, np.float32(2.0**126)))
    assert (loaded["active"] == RAYS).all()
    for end, origin in (("end_low", origins.min(axis=1)), ("end_high", origins.max(axis=1))):
        np.testing.assert_allclose(loaded[end], origin + np.float32([1.0, 0.0, 0.0]), rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    "why", ["no common end", "no end", "parallel", "far and parallel", "one origin", "both signs", "no active ray"]
)
def test_other_packets_keep_their_bounds(why):
    origins, directions = rays_to(LIGHT, 20, 0.1)
    begin, end = ranges(origins, 0.0, 1.0)
    if why == "no common end":
        directions[:] = directions[:, :1]
    elif why == "no end":
        end[:] = np.inf
    elif "parallel" in why:  # rounding leaves nothing of the origins, so that all rays seem to end at one point
        directions[:] = 0.1 * directions[:1, :1]
        end[:] = 1e12 if "far" in why else np.inf
    elif why == "one origin":
        origins[:], directions[:] = origins[:, :1], directions[:, :1]
    elif why == "both signs":
        origins, directions = rays_to(np.zeros(3), 20, 1.2)
    else:
        begin[:] = 2.0
    loaded, found = bounds_of(origins, directions, begin, end)
    assert found.tobytes() == loaded.tobytes()


def slabs(x, y, inverse, near_from, far_from, begin, end):
    """Interval of t in the boxes x .. y (float32, ..., 3) of slabs that begin and end where the origins moved to say."""
    back = inverse < 0.0
    near, far = np.where(back, y, x), np.where(back, x, y)
    enter = ((near - near_from) * inverse).max(axis=-1)
    leave = ((far - far_from) * inverse).min(axis=-1)
    return np.maximum(enter, begin), np.minimum(leave, end)


def keeps(bounds: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which boxes without extent, points (N, RAYS, 3), interval culling keeps for packet n."""
    large, small = bounds["inverse_large"][:, None], bounds["inverse_small"][:, None]
    into, out_of = points - bounds["origin_in"][:, None], points - bounds["origin_out"][:, None]
    enter = np.minimum(into * large, into * small).max(axis=-1)
    leave = np.maximum(out_of * large, out_of * small).min(axis=-1)
    return np.maximum(enter, bounds["t_min"][:, None]) <= np.minimum(leave, bounds["t_max"][:, None])


@pytest.mark.parametrize(("spread", "scale"), [(0.1, 1.0), (1e-3, 1.0), (0.1, 1e-30), (0.1, 1e30)])
def test_no_box_that_a_ray_meets_is_lost(spread, scale):
    """Boxes without extent whose corners rays just meet, because boxes are widened by the slack; along all axes, or one."""
    rng = np.random.default_rng(2)
    count = 2000
    origins, directions = rays_to(LIGHT, count, spread)
    directions = (directions * np.float32(scale)).astype(np.float32)
    begin, end = ranges(origins, 0.0, np.float32(1.0 / scale))
    loaded, found = bounds_of(origins, directions, begin, end)
    reversed_ = found["t_max"] != loaded["t_max"]
    reversed_ |= (found["backward"] != loaded["backward"]).any(axis=1)
    assert reversed_.all()
    reach = np.maximum(np.abs(LOW.astype(np.float32) - origins), np.abs(HIGH.astype(np.float32) - origins)).max(axis=-1)
    slack = (np.float32(SLACK) * reach)[..., None]
    t = rng.choice([0.0, 0.5, 1.0, -1.0], (count, RAYS, 1))
    t = np.where(t < 0.0, rng.random(t.shape), t)
    aside = rng.choice([-1.0, 0.0, 1.0], origins.shape) * rng.uniform(0.9, 1.1, origins.shape) * slack
    point = (origins + t * (LIGHT - origins) + aside).astype(np.float32)
    inverse = np.float32(1.0) / directions
    step = np.where(inverse < 0.0, -slack, slack)
    enter, leave = slabs(point, point, inverse, origins + step, origins - step, begin, end)
    meets = enter <= leave
    assert 0.2 < meets.mean() < 0.9
    assert keeps(found, point)[meets].all()
    assert keeps(found, point + np.float32(0.5)).mean() < 0.5

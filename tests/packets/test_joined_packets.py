"""Packets that are tested against the root together: their bounds contain those of each packet, and only misses are skipped."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import warp as wp
from support.hits import assert_same_hits
from support.meshes import SCENES
from support.packet_loops import OPTIONS
from support.packet_rays import packet_plan

import wrt
from wrt.engine.plan.plan import traversal_config
from wrt.engine.rays.device_rays import lay_out
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.traversal.packet.core.joined_packets import JOINED, root_misses
from wrt.kernels.traversal.packet.core.packet_bvh import walk_memory
from wrt.kernels.traversal.packet.core.packet_kernel import packet_layout
from wrt.kernels.traversal.packet.rays.joint_bounds import join_packets
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.packet_load import load_packet

RAYS = 32
PACKETS = 3
"""Packets of a group."""

LOW, HIGH = np.full(3, -1.5), np.full(3, 1.5)
"""The scene."""

CENTER = np.array([1000.0, -3.0, 0.25])


@cache
def joining_kernel(shared_origin: bool, width: int) -> wp.Kernel:
    """Bounds of each packet and of each group of packets. Item: a group."""
    layout = PacketLayout(RAYS, width, shared_origin, "woop")
    load = load_packet(layout, slopes=False, later=True, ends=not shared_origin)
    join, size = join_packets(layout, not shared_origin), layout.size

    def run(
        rays: RayBatch,
        low: wp.vec3,
        high: wp.vec3,
        each: wp.array2d(dtype=PacketBounds),
        together: wp.array(dtype=PacketBounds),
        joined: wp.array(dtype=int),
    ):
        packet = wp.zeros(shape=(size,), dtype=float)
        first = wp.tid() * wp.static(PACKETS * RAYS)
        bounds = PacketBounds()
        joined[wp.tid()] = join(rays, first, PACKETS, low, high, bounds)
        together[wp.tid()] = bounds
        for p in range(PACKETS):
            own = PacketBounds()
            load(rays, first + p * RAYS, low, high, packet, own)
            each[wp.tid(), p] = own

    return wp.kernel(run, **OPTIONS)


def groups_of_rays(groups: int, shared_origin: bool) -> tuple[np.ndarray, ...]:
    """Origins relative to the centre, directions, t_min and t_max (groups * PACKETS * RAYS, ...), some of them bad or odd."""
    rng = np.random.default_rng(8)
    shape = (groups, PACKETS * RAYS)
    middle = rng.uniform(-1.0, 1.0, (groups, 1, 3))
    origins = middle + rng.normal(size=(*shape, 3)) * rng.choice([0.0, 0.01, 0.3], (groups, 1, 1))
    directions = rng.normal(size=(groups, 1, 3)) + rng.normal(size=(*shape, 3)) * rng.choice([0.02, 0.5], (groups, 1, 1))
    kind = rng.integers(0, 5, groups)
    directions[kind == 0, :, 0] = np.abs(directions[kind == 0, :, 0]) * 2.0**-102  # counts as 0 in some of the rays
    directions[kind == 1, :, 1] = -0.0
    directions[kind == 2] = 0.9 - origins[kind == 2]  # to one point
    t_max = np.where(kind[:, None] == 2, 1.0, rng.choice([0.5, 3.0, np.inf], shape))
    t_min = rng.uniform(0.0, 0.4, shape)
    bad = rng.random(shape)
    for number, (value, of) in enumerate(((np.nan, origins), (np.nan, directions), (np.inf, directions), (0.0, directions))):
        of[(bad >= 0.01 * number) & (bad < 0.01 * (number + 1))] = value
    t_min[(bad > 0.97) & (bad < 0.98)] = np.nan
    t_max[bad > 0.99] = -1.0
    if shared_origin:
        origins = middle[:1, 0]
    arrays = (origins[None] if shared_origin else origins), directions, t_min, t_max
    return tuple(x.reshape(-1, *x.shape[2:]).astype(np.float32) for x in arrays)


def bounds_of(shared_origin: bool, ranged: bool, width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bounds of each packet (G, PACKETS), of each group (G,), and how many of its packets were joined (G,)."""
    groups, device = 60, wp.get_device("cpu")
    origins, directions, t_min, t_max = groups_of_rays(groups, shared_origin)
    if not ranged:
        t_min, t_max = np.zeros(1, np.float32), np.ones(1, np.float32)
    rays = RayBatch()
    rays.count, rays.center = len(directions), wp.vec3d(*CENTER)
    rays.origin_stride, rays.direction_stride, rays.t_min_stride, rays.t_max_stride = int(not shared_origin), 1, ranged, ranged
    rays.origins, rays.directions = (
        wp.array(x, dtype=wp.vec3, device=device) for x in ((origins + CENTER).astype(np.float32), directions)
    )
    rays.t_min, rays.t_max = (wp.array(x, dtype=float, device=device) for x in (t_min, t_max))
    each, together = (wp.zeros(shape, dtype=PacketBounds, device=device) for shape in ((groups, PACKETS), groups))
    joined = wp.zeros(groups, dtype=int, device=device)
    kernel = joining_kernel(shared_origin, width)
    wp.launch(kernel, groups, [rays, wp.vec3(*LOW), wp.vec3(*HIGH), each, together, joined], device=device)
    return each.numpy(), together.numpy(), joined.numpy()


@pytest.mark.parametrize("ranged", [False, True])
@pytest.mark.parametrize(("width", "shared_origin"), [(4, False), (8, True), (8, False), (16, True), (16, False)])
def test_bounds_contain_those_of_each_packet(width, shared_origin, ranged):
    each, together, joined = bounds_of(shared_origin, ranged, width)
    assert (joined == PACKETS).all()
    active = each["active"] > 0
    assert active.mean() > 0.9
    whole = {name: np.broadcast_to(together[name][:, None], each[name].shape)[active] for name in each.dtype.names}
    own = {name: each[name][active] for name in each.dtype.names}
    for name in ("t_min", "origin_low", "backward_small"):
        least = whole[name] if name != "backward_small" else np.where(whole[name] < 0.0, own[name], whole[name])
        assert (least <= own[name]).all(), name
    for name in ("t_max", "origin_high", "slack"):
        assert (whole[name] >= own[name]).all(), name
    mixed = np.isnan(whole["inverse_large"])
    assert 0.05 < mixed.mean() < 0.95
    assert not np.isnan(own["inverse_large"])[~mixed].any()
    np.testing.assert_array_equal(whole["backward"][~mixed], own["backward"][~mixed])
    assert (np.abs(whole["inverse_large"]) >= np.abs(own["inverse_large"]))[~mixed].all()
    assert (np.abs(whole["inverse_small"]) <= np.abs(own["inverse_small"]))[~mixed].all()
    forward = mixed & (own["backward"] == 0)  # with both signs in the group: the least of those that are positive
    least_forward = np.where(np.isnan(own["inverse_large"]), own["forward_small"], own["inverse_small"])
    assert (whole["forward_small"][forward] <= least_forward[forward]).all()
    only_back = mixed & (own["backward"] == 1)
    assert (whole["backward_small"][only_back] >= own["inverse_small"][only_back]).all()
    if not shared_origin and not ranged:
        assert (whole["end_low"] <= own["end_low"]).all()
        assert (whole["end_high"] >= own["end_high"]).all()
        assert np.isfinite(whole["end_low"]).mean() > 0.4


def background(mesh: wrt.TriangleMesh, pixels: int, own_origins: bool) -> tuple[np.ndarray, np.ndarray]:
    """A view in which the mesh fills a part of the picture; (pixels, pixels, 3) directions, and origins or the eye."""
    low, high = mesh.bounds
    size = float(np.linalg.norm(high - low))
    x, y = np.meshgrid(np.linspace(-1.6, 1.6, pixels), np.linspace(-1.6, 1.6, pixels))
    eye = mesh.center + size * np.array([0.2, 0.3, 2.0])
    directions = mesh.center + size * np.stack([x, y, np.zeros_like(x)], axis=-1) - eye
    if not own_origins:
        return eye.astype(np.float32), directions.astype(np.float32)
    origins = eye + 1.2 * size * np.stack([x, y, np.zeros_like(x)], axis=-1)
    return origins.astype(np.float32), (mesh.center + size * np.array([0.1, -0.2, -6.0]) - origins).astype(np.float32)


@pytest.mark.width
@pytest.mark.parametrize(
    ("culling", "vectors", "own_origins"),
    [("interval", 4, False), ("leaf_boxes", 2, False), ("interval", 2, True), ("leaf_boxes", 4, True)],
)
def test_hits(culling, vectors, own_origins, device):
    """Pictures and lists, whose last packets are not whole; with bad rays; float64; ranges of their own; one direction."""
    mesh = SCENES["teapot"]()
    scene = wrt.Scene(mesh, device=device)
    origins, directions = background(mesh, 96, own_origins)
    directions = directions.copy()
    rng = np.random.default_rng(2)
    bad = rng.random(directions.shape[:2])
    directions[bad < 0.002] = np.nan
    directions[(bad > 0.002) & (bad < 0.004)] = 0.0
    lists = [x.reshape(-1, 3)[: 96 * 96 - 5] if x.ndim == 3 else x for x in (origins, directions)]
    far = np.full(len(lists[1]), np.inf, np.float32)
    far[rng.random(len(far)) < 0.3] = 0.01
    given = [
        wrt.Rays(origins, directions),
        wrt.Rays(*lists),
        wrt.Rays(*(np.float64(x) for x in lists)),
        wrt.Rays(*lists, 0.0, 1.1),
        wrt.Rays(*lists, np.zeros_like(far), far),
    ]
    if own_origins:
        given.append(wrt.Rays(lists[0], np.float32([0.05, -0.1, -3.0])))
    for rays in given:
        plan = packet_plan(scene, rays, "woop", packet=vectors * scene.state.width, culling=culling)
        expected = scene.intersect(rays, traversal="brute")
        assert 0.01 < expected.is_hit.mean() < 0.5
        assert_same_hits(scene.intersect(rays, traversal=plan), expected)
        np.testing.assert_array_equal(scene.occluded(rays, traversal=plan), expected.is_hit)


def by_tiles(pixels: np.ndarray) -> np.ndarray:
    """Of a picture (256, 256, ...): tiles of 8 x 8 pixels, (32, 32, 8, 8, ...)."""
    return np.ascontiguousarray(pixels.reshape(32, 8, 32, 8, *pixels.shape[2:]).swapaxes(1, 2))


@pytest.mark.parametrize(("own_origins", "query"), [(False, "closest"), (True, "any")])
@pytest.mark.parametrize("picture", [False, True])
def test_groups_that_miss_are_found(picture, own_origins, query):
    """Most of the groups without a hit that lie far from the mesh are skipped, and no other."""
    mesh = SCENES["teapot"]()
    scene = wrt.Scene(mesh, device="cpu")
    origins, directions = background(mesh, 256, own_origins)
    if not picture:  # the tiles one after the other
        origins, directions = (x if x.ndim == 1 else by_tiles(x).reshape(-1, 3) for x in (origins, directions))
    rays = wrt.Rays(origins, directions)
    plan = packet_plan(scene, rays, "woop", packet=64, culling="leaf_boxes")
    config = traversal_config(plan, scene.state, query, False)
    size, memory, group = packet_layout(config).size, walk_memory(config), JOINED * 64
    misses = root_misses(config)

    def run(tree: WideNodes, rays: RayBatch, joined: wp.array(dtype=int)):
        packet = wp.zeros(shape=(size,), dtype=float)
        keys = wp.zeros(shape=(memory,), dtype=int)
        first = wp.tid() * group
        joined[wp.tid()] = misses(tree, rays, first, wp.static(JOINED), packet, keys)

    groups = 256 * 256 // group
    batch = lay_out(rays, wp.get_device("cpu"), scene.center).batch
    batch.columns = 256 if picture else 0
    joined = wp.zeros(groups, dtype=int, device="cpu")
    wp.launch(wp.kernel(run, **OPTIONS), groups, [scene.state.tree.struct(), batch, joined], device="cpu")
    hit = scene.intersect(rays, traversal="brute").is_hit.reshape(-1)
    if picture:
        hit = by_tiles(hit.reshape(256, 256)).ravel()
    hit = hit.reshape(groups, -1).any(axis=1)
    joined = joined.numpy()
    assert set(joined) == {0, JOINED}
    assert not (hit & (joined > 0)).any()
    assert (joined[~hit] > 0).mean() > 0.7

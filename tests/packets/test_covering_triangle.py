"""Packets that are occluded together: a triangle that covers them occludes each of their rays, and most of such packets are
found."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import warp as wp
from support.packet_loops import OPTIONS
from support.packet_rays import packet_plan

import wrt
from wrt.engine.launch.triangle_records import records_of
from wrt.engine.plan.plan import traversal_config
from wrt.engine.rays.device_rays import lay_out
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.traversal.packet.core.joined_packets import JOINED, answer_together, may_cover
from wrt.kernels.traversal.packet.core.packet_bvh import walk_memory
from wrt.kernels.traversal.packet.core.packet_kernel import packet_layout
from wrt.kernels.traversal.packet.leaves import occluder_cache
from wrt.kernels.traversal.packet.leaves.covering_triangle import covered_packets
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

PACKETS, RAYS = 3, 32
"""Of a group."""


@cache
def covering_kernel(width: int, shared_origin: bool) -> wp.Kernel:
    """How many packets of a batch a triangle of the first block covers."""
    covered = covered_packets(PacketLayout(RAYS, width, shared_origin, "woop"))

    def run(rays: RayBatch, records: wp.array(dtype=float), found: wp.array(dtype=int)):
        found[0] = covered(rays, 0, PACKETS, records, 0, 1)

    return wp.kernel(run, **OPTIONS)


def is_covered(scene: wrt.Scene, rays: wrt.Rays) -> bool:
    """Whether a triangle of the scene, which has one block of them, is found to cover the rays."""
    records = records_of(scene.state, scene.explain(rays, query="any", traversal="packet"), None).records
    found = wp.zeros(1, dtype=int, device="cpu")
    kernel = covering_kernel(scene.state.width, rays.origins.ndim == 1)
    wp.launch(kernel, 1, [lay_out(rays, wp.get_device("cpu"), scene.center).batch, records, found], device="cpu")
    assert found.numpy()[0] in (0, PACKETS)
    return bool(found.numpy()[0])


def shaft(rng: np.random.Generator, shared_origin: bool) -> tuple[wrt.TriangleMesh, wrt.Rays, bool]:
    """A triangle, the rays of a group towards it, many of them close to an edge, to its plane or to an end of their range; and
    whether all of them clearly hit it: in float64, well inside and from well before it to well behind."""
    size = 10.0 ** (rng.uniform(-3.0, 3.0) if rng.random() < 0.9 else rng.uniform(-18.0, 8.0))
    away = 10.0 ** rng.uniform(-1.5, 0.5)
    triangle = rng.normal(size=(3, 3)) * size + rng.normal(size=3) * size * rng.choice([0.0, 30.0])
    if rng.random() < 0.1:
        triangle[2] = 0.5 * (triangle[0] + triangle[1]) + 10.0 ** rng.uniform(-6.0, 0.0) * (triangle[2] - triangle[0])
    weights = rng.dirichlet(np.full(3, rng.choice([0.2, 2.0, 20.0])))
    target, wide = weights @ triangle, size * 10.0 ** rng.uniform(-5.0, -0.5)
    origin = target + size * away * rng.normal(size=3)
    origins = origin + rng.uniform(-1.0, 1.0, (PACKETS * RAYS, 3)) * wide * rng.choice([0.0, 1.0], 3)
    if shared_origin:
        origins[:] = origin
    ends = target + rng.uniform(-1.0, 1.0, (PACKETS * RAYS, 3)) * wide * rng.choice([0.0, 1.0])
    behind = max(1.0 + 10.0 ** rng.uniform(-6.0, 1.0) * rng.choice([1.0, 10.0, -0.1]), 0.5)
    directions = (ends - origins) * 10.0 ** rng.uniform(-3.0, 3.0) * rng.uniform(0.8, 1.2, (len(ends), 1))
    if rng.random() < 0.3:
        directions[:] = directions[0]
    t = np.linalg.norm(ends - origins, axis=1) / np.linalg.norm(directions, axis=1)
    t_max = np.inf if rng.random() < 0.3 else behind * float(np.median(t))
    t_min = 0.0 if rng.random() < 0.7 else min(t_max, float(np.median(t)) * (1.0 - 10.0 ** rng.uniform(-6.0, 0.0)))
    origins, directions, triangle = (x.astype(np.float32) for x in (origins, directions, triangle))
    mesh = wrt.TriangleMesh(triangle, np.array([[0, 1, 2]]))
    rays = wrt.Rays(origins[0] if shared_origin else origins, directions, np.float32(t_min), np.float32(t_max))
    return mesh, rays, clearly_hit(*(np.float64(x) for x in (triangle, origins, directions)), t_min, t_max)


def clearly_hit(triangle: np.ndarray, origins: np.ndarray, directions: np.ndarray, t_min: float, t_max: float) -> bool:
    """Whether each ray from the box of the origins in a direction of their box hits the triangle, a tenth of it from its edges
    and of the way from its ends: the corners of both boxes do."""
    corners = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1]), axis=-1).reshape(-1, 3)
    starts, ways = (np.where(corners, x.max(axis=0), x.min(axis=0)) for x in (origins, directions))
    starts, ways = np.repeat(starts, 8, axis=0), np.tile(ways, (8, 1))
    first, second = triangle[1] - triangle[0], triangle[2] - triangle[0]
    normal = np.cross(first, second)
    facing, from_corner = ways @ normal, starts - triangle[0]
    longest = max(np.linalg.norm(first), np.linalg.norm(second), np.abs(from_corner).max())
    if np.abs(facing).min() < 0.03 * np.linalg.norm(ways, axis=1).max() * longest**2 or len(set(np.sign(facing))) > 1:
        return False
    t = -(from_corner @ normal) / facing
    u = np.einsum("nk,nk->n", np.cross(ways, second[None]), from_corner) / -facing
    v = np.einsum("nk,nk->n", np.cross(first[None], ways), from_corner) / -facing
    inside = min(u.min(), v.min(), (1.0 - u - v).min()) > 0.1
    return bool(inside and (t.min() > 1.1 * t_min + 0.1 * t.max()) and (t.max() < 0.9 * t_max))


@pytest.mark.width
@pytest.mark.parametrize("shared_origin", [False, True])
def test_covered_rays_hit(shared_origin):
    """No group is covered of which a ray misses by brute force; groups that clearly hit are covered."""
    rng = np.random.default_rng(4)
    covered, clear, found = 0, 0, 0
    for _ in range(1500):
        mesh, rays, clearly = shaft(rng, shared_origin)
        scene = wrt.Scene(mesh, device="cpu")
        all_hit = bool(scene.occluded(rays, traversal="brute").all())
        assert all_hit or not clearly
        covers = is_covered(scene, rays)
        assert all_hit or not covers
        own = (np.full(PACKETS * RAYS, t, np.float32) for t in (rays.t_min, rays.t_max))
        assert not is_covered(scene, wrt.Rays(rays.origins, rays.directions, *own))
        covered, clear, found = covered + covers, clear + clearly, found + (covers and clearly)
    assert covered > 150
    assert clear > 80
    assert found > 0.95 * clear


def courtyard(size: float = 1.0, offset: float = 0.0) -> wrt.TriangleMesh:
    """A roof of two triangles and a narrow beam above a floor of many."""
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, 9), np.linspace(-1.0, 1.0, 9))
    corner = (np.arange(8)[:, None] * 9 + np.arange(8)).reshape(-1, 1)
    floor = np.concatenate([corner + np.array([0, 1, 10]), corner + np.array([0, 10, 9])])
    flat = np.array([[-0.7, -0.5, 0.5], [0.6, -0.5, 0.5], [0.6, 0.4, 0.7], [-0.7, 0.4, 0.7]])
    beam = np.array([[-0.9, 0.6, 0.5], [0.9, 0.6, 0.5], [0.9, 0.62, 0.5], [-0.9, 0.62, 0.5]])
    vertices = np.concatenate([np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3), flat, beam])
    quads = np.array([[0, 1, 2], [0, 2, 3]])
    return wrt.TriangleMesh(vertices * size + offset, np.concatenate([floor, quads + 81, quads + 85]))


def shadow_rays(mesh: wrt.TriangleMesh, pixels: int, sun: bool) -> tuple[np.ndarray, np.ndarray, float]:
    """From points of the floor, (pixels, pixels, 3), to a lamp or the sun: origins, directions and t_max."""
    low, high = mesh.bounds
    size = high - low
    x, y = np.meshgrid(np.linspace(0.02, 0.98, pixels), np.linspace(0.02, 0.98, pixels))
    origins = low + size * np.stack([x, y, np.full_like(x, 0.001)], axis=-1)
    lamp = low + size * np.array([0.45, 0.6, 4.0])
    directions = np.broadcast_to(lamp - mesh.center, origins.shape) if sun else lamp - origins
    return origins.astype(np.float32), directions.astype(np.float32), np.inf if sun else 1.0


@pytest.mark.width
@pytest.mark.parametrize("sun", [False, True])
@pytest.mark.parametrize("packet", [2, 4])
def test_occlusion(packet, sun, device):
    """As by brute force: pictures and lists; bad rays; float64; ranges of their own; one direction; far from the origin."""
    rng = np.random.default_rng(3)
    for size, offset in ((1.0, 0.0), (300.0, 20000.0)):
        mesh = courtyard(size, offset)
        scene = wrt.Scene(mesh, device=device)
        origins, directions, t_max = shadow_rays(mesh, 128, sun)
        bad = rng.random(origins.shape[:2])
        spoilt = origins.copy(), directions.copy()
        spoilt[0][bad < 0.001], spoilt[1][bad > 0.999] = np.nan, 0.0
        spoilt[1][(bad > 0.5) & (bad < 0.501)] = np.inf
        lists = [x.reshape(-1, 3)[:-7] for x in (origins, directions)]
        own = np.where(np.arange(len(lists[0])) // 200 % 3 == 2, 0.01, t_max).astype(np.float32)
        given = [
            wrt.Rays(origins, directions, 0.0, t_max),
            wrt.Rays(*lists, 0.0, t_max),
            wrt.Rays(*spoilt, 0.0, t_max),
            wrt.Rays(*(x.reshape(-1, 3) for x in spoilt), 0.0, t_max),
            wrt.Rays(*(np.float64(x) for x in lists), 0.0, t_max),
            wrt.Rays(*lists, np.zeros_like(own), own),
            wrt.Rays(*lists, 0.1 if sun else 0.13, t_max),
            wrt.Rays(lists[0], directions[0, 0], 0.0, t_max),
        ]
        for rays in given:
            plan = packet_plan(scene, rays, "woop", packet=packet * scene.state.width, culling="leaf_boxes")
            expected = scene.occluded(rays, traversal="brute")
            assert 0.05 < expected.mean() < 0.6
            np.testing.assert_array_equal(scene.occluded(rays, traversal=plan), expected)


@pytest.mark.parametrize("sun", [False, True])
@pytest.mark.parametrize("picture", [False, True])
def test_groups_that_are_occluded_are_found(picture, sun):
    """Most of the groups in the roof's shadow are answered together, and no other; nor are they for other tests."""
    pixels, packet = 256, 32
    mesh = courtyard()
    scene = wrt.Scene(mesh, device="cpu")
    origins, directions, t_max = shadow_rays(mesh, pixels, sun)

    def tiles(pictures: np.ndarray) -> np.ndarray:
        """Of (256, 256, ...): those of 8 columns and 4 rows, one after the other."""
        parts = pictures.reshape(64, 4, 32, 8, *pictures.shape[2:]).swapaxes(1, 2)
        return np.ascontiguousarray(parts).reshape(-1, *pictures.shape[2:])

    rays = wrt.Rays(*((x if picture else tiles(x)) for x in (origins, directions)), 0.0, t_max)
    plan = packet_plan(scene, rays, "woop", packet=packet, culling="leaf_boxes")
    config = traversal_config(plan, scene.state, "any", False)
    assert may_cover(config)
    for changes in ({"query": "closest"}, {"triangle_test": "komatsu"}, {"cull_backfaces": True}):
        assert not may_cover(replace(config, **changes))
    layout, memory, group = packet_layout(config), walk_memory(config), JOINED * packet
    answer, cache_leaf, size = answer_together(config), occluder_cache.cache_leaf(layout), layout.size

    def run(
        tree: WideNodes, triangles: TriangleBlocks, rays: RayBatch, hits: HitBatch, leaf: int, answered: wp.array(dtype=int)
    ):
        packet = wp.zeros(shape=(size,), dtype=float)
        keys = wp.zeros(shape=(memory,), dtype=int)
        cache_leaf(packet, leaf, True)
        first, missed = wp.tid() * group, int(0)
        answered[wp.tid()] += answer(tree, triangles, rays, wp.vec2i(first, first + group), packet, keys, hits, missed)

    groups, kernel = pixels**2 // group, wp.kernel(run, **OPTIONS)
    batch, tree = lay_out(rays, wp.get_device("cpu"), scene.center).batch, scene.state.tree
    batch.columns = pixels if picture else 0
    hits = HitBatch()
    hits.occluded = wp.zeros(pixels**2, dtype=wp.bool, device="cpu")
    answered = wp.zeros(groups, dtype=int, device="cpu")
    for leaf in np.flatnonzero(tree.child.numpy() < 0) + 1:
        inputs = [tree.struct(), records_of(scene.state, plan, None), batch, hits, int(leaf), answered]
        wp.launch(kernel, groups, inputs, device="cpu")
    expected = scene.occluded(rays, traversal="brute")
    occluded = (tiles(expected) if picture else expected).reshape(groups, -1).all(axis=1)
    answered, written = answered.numpy(), hits.occluded.numpy()
    assert not (written & ~expected.ravel()).any()
    assert not (answered > 0)[~occluded].any()
    assert occluded.sum() > 50
    assert (answered > 0)[occluded].mean() > 0.6  # not those that the roof's diagonal divides

"""Streams against brute force, bit for bit: both trees, any rays, lists of every length, and how full their vectors are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from support.algorithms import ENGINE_TESTS
from support.hits import assert_same_hits, brute_force, mixed_rays
from support.meshes import SCENES
from support.packet_rays import beams

import wrt
from wrt.engine.plan.plan import Plan
from wrt.engine.plan.plan_checks import MAX_LOCAL_STREAM, MAX_STREAM, longest_stream
from wrt.engine.plan.planner import CUDA_STREAM, STREAMS
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.triangle import TRIANGLE_TESTS

pytestmark = pytest.mark.width

TREES = TRAVERSALS["stream"].trees
SMALL_SCENES = ("teapot", "random_triangles", "stadium", "grid", "degenerate")
SIZE = STREAMS[-1]
"""What a plan asks for if rays are few: other tests have these kernels too."""


def size_on(scene: wrt.Scene) -> int:
    """Rays of a stream. On CUDA a stream is a thread's, and takes memory for all threads."""
    return CUDA_STREAM if scene.device.is_cuda else SIZE


def stream_plan(scene: wrt.Scene, rays: wrt.Rays, size: int, triangle_test: str = "woop") -> Plan:
    return replace(scene.explain(rays, traversal="stream", triangle_test=triangle_test), stream=size)


def assert_equals_brute_force(scene: wrt.Scene, rays: wrt.Rays, size: int, triangle_test: str = "woop") -> wrt.Hits:
    expected = brute_force(scene, rays, triangle_test=triangle_test)
    plan = stream_plan(scene, rays, size, triangle_test)
    assert_same_hits(scene.intersect(rays, traversal=plan), expected)
    np.testing.assert_array_equal(scene.occluded(rays, traversal=plan), expected.is_hit)
    return expected


def utilisation(scene: wrt.Scene, rays: wrt.Rays, size: int) -> tuple[float, float]:
    """Share of the lanes in use, for traversal and for intersection."""
    work = scene.intersect(rays, traversal=stream_plan(scene, rays, size), counters=True).counters
    traversal = work["traversal_active"].sum() / work["traversal_slots"].sum()
    return traversal, work["intersection_active"].sum() / work["intersection_slots"].sum()


BEAMS = [
    pytest.param(tree, name, own, marks=[pytest.mark.exhaustive] * (name != ENGINE_TESTS[0] and tree != "bvh"))
    for tree in TREES
    for name in ENGINE_TESTS
    for own in (False, True)
    if not (own and TRIANGLE_TESTS[name].needs_shared_origin)
]
"""All tests in one tree, and all trees with one test: leaves are the same in all."""


@pytest.mark.parametrize(("tree", "triangle_test", "own_origins"), BEAMS)
def test_beams(tree, triangle_test, own_origins, device):
    """Rays that stay together, in planes of faces and along the axes; some are bad; the last stream is not full."""
    for name in SMALL_SCENES:
        mesh = SCENES[name]()
        scene = wrt.Scene(mesh, tree, device=device)
        origins, directions = beams(mesh, 60, own_origins)
        rays = wrt.Rays(origins[:-5] if own_origins else origins, directions[:-5])
        expected = assert_equals_brute_force(scene, rays, size_on(scene), triangle_test)
        assert expected.is_hit.mean() > 0.05


def walls() -> wrt.TriangleMesh:
    """A room with boxes in it, one of them twice, so that hits tie, and a ball: leaves of few triangles, and full ones."""
    at = trimesh.transformations.translation_matrix
    places = [(x, y, -1.2) for x in (-1.0, 1.0) for y in (-1.5, 0.0, 1.5)]
    boxes = [trimesh.creation.box((0.5, 0.8, 0.6), transform=at(place)) for place in places]
    room = trimesh.creation.box((4.0, 5.0, 3.0))
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.4)
    merged = trimesh.util.concatenate([room, *boxes, ball, boxes[0]])
    return wrt.TriangleMesh(merged.vertices.astype(np.float32), merged.faces)


def test_leaves_of_few_triangles(device):
    """Rays in lanes: ranges that end at hits, rays that have ended, ties; lanes are full where those of blocks would not be."""
    mesh = walls()
    scene = wrt.Scene(mesh, device=device)
    origins, directions = mixed_rays(mesh, 4500, seed=3)
    size = CUDA_STREAM if scene.device.is_cuda else MAX_STREAM
    expected = assert_equals_brute_force(scene, wrt.Rays(origins, directions), size)
    assert expected.is_hit.mean() > 0.5
    t_max = np.where(expected.is_hit, expected.t * np.float32([1.0, 0.9, 2.0])[np.arange(4500) % 3], np.float32(1.0))
    assert_equals_brute_force(scene, wrt.Rays(origins, directions, 0.0, t_max), size)
    if not scene.device.is_cuda:
        rays = wrt.Rays(origins, directions)
        assert utilisation(scene, rays, MAX_STREAM)[1] > utilisation(scene, rays, 16)[1]  # lists of 16 rays are too short


@pytest.mark.parametrize("size", [1, 17, SIZE, MAX_LOCAL_STREAM, MAX_STREAM])
@pytest.mark.parametrize("tree", TREES)
def test_sizes(tree, size, device):
    """Streams of one ray to the longest, with per-ray ranges that cut between hits, at hits, and empty ones."""
    mesh = wrt.scenes.build("teapot", level=4)
    scene = wrt.Scene(mesh, tree, device=device)
    origins, directions = mixed_rays(mesh, 4500, seed=size)
    if size > longest_stream(scene.state.facts, TRAVERSALS["stream"]):
        with pytest.raises(ValueError, match=r"plan\.stream"):
            assert_equals_brute_force(scene, wrt.Rays(origins, directions), size)
        return
    first = scene.intersect(origins, directions)
    rng = np.random.default_rng(2)
    t_min = np.where(first.is_hit & (rng.random(4500) < 0.5), first.t, rng.random(4500)).astype(np.float32)
    t_max = np.where(rng.random(4500) < 0.3, t_min, t_min + rng.random(4500) - 0.1).clip(0).astype(np.float32)
    assert_equals_brute_force(scene, wrt.Rays(origins, directions, t_min, t_max), size)
    assert_equals_brute_force(scene, wrt.Rays(origins, directions), size)


@pytest.mark.parametrize("tree", TREES)
def test_ray_counts(tree, device):
    """None, one, and counts about the length of a stream."""
    mesh = wrt.scenes.build("teapot", level=3)
    scene = wrt.Scene(mesh, tree, device=device)
    size = size_on(scene)
    for count in (0, 1, size - 1, size, size + 1, 2 * size - 1, 2 * size, 2 * size + 1):
        assert_equals_brute_force(scene, wrt.Rays(*mixed_rays(mesh, count, seed=count)), size)


@pytest.mark.parametrize("accelerator", [wrt.Bvh(width=2), wrt.Bvh(width=8), wrt.KdTree(width=1), wrt.KdTree(width=4)])
def test_widths(accelerator):
    mesh = wrt.scenes.build("teapot", level=4)
    scene = wrt.Scene(mesh, accelerator, device="cpu")
    rays = wrt.Rays(*mixed_rays(mesh, 1500, seed=accelerator.width))
    expected = scene.intersect(rays, traversal="brute")
    assert_same_hits(scene.intersect(rays, traversal=stream_plan(scene, rays, 1024)), expected)


@pytest.mark.parametrize("triangles", [63, 200])
def test_one_leaf(triangles):
    """A kd-tree that is one leaf, of more triangles than a pair's leaf can name, and of more rays than pairs can wait."""
    mesh = wrt.scenes.build("random_triangles", count=triangles, size=0.5, seed=1)
    for width in (1, 16):
        scene = wrt.Scene(mesh, wrt.KdTree(width=width, max_depth=0), device="cpu")
        assert len(scene.tree.nodes) == 1
        origins = np.random.default_rng(0).uniform(-0.5, 0.0, (1100, 3))
        assert_equals_brute_force(scene, wrt.Rays(origins, 0.5 - origins), MAX_LOCAL_STREAM)


@pytest.mark.parametrize("tree", TREES)
def test_many_layers_met_at_their_vertices_and_edges(tree, device):
    """A ray's line meets more triangles than candidates can wait, most of them on an edge, and every layer is there twice."""
    layers, across = 100, np.arange(3.0)
    x, y = (axis.ravel() for axis in np.meshgrid(across, across))
    corners = np.concatenate([np.stack([x, y, np.full(9, z)], axis=1) for z in np.repeat(np.arange(layers) * 0.125, 2)])
    quads = np.array([0, 1, 3, 4])[:, None, None] + np.array([[0, 1, 4], [0, 4, 3]])
    faces = (quads.reshape(-1, 3)[None] + 9 * np.arange(2 * layers)[:, None, None]).reshape(-1, 3)
    scene = wrt.Scene(wrt.TriangleMesh(corners, faces), tree, device=device)
    rng = np.random.default_rng(0)
    at = np.concatenate([rng.integers(0, 5, (150, 2)) / 2.0, rng.uniform(0.0, 2.0, (150, 2))])
    origins = np.column_stack([at, rng.uniform(-1.0, 0.125 * layers + 1.0, 300)])
    directions = np.tile([0.0, 0.0, 1.0], (300, 1)) * rng.choice([-1.0, 1.0], (300, 1))
    directions[200:] += rng.normal(scale=0.05, size=(100, 3))
    far = rng.choice([0.03, 0.5, np.inf], 300).astype(np.float32)
    expected = assert_equals_brute_force(scene, wrt.Rays(origins, directions, 0.0, far), size_on(scene))
    assert 0.4 < expected.is_hit.mean() < 0.95
    assert_equals_brute_force(scene, wrt.Rays(origins, directions), size_on(scene))


@pytest.mark.parametrize("tree", TREES)
def test_a_range_from_minus_zero(tree, device):
    """As an integer, -0.0 is less than every key of a child: the nearest one was never visited."""
    mesh = wrt.scenes.build("teapot", level=4)
    scene = wrt.Scene(mesh, tree, device=device)
    rng = np.random.default_rng(0)
    origins, directions = rng.uniform(*mesh.bounds, (500, 3)), rng.normal(size=(500, 3))
    rays = wrt.Rays(origins, directions, np.full(500, -0.0, dtype=np.float32))
    assert assert_equals_brute_force(scene, rays, size_on(scene)).is_hit.mean() > 0.3


@pytest.mark.parametrize("tree", TREES)
def test_only_bad_rays(tree, device):
    scene = wrt.Scene(wrt.scenes.build("teapot", level=2), tree, device=device)
    rays = wrt.Rays(np.full((300, 3), np.nan), np.zeros((300, 3)))
    assert not assert_equals_brute_force(scene, rays, size_on(scene)).is_hit.any()


@pytest.mark.parametrize("tree", TREES)
def test_coherent_rays_and_long_streams_fill_the_lanes(tree):
    mesh = wrt.scenes.build("teapot", level=5)
    scene = wrt.Scene(mesh, tree, device="cpu")
    camera = wrt.PinholeCamera(128, 128, position=(0.0, -9.0, 4.0), look_at=(0.0, 0.0, 1.0)).rays()
    rng = np.random.default_rng(0)
    random = wrt.Rays(rng.uniform(*mesh.bounds, (128 * 128, 3)), rng.normal(size=(128 * 128, 3)))
    kinds = {"camera": camera, "random": random}
    shares = {(name, size): utilisation(scene, rays, size) for name, rays in kinds.items() for size in (SIZE, 1024)}
    assert all(0.0 < share <= 1.0 for both in shares.values() for share in both)
    for size in (SIZE, 1024):
        assert shares["camera", size][0] > shares["random", size][0]
    for name in ("camera", "random"):
        assert shares[name, 1024][0] > shares[name, SIZE][0]


def test_counters_of_a_stream():
    """The work of a stream is at its first ray; a list meets what single rays meet, or a little more."""
    mesh = wrt.scenes.build("teapot", level=4)
    for tree in TREES:
        scene = wrt.Scene(mesh, tree, device="cpu")
        rays = wrt.Rays(*mixed_rays(mesh, 1000))
        work = scene.intersect(rays, traversal=stream_plan(scene, rays, SIZE), counters=True).counters
        single = scene.intersect(rays, traversal="single", counters=True).counters
        assert np.flatnonzero(work["nodes"]).tolist() == list(range(0, 1000, SIZE))
        for name in ("nodes", "triangles"):
            assert 1.0 <= work[name].sum() / single[name].sum() < 2.0
        assert work["intersection_active"].sum() == work["triangles"].sum()


def test_plans_that_do_not_fit():
    mesh = wrt.scenes.build("teapot", level=2)
    scene = wrt.Scene(mesh, "bvh", device="cpu")
    rays = wrt.Rays(*mixed_rays(mesh, 10))
    assert "streams of" in str(scene.explain(rays, traversal="stream"))
    for size in (0, MAX_STREAM + 1):
        with pytest.raises(ValueError, match=r"plan\.stream"):
            scene.intersect(rays, traversal=stream_plan(scene, rays, size))

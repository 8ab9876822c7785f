"""Multi-frusta for rays from one point: the hits of brute force, bit for bit, whatever the rays and the picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.algorithms import ENGINE_TESTS
from support.hits import assert_same_hits, brute_force, mixed_rays
from support.meshes import SCENES

import wrt

pytestmark = pytest.mark.classics

FRUSTA = "multi_frusta"


def directions_from(mesh: wrt.TriangleMesh, origin: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) float32: to vertices, edges and anywhere, along axes and in planes through the origin; some are bad."""
    rng = np.random.default_rng(count)
    starts, along = mixed_rays(mesh, count)
    directions = (starts + along - origin).astype(np.float32)
    corners = mesh.vertices[mesh.faces[rng.integers(0, mesh.triangle_count, count)]]
    kind = rng.integers(0, 10, count)
    directions[kind == 0] = (corners[:, 0] - origin)[kind == 0]
    directions[kind == 1] = ((corners[:, 0] + corners[:, 1]) / 2 - origin)[kind == 1]
    axis = np.eye(3, dtype=bool)[rng.integers(0, 3, count)]
    directions[(kind == 2)[:, None] & ~axis] = 0.0
    directions[kind == 3, rng.integers(0, 3)] = 0.0
    directions[kind == 4] *= np.float32(1e-30)
    directions[kind == 5, 0] = -0.0
    return directions


def places(mesh: wrt.TriangleMesh) -> list[np.ndarray]:
    """Eyes outside, inside, at a vertex, on a face, in the plane of a side of the bounding box, and far away."""
    low, high = mesh.bounds
    size = high - low + 1e-6
    a, b, c = mesh.vertices[mesh.faces[mesh.triangle_count // 3]]
    found = [low - 0.4 * size, (low + high) / 2, a, (a + b + c) / 3, [low[0], high[1], high[2]], low - 300.0 * size]
    return [np.asarray(place, np.float32) for place in found]


@pytest.mark.width
def test_any_rays_from_one_point(scene_mesh):
    """In no order at all: most frusta have both signs along all axes. Lists end within a frustum and within a block."""
    scene = wrt.Scene(scene_mesh, wrt.Bvh(), device="cpu")
    for number, origin in enumerate(places(scene_mesh)):
        directions = directions_from(scene_mesh, origin, 1537 + 101 * number)
        expected = brute_force(scene, wrt.Rays(origin, directions))
        assert expected.is_hit.any()
        assert_same_hits(scene.intersect(origin, directions, traversal=FRUSTA), expected)
        np.testing.assert_array_equal(scene.occluded(origin, directions, traversal=FRUSTA), expected.is_hit)


@pytest.mark.parametrize("size", [(128, 96), (64, 17), (33, 20), (7, 5), (1, 1), (200, 1), (8, 50)])
def test_pictures_of_every_size(size):
    """Whole blocks, blocks cut at the right and below, less than a tile; the same rays as a list, row by row."""
    mesh = SCENES["grid"]()
    scene = wrt.Scene(mesh, wrt.Bvh(), device="cpu")
    low, high = mesh.bounds
    for place in (high + 0.3 * (high - low), 0.6 * low + 0.4 * high):
        rays = wrt.PinholeCamera(*size, fov=70.0, position=place, look_at=(low + high) / 2 + 0.01, up=(0, 0, 1)).rays()
        plan = scene.explain(rays, traversal=FRUSTA)
        assert plan.reorder == ("tiles" if size[0] > 32 and size[1] > 1 else plan.reorder)
        assert plan.packet == plan.width
        expected = brute_force(scene, rays)
        assert_same_hits(scene.intersect(rays, traversal=FRUSTA), expected)
        listed = wrt.Rays(place, np.asarray(rays.directions).reshape(-1, 3))
        hits = scene.intersect(listed, traversal=FRUSTA)
        np.testing.assert_array_equal(hits.t.view(np.int32), expected.t.view(np.int32).reshape(-1))
        np.testing.assert_array_equal(hits.primitive_id, expected.primitive_id.reshape(-1))


@pytest.mark.parametrize("triangle_test", ENGINE_TESTS[:2])
def test_ranges_of_their_own(triangle_test):
    """Each ray has its own t_min and t_max, some at hits and some empty; frusta whose rays are all invalid."""
    mesh = SCENES["needles"]()
    scene = wrt.Scene(mesh, wrt.Bvh(), device="cpu")
    origin = places(mesh)[0]
    directions = directions_from(mesh, origin, 2000)
    directions[300:700] = np.nan
    options = {"triangle_test": triangle_test}
    first = brute_force(scene, wrt.Rays(origin, directions), **options)
    rng = np.random.default_rng(2)
    t_min = np.where(first.is_hit & (rng.random(2000) < 0.5), first.t, rng.random(2000)).astype(np.float32)
    t_max = np.where(rng.random(2000) < 0.3, t_min, t_min + rng.random(2000) - 0.1).clip(0).astype(np.float32)
    expected = brute_force(scene, wrt.Rays(origin, directions, t_min, t_max), **options)
    assert_same_hits(scene.intersect(origin, directions, t_min, t_max, traversal=FRUSTA, **options), expected)
    if triangle_test == ENGINE_TESTS[0]:
        dark = scene.occluded(origin, directions, t_min, t_max, traversal=FRUSTA)
        np.testing.assert_array_equal(dark, expected.is_hit)


@pytest.mark.parametrize("culling", ["corner_rays", "transient_frustum"])
def test_cullings_at_leaves(culling):
    """Corner rays; a frustum of those rays that meet the leaf, which are tested one by one if they are few."""
    mesh = SCENES["stadium"]()
    scene = wrt.Scene(mesh, wrt.Bvh(), device="cpu")
    low, high = mesh.bounds
    rays = wrt.PinholeCamera(48, 40, fov=60.0, position=0.3 * low + 0.7 * high, look_at=(low + high) / 2, up=(0, 0, 1)).rays()
    plan = replace(scene.explain(rays, traversal=FRUSTA), culling=culling)
    assert_same_hits(scene.intersect(rays, traversal=plan), brute_force(scene, rays))


def test_front_faces():
    """Triangles seen exactly from the side, an eye in the planes of triangles, duplicates wound both ways."""
    for name in ("random_triangles", "grid", "degenerate"):
        mesh = SCENES[name]()
        scene = wrt.Scene(mesh, wrt.Bvh(), device="cpu")
        for origin in places(mesh)[:5]:
            directions = directions_from(mesh, origin, 900)
            expected = scene.intersect(origin, directions, traversal="brute", cull_backfaces=True)
            assert (expected.t != brute_force(scene, wrt.Rays(origin, directions)).t).any()
            hits = scene.intersect(origin, directions, traversal=FRUSTA, cull_backfaces=True)
            assert "front faces only" in str(scene.explain(origin, directions, traversal=FRUSTA, cull_backfaces=True))
            assert_same_hits(hits, expected)


def test_frusta_that_see_nothing_make_no_rays():
    """Work is counted for each block; a block beside the scene tests no triangle."""
    scene = wrt.Scene(SCENES["teapot"](), wrt.Bvh(), device="cpu")
    away = np.float32([0, 0, 1]) + np.random.default_rng(0).uniform(-0.1, 0.1, (4096, 3)).astype(np.float32)
    work = scene.intersect(np.float32([0, 0, 50]), away, traversal=FRUSTA, counters=True).counters
    assert work["nodes"].sum() > 0
    assert work["leaves"].sum() == work["triangles"].sum() == 0
    work = scene.intersect(np.float32([0, 0, 50]), -away, traversal=FRUSTA, counters=True).counters
    assert work["triangles"].sum() > 0


def test_other_rays_and_trees_are_refused():
    mesh = SCENES["teapot"]()
    scene = wrt.Scene(mesh, wrt.Bvh(), device="cpu")
    origins, directions = mixed_rays(mesh, 100)
    with pytest.raises(ValueError, match=r"traversal 'multi_frusta' needs rays that share their origin; .* traversal='auto'"):
        scene.intersect(origins, directions, traversal=FRUSTA)
    plan = scene.explain(origins[0], directions, traversal=FRUSTA)
    with pytest.raises(ValueError, match="share their origin"):
        scene.occluded(origins, directions, traversal=plan)
    with pytest.raises(ValueError, match=r"plan.shared_origin is false, but traversal 'multi_frusta'"):
        scene.intersect(origins[0], directions, traversal=replace(plan, shared_origin=False))
    with pytest.raises(ValueError, match="does not answer the query 'count'"):
        scene.count(origins[0], directions, traversal=FRUSTA)
    with pytest.raises(ValueError, match="does not walk a kdtree"):
        wrt.Scene(mesh, wrt.KdTree(), device="cpu").intersect(origins[0], directions, traversal=FRUSTA)
    with pytest.raises(ValueError, match="two levels"):
        wrt.Scene([wrt.Instance(mesh)], device="cpu").intersect(origins[0], directions, traversal=FRUSTA)
    assert len(scene.intersect(origins[0], np.zeros((0, 3)), traversal=FRUSTA).t) == 0
    assert scene.intersect(origins[5:6], directions[5:6], traversal=FRUSTA).t.shape == (1,), "a single ray shares its origin"

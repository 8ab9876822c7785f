"""`skip`: a ray passes through one triangle, and its answer is that of the mesh without it, to the bit."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.hits import mixed_rays
from support.meshes import degenerate_soup, snapped_soup
from support.ptx import FUSIBLE, compile_to_ptx
from support.selection import slow

import wrt
from wrt.engine.facts.query_kinds import ANY, CLOSEST
from wrt.kernels.answers import SKIPPING
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.traversal_config import TraversalConfig

TREES = ("bvh", "kdtree")

MESHES = {"degenerate": degenerate_soup, "grid": lambda: snapped_soup(150, seed=4)}

TEAPOT = wrt.scenes.build("teapot", level=3)


def rays_about(mesh: wrt.TriangleMesh, triangle: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays of every kind, rays at a triangle and rays that start on it, its edges and vertices included."""
    rng = np.random.default_rng(seed)
    origins, directions = mixed_rays(mesh, 100, seed)
    corners = mesh.vertices[mesh.faces[triangle]]
    weights = np.concatenate([np.eye(3), (1 - np.eye(3)) / 2, rng.dirichlet((1, 1, 1), 34)])
    points = (weights @ corners).astype(np.float32)
    at = rng.uniform(*mesh.bounds, points.shape).astype(np.float32)
    away = rng.normal(size=points.shape).astype(np.float32)
    return np.concatenate([origins, at, points]), np.concatenate([directions, points - at, away])


@pytest.mark.parametrize("name", MESHES)
def test_meshes_without_the_triangle(name, device):
    """A few dozen triangles, removed one by one; those are left in whose absence the scene would have another box."""
    mesh = MESHES[name]()
    scenes = [wrt.Scene(mesh, tree, device=device) for tree in TREES]
    met, removed = 0, 0
    for triangle in range(0, mesh.triangle_count, mesh.triangle_count // 18):
        others = np.delete(np.arange(mesh.triangle_count), triangle)
        without = wrt.Scene(wrt.TriangleMesh(mesh.vertices, mesh.faces[others]), device=device)
        if (without.bounds != scenes[0].bounds).any():
            continue
        rays = rays_about(mesh, triangle, seed=triangle)
        expected, counts = without.intersect(*rays, traversal="brute"), without.count(*rays, traversal="brute")
        for scene in scenes:
            hits = scene.intersect(*rays, skip=triangle)
            np.testing.assert_array_equal(hits.primitive_id, np.append(others, -1)[expected.primitive_id])
            np.testing.assert_array_equal(hits.t.view(np.int32), expected.t.view(np.int32))
            np.testing.assert_array_equal(hits.uv.view(np.int32), expected.uv.view(np.int32))
            np.testing.assert_array_equal(scene.occluded(*rays, skip=triangle), expected.is_hit)
            np.testing.assert_array_equal(scene.count(*rays, skip=triangle), counts)
        met += (scenes[0].intersect(*rays).primitive_id == triangle).sum()
        removed += 1
    assert removed >= 15
    assert met > 5 * removed


@pytest.mark.parametrize("tree", TREES)
def test_rays_that_leave_hits(tree, device):
    """From where rounding puts the hit: the own triangle is never met, and what else is met stays the same."""
    scene, rng = wrt.Scene(TEAPOT, tree, device=device), np.random.default_rng(5)
    hits = scene.intersect(*mixed_rays(TEAPOT, 1000, seed=2))
    directions = rng.normal(size=(1000, 3)).astype(np.float32)
    origins = np.where(hits.is_hit[:, None], hits.position, 9.0)
    plain, past = scene.intersect(origins, directions), scene.intersect(origins, directions, skip=hits)
    own = hits.is_hit & (plain.primitive_id == hits.primitive_id)
    assert own.mean() > 0.05
    assert not (hits.is_hit & (past.primitive_id == hits.primitive_id)).any()
    np.testing.assert_array_equal(past.primitive_id[~own], plain.primitive_id[~own])
    np.testing.assert_array_equal(past.t[~own].view(np.int32), plain.t[~own].view(np.int32))
    assert (past.t[own] >= plain.t[own]).all()
    np.testing.assert_array_equal(scene.occluded(origins, directions, skip=hits), past.is_hit)


def test_coincident_triangles(device):
    """Of twins, the other one stays."""
    square = wrt.TriangleMesh([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 1, 2], [1, 2, 0]])
    scene = wrt.Scene(square, device=device)
    origins = np.full((5, 3), 0.25, dtype=np.float32) * [1, 1, 0]
    hits = scene.intersect(origins, [0, 0, 1.0], skip=[-1, 0, 1, 2, 0])
    assert hits.primitive_id.tolist() == [0, 1, 0, 0, 1]
    assert hits.t.tolist() == [0.0] * 5
    assert scene.count(origins, [0, 0, 1.0], skip=[-1, 0, 1, 2, 0]).tolist() == [3, 2, 2, 2, 2]
    assert scene.intersect(origins[0], [0, 0, 1.0], t_min=1e-3, skip=1).primitive_id == -1


def test_front_faces(device):
    """What is skipped, and what is seen from behind, is not there."""
    back_to_back = wrt.TriangleMesh([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 1, 2], [2, 1, 0]])
    scene = wrt.Scene(back_to_back, device=device)
    up, down = ([0.25, 0.25, -1.0], [0, 0, 1.0]), ([0.25, 0.25, 1.0], [0, 0, -1.0])
    for rays, met in ((up, [2, 2, 2, -1]), (down, [0, 1, 0, 0])):
        hits = scene.intersect(np.tile(rays[0], (4, 1)), rays[1], cull_backfaces=True, skip=[-1, 0, 1, 2])
        assert hits.primitive_id.tolist() == met


def test_shapes_and_kinds(device):
    """Hits, integers of any width, NumPy and Warp; shapes that broadcast."""
    scene, rng = wrt.Scene(TEAPOT, device=device), np.random.default_rng(6)
    origins, directions = (values.reshape(20, 25, 3) for values in mixed_rays(TEAPOT, 500, seed=3))
    hits = scene.intersect(origins, directions)
    away = rng.normal(size=(2, 20, 25, 3)).astype(np.float32)
    position = np.nan_to_num(hits.position)
    expected = np.stack([scene.intersect(position, one, skip=hits.primitive_id.astype(np.int64)).t for one in away])
    for i in range(0, 25, 3):  # each ray its own triangle, as if it were asked alone
        alone = scene.intersect(position[7, i], away[1, 7, i], skip=int(hits.primitive_id[7, i]))
        assert alone.t == expected[1, 7, i]
    on_device = wp.array(hits.primitive_id, dtype=int, device=device)
    for skip in (hits, hits.primitive_id, on_device, hits.primitive_id[None], np.stack([hits.primitive_id] * 2)):
        np.testing.assert_array_equal(scene.intersect(position, away, skip=skip).t, expected)
    column = scene.intersect(origins[:, :1], directions[:, :1])
    expected = scene.intersect(position, away, skip=np.repeat(column.primitive_id, 25, axis=1)).t
    for skip in (column, column.primitive_id):
        np.testing.assert_array_equal(scene.intersect(position, away, skip=skip).t, expected)
    first = scene.intersect(origins[0, 0], directions[0, 0])
    expected = scene.intersect(position, away, skip=first.primitive_id.item()).t
    np.testing.assert_array_equal(scene.intersect(position, away, skip=first).t, expected)
    assert scene.intersect(position[0, 0], away[0, 0, 0], skip=first).shape == ()
    rays = [wp.array(values.reshape(-1, 3), dtype=wp.vec3, device=device) for values in (position, away[0])]
    there = scene.intersect(*rays, skip=scene.intersect(*rays))
    assert isinstance(there.t, wp.array)
    assert there.shape == (500,)
    nothing = np.zeros((0, 3), dtype=np.float32)
    assert scene.occluded(nothing, nothing, skip=scene.intersect(nothing, nothing)).shape == (0,)


def test_other_scenes(device):
    """Several meshes, a tree that is built lazily, and one for influence areas: triangles have the scene's numbers."""
    soup = snapped_soup(150, seed=4)
    halves = [wrt.TriangleMesh(soup.vertices, soup.faces[rows]) for rows in (slice(0, 40), slice(40, None))]
    rays, away = mixed_rays(soup, 400, seed=1), np.random.default_rng(7).normal(size=(400, 3))
    area = wrt.known_rays.PlaneInfluenceArea(position=(0, 0, 3), direction=(0, 0, -1), width=9, height=9, depth=9)
    aware = wrt.known_rays.RayAwareBvh(areas=[area], local=wrt.Bvh())
    answers = []
    for geometry, tree in ((soup, "bvh"), (halves, "bvh"), (soup, aware)):
        scene = wrt.Scene(geometry, tree, device=device)
        hits = scene.intersect(*rays)
        origins = np.nan_to_num(hits.position)
        past = scene.intersect(origins, away, skip=hits)
        answers.append(past.primitive_id + 40 * (past.geometry_id == 1))
    lazy = wrt.Scene(soup, wrt.KdTree(builder="lazy"), device=device)  # asked for nothing before
    answers.append(lazy.intersect(origins, away, skip=hits).primitive_id)
    assert (answers[0] >= 0).mean() > 0.3
    for other in answers[1:]:
        np.testing.assert_array_equal(other, answers[0])


def test_bad_arguments(device):
    scene, (origins, directions) = wrt.Scene(TEAPOT, device=device), mixed_rays(TEAPOT, 20)
    count, hits = TEAPOT.triangle_count, scene.intersect(origins, directions)
    twins = wrt.Scene([TEAPOT, TEAPOT], device=device)
    bad = [
        (
            ValueError,
            f"from -1 to {count - 1}, but ranges from 0 to {count}",
            {"skip": [0] * 19 + [count]},
        ),
        (ValueError, r"must be from -1 to \d+, but ranges from -2 to -2", {"skip": -2}),
        (TypeError, "hold integers, not float64; pass a wrt.Hits, or primitive ids", {"skip": np.zeros(20)}),
        (TypeError, "not bool", {"skip": True}),
        (TypeError, "not object", {"skip": scene}),
        (TypeError, "int32, not of uint32", {"skip": wp.zeros(20, dtype=wp.uint32, device=device)}),
        (ValueError, r"shape \(7,\), which does not broadcast to that of the rays, \(20,\)", {"skip": [0] * 7}),
        (ValueError, r"shape \(2, 20\), which does not", {"skip": np.zeros((2, 20), dtype=int)}),
        (ValueError, "hits of another scene", {"skip": twins.intersect(origins, directions)}),
        (ValueError, "cannot be combined with traversal;", {"skip": hits, "traversal": "single"}),
        (ValueError, "cannot be combined with traversal;", {"skip": hits, "traversal": hits.plan}),
        (
            ValueError,
            "cannot be combined with triangle_test, counters;",
            {"skip": 0, "triangle_test": "woop", "counters": True},
        ),
        (ValueError, "cannot be combined with precise;", {"skip": 0, "precise": True}),
    ]
    for kind, message, arguments in bad:
        with pytest.raises(kind, match=message):
            scene.intersect(origins, directions, **arguments)
    with pytest.raises(ValueError, match=r"the scene has 2; pass the wrt\.Hits"):
        twins.occluded(origins, directions, skip=3)
    with pytest.raises(ValueError, match="skip holds hits of another scene; pass hits of this scene"):
        wrt.Scene(wrt.Instance(TEAPOT), device=device).count(origins, directions, skip=hits)
    with pytest.raises(ValueError, match=r"a scene with one tree; .* use wrt\.Scene\(scene\.meshes\)"):
        wrt.moving.FuzzyScene(TEAPOT.vertices[None], TEAPOT.faces, device=device).occluded(origins, directions, skip=hits)


@pytest.mark.parametrize(("tree", "query"), [("bvh", ANY), *slow(("kdtree", CLOSEST))])
def test_cuda(tree, query, tmp_path, monkeypatch):
    monkeypatch.setattr(wp.config, "optimization_level", 1)  # what is asked is whether it compiles
    text = compile_to_ptx(
        TRAVERSALS["single"].kernels[tree](TraversalConfig("woop", 2, query, variant=SKIPPING)).module, tmp_path
    )
    assert ".entry" in text
    assert not FUSIBLE.search(text)

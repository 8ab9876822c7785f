"""Triangle fans: how a mesh is cut into them, and that they are hit as their triangles are."""

from __future__ import annotations

import numpy as np
import pytest
from support.hits import mixed_rays

import wrt
from studies.triangles.fan_comparison import closest, compare, compare_files, compare_trees, fans_of, on_device
from wrt.builders.triangle_fans import build_fans

GRID = np.arange(49).reshape(7, 7)
CELLS = np.stack([GRID[:-1, :-1], GRID[:-1, 1:], GRID[1:, 1:], GRID[1:, :-1]], axis=-1).reshape(-1, 4)
HEXAGON = np.array([(0, k, k % 6 + 1) for k in range(1, 7)])


def meshes() -> dict[str, np.ndarray]:
    """Faces: closed, open, one with all orientations mixed, and one with nothing in common."""
    teapot = wrt.scenes.build("teapot", level=2)
    _, same = np.unique(teapot.vertices, axis=0, return_inverse=True)
    patch = np.concatenate([CELLS[:, [0, 1, 2]], CELLS[:, [0, 2, 3]]])
    mixed = patch.copy()
    mixed[::3] = mixed[::3, ::-1]
    return {
        "octahedron": np.array([(a, b, c) for a in (0, 1) for b in (2, 3) for c in (4, 5)]),
        "teapot": same.ravel()[teapot.faces],
        "patch": patch,
        "mixed": mixed,
        "soup": np.arange(30).reshape(-1, 3),
        "odd": np.array([(0, 1, 2), (0, 1, 2), (0, 0, 1), (1, 0, 3), (0, 1, 4), (0, 1, 5)]),
        "hexagon": HEXAGON,
    }


@pytest.mark.parametrize("name", meshes())
def test_every_triangle_is_in_one_fan(name):
    """And is its centre with two rim vertices that follow one another, in the order that `corner` tells."""
    faces = meshes()[name]
    fans = build_fans(faces)
    np.testing.assert_array_equal(np.sort(fans.primitive), np.arange(len(faces)))
    assert len(fans.rim) == len(faces) + len(fans)
    for f in range(len(fans)):
        for place in range(fans.first[f], fans.first[f + 1] - 1):
            face, corner = faces[fans.primitive[place - f]], fans.corner[place - f]
            one, other = fans.rim[place : place + 2][:: -1 if corner >= 3 else 1]
            assert face.tolist() == np.roll([fans.centre[f], one, other], corner % 3).tolist()


def test_few_fans_are_small():
    """A hexagon is one fan; single triangles are left where nothing else is possible, and seldom elsewhere."""
    assert build_fans(HEXAGON).sizes.tolist() == [6]
    assert build_fans(meshes()["octahedron"]).sizes.tolist() == [4, 4]
    assert (build_fans(meshes()["soup"]).sizes == 1).all()
    for name in ("teapot", "patch", "mixed"):
        sizes = build_fans(meshes()[name]).sizes
        assert (sizes == 1).mean() < 0.06
        assert sizes.mean() > 3.5


@pytest.mark.parametrize("edges", [False, True])
@pytest.mark.parametrize("name", ["teapot", "random_triangles"])
def test_hit_as_triangles_are(name, edges, device):
    """Triangle by triangle and fan by fan agree but for rays close to edges."""
    mesh = wrt.scenes.build("teapot", level=3) if name == "teapot" else wrt.scenes.build(name, count=300, size=0.4, seed=3)
    scene = wrt.Scene(mesh, device=device)
    rng = np.random.default_rng(1)
    low, high = mesh.bounds
    origins = rng.uniform(low - (high - low), high + (high - low), (500, 3))
    rays = wrt.Rays(origins, rng.uniform(low, high, (500, 3)) - origins)
    t, primitive, uv = closest(scene, on_device(scene.state, fans_of(scene.state), edges), rays, edges)
    expected = scene.intersect(rays, traversal="brute", triangle_test="moeller_trumbore")
    assert expected.is_hit.mean() > 0.2
    assert (primitive == expected.primitive_id).mean() > 0.995
    same = (primitive == expected.primitive_id) & expected.is_hit
    np.testing.assert_allclose(t[same], expected.t[same], rtol=1e-3)
    np.testing.assert_allclose(uv[same], expected.uv[same], atol=5e-3)
    assert (t[primitive < 0] == np.inf).all()


def test_precomputed_normals_change_nothing(device):
    """Equal bit for bit to normals that are computed where signs differ."""
    mesh = wrt.scenes.build("teapot", level=3)
    scene = wrt.Scene(mesh, device=device)
    origins, directions = mixed_rays(mesh, 400)
    rays, fans = wrt.Rays(origins, directions), fans_of(scene.state)
    for edges in (False, True):
        made = on_device(scene.state, fans, edges)
        assert made.normal.shape == (mesh.triangle_count,)
        expected = [values.copy() for values in closest(scene, made, rays, edges)]
        assert (expected[1] >= 0).mean() > 0.1
        for value, same in zip(closest(scene, made, rays, edges, normals=True), expected, strict=True):
            np.testing.assert_array_equal(value, same)


def test_bad_rays_miss(device):
    mesh = wrt.scenes.build("teapot", level=2)
    scene = wrt.Scene(mesh, device=device)
    origins, directions = mixed_rays(mesh, 300)
    bad = ~(np.isfinite(origins).all(axis=1) & np.isfinite(directions).all(axis=1) & directions.any(axis=1))
    _, primitive, _ = closest(scene, on_device(scene.state, fans_of(scene.state), True), wrt.Rays(origins, directions), True)
    assert bad.any()
    assert (primitive[bad] == -1).all()


def test_no_ray_slips_through_a_spoke(device):
    """Both triangles at a spoke see it by the same number: rays at spokes of a closed, convex fan hit."""
    rng = np.random.default_rng(2)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 12))
    rim = np.stack([np.cos(angles), np.sin(angles), 0.1 * rng.random(12)], axis=1)
    vertices = np.concatenate([[[0.01, 0.02, 0.3]], rim]).astype(np.float32)
    faces = np.array([(0, k + 1, (k + 1) % 12 + 1) for k in range(12)])
    scene = wrt.Scene(wrt.TriangleMesh(vertices, faces), device=device)
    fans = fans_of(scene.state)
    assert fans.sizes.tolist() == [12]
    weights = rng.uniform(0.05, 0.95, (20_000, 1))
    targets = vertices[:1] * weights + vertices[1 + rng.integers(0, 12, 20_000)] * (1 - weights)
    origins = rng.normal(size=(20_000, 3)) * 0.2 + (0, 0, 4)
    rays = wrt.Rays(origins.astype(np.float32), (targets - origins).astype(np.float32))
    _, primitive, _ = closest(scene, on_device(scene.state, fans, False), rays, False)
    assert (primitive >= 0).all()


@pytest.mark.studies
def test_comparison():
    """Rows with all that a table needs, and every way finds the same."""
    rows = compare(("teapot",), size=4, rounds=1)
    assert [row["way"] for row in rows][-3:] == ["fans", "fans, edges", "fans, edges, normals"]
    stored = {(row["triangles"] + 2 * row["fans"]) / (3 * row["triangles"]) for row in rows}
    assert {row["stored"] for row in rows} == stored, "M + 2 vertices a fan, three a triangle"
    assert 1 / 3 < min(stored) < 0.7
    assert all(row["ratio"] > 0 and row["fans"] < row["triangles"] for row in rows)


@pytest.mark.studies
def test_comparison_of_trees_and_files(tmp_path):
    """Every way has a row; a file of fans is smaller, as it has fewer vertices."""
    rows = compare_trees(("teapot",), size=8, rounds=1)
    assert [row["way"] for row in rows] == [
        "fans, bvh",
        "fans, bvh, planes",
        "fans, kdtree",
        "bvh",
        "kdtree",
        "bvh, one by one",
    ]
    assert rows[-1]["ratio"] == 1.0
    (row,) = compare_files(tmp_path, ("teapot",), rounds=1)
    assert row["fan_bytes"] < 0.6 * row["triangle_bytes"]
    assert row["fan_seconds"] > 0.0

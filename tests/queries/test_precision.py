"""`precise=True`: what brute force in float64 finds, to the bit, on every tree."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.hits import mixed_rays
from support.meshes import degenerate_soup, snapped_soup
from support.ptx import compile_to_ptx
from support.selection import slow

import wrt
from wrt.engine.facts.query_kinds import EXACT
from wrt.kernels.query.exact_closest import make_exact_kernel
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.query.verification import nearest64

TREES = ("bvh", "kdtree")

MESHES = {
    "degenerate": degenerate_soup,
    "grid": lambda: snapped_soup(200, seed=2),
    "teapot": lambda: wrt.scenes.build("teapot", level=3),
}


def brute(mesh: wrt.TriangleMesh, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    with np.errstate(all="ignore"):
        return nearest64(mesh.vertices, mesh.faces, origins, directions)


@pytest.mark.parametrize("tree", TREES)
@pytest.mark.parametrize("name", MESHES)
def test_brute_force(name, tree, device):
    """Rays of every kind and direction's length, near and far, on vertices with more digits than float32 holds."""
    made = MESHES[name]()
    rng = np.random.default_rng(3)
    origins, directions = (values.astype(np.float64) for values in mixed_rays(made, 600, seed=1))
    far = rng.random(600) < 0.3
    origins[far] -= 1e5 * directions[far]
    directions *= 10.0 ** rng.uniform(-6, 6, (600, 1))
    for scale, shift in ((1.0 / 3.0, 0.0), (1e-4 / 3.0, 10.0 / 3.0), (1.0 / 3.0, 1e7), (1e8 / 3.0, 0.0)):
        mesh = wrt.TriangleMesh(made.vertices.astype(np.float64) * scale + shift, made.faces)
        o, d = origins * scale + shift, directions * scale
        hits = wrt.Scene(mesh, tree, device=device).intersect(o, d, precise=True)
        primitive, t = brute(mesh, o, d)
        np.testing.assert_array_equal(hits.primitive_id, primitive)
        np.testing.assert_array_equal(hits.t, t)
        assert 0.1 < hits.is_hit.mean() < 0.99
        o, d, t, position = o[hits.is_hit], d[hits.is_hit], t[hits.is_hit, None], hits.position[hits.is_hit]
        size = np.abs(o - position).max(axis=1) + mesh.extent + shift
        error = np.linalg.norm(position - (o + t * d), axis=1)
        assert (error <= 1e-13 * size).mean() > 0.99  # the others are on needles, or nearly in the ray's direction


def sheets(gap: float, shift: float) -> wrt.TriangleMesh:
    """A hundred squares, one behind another in z, the nearest one last."""
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float64)
    heights = gap * np.arange(100)[::-1]
    vertices = (square + np.stack([0 * heights, 0 * heights, heights], axis=1)[:, None]).reshape(-1, 3) + shift
    return wrt.TriangleMesh(vertices, np.concatenate([np.add([[0, 1, 2], [0, 2, 3]], 4 * k) for k in range(100)]))


@pytest.mark.parametrize("shift", [0.0, 1e7])
@pytest.mark.parametrize("tree", TREES)
def test_nearer_than_float32_tells(tree, shift, device):
    """Sheets so close together that float32 takes them for one. (At 1e7, a float64 has nine digits left behind the point.)"""
    mesh = sheets(1e-7 if shift else 1e-12, shift)
    scene = wrt.Scene(mesh, tree, device=device)
    origins = np.array([[0.3, 0.2, -10.0], [-0.3, 0.2, -10.0]]) + shift
    hits = scene.intersect(origins, [0.0, 0.0, 1.0], precise=True)
    assert hits.primitive_id.tolist() == [198, 199]
    np.testing.assert_array_equal(hits.t, (mesh.vertices[-1, 2] - origins)[:, 2])
    assert (scene.intersect(origins, [0.0, 0.0, 1.0]).primitive_id < 198).all()  # several at the same t: the first wins


def test_range_and_types(device):
    """The range of t is closed, in float64; answers are float64, NumPy or Warp as the rays are, in their shape."""
    third = 1.0 / 3.0
    mesh = wrt.TriangleMesh(np.array([[0, 0, third], [1, 0, third], [0, 1, third]]), [[0, 1, 2]])
    scene = wrt.Scene(mesh, device=device)
    up, below = np.array([0.0, 0.0, 1.0], dtype=np.float32), np.array([[[0.25, 0.25, 0.0]]], dtype=np.float32)
    hits = scene.intersect(below, up, t_min=third, t_max=third, precise=True)
    assert hits.t.dtype == hits.uv.dtype == hits.position.dtype == hits.normal.dtype == np.float64
    assert hits.t.tolist() == [[third]]
    assert hits.uv.tolist() == [[[0.25, 0.25]]]
    assert hits.position.tolist() == [[[0.25, 0.25, third]]]
    assert hits.normal.tolist() == [[[0.0, 0.0, 1.0]]]
    ranges = [(0.0, np.nextafter(third, 0)), (np.nextafter(third, 1), np.inf), (np.array([third]), np.array([third]))]
    assert [scene.intersect(below, up, *ends, precise=True).is_hit.item() for ends in ranges] == [False, False, True]
    miss = scene.intersect(below, -up, precise=True)
    assert miss.t.item() == np.inf
    assert miss.geometry_id.item() == miss.primitive_id.item() == -1
    assert np.isnan(miss.position).all()
    assert not miss.normal.any()
    for kind in (wp.vec3f, wp.vec3d):
        on_device = [wp.array(values.reshape(-1, 3), dtype=kind, device=device) for values in (below, up)]
        there = scene.intersect(*on_device, precise=True)
        assert there.t.dtype is wp.float64
        assert there.t.numpy().tolist() == [third]
    bad = [[np.nan, 0, 0], [0, np.inf, 0]], [[0.0, 0, 1], [0, 0, 1]]
    assert not scene.intersect(*bad, precise=True).is_hit.any()
    assert not scene.intersect(below, [0.0, 0.0, 0.0], precise=True).is_hit.any()
    with pytest.raises(ValueError, match="leave them out"):
        scene.intersect(below, up, precise=True, traversal="single")


def test_geometries(device):
    """Of several meshes, one in float32, all as they were given."""
    square = sheets(1.0, 0.0)
    low = wrt.TriangleMesh(square.vertices[-4:].astype(np.float32), square.faces[:2])
    high = wrt.TriangleMesh(square.vertices[-4:] + 1e-9, square.faces[:2])
    hits = wrt.Scene([high, low], device=device).intersect(
        [[0.3, 0.2, -1], [0.3, 0.2, 1]], [[0.0, 0, 1], [0, 0, -1]], precise=True
    )
    assert hits.geometry_id.tolist() == [1, 0]
    assert hits.primitive_id.tolist() == [0, 0]
    np.testing.assert_allclose(hits.t, [1.0, 1.0 - 1e-9], rtol=1e-15)
    assert np.isfinite(hits.spawn([0.0, 0.0, 1.0])).all()


@pytest.mark.parametrize("tree", ["bvh", *slow("kdtree")])
def test_cuda(tree, tmp_path):
    assert ".entry" in compile_to_ptx(make_exact_kernel(tree, TraversalConfig("woop", 2, EXACT)).module, tmp_path)

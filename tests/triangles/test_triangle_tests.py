"""Every triangle test against closed forms, float64 linear algebra, and its own lane form."""

from __future__ import annotations

import re

import numpy as np
import pytest
from support.algorithms import ENGINE_TESTS
from support.hits import assert_same_hits, mixed_rays
from support.meshes import degenerate_soup
from support.triangle_pairs import all_pairs

import wrt
from wrt.kernels.triangle import TRIANGLE_TESTS


def shared_if_needed(name: str, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rays; if the test needs it, all from the first one's origin, to where they aimed."""
    if not TRIANGLE_TESTS[name].needs_shared_origin:
        return origins, directions
    first = np.broadcast_to(origins[0], origins.shape)
    return first, origins + directions - first


def solve(corners: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """The same by a float64 3 x 3 solve of origin + t d = a + u (b - a) + v (c - a), for the line through the plane."""
    a, b, c = (corners.astype(np.float32).astype(np.float64)[None, :, i] for i in range(3))
    o, d = (x.astype(np.float32).astype(np.float64)[:, None] for x in (origins, directions))
    matrix = np.stack(np.broadcast_arrays(b - a, c - a, -d), axis=-1)
    with np.errstate(all="ignore"):
        uvt = np.linalg.solve(matrix, (o - a)[..., None])[..., 0]
    return uvt[..., [2, 0, 1]]


@pytest.mark.parametrize("name", TRIANGLE_TESTS)
def test_closed_form(name, device):
    """A right triangle in z = 2, seen from the origin: t and the weights are known."""
    corners = np.array([[[0, 0, 2], [4, 0, 2], [0, 4, 2]]], dtype=float)
    rays = [[1, 1, 2], [2, 0.5, 2], [0.5, 3, 2], [-1, 1, 2], [1, -1, 2], [3, 3, 2], [-1, -1, -2], [1, 1, 0]]
    rays = np.array(rays, dtype=float)
    got = all_pairs(name, corners, np.zeros_like(rays), rays / 2, 8, "scalar", device)[:, 0]
    np.testing.assert_allclose(got[:3], [[2, 0.25, 0.25], [2, 0.5, 0.125], [2, 0.125, 0.75]], rtol=1e-6)
    assert np.isnan(got[3:6, 0]).all()  # beside each of the three edges
    if TRIANGLE_TESTS[name].needs_shared_origin:
        assert np.isnan(got[6, 0])  # behind the origin
    else:  # a test sees the line, the traversal the range
        np.testing.assert_allclose(got[6], [-2, 0.25, 0.25], rtol=1e-6)
    assert np.isnan(got[7, 0])  # parallel to the plane


@pytest.mark.parametrize("name", TRIANGLE_TESTS)
def test_edges_and_vertices_belong_to_the_triangle(name, device):
    """Where nothing rounds: at the vertices, on the edges, seen steeply and at a grazing angle, from both sides."""
    corners = np.array([[[0, 0, 2], [4, 0, 2], [0, 4, 2]]], dtype=float)
    weights = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0], [0, 0.5], [0.5, 0.5], [0.25, 0.75]])
    targets = np.concatenate([4 * weights, np.full((7, 1), 2.0)], axis=1)
    for origin in ([0, 0, 0], [1, 1, 4], [1024, 512, 3], [4, 0, -2]):
        origins = np.broadcast_to(np.array(origin, dtype=float), (7, 3))
        got = all_pairs(name, corners, origins, 0.5 * (targets - origins), 8, "scalar", device)[:, 0]
        np.testing.assert_array_equal(got, np.concatenate([np.full((7, 1), 2.0), weights], axis=1))


@pytest.mark.parametrize("name", TRIANGLE_TESTS)
def test_rays_in_the_plane_miss(name, device):
    """Coplanar rays, at the triangle and beside it, from inside it and from outside, along the axes and not."""
    corners = np.array([[[0, 0, 2], [4, 0, 2], [0, 4, 2]]], dtype=float)
    directions = np.array([[1, 0, 0], [0, 1, 0], [1, 1, 0], [-1, 3, 0], [-2, 0.5, 0]], dtype=float)
    for origin in ([1, 1, 2], [-1, -1, 2], [0, 0, 2], [2, 2, 2], [9, 0, 2]):
        origins = np.broadcast_to(np.array(origin, dtype=float), (5, 3))
        got = all_pairs(name, corners, origins, directions, 8, "scalar", device)
        assert np.isnan(got[..., 0]).all()


@pytest.mark.parametrize("form", ["scalar", "lanes"])
@pytest.mark.parametrize("name", TRIANGLE_TESTS)
def test_a_nan_anywhere_is_a_miss(name, form, device):
    """A hit, and the same with a NaN in the place of each of the fifteen numbers: vertices, origin, direction."""
    rng = np.random.default_rng(4)
    corners = np.concatenate([rng.normal(size=(20, 3, 3)), rng.integers(-2, 3, (40, 3, 3))])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    is_large = np.linalg.norm(normals, axis=1) > 0.1
    corners, origins = corners[is_large], (corners.mean(axis=1) + normals)[is_large]
    towards = corners.mean(axis=1) - origins
    triangles = np.concatenate([corners[:, None], with_nan(corners.reshape(-1, 9)).reshape(-1, 9, 3, 3)], axis=1)
    directions = np.concatenate([towards[:, None], with_nan(towards)], axis=1)
    is_shared = TRIANGLE_TESTS[name].needs_shared_origin  # then records are made for one origin
    for chosen in np.split(np.arange(len(corners)), len(corners) if is_shared else 1):
        tried, own = triangles[chosen].reshape(-1, 3, 3), np.arange(len(chosen))
        rays = np.repeat(origins[chosen], 4, axis=0), directions[chosen].reshape(-1, 3)
        got = all_pairs(name, tried, *rays, 4, form, device)[..., 0].reshape(len(chosen), 4, len(chosen), 10)
        assert np.argwhere(~np.isnan(got[own, :, own])).tolist() == [[one, 0, 0] for one in own]
        bad, straight = with_nan(origins[chosen]).reshape(-1, 3), np.repeat(towards[chosen], 3, axis=0)
        for some in np.split(np.arange(len(bad)), len(bad) if is_shared else 1):
            assert np.isnan(all_pairs(name, tried, bad[some], straight[some], 4, form, device)[..., 0]).all()


def with_nan(numbers: np.ndarray) -> np.ndarray:
    """(..., N, N) rows of the last N numbers, in each of which another is a NaN."""
    return np.where(np.eye(numbers.shape[-1], dtype=bool), np.nan, numbers[..., None, :])


@pytest.mark.parametrize("name", TRIANGLE_TESTS)
def test_against_float64(name, device):
    """Inside, outside and the values agree with a float64 solve wherever that is clear."""
    rng = np.random.default_rng(1)
    corners = rng.normal(size=(150, 3, 3))
    origins = 4 * rng.normal(size=(200, 3))
    origins, directions = shared_if_needed(name, origins, rng.normal(size=(200, 3)) - origins)
    got = all_pairs(name, corners, origins, directions, 8, "scalar", device).astype(np.float64)
    t, u, v = np.moveaxis(solve(corners, origins, directions), -1, 0)
    clearance = np.minimum(np.minimum(u, v), 1 - u - v)
    if TRIANGLE_TESTS[name].needs_shared_origin:
        clearance[t < 0.0] = -1.0  # sees only what lies ahead
    hit = ~np.isnan(got[..., 0])
    assert hit[clearance > 1e-3].all()
    assert not hit[clearance < -1e-3].any()
    sure = clearance > 1e-3
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sine = np.abs(np.einsum("rj,kj->rk", directions, normal))
    sine /= np.linalg.norm(directions, axis=1)[:, None] * np.linalg.norm(normal, axis=1)
    tolerance = 4e-6 * (1 + np.abs(t)) / np.maximum(sine, 1e-3)  # a grazing ray amplifies every rounding
    for value, exact in zip(np.moveaxis(got, -1, 0), (t, u, v), strict=True):
        assert (np.abs(value - exact)[sure] <= tolerance[sure] * 30).all()
    assert sure.sum() > 1000


@pytest.mark.parametrize(
    ("name", "width"),
    [(name, width) for name in TRIANGLE_TESTS for width in ((1, 2, 4, 8, 16) if name in ENGINE_TESTS else (4, 16))],
)
def test_lanes_equal_scalar(name, width, device):
    """One ray x W triangles gives the bits of one ray x one triangle: generic, degenerate, on edges, and bad rays."""
    mesh = degenerate_soup()
    corners = mesh.vertices[mesh.faces][: 16 * 12 + 5]
    origins, directions = mixed_rays(mesh, 400)
    finite = np.isfinite(origins).all(1) & np.isfinite(directions).all(1) & directions.any(1)
    origins, directions = shared_if_needed(name, origins[finite], directions[finite])
    scalar = all_pairs(name, corners, origins, directions, width, "scalar", device)
    block = all_pairs(name, corners, origins, directions, width, "lanes", device)
    np.testing.assert_array_equal(np.isnan(scalar[..., 0]), np.isnan(block[..., 0]))
    hit = ~np.isnan(scalar[..., 0])
    np.testing.assert_array_equal(scalar[hit].view(np.int32), block[hit].view(np.int32))
    assert hit.any()


@pytest.mark.parametrize("name", ["woop", "pluecker", "benthin", "komatsu"])
def test_no_ray_passes_along_an_edge(name, device):
    """Two triangles see their common edge through the same numbers: rays aimed at its points hit one of them or both."""
    rng = np.random.default_rng(6)
    eye = np.array([3.0, -7.0, 5.0])
    p, q = rng.normal(size=(2, 60, 3)) * rng.choice([0.01, 1.0, 30.0], (60, 1))
    across = np.cross(q - p, (p + q) / 2 - eye)
    across *= np.linalg.norm(q - p, axis=1, keepdims=True) / np.linalg.norm(across, axis=1, keepdims=True)
    left, right = ((p + q) / 2 + sign * rng.uniform(0.2, 2.0, (60, 1)) * across for sign in (1, -1))
    corners = np.concatenate([np.stack([p, q, left], axis=1), np.stack([q, p, right], axis=1)])
    weight = rng.uniform(0.1, 0.9, (60, 50, 1))
    targets = ((1 - weight) * p[:, None] + weight * q[:, None]).reshape(-1, 3)
    origins = np.broadcast_to(eye, targets.shape)
    if not TRIANGLE_TESTS[name].needs_shared_origin:
        origins = origins + 0.1 * rng.normal(size=targets.shape)
    hit = ~np.isnan(all_pairs(name, corners, origins, targets - origins, 8, "scalar", device)[..., 0])
    ray, hinge = np.arange(3000), np.repeat(np.arange(60), 50)
    first, second = hit[ray, hinge], hit[ray, 60 + hinge]
    assert (first | second).all()
    assert (first != second).mean() > 0.5  # they do pass on both sides


@pytest.mark.parametrize("name", TRIANGLE_TESTS)
def test_degenerate_triangles_miss(name, device):
    """Points and needles have no inside; nothing is hit and nothing hangs."""
    rng = np.random.default_rng(2)
    a, b = rng.random((2, 50, 3))
    corners = np.concatenate([np.stack([a, a, a], axis=1), np.stack([a, b, b], axis=1), np.stack([a, a, b], axis=1)])
    origins = rng.normal(size=(60, 3)) * 5
    directions = corners[rng.integers(0, 150, 60)].mean(axis=1) - origins
    origins, directions = shared_if_needed(name, origins, directions)
    got = all_pairs(name, corners, origins, directions, 8, "scalar", device)
    assert np.isnan(got[:, :50, 0]).all()
    scene = wrt.Scene(wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(450).reshape(-1, 3)), device=device)
    start = origins[0] if TRIANGLE_TESTS[name].needs_shared_origin else origins
    hits = scene.intersect(np.float32(start), np.float32(directions), traversal="brute", triangle_test=name)
    assert not np.isnan(hits.t).any()
    if TRIANGLE_TESTS[name].watertight:  # others may take the rounded area of a needle for a real one
        assert not hits.is_hit.any()


OTHER_TESTS = [name for name in TRIANGLE_TESTS if name not in ENGINE_TESTS]
ONE_RAY_EACH = (("kdtree", "single"), ("bvh", "stream"))
"""Ways to meet leaves with one ray and many triangles, which a test answers in its one form for these: that it has the bits of
the scalar form is asked of every test above, and of one in four each way through a tree."""


@pytest.mark.parametrize(
    ("name", "tree", "traversal"),
    [
        *((name, "bvh", "packet") for name in OTHER_TESTS),
        *(
            pytest.param(name, *way, marks=[pytest.mark.exhaustive] if (i + 2 * k) % 4 else [])
            for i, name in enumerate(OTHER_TESTS)
            for k, way in enumerate(ONE_RAY_EACH)
        ),
    ],
)
def test_in_the_engine(name, tree, traversal, device):
    """Trees find with any test what brute force finds with it; `ENGINE_TESTS` go through all the engine elsewhere."""
    scene = wrt.Scene(degenerate_soup(), tree, device=device)
    origins, directions = mixed_rays(degenerate_soup(), 500)
    if TRIANGLE_TESTS[name].needs_shared_origin:
        origins = np.float32((0.4, 0.6, 1.3))
    expected = scene.intersect(origins, directions, traversal="brute", triangle_test=name)
    assert 0.05 < expected.is_hit.mean() < 0.99
    assert_same_hits(scene.intersect(origins, directions, traversal=traversal, triangle_test=name), expected)


def test_origin_in_the_plane_of_a_triangle(device):
    """Where Benthin's test and Komatsu's part: the one sees the triangle at t = 0 from both sides, the other from one."""
    corners = np.array([[[0, 0, 2], [4, 0, 2], [0, 4, 2]]], dtype=float)
    origins, directions = np.full((2, 3), (1.0, 1.0, 2.0)), np.array([[0, 0, 1.0], [0.5, 0, -1.0]])
    seen = {name: all_pairs(name, corners, origins, directions, 8, "scalar", device)[:, 0] for name in ("benthin", "komatsu")}
    np.testing.assert_array_equal(seen["benthin"], [[0.0, 0.25, 0.25]] * 2)
    assert np.isnan(seen["komatsu"][:, 0]).sum() == 1


def test_a_shared_origin_is_asked_for(device):
    """Komatsu's records are made for a point: other rays are refused by every way in, and a new point gets new records."""
    mesh = wrt.scenes.build("teapot", level=3)
    scene = wrt.Scene(mesh, device=device)
    origins, directions = mixed_rays(mesh, 300)
    for ask in (scene.intersect, scene.occluded, scene.explain):
        with pytest.raises(ValueError, match=r"share their origin.*woop"):
            ask(origins, directions, triangle_test="komatsu")
    scene.intersect(origins[0], directions, triangle_test="komatsu")
    held = scene.state.record_bytes
    for origin in ((0.0, -9.0, 4.0), (0.5, 8.0, 3.0), (0.0, -9.0, 4.0)):
        towards = (np.random.default_rng(0).normal(size=(4000, 3)) - origin).astype(np.float32)
        hits = scene.intersect(origin, towards, triangle_test="komatsu")
        expected = scene.intersect(origin, towards, triangle_test="woop")
        assert expected.is_hit.mean() > 0.2
        assert (hits.primitive_id != expected.primitive_id).mean() < 1e-3
        both = hits.is_hit & expected.is_hit
        np.testing.assert_allclose(hits.t[both], expected.t[both], rtol=1e-3)
        alone = scene.intersect(origin, towards[7], triangle_test="komatsu")
        assert alone.primitive_id == hits.primitive_id[7]
    woop = 160 if scene.device.is_cuda else 36  # bytes of a triangle; those of one origin are kept
    assert scene.state.record_bytes <= held + woop * len(scene.tree.primitive)


def test_table_is_complete():
    for name, test in TRIANGLE_TESTS.items():
        assert test.name == name
        assert re.search(r"\((19|20)\d\d\)", test.paper)
        assert test.record.components > 0

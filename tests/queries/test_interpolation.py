"""Values of vertices at hits: interpolation, texture coordinates and smooth normals."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import trimesh
import warp as wp

import wrt
from wrt.scenes.shapes import boxes, plane

RNG = np.random.default_rng(0)


def sphere(subdivisions=3):
    return wrt.TriangleMesh.from_trimesh(trimesh.creation.icosphere(subdivisions, 1.0))


def rays(count=500):
    directions = RNG.normal(size=(count, 3))
    return -3.0 * directions + 0.4 * RNG.normal(size=(count, 3)), directions


def expected(meshes, values, hits):
    """The same in NumPy, from ids and weights."""
    out = np.full((*hits.shape, *values[0].shape[1:]), np.nan)
    for ray in np.argwhere(hits.is_hit):
        at = tuple(ray)
        rows = values[hits.geometry_id[at]][meshes[hits.geometry_id[at]].faces[hits.primitive_id[at]]]
        u, v = hits.uv[at]
        out[at] = np.tensordot([1 - u - v, u, v], rows, axes=1)
    return out


@pytest.mark.parametrize("row", [(), (1,), (2, 3)])
def test_values_are_interpolated(device, row):
    mesh = sphere()
    scene = wrt.Scene(mesh, device=device)
    hits = scene.intersect(*rays())
    values = RNG.random((mesh.vertex_count, *row))
    found = hits.interpolate(values)
    assert found.dtype == np.float32
    assert found.shape == (500, *row)
    np.testing.assert_allclose(found, expected([mesh], [values], hits), rtol=1e-4, atol=1e-6)
    assert not hits.is_hit.all()
    np.testing.assert_array_equal(np.isnan(found).reshape(500, -1).any(axis=1), ~hits.is_hit)
    np.testing.assert_allclose(hits.interpolate(mesh.vertices)[hits.is_hit], hits.position[hits.is_hit], atol=1e-5)


def test_several_meshes_and_instances(device):
    meshes = [sphere(2), boxes((0.5, 0.5, 0.5), (2, 2, 2)), plane((-3, -3), (3, 3), z=-1.5, cells=3)]
    origins, directions = rays()
    for scene in (wrt.Scene(meshes, device=device), wrt.Scene([wrt.Instance(m) for m in meshes], device=device)):
        hits = scene.intersect(origins.reshape(5, 100, 3), directions.reshape(5, 100, 3))
        values = [RNG.random((mesh.vertex_count, 2)) for mesh in meshes]
        np.testing.assert_allclose(hits.interpolate(values), expected(meshes, values, hits), rtol=1e-4, atol=1e-6)
    with pytest.raises(ValueError, match="3 arrays"):
        hits.interpolate(values[:2])


def test_warp_arrays(device):
    mesh = sphere()
    origins, directions = (wp.array(a, dtype=wp.vec3, device=device) for a in rays(64))
    hits = wrt.Scene(mesh, device=device).intersect(origins, directions)
    found = hits.interpolate(mesh.vertices)
    assert isinstance(found, wp.array)
    hit = hits.is_hit.numpy()
    np.testing.assert_allclose(found.numpy()[hit], hits.position.numpy()[hit], atol=1e-5)


def test_texture_coordinates():
    quad = plane((-2, -2), (2, 2), cells=3)
    mesh = quad.with_materials(wrt.Material(), uv=quad.vertices[:, :2] * (0.5, -1.0))
    hits = wrt.Scene([boxes((5, 5, 5), (6, 6, 6)), mesh]).intersect([[0.3, 1.1, 5], [5.5, 5.5, 9], [9, 9, 9]], [0, 0, -1.0])
    np.testing.assert_allclose(hits.uv_at(), [[0.15, -1.1], [0, 0], [np.nan, np.nan]], atol=1e-5)
    with pytest.raises(ValueError, match="texture coordinates"):
        wrt.Scene(quad).intersect([[0, 0, 1]], [0, 0, -1.0]).uv_at()


@pytest.mark.parametrize("form", ["mesh", "instance", "mirrored"])
def test_smooth_normals_of_a_sphere(device, form):
    """They point along the radius; facets do not. Creases stay."""
    mesh = sphere(4)
    matrix = np.diag([2.0, 2.0, -2.0 if form == "mirrored" else 2.0, 1.0])
    scene = wrt.Scene(mesh.transformed(matrix) if form == "mesh" else wrt.Instance(mesh, matrix), device=device)
    origins, directions = rays()
    hits = scene.intersect(3 * origins, directions)
    hit = hits.is_hit
    radius = hits.position[hit] / np.linalg.norm(hits.position[hit], axis=1, keepdims=True)
    assert np.abs(hits.normal[hit] - radius).max() > 0.03
    np.testing.assert_allclose(hits.smooth_normal()[hit], radius, atol=5e-3)
    np.testing.assert_array_equal(hits.smooth_normal()[~hit], 0.0)
    box = wrt.Scene(boxes((-1, -1, -1), (1, 1, 1)), device=device).intersect(origins, directions)
    np.testing.assert_allclose(box.smooth_normal(), box.normal, atol=1e-6)
    np.testing.assert_allclose(hits.smooth_normal(1.0)[hit], hits.normal[hit], atol=1e-6)


def test_bad_values():
    mesh = sphere(1)
    hits = wrt.Scene(mesh).intersect(*rays(5))
    with pytest.raises(ValueError, match="a row for each of its 42 vertices"):
        hits.interpolate(np.zeros(41))
    with pytest.raises(TypeError, match="real numbers"):
        hits.interpolate(np.array(["a"] * 42))
    with pytest.raises(ValueError, match="crease_angle"):
        hits.smooth_normal(90)
    kept = pickle.loads(pickle.dumps(hits))
    for call in (kept.smooth_normal, kept.uv_at, lambda: kept.interpolate(np.zeros(42))):
        with pytest.raises(ValueError, match="pickle"):
            call()

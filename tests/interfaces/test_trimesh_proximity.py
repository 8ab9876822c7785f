"""`wrt.compat.ProximityQuery` in the place of trimesh's `mesh.nearest`, and the switch for all meshes."""

from __future__ import annotations

import pickle
from contextlib import suppress

import numpy as np
import pytest
import trimesh

import wrt

BODIES = {"sphere": trimesh.creation.icosphere(2), "torus": trimesh.creation.torus(1.0, 0.4)}
POINTS = np.random.default_rng(5).uniform(-1.6, 1.6, (300, 3))
NAMES = ("on_surface", "vertex", "signed_distance")


@pytest.mark.parametrize("body", BODIES)
def test_same_answers_as_trimesh(body):
    """Types, shapes and values; triangles but for those at the same distance."""
    pytest.importorskip("rtree")
    mesh = BODIES[body].copy()
    theirs, ours = trimesh.proximity.ProximityQuery(mesh), wrt.compat.ProximityQuery(mesh)
    for name in NAMES:
        got, expected = getattr(ours, name)(POINTS), getattr(theirs, name)(POINTS)
        got, expected = (each if isinstance(each, tuple) else (each,) for each in (got, expected))
        assert [(part.shape, part.dtype) for part in got] == [(part.shape, part.dtype) for part in expected]
        for one, other in zip(got, expected, strict=True):
            if one.dtype == np.int64:
                assert (one == other).mean() > 0.6
            else:
                np.testing.assert_allclose(one, other, atol=2e-3 if one.ndim == 2 else 1e-6)


def test_all_methods_are_here():
    """Those of trimesh 5, and of the one that is installed."""
    public = {name for name in dir(trimesh.proximity.ProximityQuery) if not name.startswith("_")}
    assert public | set(NAMES) <= set(dir(wrt.compat.ProximityQuery))


def test_signs_at_acute_edges():
    """Where the normal of one triangle is on the wrong side."""
    pytest.importorskip("scipy", reason="trimesh mends normals by SciPy, which is not installed: pip install 'wrt[test-all]'")
    wedge = trimesh.Trimesh([[0, 0, 0], [4, 1, 0], [4, -1, 0.5], [4, 0, -1.5]], [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    wedge.fix_normals()
    points = np.random.default_rng(2).normal(size=(2000, 3)) * 1.5
    found = wrt.compat.ProximityQuery(wedge).signed_distance(points)
    planes = np.einsum("ij,kij->ki", wedge.face_normals, points[:, None] - wedge.triangles[:, 0])
    np.testing.assert_array_equal(found > 0, (planes < 0).all(axis=1))


def test_follows_the_mesh_and_pickles():
    mesh = BODIES["sphere"].copy()
    mesh.nearest = wrt.compat.ProximityQuery(mesh)
    assert mesh.nearest.on_surface([[0, 0, 3.0]])[1] == pytest.approx(2.0, abs=1e-6)
    mesh.apply_scale(2.0)
    assert mesh.nearest.on_surface([[0, 0, 3.0]])[1] == pytest.approx(1.0, abs=1e-6)
    again = pickle.loads(pickle.dumps(mesh.nearest))
    np.testing.assert_array_equal(again.signed_distance(POINTS), mesh.nearest.signed_distance(POINTS))
    assert "ProximityQuery" in repr(again)


def test_the_switch_is_reversible():
    """Meshes made inside have wrt's queries, copies and subdivisions too; then trimesh is as it was, also after errors."""
    modules = (trimesh.proximity, trimesh.ray.ray_triangle)
    before = [{name: getattr(module, name) for name in dir(module)} for module in modules]
    plain = BODIES["sphere"].copy()
    with suppress(KeyError), wrt.compat.for_all_meshes(num_threads=1):
        inside = trimesh.creation.icosphere(1)
        for mesh in (inside, inside.copy(), inside.subdivide(), trimesh.primitives.Box()):
            assert isinstance(mesh.ray, wrt.compat.RayMeshIntersector)
            assert isinstance(mesh.nearest, wrt.compat.ProximityQuery)
        closest, distance, triangle = trimesh.proximity.closest_point(plain, POINTS)
        assert trimesh.proximity.signed_distance(inside, [[0.0, 0.0, 0.0]]) > 0.7
        raise KeyError
    assert [{name: getattr(module, name) for name in dir(module)} for module in modules] == before
    assert not isinstance(plain.nearest, wrt.compat.ProximityQuery)
    assert isinstance(inside.nearest, wrt.compat.ProximityQuery)
    ours = wrt.compat.ProximityQuery(plain).on_surface(POINTS)
    np.testing.assert_array_equal(closest, ours[0])
    np.testing.assert_array_equal(distance, ours[1])
    np.testing.assert_array_equal(triangle, ours[2])


def test_bad_points():
    """NaN and infinity are answered; wrong shapes and empty meshes are refused."""
    query = wrt.compat.ProximityQuery(BODIES["sphere"])
    closest, distance, triangle = query.on_surface([[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 2.0]])
    np.testing.assert_array_equal(triangle == -1, [True, True, False])
    np.testing.assert_array_equal(np.isinf(distance), [True, True, False])
    assert np.isnan(closest[:2]).all()
    assert np.isnan(query.signed_distance([[np.nan, 0, 0]])).all()
    for call in (query.on_surface, query.signed_distance, query.vertex):
        with pytest.raises(ValueError, match=r"points must have shape \(n, 3\)"):
            call(np.zeros(2 if call == query.vertex else 3))
    with pytest.raises(ValueError, match="the mesh has no faces"):
        wrt.compat.ProximityQuery(trimesh.Trimesh()).on_surface(POINTS)
    with pytest.raises(ValueError, match="is near no vertex"):
        query.vertex([[np.nan, 0, 0]])
    with pytest.raises(ValueError, match="device 'gpu7' does not exist"), wrt.compat.for_all_meshes(device="gpu7"):
        pytest.fail("entered")
    with pytest.raises(TypeError, match=r"mesh must be a trimesh\.Trimesh"):
        wrt.compat.ProximityQuery(3)


def test_the_vertex_next_to_one_point():
    """Of one point alone, trimesh gives two numbers."""
    pytest.importorskip("scipy")
    mesh = BODIES["sphere"]
    ours, theirs = wrt.compat.ProximityQuery(mesh).vertex(POINTS[0]), trimesh.proximity.ProximityQuery(mesh).vertex(POINTS[0])
    assert np.shape(ours[0]) == np.shape(ours[1]) == ()
    assert ours == theirs

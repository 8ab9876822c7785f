"""Inside tests: parity against analytic bodies and winding numbers, at edges, and where a mesh has a hole."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from support.bodies import BODIES, feature_points, winding_number
from support.meshes import load_model

import wrt
from wrt.query import inside


def test_contains_an_analytic_body(device):
    """A sphere and a box, one inside the other's hull: inside an odd number of surfaces."""
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    box = trimesh.creation.box(extents=(0.4, 0.4, 0.4))
    rng = np.random.default_rng(1)
    points = rng.uniform(-1.2, 1.2, (20, 1000, 3))
    radius, side = np.linalg.norm(points, axis=-1), np.abs(points).max(axis=-1)
    clear = (np.abs(radius - 0.998) > 0.003) & (np.abs(side - 0.2) > 1e-4)
    expected = (radius < 1.0) ^ (side < 0.2)
    for tree in ("bvh", "kdtree"):
        scene = wrt.Scene([sphere, box], tree, device=device)
        assert scene.is_closed
        found = scene.contains(points)
        assert (found.shape, found.dtype) == ((20, 1000), bool)
        np.testing.assert_array_equal(found[clear], expected[clear])
    single = scene.contains(points[0, 0])
    assert single.shape == ()
    assert single == expected[0, 0]
    assert scene.contains(np.empty((0, 3))).shape == (0,)
    assert scene.contains([[np.nan, 0, 0], [np.inf, 0, 0], [0.5, 0, 0]]).tolist() == [False, False, True]


def test_contains_does_not_depend_on_edges():
    """Points below vertices and edges along the very direction of the rays: parity holds where rays meet them."""
    body = BODIES["icosphere"]
    scene = wrt.Scene(body, device="cpu")
    way = np.array(inside.DIRECTIONS[0], dtype=np.float32).astype(np.float64)
    points = feature_points(body)
    for distance in (0.2, 0.5, 5.0):
        start = points - distance * way
        clear = np.abs(np.linalg.norm(start, axis=1) - 1.0) > 0.02
        np.testing.assert_array_equal(scene.contains(start)[clear], (np.linalg.norm(start, axis=1) < 1.0)[clear])


def test_contains_on_the_bunny():
    """Against winding numbers in float64, by solid angles."""
    bunny = load_model("bunny.ply")
    scene = wrt.Scene(bunny, device="cpu")
    points = np.random.default_rng(0).uniform(*bunny.bounds, (150, 3))
    triangles = bunny.vertices[bunny.faces].astype(np.float64)
    winding = np.array([winding_number(triangles - point) for point in points])
    assert 0.1 < (winding > 0.5).mean() < 0.9
    np.testing.assert_array_equal(scene.contains(points), winding > 0.5)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("away", [0.0, 40.0])
@pytest.mark.parametrize("direction", inside.DIRECTIONS[:2])
def test_contains_votes_where_the_mesh_has_a_hole(direction, away, dtype):
    """A sphere without one of its triangles, at the origin and elsewhere: the ray that leaves through the hole is outvoted, the
    first or the second.
    """
    body = BODIES["icosphere"]
    way = np.array(direction)
    hole = int(np.argmax(body.triangles_center @ way))
    open_body = wrt.TriangleMesh(body.vertices + away, np.delete(body.faces, hole, axis=0))
    scene = wrt.Scene(open_body, device="cpu")
    assert not scene.is_closed
    local = np.outer(np.linspace(-0.9, 0.8, 40), body.triangles_center[hole])
    points = (local + away).astype(dtype)
    # away from the centre, rays along this direction leave through the hole
    assert (scene.count(points[local @ way > 0], way) % 2 == 0).any()
    assert scene.contains(points).all()
    assert not scene.contains(points + dtype(5.0)).any()

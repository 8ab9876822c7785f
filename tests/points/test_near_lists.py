"""The k nearest triangles, all within a distance, and the work of a search: brute force in float64, ties, ends of lists."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import trimesh
import warp as wp
from support.meshes import SCENES
from support.point_oracles import points_around, squares

import wrt

COLUMNS = ("distance", "primitive_id", "uv", "feature")


def all_distances(mesh: wrt.TriangleMesh, points: np.ndarray) -> np.ndarray:
    """(N, F) float64 distances of points from all triangles."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    return np.sqrt([squares(corners - point) for point in points.astype(np.float64)])


def rows_of(lists: wrt.results.TrianglesWithin, i: int) -> slice:
    return slice(lists.offsets[i], lists.offsets[i + 1])


@pytest.mark.parametrize("tree", ["bvh", "kdtree"])
@pytest.mark.parametrize("name", ["random_triangles", "grid"])
def test_lists_against_float64(name, tree):
    """All triangles in order; those within radii, one for each point; the k nearest, which are the first of all."""
    mesh = SCENES[name]()
    points = points_around(mesh, 1100)
    scene, size = wrt.Scene(mesh, tree, device="cpu"), float(np.ptp(mesh.bounds, axis=0).max())
    expected, found = all_distances(mesh, points[:60]), scene.within(points[:60], np.inf)
    assert (found.count == mesh.triangle_count).all()
    bound = 4e-6 * size + 2e-6 * expected
    for i, true in enumerate(expected):
        rows = rows_of(found, i)
        ids, distance = found.primitive_id[rows], found.distance[rows]
        assert (np.abs(true[ids] - distance) < bound[i, ids]).all()
        np.testing.assert_array_equal(np.lexsort((ids, distance)), np.arange(len(ids)))
    assert (found.point_id == np.repeat(np.arange(60), mesh.triangle_count)).all()

    one, some = scene.closest_point(points), scene.closest_point(points, k=5)
    assert some.shape == some.distance.shape == (1100, 5)
    for column in COLUMNS:
        np.testing.assert_array_equal(getattr(some, column)[:, 0], getattr(one, column))
        first = np.stack([getattr(found, column)[rows_of(found, i)][:5] for i in range(60)])
        np.testing.assert_array_equal(getattr(some, column)[:60], first)
    radius = np.float32(some.distance[:, 3])
    near = scene.within(points, radius)
    assert (near.count >= 4).all()
    assert near.count.dtype == np.int32
    for i in range(60):
        rows, count = rows_of(near, i), int((found.distance[rows_of(found, i)] <= radius[i]).sum())
        assert count == near.count[i] == rows.stop - rows.start
        np.testing.assert_array_equal(near.primitive_id[rows], found.primitive_id[rows_of(found, i)][:count])
    apart = np.linalg.norm(near.position - points[near.point_id], axis=1)
    np.testing.assert_allclose(apart, near.distance, rtol=1e-5, atol=4e-6 * size)


def test_ends_of_lists(device):
    """Fewer than k; a limit; points that find nothing; ties in the order of triangles; shapes; Warp arrays."""
    box = trimesh.creation.box((2.0, 2.0, 2.0))
    scene = wrt.Scene(box, device=device)
    middle = np.zeros((3, 1, 3), dtype=np.float32)
    found = scene.closest_point(middle, k=20)
    assert found.shape == (3, 1, 20)
    np.testing.assert_array_equal(found.primitive_id[0, 0], [*range(12), *[-1] * 8])
    np.testing.assert_array_equal(found.distance[0, 0], [1.0] * 12 + [np.inf] * 8)
    np.testing.assert_array_equal(found.feature[0, 0, 12:], -1)
    assert np.isnan(found.position[0, 0, 12:]).all()
    assert (found.uv[0, 0, 12:] == 0).all()
    bad = np.float32([[np.nan, 0, 0], [0, 0, 0.5], [np.inf, 0, 0]])
    some = scene.closest_point(bad, k=2, max_distance=0.5)
    assert some.is_hit.tolist() == [[False, False], [True, True], [False, False]]
    near = scene.within(bad, [9.0, 0.5, 9.0])
    assert near.offsets.tolist() == [0, 0, 2, 2]
    assert near.offsets.dtype == np.int64
    assert (near.distance == 0.5).all()
    np.testing.assert_array_equal(np.abs(near.normal), [[0, 0, 1]] * 2)
    assert (near.geometry_id == 0).all()
    empty = scene.within(np.zeros((0, 3), dtype=np.float32), 1.0)
    assert (len(empty), empty.offsets.tolist()) == (0, [0])
    given = wp.array(bad, dtype=wp.vec3, device=device)
    lists = scene.within(given, 0.5)
    assert all(isinstance(values, wp.array) for values in (lists.distance, lists.offsets, lists.feature))
    assert lists.feature.numpy().tolist() == near.feature.tolist()
    for kept in (near, lists):
        again = pickle.loads(pickle.dumps(kept))
        assert (type(again), again.shape) == (wrt.results.TrianglesWithin, kept.shape)
        for name in ("offsets", "count", "point_id", *COLUMNS, "position", "normal"):
            values, expected = getattr(again, name), getattr(kept, name)
            assert type(values) is type(expected)
            np.testing.assert_array_equal(*(one.numpy() if isinstance(one, wp.array) else one for one in (values, expected)))
    again = pickle.loads(pickle.dumps(some))
    np.testing.assert_array_equal(again.distance, some.distance)
    assert again.position.shape == (3, 2, 3)


def test_lists_are_independent_of_neighbours():
    """The lists of points do not depend on the other points of a batch."""
    scene = wrt.Scene(SCENES["random_triangles"](), device="cpu")
    points = points_around(scene.meshes[0], 1100)
    together = scene.closest_point(points, k=5)
    for i in (0, 500, 1099):
        alone = scene.closest_point(points[i], k=5)
        for column in COLUMNS:
            np.testing.assert_array_equal(getattr(alone, column), getattr(together, column)[i])


def test_work():
    """What is counted: never more triangles than there are twice, more nodes for points far from all; the same answers."""
    mesh = SCENES["random_triangles"]()
    scene = wrt.Scene(mesh, device="cpu")
    points = points_around(mesh, 1100)
    plain, counted = scene.closest_point(points), scene.closest_point(points, counters=True)
    for column in COLUMNS:
        np.testing.assert_array_equal(getattr(plain, column), getattr(counted, column))
    work = counted.counters
    assert (work["nodes"] >= 1).all()
    assert (work["leaves"] <= work["triangles"]).all()
    assert 1 <= work["triangles"].mean() < mesh.triangle_count / 4
    floor = scene.closest_point(points, max_distance=plain.distance, counters=True).counters
    assert (floor["nodes"] <= work["nodes"]).all()
    with pytest.raises(ValueError, match="no counters"):
        plain.counters  # noqa: B018


REFUSED = {
    "k": (lambda scene: scene.closest_point([0, 0, 0], k=0), "from 1 to 1024"),
    "more than int32": (
        lambda scene: scene.closest_point(np.broadcast_to([0.0, 0, 0], (1 << 21, 3)), k=1024),
        "times k=1024 are more",
    ),
    "too many": (lambda scene: scene.closest_point([0, 0, 0], k=2000), "from 1 to 1024"),
    "counters of lists": (lambda scene: scene.closest_point([0, 0, 0], k=2, counters=True), "leave k out"),
    "mask": (lambda scene: scene.closest_point([0, 0, 0], mask=1), "mask needs instances"),
    "environment": (lambda scene: scene.within([0, 0, 0], 1.0, environment=1), "environment needs instances"),
    "radius": (lambda scene: scene.within([0, 0, 0], -1.0), "radius must be 0 or more"),
    "radii": (lambda scene: scene.within(np.zeros((4, 3)), [1.0, 2.0]), "radius .* does not broadcast"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case):
    call, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        call(wrt.Scene(trimesh.creation.box((1, 1, 1)), device="cpu"))


def test_k_is_an_int():
    with pytest.raises(TypeError, match="k"):
        wrt.Scene(trimesh.creation.box((1, 1, 1)), device="cpu").closest_point([0, 0, 0], k=2.5)

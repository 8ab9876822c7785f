"""Regions against sampled points, against the convex hull of their corners, and against linear programming."""

from __future__ import annotations

import numpy as np
import pytest

from wrt.builders.influence.regions import Aabb, Frustum, Obb, contain_points
from wrt.kernels.runtime.launch import use_threads

optimize = pytest.importorskip("scipy.optimize", reason="scipy is not installed: pip install 'wrt[test-all]'")
spatial = pytest.importorskip("scipy.spatial", reason="scipy is not installed: pip install 'wrt[test-all]'")

REGIONS = {
    "aabb": Aabb((-1, 0, 2), (2, 0.5, 3)),
    "obb": Obb(center=(0.3, -0.2, 0.1), half_size=(1, 0.4, 2), forward=(1, 2, 0.5), up=(0.1, 0, 1)),
    "obb_along_an_axis": Obb(center=(0.5, 0.5, 0.5), half_size=(1, 0.5, 2), forward=(0, 0, -3)),
    "frustum": Frustum(eye=(1, 1, -2), forward=(-0.3, 0.2, 1), fov_x=70, fov_y=35, near=0.4, far=4),
    "pyramid": Frustum(eye=(0, 0, 0), forward=(0, 1, 0), fov_x=120, fov_y=90, near=0, far=1.5, up=(1, 0.2, 0)),
}


@pytest.fixture(params=REGIONS)
def region(request):
    return REGIONS[request.param]


def faces(region) -> tuple[np.ndarray, np.ndarray]:
    """Normals (F, 3) and offsets (F,) of the hull of the corners: inside is normals @ x <= offsets."""
    equations = spatial.ConvexHull(region.corners).equations
    return equations[:, :3], -equations[:, 3]


def random_boxes(region, count, seed=1) -> tuple[np.ndarray, np.ndarray]:
    """Boxes of all sizes about the region: far, touching, within and around it."""
    rng = np.random.default_rng(seed)
    size = np.ptp(region.corners, axis=0).max()
    center = region.corners.mean(axis=0) + rng.normal(scale=0.4 * size, size=(count, 3))
    half = size * 10 ** rng.uniform(-2, 0, (count, 3))
    return center - half, center + half


def test_points(region):
    rng = np.random.default_rng(0)
    normals, offsets = faces(region)
    low, high = region.box
    points = rng.uniform(low - 0.2, high + 0.2, (5000, 3))
    distance = (points @ normals.T - offsets).max(axis=1)
    assert 0.05 < (distance < 0).mean() < 0.95
    np.testing.assert_array_equal(region.contains(points), distance < 0)
    assert not region.contains([[np.nan, 0, 0], [np.inf, 0, 0]]).any()


def test_box_is_the_tightest(region):
    low, high = region.box
    np.testing.assert_array_equal([low, high], [region.corners.min(axis=0), region.corners.max(axis=0)])
    middle = region.corners.mean(axis=0)
    weights = np.random.default_rng(0).dirichlet(np.full(8, 0.2), 3000)
    points = middle + (weights @ region.corners - middle) * (1 - 1e-9)
    assert region.contains(points).all()
    assert ((points >= low) & (points <= high)).all()


def overlap(region, low, high) -> float:
    """How far all faces of region and box can be moved inward before they have no point in common; negative: apart."""
    normals, offsets = faces(region)
    rows = np.concatenate([np.eye(3), -np.eye(3), normals])
    bounds = np.concatenate([high, -low, offsets])
    result = optimize.linprog([0, 0, 0, -1], np.column_stack([rows, np.ones(len(rows))]), bounds, bounds=[(None, None)] * 4)
    return result.x[3]


def test_boxes(region):
    """By a linear programme; one box against many corners where it encloses."""
    low, high = random_boxes(region, 150)
    depth = np.array([overlap(region, a, b) for a, b in zip(low, high, strict=True)])
    assert np.abs(depth).min() > 1e-9
    assert 0.1 < (depth > 0).mean() < 0.95
    np.testing.assert_array_equal(region.intersects(low, high), depth > 0)
    corners = np.stack([np.stack([np.where(k >> a & 1, high[:, a], low[:, a]) for a in range(3)], axis=1) for k in range(8)])
    np.testing.assert_array_equal(region.encloses(low, high), region.contains(corners).all(axis=0))
    middle = region.corners.mean(axis=0)
    assert region.encloses(middle - 0.01, middle + 0.01)
    assert not region.intersects([1, 1, 1], [0, 0, 0])


def test_boxes_that_only_edges_tell_apart():
    """Neither body's faces separate these: crossed bars, a hair's breadth apart and a hair's breadth into each other."""
    for gap, expected in ((1e-9, False), (-1e-9, True)):
        bar = Obb(center=(0, 1, 1), half_size=(1e-12, 1e-12, 3), forward=(0.5, 1, -1), up=(1, 2, 0))
        edge = 1 - gap
        low, high = np.array([-9.0, edge - 9, edge - 9]), np.array([9.0, edge, edge])
        assert bar.intersects(low, high) == expected


def test_touching_counts(region):
    """A box at the outermost corner along each axis, and one whose corner is a corner of the region."""
    low, high = region.box
    for axis in range(3):
        beyond_low, beyond_high = low - 1, high + 1
        beyond_low[axis] = high[axis]
        assert region.intersects(beyond_low, beyond_high)
        beyond_low[axis] = high[axis] + 1e-9
        assert not region.intersects(beyond_low, beyond_high)
    assert region.intersects(region.corners, region.corners).all()


def test_margin_moves_every_face_outward(region):
    """A widened region is the region of the moved faces: also a pyramid whose eye moves back."""
    normals, offsets = faces(region)
    near = -region.frame.axes[2]  # a pyramid's near face is a point, and no face of the hull
    normals, offsets = np.vstack([normals, near]), np.append(offsets, (region.corners @ near).max())
    corners = region.frame.widened(0.1).corners
    distance = corners @ normals.T - offsets
    np.testing.assert_allclose(distance.max(axis=0), 0.1, atol=1e-12)
    assert (np.isclose(distance, 0.1, atol=1e-12).sum(axis=1) >= 3).all()


def test_many_regions_at_once_and_threads():
    points = np.random.default_rng(2).uniform(-2, 3, (7, 500, 3))
    expected = np.stack([region.contains(points) for region in REGIONS.values()], axis=-1)
    with use_threads(2):
        np.testing.assert_array_equal(contain_points(list(REGIONS.values()), points), expected)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Aabb((0, 0, 1), (1, 1, 0)), "low .* above"),
        (lambda: Aabb((0, 0, np.nan), (1, 1, 0)), "low is .*finite"),
        (lambda: Obb(center=(0, 0), half_size=(1, 1, 1), forward=(1, 0, 0)), "center is"),
        (lambda: Obb(center=(0, 0, 0), half_size=(1, -1, 1), forward=(1, 0, 0)), "half_size"),
        (lambda: Obb(center=(0, 0, 0), half_size=(1, 1, 1), forward=(0, 0, 0)), "forward"),
        (lambda: Obb(center=(0, 0, 0), half_size=(1, 1, 1), forward=(1, 0, 0), up=(-2, 0, 0)), "up"),
        (lambda: Frustum(eye=(0, 0, 0), forward=(1, 0, 0), fov_x=180, fov_y=1, near=0, far=1), "fov_x"),
        (lambda: Frustum(eye=(0, 0, 0), forward=(1, 0, 0), fov_x=90, fov_y=1, near=2, far=1), "near"),
        (lambda: REGIONS["aabb"].contains([1.0, 2.0]), "points must have shape"),
        (lambda: REGIONS["aabb"].intersects([1.0, 2.0], [1, 1, 1]), "low must have shape"),
    ],
)
def test_bad_arguments(make, message):
    with pytest.raises(ValueError, match=message):
        make()

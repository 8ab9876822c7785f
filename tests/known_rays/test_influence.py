"""Influence areas: projected areas against a polygon library and against rays, outlines, affinity, bad input."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import warp as wp
from support.known_areas import picture, window

from wrt.builders.influence.influence_area import PlaneInfluenceArea, PointInfluenceArea
from wrt.kernels.influence.box_clipping import clipped_areas, projected_area
from wrt.kernels.influence.box_projection import NEEDS_NEAR, NEEDS_WINDOW, whole_areas
from wrt.kernels.influence.silhouette import MAX_CORNERS, clip_to_window, polygon_area, projected_hull
from wrt.kernels.influence.view import AreaView

shapely = pytest.importorskip("shapely", reason="shapely is not installed: pip install 'wrt[test-all]'")

AREAS = {
    "plane along an axis": PlaneInfluenceArea(position=(0, 0, -2), direction=(0, 0, 1), width=3, height=2, depth=4),
    "plane": PlaneInfluenceArea(
        position=(-1, 2, 1), direction=(0.5, -1.2, -0.4), width=2.5, height=3, depth=5, up=(0.1, 0.2, 1)
    ),
    "point along an axis": PointInfluenceArea(position=(0.2, -2, 0), direction=(0, 3, 0), fov=(60, 40), near=0.25, far=6),
    "point": PointInfluenceArea(position=(1.5, 1, 1), direction=(-2, -1, -1.3), fov=(75, 60), near=0.5, far=6),
    "point, wide": PointInfluenceArea(position=(0, 0, 0), direction=(1, 0.3, 0), fov=(160, 150), near=0.02, far=9),
}


@wp.kernel(module="unique")
def measure(
    view: AreaView,
    low: wp.array(dtype=wp.vec3),
    high: wp.array(dtype=wp.vec3),
    areas: wp.array2d(dtype=float),
    corners: wp.array2d(dtype=wp.vec2),
    counts: wp.array(dtype=int),
):
    """Item: a box. Its area, its outline, and the area by the outline alone."""
    i = wp.tid()
    areas[i, 0] = projected_area(view, low[i], high[i])
    hull = wp.zeros(shape=(MAX_CORNERS,), dtype=wp.vec2)
    counts[i] = projected_hull(view, low[i], high[i], hull)
    for c in range(counts[i]):
        corners[i, c] = hull[c]
    areas[i, 1] = polygon_area(hull, clip_to_window(hull, counts[i], view.half))


@wp.kernel(module="unique")
def measure_lanes(view: AreaView, boxes: wp.array(dtype=float), count: int, areas: wp.array2d(dtype=float)):
    """One item: all boxes at once. Their areas if they need no clipping, cut off at the window, and at the near plane too."""
    whole_areas(view, boxes, count, areas[0])
    for by_near in range(2):
        clipped_areas(view, boxes, count, by_near == 1, areas[1 + by_near])


def some_boxes(count: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Boxes of all sizes around the origin, some of them flat or a point."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-2, 2, (count, 3))
    size = 10 ** rng.uniform(-3, 0.5, (count, 1)) * rng.uniform(0, 1, (count, 3)) * (rng.random((count, 3)) > 0.1)
    return (middle - size / 2).astype(np.float32), (middle + size / 2).astype(np.float32)


@cache
def measured(name: str, count: int = 600):
    """Boxes, areas (count, 2), corners and numbers of corners as the device has them."""
    low, high = some_boxes(count)
    view = AREAS[name].view(np.zeros(3))
    boxes = [wp.array(b, dtype=wp.vec3, device="cpu") for b in (low, high)]
    areas = wp.zeros((count, 2), dtype=float, device="cpu")
    corners = wp.zeros((count, MAX_CORNERS), dtype=wp.vec2, device="cpu")
    counts = wp.zeros(count, dtype=int, device="cpu")
    wp.launch(measure, count, [view, *boxes, areas, corners, counts], device="cpu")
    return low, high, areas.numpy(), corners.numpy(), counts.numpy()


@pytest.mark.parametrize("name", AREAS)
def test_projected_areas_by_a_polygon_library(name):
    """Boxes in the window, across it, across the near plane, around the eye, and outside: all ways give the area."""
    low, high, areas, corners, counts = measured(name)
    half_x, half_y = window(AREAS[name])
    shown = [picture(AREAS[name], a, b) for a, b in zip(low, high, strict=True)]
    frame = shapely.box(-half_x, -half_y, half_x, half_y)
    cut = [p.intersection(frame) for p in shown]
    expected = np.array([p.area for p in cut])
    tolerance = {"rtol": 2e-4, "atol": 4e-5 * half_x * half_y}
    np.testing.assert_allclose(areas[:, 0], expected, **tolerance)
    np.testing.assert_allclose(areas[:, 1], expected, **tolerance)
    for i in np.flatnonzero(counts >= 3)[:200]:
        outline = shapely.MultiPoint(corners[i, : counts[i]]).convex_hull
        assert outline.symmetric_difference(shown[i]).area <= 1e-4 * max(shown[i].area, 1.0)


@pytest.mark.parametrize("name", AREAS)
def test_lanes_give_the_same_bits(name):
    """Of boxes at once: those wholly in the window or outside, those that the window cuts, and those that the near plane cuts;
    whatever cuts more off gives the others their areas too."""
    low, high, areas, _, _ = measured(name)
    for count in (len(low), 37, 1):  # whole blocks of lanes, some of one, a single box
        boxes = wp.array(np.concatenate([low, high], axis=1)[:count].T.reshape(-1), dtype=float, device="cpu")
        found = wp.zeros((3, count), dtype=float, device="cpu")
        wp.launch(measure_lanes, 1, [AREAS[name].view(np.zeros(3)), boxes, count, found], device="cpu")
        whole, in_window, in_front = found.numpy()
        by_window, by_near = whole == NEEDS_WINDOW, whole == NEEDS_NEAR
        done = ~by_window & ~by_near
        for chosen, lanes in ((done, whole), (by_window, in_window), (by_near, in_front)):
            np.testing.assert_array_equal(lanes[chosen], areas[:count, 0][chosen])
            assert chosen.any() or count < len(low)
        tolerance = {"rtol": 1e-2, "atol": 1e-5 * np.prod(window(AREAS[name]))}
        np.testing.assert_allclose(in_window[done], whole[done], **tolerance)
        np.testing.assert_allclose(in_front[~by_near], np.where(done, whole, in_window)[~by_near], **tolerance)
        if count == len(low):
            assert 0.05 < (done & (whole > 0)).mean() < 0.9
            assert (done & (whole == 0)).any()


@pytest.mark.parametrize("name", AREAS)
def test_projected_areas_are_the_share_of_rays(name):
    """Monte Carlo: rays of the area that meet a box, counted by a slab test in float64."""
    area = AREAS[name]
    low, high, areas, _, _ = measured(name)
    half = np.array(window(area))
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-half, half, (20_000, 2)).T
    right, up, forward = area.frame
    through = x[:, None] * right + y[:, None] * up
    if isinstance(area, PointInfluenceArea):
        directions = through + forward
        origins = np.array(area.position) + area.near * directions
    else:
        origins, directions = np.array(area.position) + through, np.broadcast_to(forward, through.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        for i in np.argsort(-areas[:, 0])[::12][:25]:
            ends = (np.array([low[i], high[i]], dtype=np.float64)[:, None] - origins) / directions
            meets = (ends.min(axis=0).max(axis=-1) <= ends.max(axis=0).min(axis=-1)) & (ends.max(axis=0).min(axis=-1) >= 0)
            share = min(areas[i, 0] / (4 * half.prod()), 1.0)
            assert abs(meets.mean() - share) <= 5 * np.sqrt(share * (1 - share) / len(x)) + 1e-4


@pytest.mark.parametrize("name", ["plane", "point"])
def test_affine_rays_start_inside_and_are_aligned(name):
    area = AREAS[name]
    rng = np.random.default_rng(3)
    right, up, forward = area.frame
    count, degrees = 4000, 2.0
    depth = rng.uniform(0, 8, count)
    across = rng.uniform(-1.3, 1.3, (count, 2)) * window(area)
    reach = depth if name == "point" else np.ones(count)
    origins = np.array(area.position) + depth[:, None] * forward + (across * reach[:, None]) @ np.array([right, up])
    lines = origins - area.position if name == "point" else np.broadcast_to(forward, origins.shape)
    lines = lines / np.linalg.norm(lines, axis=1, keepdims=True)
    aside = np.cross(lines, rng.normal(size=(count, 3)))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    angle = np.radians(rng.uniform(0, 4, count))
    turned = np.cos(angle)[:, None] * lines + np.sin(angle)[:, None] * aside
    directions = turned * rng.choice([-3.0, 0.01], (count, 1))  # either sense, any length
    near, far = (area.near, area.far) if name == "point" else (0.0, area.depth)
    inside = (near <= depth) & (depth <= far) & (np.abs(across) <= window(area)).all(axis=1)
    expected = inside & (angle <= np.radians(degrees))
    clear = np.abs(angle - np.radians(degrees)) > 1e-4
    found = area.affine(origins, directions, degrees)
    assert 100 < expected.sum() < count - 100
    np.testing.assert_array_equal(found[clear], expected[clear])


@pytest.mark.parametrize("name", ["plane", "point"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_bad_rays_are_never_affine(name, bad):
    area = AREAS[name]
    good = np.array(area.position) + 2 * area.frame[2]
    assert area.affine([good], [area.frame[2]]).all()
    for axis in range(3):
        broken = np.zeros(3)
        broken[axis] = bad
        assert not area.affine([good + broken], [area.frame[2]]).any()
        assert not area.affine([good], [broken]).any()
    assert not area.affine([good], [np.zeros(3)]).any()
    with pytest.raises(ValueError, match="tolerance is 90"):
        area.affine([good], [good], 90.0)
    with pytest.raises(ValueError, match="must both be"):
        area.affine(good, good)


PLANE = {"position": (0, 0, 0), "direction": (0, 0, 1), "width": 1, "height": 1, "depth": 1}
POINT = {"position": (0, 0, 0), "direction": (0, 0, 1), "fov": (60, 60), "near": 0.1, "far": 2}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position": (0, 0)}, "position must be 3 finite numbers"),
        ({"position": (0, 0, np.nan)}, "position must be 3 finite numbers"),
        ({"direction": (0, 1)}, "direction must be 3 finite numbers"),
        ({"direction": (0, 0, 0)}, "direction is zero"),
        ({"up": (0, 0, -2)}, "up is .* parallel to the direction"),
        ({"up": (0, 0, 0)}, "up is .* zero"),
        ({"width": 0}, "width is 0.0; it must be above 0 and finite"),
        ({"height": np.inf}, "height is inf"),
        ({"depth": -1}, "depth is -1"),
        ({"fov": 60}, "fov must be 2 finite numbers"),
        ({"fov": (60, 180)}, "below 180"),
        ({"near": 0}, "near is 0"),
        ({"far": 0.1}, "far is 0.1; it must be above near"),
    ],
)
def test_bad_areas_are_refused(change, message):
    (name,) = change
    for kind, fields in ((PlaneInfluenceArea, PLANE), (PointInfluenceArea, POINT)):
        if name in fields or name == "up":
            with pytest.raises(ValueError, match=message):
                kind(**fields | change)


def test_areas_are_values():
    """Arrays may be given; what is kept compares, hashes, and may be endless."""
    given = PlaneInfluenceArea(**PLANE | {"position": np.zeros(3), "depth": np.inf})
    assert given == PlaneInfluenceArea(**PLANE | {"depth": float("inf")})
    assert len({given, PointInfluenceArea(**POINT | {"far": np.inf})}) == 2
    with pytest.raises(TypeError, match="width must be a number"):
        PlaneInfluenceArea(**PLANE | {"width": "1"})

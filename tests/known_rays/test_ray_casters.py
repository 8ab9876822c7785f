"""Ray casters: where rays start and go, how evenly, and again the same; shadow rays of what a camera sees."""

from __future__ import annotations

import numpy as np
import pytest

import wrt
from wrt.builders.influence.influence_area import frame_of

AIM = {"position": (1e4, -2.0, 3.0), "direction": (1.0, -2.0, 0.7), "up": (0.2, 0.1, 1.0)}
COUNT = 1 << 14


def seen(rays: wrt.Rays) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions along right, up and forward."""
    frame = frame_of(AIM["direction"], AIM["up"])
    return (rays.origins - AIM["position"]) @ frame.T, rays.directions.astype(np.float64) @ frame.T


def assert_even(*coordinates: np.ndarray) -> None:
    """Numbers that should fill the unit cube: every cell of 8 an axis holds its share, within 6 standard deviations."""
    counts, _ = np.histogramdd(np.column_stack(coordinates), bins=8, range=[(0, 1)] * len(coordinates))
    assert counts.sum() == len(coordinates[0])
    expected = counts.mean()
    assert np.abs(counts - expected).max() < 6 * np.sqrt(expected)


def test_plane():
    rays = wrt.known_rays.PlaneCaster(**AIM, width=4, height=0.5).rays(COUNT, seed=3)
    origins, directions = seen(rays)
    assert (rays.origins.dtype, rays.directions.dtype, rays.shape) == (np.float64, np.float32, (COUNT,))
    assert np.abs(origins[:, 2]).max() < 1e-10
    assert_even(origins[:, 0] / 4 + 0.5, origins[:, 1] / 0.5 + 0.5)
    np.testing.assert_allclose(directions, np.broadcast_to([0, 0, 1], directions.shape), atol=1e-7)


@pytest.mark.parametrize("angle", [1e-3, 20, 150, 180])
def test_circular_cap(angle):
    """The share of the cap within a circle is that of the rises; angles about the axis are even too."""
    cap = wrt.known_rays.CircularCapCaster(**AIM, angle=angle).rays(COUNT)
    spread = wrt.known_rays.PlaneCaster(**AIM, width=2, height=1, tolerance=min(angle, 90)).rays(COUNT)
    assert cap.origins.shape == (1, 3)
    for rays, widest in ((cap, angle), (spread, min(angle, 90))):
        origins, (x, y, z) = seen(rays)[0], seen(rays)[1].T
        np.testing.assert_allclose(x * x + y * y + z * z, 1.0, rtol=3e-7)
        tangent = np.hypot(x, y)
        share = np.sin(np.arctan2(tangent, z) / 2) ** 2 / np.sin(np.radians(widest) / 2) ** 2
        assert share.max() < 1 + 1e-2
        around = np.arctan2(y, x) / (2 * np.pi) % 1.0
        assert_even(np.clip(share, 0, 1), around)
    assert_even(*np.clip((origins[:, :2] / [2, 1] + 0.5).T, 0, 1), np.clip(share, 0, 1))


@pytest.mark.parametrize("fov", [(60, 40), (170, 5), (1e-2, 1e-2)])
def test_square_cap(fov):
    """Against the solid angles of the cells of the window, by van Oosterom and Strackee's formula in float64."""
    rays = wrt.known_rays.SquareCapCaster(**AIM, fov=fov).rays(COUNT, seed=9)
    directions = seen(rays)[1]
    window = directions[:, :2] / directions[:, 2:] / np.tan(np.radians(fov) / 2)
    assert np.abs(window).max() < 1 + 1e-3
    edges = np.tan(np.radians(fov) / 2)[:, None] * np.linspace(-1, 1, 9)
    corners = np.stack([*np.meshgrid(*edges, indexing="ij"), np.ones((9, 9))], axis=-1)
    a, b, c, d = corners[:-1, :-1], corners[1:, :-1], corners[1:, 1:], corners[:-1, 1:]
    solid = solid_angle(a, b, c) + solid_angle(a, c, d)
    counts, _, _ = np.histogram2d(*np.clip(window, -1, 1).T, bins=8, range=[(-1, 1)] * 2)
    expected = solid / solid.sum() * COUNT
    assert np.abs((counts - expected) / np.sqrt(expected)).max() < 6


def solid_angle(a, b, c):
    """Of the triangles a, b, c seen from the origin."""
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    dot = [(u * v).sum(axis=-1) for u, v in ((a, b), (a, c), (b, c))]
    volume = np.linalg.det(np.stack([a, b, c], axis=-1))
    return 2 * np.arctan2(np.abs(volume), la * lb * lc + dot[0] * lc + dot[1] * lb + dot[2] * la)


def test_seeds():
    """The same seed gives the same rays, of a shorter batch too; another one gives others."""
    caster = wrt.known_rays.SquareCapCaster(**AIM, fov=(30, 30))
    rays = caster.rays(100, seed=5).directions
    np.testing.assert_array_equal(rays[:60], caster.rays(60, seed=5).directions)
    assert (rays != caster.rays(100, seed=6).directions).any(axis=1).all()
    assert len(caster.rays(0)) == 0


def test_casters_of_areas():
    plane = wrt.known_rays.PlaneInfluenceArea(position=(1, 2, 3), direction=(0, 1, 1), width=2, height=1, depth=3, up=(1, 1, 0))
    point = wrt.known_rays.PointInfluenceArea(position=(1, 2, 3), direction=(0, 1, 1), fov=(50, 20), near=1, far=3)
    assert wrt.known_rays.PlaneCaster.of(plane, 2.0) == wrt.known_rays.PlaneCaster(
        position=(1, 2, 3), direction=(0, 1, 1), width=2, height=1, up=(1, 1, 0), tolerance=2.0
    )
    assert wrt.known_rays.SquareCapCaster.of(point) == wrt.known_rays.SquareCapCaster(
        position=(1, 2, 3), direction=(0, 1, 1), fov=(50, 20)
    )


def test_shadow_rays():
    """A ball's points in the light are those that face it: brute geometry. Misses cast no shadow ray."""
    vertices, faces = icosahedron()
    mesh = wrt.TriangleMesh(vertices, faces)
    scene = wrt.Scene(mesh, device="cpu")
    camera = wrt.PinholeCamera(24, 16, position=(0, -4, 1), look_at=(0, 0, 0))
    hits = scene.intersect(camera.rays())
    assert 0.1 < hits.is_hit.mean() < 0.9
    light = np.array([2.0, -3.0, 2.5])
    for rays, towards in (
        (wrt.known_rays.point_shadow_rays(hits, light), light - hits.position),
        (wrt.known_rays.directional_shadow_rays(hits, -light), np.broadcast_to(light, hits.position.shape)),
    ):
        assert rays.shape == (16, 24)
        facing = (towards * hits.normal).sum(axis=-1)
        clear = hits.is_hit & (np.abs(facing) > 1e-3)
        np.testing.assert_array_equal(scene.occluded(rays)[clear], facing[clear] < 0)
        assert not scene.occluded(rays)[~hits.is_hit].any()
        assert np.isnan(np.asarray(rays.origins)[~hits.is_hit]).all()
    rays = wrt.known_rays.point_shadow_rays(hits, light)
    np.testing.assert_allclose((rays.origins + rays.directions)[hits.is_hit], np.broadcast_to(light, (hits.is_hit.sum(), 3)))


def icosahedron() -> tuple[np.ndarray, np.ndarray]:
    """A convex body: what faces the light is lit."""
    spatial = pytest.importorskip("scipy.spatial", reason="scipy is not installed: pip install 'wrt[test-all]'")

    golden = (1 + 5**0.5) / 2
    corners = np.array([np.roll((0, a, b * golden), k) for k in range(3) for a in (-1, 1) for b in (-1, 1)])
    faces = spatial.ConvexHull(corners).simplices
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * a).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return corners / 2, faces


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: wrt.known_rays.PlaneCaster(**AIM, width=0, height=1), ValueError, "width is 0"),
        (lambda: wrt.known_rays.PlaneCaster(**AIM, width=1, height=1, tolerance=91), ValueError, "tolerance is 91"),
        (lambda: wrt.known_rays.CircularCapCaster(**AIM, angle=np.nan), ValueError, "angle is nan"),
        (lambda: wrt.known_rays.SquareCapCaster(**AIM, fov=(30, 180)), ValueError, "fov is"),
        (lambda: wrt.known_rays.SquareCapCaster(**{**AIM, "up": (2, -4, 1.4)}, fov=(30, 30)), ValueError, "up is"),
        (lambda: wrt.known_rays.SquareCapCaster(**{**AIM, "position": (0, 0)}, fov=(30, 30)), ValueError, "position must be 3"),
        (lambda: wrt.known_rays.SquareCapCaster(**AIM, fov=(30, 30)).rays(-1), ValueError, "count"),
        (lambda: wrt.known_rays.SquareCapCaster(**AIM, fov=(30, 30)).rays(1.5), TypeError, "count"),
        (lambda: wrt.known_rays.SquareCapCaster(**AIM, fov=(30, 30)).rays(1, seed=1 << 32), ValueError, "seed"),
    ],
)
def test_bad_arguments(make, error, message):
    with pytest.raises(error, match=message):
        make()

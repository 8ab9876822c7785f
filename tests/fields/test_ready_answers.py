"""Ready answers: samples, thickness, exposure, visible faces and viewsheds, against closed forms and other queries."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from support.selection import slow

import wrt
from wrt import analysis
from wrt.analysis import surface_samples
from wrt.analysis.wall_thickness import mean_near_median

SPHERE = trimesh.creation.icosphere(4)


@pytest.fixture(scope="module")
def scene():
    return wrt.Scene(SPHERE, device="cpu")


@pytest.fixture(scope="module")
def somewhere(scene):
    return analysis.sample_surface(scene, 1500, seed=1)


def test_samples_are_even():
    """Triangles get points by area, and each part of a triangle the same; instances, too; a seed gives the same points."""
    quad = wrt.TriangleMesh(
        np.float32([[0, 0, 0], [3, 0, 0], [3, 1, 0], [0, 1, 0], [0, 9, 0]]), [[0, 1, 2], [0, 2, 3], [0, 3, 3]]
    )
    moved = np.eye(4)
    moved[:3, 3] = [0, 0, 2]
    moved[0, 0] = 2.0
    scene = wrt.Scene([wrt.Instance(quad), wrt.Instance(quad, moved)], device="cpu")
    found = analysis.sample_surface(scene, 90_000)
    assert found.is_hit.all()
    assert (found.instance_id == 1).mean() == pytest.approx(2 / 3, abs=0.01)
    assert not (found.primitive_id == 2).any()
    below = found.position[found.instance_id == 0]
    counts = np.histogram2d(below[:, 0], below[:, 1], bins=(6, 2), range=((0, 3), (0, 1)))[0]
    np.testing.assert_allclose(counts, len(below) / 12, rtol=0.1)
    np.testing.assert_array_equal(
        analysis.sample_surface(scene, 50, seed=3).position, analysis.sample_surface(scene, 50, seed=3).position
    )


def test_samples_apart(scene, monkeypatch):
    """None nearer than the radius, nowhere a hole of more than two radii; as by throwing one after the other."""
    found = analysis.sample_surface(scene, radius=0.1).position
    apart = np.linalg.norm(found[:, None] - found, axis=-1)
    np.fill_diagonal(apart, np.inf)
    assert apart.min() >= 0.0999
    anywhere = analysis.sample_surface(scene, 1000).position
    assert np.linalg.norm(anywhere[:, None] - found, axis=-1).min(axis=1).max() < 0.2
    assert 0.5 < len(found) * 0.1**2 / SPHERE.area < 0.75
    places = np.random.default_rng(4).uniform(-1, 1, (300, 3)).astype(np.float32)
    kept: list[int] = []
    for number, place in enumerate(places):
        if not len(kept) or (((places[kept] - place) ** 2).sum(axis=1) >= np.float32(0.3) ** 2).all():
            kept.append(number)
    for least in (300, 1):  # all at once, and a part at a time
        monkeypatch.setattr(surface_samples, "MIN_PART", least)
        np.testing.assert_array_equal(surface_samples.kept_apart(scene, places, 0.3), kept)


def test_thickness(scene, somewhere):
    """The diameter of a sphere; the wall of a hollow one; nothing behind a sheet."""
    np.testing.assert_allclose(analysis.thickness(scene, somewhere), 2.0, atol=0.01)
    inner = SPHERE.copy().apply_scale(0.75)
    inner.invert()
    hollow = wrt.Scene([SPHERE, inner], device="cpu")
    np.testing.assert_allclose(analysis.thickness(hollow, analysis.sample_surface(hollow, 500)), 0.25, atol=0.02)
    sheet = wrt.Scene(wrt.TriangleMesh(np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), [[0, 1, 2]]), device="cpu")
    assert analysis.thickness(sheet, sheet.points_on([0])) == np.inf
    assert np.isnan(analysis.thickness(scene, scene.points_on([-1, 0]))).tolist() == [True, False]


def test_shape_diameter(scene, somewhere):
    """Of a sphere, the chords within 45 degrees, beyond which its sides face the point's way; of a slab, near its thickness."""
    found = analysis.shape_diameter(scene, somewhere)
    assert found.std() < 0.02
    cone = np.arccos(1.0 - (np.arange(30) + 0.5) / 30 * 0.5)
    cone = cone[cone < np.pi / 4]
    expected = mean_near_median(2.0 * np.cos(cone)[:, None], 1.0 / cone)
    np.testing.assert_allclose(found.mean(), expected[0], rtol=0.01)
    slab = wrt.Scene(trimesh.creation.box((100, 100, 1)), device="cpu")
    top = slab.points_on(np.flatnonzero(trimesh.creation.box((100, 100, 1)).face_normals[:, 2] > 0.5))
    thick = analysis.shape_diameter(slab, top, opening=20.0, rays=60)
    assert ((thick > 1.0) & (thick < 1.0 / np.cos(np.radians(10.0)))).all()
    assert np.isnan(analysis.shape_diameter(scene, scene.points_on([-1]))).all()
    narrow = analysis.shape_diameter(slab, top, opening=1e-200)
    np.testing.assert_allclose(narrow, analysis.thickness(slab, top), rtol=1e-6)


def test_mean_near_median():
    """An outlier and rays that met nothing are left out."""
    values = np.array([[1.0, np.nan], [1.1, np.nan], [0.9, np.nan], [9.0, np.nan], [np.nan, np.nan]])
    np.testing.assert_allclose(mean_near_median(values, np.ones(5)), [1.0, np.nan])


def test_the_sky_of_a_sphere(scene, somewhere):
    """Of a free slope: the share of the sky 1 - slope / 180, the view factor (1 + cos slope) / 2."""
    sky = analysis.sky_directions(400)
    assert sky.shape == (400, 3)
    np.testing.assert_allclose(np.linalg.norm(sky, axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(sky.mean(axis=0), [0, 0, 0.5], atol=5e-3)
    slope = np.arccos(np.clip(somewhere.normal[:, 2], -1, 1))
    openness = analysis.exposure(scene, somewhere, sky)
    np.testing.assert_allclose(openness, 1.0 - slope / np.pi, atol=0.02)
    factor = analysis.exposure(scene, somewhere, sky, weights=np.full(400, 2 / 400), cosine=True)
    np.testing.assert_allclose(factor, 0.5 + 0.5 * np.cos(slope), atol=0.02)
    sideways = analysis.sky_directions(100, up=(2, 0, 0))
    assert (sideways[:, 0] > 0).all()
    for length in (1e-200, 1e200):  # whose squares float64 does not hold
        np.testing.assert_array_equal(analysis.sky_directions(100, up=(length, 0, 0)), sideways)
        way = length * scene.points_on([0]).normal.astype(np.float64)
        assert analysis.exposure(scene, scene.points_on([0]), way) == 1.0


def test_sun_hours_on_a_floor():
    """A wall hides the sun of the morning; the back of the floor has none; hours are the sums of weights."""
    floor = trimesh.Trimesh([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]])
    wall = trimesh.creation.box((0.2, 18, 2)).apply_translation([2.0, 0.0, 1.0])
    scene = wrt.Scene([floor, wall], device="cpu")
    places = scene.points_on([0, 1], points=[[0.0, -0.5, 0], [-5, 0.5, 0]], instance_id=0)
    angles = np.radians(np.arange(5, 180, 10))
    sun = np.stack([np.cos(angles), np.zeros(18), np.sin(angles)], axis=1)
    hours = analysis.exposure(scene, places, sun, weights=np.full(18, 0.5))
    hidden = [(angles < np.arctan2(2.0, 1.9)).sum(), (angles < np.arctan2(2.0, 6.9)).sum()]
    np.testing.assert_allclose(hours, [9.0 - 0.5 * hidden[0], 9.0 - 0.5 * hidden[1]])
    np.testing.assert_array_equal(analysis.exposure(scene, places, -sun), 0.0)


def summed(scene, surface, ways, weights, cosine):
    """`exposure` by the public queries, ray by ray, those to the back included."""
    ways = np.float32(ways / np.linalg.norm(ways, axis=1, keepdims=True))
    found, normal = np.zeros(surface.shape), surface.normal.astype(np.float64)
    for way, weight in zip(ways, weights, strict=True):
        towards = np.broadcast_to(way, (*surface.shape, 3))
        seen = surface.faces(towards) & ~scene.occluded(surface.spawn(towards), towards)
        found += seen * weight * (np.maximum((way * normal).sum(axis=-1), 0.0) if cosine else 1.0)
    return found


@pytest.mark.parametrize("cosine", [True, *slow(False)])
def test_exposure_sums_what_single_rays_find(somewhere, scene, cosine):
    """Bit for bit, in one mesh and through instances, for points in any order, misses among them, by groups and alone."""
    rng = np.random.default_rng(5)
    ways, weights = rng.normal(size=(23, 3)), rng.random((3, 23))
    turned = np.diag([-1.0, 1.0, 0.5, 1.0])
    turned[:3, 3] = 0.1, 0.2, 2.5
    pair = wrt.Scene([wrt.Instance(scene.meshes[0]), wrt.Instance(scene.meshes[0], turned)], device="cpu")
    rays = pair.intersect(rng.normal(size=(17, 23, 3)) * 5.0, rng.normal(size=(17, 23, 3)))
    assert rays.is_hit.any()
    assert not rays.is_hit.all()
    sampled = analysis.sample_surface(pair, 700, seed=4)
    for place, surface in ((scene, somewhere), (pair, rays), (pair, sampled), (pair, somewhere), (scene, sampled)):
        found = analysis.exposure(place, surface, ways, weights=weights, cosine=cosine)
        assert found.shape == (*surface.shape, 3)
        for group, own in enumerate(weights):
            expected = summed(place, surface, ways, own, cosine)
            np.testing.assert_array_equal(found[..., group], expected)
            np.testing.assert_array_equal(analysis.exposure(place, surface, ways, weights=own, cosine=cosine), expected)
    assert (found > 0.0).any()


def test_exposure_to_suns_that_follow_each_other():
    """Bit for bit, where all points of a tile face all directions of a group of eight, and of smaller groups."""
    floor = trimesh.Trimesh([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]])
    scene = wrt.Scene([floor, trimesh.creation.box((0.2, 18, 2)).apply_translation([2.0, 0.0, 1.0])], device="cpu")
    x, y = np.random.default_rng(7).uniform(-8.5, 8.5, (2, 600))
    places = scene.intersect(np.stack([x, y, np.full(600, 1.0)], axis=1), [0.0, 0.0, -1.0])
    for count in (16, 21):
        angles = np.radians(20 + 2.0 * np.arange(count))
        sun, weights = np.stack([np.cos(angles), 0.1 * np.ones(count), np.sin(angles)], axis=1), np.linspace(0.1, 1.0, count)
        found = analysis.exposure(scene, places, sun, weights=weights)
        np.testing.assert_array_equal(found, summed(scene, places, sun, weights, False))
        assert 0.1 < (found < weights.sum()).mean() < 0.9


def test_exposure_in_blocks(somewhere, scene, monkeypatch):
    """Blocks of directions and of points change nothing."""
    ways, weights = analysis.sky_directions(19), np.random.default_rng(6).random((2, 19))
    expected = analysis.exposure(scene, somewhere, ways, weights=weights)
    monkeypatch.setattr("wrt.analysis.sky_exposure.BLOCK", 256)
    np.testing.assert_array_equal(analysis.exposure(scene, somewhere, ways, weights=weights), expected)


def test_visible_faces(scene):
    """Those that face the camera, of a large enough picture; none behind another body; instances in the scene's numbers."""
    camera = wrt.PinholeCamera(200, 200, position=(0, -5, 0), look_at=(0, 0, 0), fov=26.0)
    seen = analysis.visible_faces(scene, camera, samples=2)
    facing = ((np.array([0, -5, 0]) - SPHERE.triangles_center) * SPHERE.face_normals).sum(axis=1)
    assert not seen[facing < -1e-6].any()
    assert seen[facing > 0.5].all()
    box = trimesh.creation.box((1, 1, 1))
    near, far = np.eye(4), np.eye(4)
    near[1, 3], far[1, 3] = -2.0, 3.0
    scene = wrt.Scene([wrt.Instance(box, far), wrt.Instance(box, near)], device="cpu")
    seen = analysis.visible_faces(scene, camera)
    assert (len(seen), seen[:12].sum(), seen[12:].sum()) == (24, 0, 2)
    assert (box.face_normals[seen[12:]][:, 1] < -0.5).all()


def test_height_maps():
    """Places, winding and gaps; rows from the north; closed forms of slope and area."""
    heights = np.arange(12.0).reshape(3, 4) * 0.0
    mesh = wrt.TriangleMesh.from_heightmap(heights + 2, spacing=(10.0, 5.0), origin=(500_000, 4_000_000, 1))
    np.testing.assert_array_equal(mesh.bounds, [[500_000, 4_000_000, 3], [500_030, 4_000_010, 3]])
    assert (mesh.triangle_count, mesh.surface_area, tuple(mesh.up)) == (12, 300.0, (0, 0, 1))
    assert (mesh.face_normals == [0, 0, 1]).all()
    north = wrt.TriangleMesh.from_heightmap(np.array([[1, 1], [0, 0]]), spacing=(1.0, -1.0))
    assert (north.face_normals[:, 2] > 0).all()
    assert (north.face_normals[:, 1] < 0).all()  # it falls to the south
    heights[1, 1] = np.nan
    assert wrt.TriangleMesh.from_heightmap(heights).triangle_count == 4
    for bad, message in ((np.zeros(3), "heights must have shape"), (np.full((2, 2), np.nan), "no cell")):
        with pytest.raises(ValueError, match=message):
            wrt.TriangleMesh.from_heightmap(bad)
    with pytest.raises(ValueError, match="spacing must not be 0"):
        wrt.TriangleMesh.from_heightmap(np.zeros((2, 2)), spacing=(1, 0))
    with pytest.raises(ValueError, match="spacing must be a number or two"):
        wrt.TriangleMesh.from_heightmap(np.zeros((2, 2)), spacing=(1, 2, 3))
    with pytest.raises(TypeError, match="heights must hold real numbers"):
        wrt.TriangleMesh.from_heightmap([["a", "b"]])


def test_viewshed():
    """A ridge hides what is behind it, and not what stands high enough; several observers; both ways."""
    heights = np.zeros((21, 41))
    heights[:, 20] = 5.0
    terrain = wrt.TriangleMesh.from_heightmap(heights)
    cells, scene = terrain.vertices.reshape(21, 41, 3), wrt.Scene(terrain, device="cpu")
    seen = analysis.viewshed(scene, cells, cells[10, 5], eye_height=1.5)
    assert seen[:, :20].all()
    assert not seen[:, 21:].any()
    tall = analysis.viewshed(scene, cells, cells[10, 5], eye_height=1.5, target_height=12.0)
    slope = (5.0 - 1.5) / 15.0
    expected = slope * (np.arange(41) - 5.0) < 12.0 - 1.5
    np.testing.assert_array_equal(tall[10, 21:], expected[21:])
    both = analysis.viewshed(scene, cells, cells[10, [5, 35]], eye_height=1.5)
    np.testing.assert_array_equal(both[0], seen)
    np.testing.assert_array_equal(both[1], seen[:, ::-1])


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda s, h: analysis.sample_surface(s), TypeError, "pass either count.*or radius"),
        (lambda s, h: analysis.sample_surface(s, radius=1e-200), ValueError, "radius 1e-200 is too small"),
        (lambda s, h: analysis.sample_surface(SPHERE, 3), TypeError, "scene must be a wrt.Scene, not Trimesh"),
        (lambda s, h: analysis.winding_number(SPHERE, [0, 0, 0]), TypeError, "scene must be a wrt.Scene"),
        (lambda s, h: analysis.clearance([s, s]), TypeError, "scene must be a wrt.Scene, not list"),
        (lambda s, h: analysis.distance_grid(s, 10**400), ValueError, "resolution is 1000"),
        (lambda s, h: analysis.distance_grid(s, 16, band=1e39), ValueError, "band must be above 0 and a float32"),
        (lambda s, h: analysis.distance_grid(s, 16, band=1e-200), ValueError, "band must be above 0 and a float32"),
        (lambda s, h: analysis.thickness(s, [[0, 0, 1]]), TypeError, "surface must be hits, .*not list"),
        (lambda s, h: analysis.shape_diameter(s, None), TypeError, "surface must be hits, .*not NoneType"),
        (lambda s, h: analysis.exposure(s, "floor", [0, 0, 1]), TypeError, "surface must be hits, .*not str"),
        (
            lambda s, h: analysis.exposure(s, h, [[0, 0, 1], [0, 0, 0]]),
            ValueError,
            r"directions\[1\] is .*other than zero",
        ),
        (lambda s, h: analysis.visible_faces(s, "front"), TypeError, "camera must be a camera"),
        (lambda s, h: analysis.sample_surface(s, 5, radius=0.1), TypeError, "pass either count"),
        (lambda s, h: analysis.sample_surface(s, radius=0.0), ValueError, "radius must be above 0"),
        (lambda s, h: analysis.sample_surface(s, radius=1e-6), ValueError, "radius 1e-06 is too small"),
        (lambda s, h: analysis.shape_diameter(s, h, opening=180), ValueError, "opening must be between 0 and 180"),
        (lambda s, h: analysis.shape_diameter(s, h, rays=0), ValueError, "rays"),
        (
            lambda s, h: analysis.exposure(s, h, [[0, 0, 0]]),
            ValueError,
            r"directions\[0\] is .*other than zero",
        ),
        (lambda s, h: analysis.exposure(s, h, [[0, 0, 1]], weights=[-1]), ValueError, "weights must be 0 or more"),
        (lambda s, h: analysis.exposure(s, h, [[0, 0, 1]], weights=np.ones((0, 1))), ValueError, "at least one group"),
        (lambda s, h: analysis.exposure(s, h, [[0, 0, 1]], weights=[[1, 2]]), ValueError, "weights has the shape"),
        (lambda s, h: analysis.sky_directions(0), ValueError, "count"),
        (lambda s, h: analysis.sky_directions(4, up=(0, 0, 0)), ValueError, "up is zero"),
        (lambda s, h: analysis.viewshed(s, [0, 0, 0], [0, 0, 0], eye_height=-1), ValueError, "eye_height must be 0 or more"),
        (lambda s, h: analysis.viewshed(s, [0, 0], [0, 0, 0]), ValueError, "points must have shape"),
        (lambda s, h: analysis.viewshed(s, [0, 0, 0], [0, 0]), ValueError, "observers must have shape"),
        (
            lambda s, h: analysis.visible_faces(s, wrt.PinholeCamera(4, 4, position=(9, 0, 0), look_at=(0, 0, 0)), samples=0),
            ValueError,
            "samples",
        ),
    ],
)
def test_what_is_refused(scene, call, error, message):
    with pytest.raises(error, match=message):
        call(scene, scene.points_on([0]))

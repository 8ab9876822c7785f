"""Lidars against closed forms: planes, spheres, steps; patterns, returns, intensity and noise."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import warp as wp
from support.sensed_scenes import cone, exact, wall

import wrt
from wrt.sensors import LIDARS, Lidar, LidarPattern


@pytest.fixture(scope="module")
def head_on():
    """A wall at 10 m, and a cone of beams at it."""
    return {"scene": wrt.Scene(wall(10.0), device="cpu"), "pattern": LidarPattern(cone(0.9), np.linspace(0, 0.1, 16))}


def test_plane(device):
    """Range, point, normal and intensity of a plane are those of the closed form."""
    scene, pattern = wrt.Scene(wall(10.0), device=device), LidarPattern(cone(0.9))
    scan = Lidar(pattern=pattern).scan(scene, np.eye(4), reflectance=0.4)
    cosine = exact(pattern)[..., 0]
    np.testing.assert_allclose(scan.range, 10 / cosine, rtol=1e-6)
    np.testing.assert_allclose(scan.point, 10 / cosine[..., None] * exact(pattern), atol=1e-5)
    np.testing.assert_array_equal(scan.point, scan.position)
    np.testing.assert_allclose(scan.intensity, 0.4 * cosine * cosine**2, rtol=1e-5)
    np.testing.assert_allclose(np.abs(scan.normal), np.broadcast_to([1, 0, 0], scan.normal.shape), atol=1e-6)
    assert (scan.instance_id == 0).all()
    assert (scan.geometry_id == 0).all()
    assert set(np.unique(scan.primitive_id)) == {0, 1}
    np.testing.assert_allclose(scan.radial_velocity, 0.0, atol=1e-7)


def test_sphere():
    """Points of a fine sphere, seen from a turned and shifted sensor, lie on it, and ranges follow."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=5, radius=2.0)
    scene = wrt.Scene(wrt.TriangleMesh.from_trimesh(ball), device="cpu")
    pose = np.array([[0.0, -1, 0, 3], [1, 0, 0, -8], [0, 0, 1, 0.5], [0, 0, 0, 1]])  # looks along +y
    pattern = LidarPattern(cone(0.15))
    scan = Lidar(pattern=pattern).scan(scene, pose)
    axis, origin = exact(pattern) @ pose[:3, :3].T, pose[:3, 3]
    half = axis @ origin
    root = half**2 - (origin @ origin - 4.0)
    assert np.isinf(scan.range)[root < -0.2].all()
    seen = root > 0.2
    np.testing.assert_allclose(scan.range[seen], -half[seen] - np.sqrt(root[seen]), atol=2e-2)
    np.testing.assert_allclose(np.linalg.norm(scan.position[seen], axis=-1), 2.0, atol=2e-3)
    np.testing.assert_allclose(scan.normal[seen], scan.position[seen] / 2.0, atol=0.05)
    np.testing.assert_allclose(scan.point[seen] @ pose[:3, :3].T + origin, scan.position[seen], atol=1e-12)


def test_misses():
    scan = Lidar(pattern=LidarPattern(-cone(0.3)), range_noise=1.0, angle_noise=0.1).scan(
        wrt.Scene(wall(10.0), device="cpu"), np.eye(4), seed=4
    )
    assert np.isinf(scan.range).all()
    assert np.isnan(scan.point).all()
    assert np.isnan(scan.position).all()
    assert np.isnan(scan.radial_velocity).all()
    assert (scan.intensity == 0).all()
    assert (scan.normal == 0).all()
    for ids in (scan.instance_id, scan.geometry_id, scan.primitive_id):
        assert (ids == -1).all()
    assert len(scan.to_structured()) == 0


def test_range_limits(head_on):
    """A surface that is too near blocks the beam: what is behind it is not seen either."""
    both = wrt.Scene([wall(1.0), wall(10.0)], device="cpu")
    lidar = Lidar(pattern=head_on["pattern"], min_range=2.0)
    assert np.isinf(lidar.scan(both, np.eye(4)).range).all()
    cosine = exact(head_on["pattern"])[..., 0]
    far = Lidar(pattern=head_on["pattern"], max_range=12.0).scan(head_on["scene"], np.eye(4)).range
    np.testing.assert_array_equal(np.isfinite(far), 10 / cosine <= 12.0)


def test_threshold_and_extinction(head_on):
    lidar = Lidar(pattern=head_on["pattern"], threshold=0.25, extinction=0.02, range_exponent=0.0)
    scan = lidar.scan(head_on["scene"], np.eye(4), reflectance=[0.7])
    cosine = exact(head_on["pattern"])[..., 0]
    expected = 0.7 * cosine * np.exp(-0.04 * 10 / cosine)
    np.testing.assert_array_equal(np.isfinite(scan.range), expected >= 0.25)
    found = np.isfinite(scan.range)
    assert 0 < found.mean() < 1
    np.testing.assert_allclose(scan.intensity[found], expected[found], rtol=1e-5)
    assert (scan.intensity[~found] == 0).all()


@pytest.mark.parametrize("form", [list, np.array])
def test_reflectance_by_instance(form):
    near, far = wall(5.0, 0.0, 100.0), wall(9.0, -100.0, 0.0)
    scene = wrt.Scene([wrt.Instance(near), wrt.Instance(far)], device="cpu")
    pattern = LidarPattern([[np.cos(a), np.sin(a), 0.1] / np.hypot(1, 0.1) for a in (0.1, 0.2, -0.1, -0.2)])
    scan = Lidar(pattern=pattern, range_exponent=0.0).scan(scene, np.eye(4), reflectance=form([0.2, 0.6]))
    np.testing.assert_array_equal(scan.instance_id, [0, 0, 1, 1])
    np.testing.assert_allclose(scan.intensity, [0.2, 0.2, 0.6, 0.6] * exact(pattern)[:, 0], rtol=1e-5)


STEP = {"divergence": 0.02, "bundle": 64, "returns": 2, "range_exponent": 0.0}


@pytest.mark.parametrize("keep", ["first", "last", "strongest"])
def test_two_returns_at_an_edge(keep):
    """A beam that an edge cuts returns from both walls, with the shares of its disk."""
    scene = wrt.Scene([wall(5.0, 0.03, 100.0), wall(8.0)], device="cpu")
    lidar = Lidar(pattern=LidarPattern([[1.0, 0, 0]]), keep=keep, **STEP)
    scan = lidar.scan(scene, np.eye(4))
    # the edge is at 0.03 of a disk of radius 0.05: a circular segment
    share = (np.arccos(0.6) - 0.6 * 0.8) / np.pi
    first, second = (0, 1) if keep == "first" else (1, 0)
    np.testing.assert_allclose(scan.range[0, [first, second]], [5.0, 8.0], rtol=2e-4)
    np.testing.assert_allclose(scan.intensity[0, [first, second]], [share, 1 - share], atol=0.03)
    np.testing.assert_allclose(scan.intensity.sum(), 1.0, atol=1e-3)
    np.testing.assert_array_equal(scan.instance_id[0, [first, second]], [0, 1])
    assert scan.shape == (1, 2)
    assert len(scan.to_structured()) == 2
    np.testing.assert_array_equal(np.sort(scan.to_structured()["return_number"]), [0, 1])


def test_range_resolution_joins_returns():
    """Two walls nearer to each other than the resolution are one return, at the mean range weighted by power."""
    scene = wrt.Scene([wall(5.0, 0.0, 100.0), wall(5.3)], device="cpu")
    scan = Lidar(pattern=LidarPattern([[1.0, 0, 0]]), range_resolution=0.4, **STEP).scan(scene, np.eye(4))
    assert 5.1 < scan.range[0, 0] < 5.2
    assert np.isinf(scan.range[0, 1])
    apart = Lidar(pattern=LidarPattern([[1.0, 0, 0]]), range_resolution=0.2, **STEP).scan(scene, np.eye(4))
    np.testing.assert_allclose(np.sort(apart.range[0]), [5.0, 5.3], rtol=2e-4)


def test_more_surfaces_than_returns():
    """Five steps, three returns kept: the nearest, the farthest, the strongest."""
    ranges = [5.0, 6.0, 7.0, 8.0, 9.0]
    scene = wrt.Scene([wall(r, low) for r, low in zip(ranges, (0.03, 0.015, 0.0, -0.02, -100.0), strict=True)], device="cpu")
    found = {}
    for keep in ("first", "last", "strongest"):
        options = {**STEP, "bundle": 200, "returns": 3}
        found[keep] = Lidar(pattern=LidarPattern([[1.0, 0, 0]]), keep=keep, **options).scan(scene, np.eye(4))
    everything = Lidar(pattern=LidarPattern([[1.0, 0, 0]]), keep="first", **{**STEP, "bundle": 200, "returns": 8})
    all_returns = everything.scan(scene, np.eye(4))
    count = int(np.isfinite(all_returns.range).sum())
    assert count == 5
    np.testing.assert_array_equal(found["first"].range[0], all_returns.range[0, :3])
    np.testing.assert_array_equal(found["last"].range[0], all_returns.range[0, count - 3 : count][::-1])
    strongest = np.sort(all_returns.intensity[0])[::-1][:3]
    np.testing.assert_array_equal(found["strongest"].intensity[0], strongest)


def test_bundle_of_one_beam_is_its_axis(head_on):
    one = Lidar(pattern=head_on["pattern"]).scan(head_on["scene"], np.eye(4))
    wide = Lidar(pattern=head_on["pattern"], bundle=16, divergence=0.0).scan(head_on["scene"], np.eye(4))
    np.testing.assert_allclose(wide.range, one.range, rtol=1e-6)
    np.testing.assert_allclose(wide.intensity, one.intensity, rtol=1e-5)


# -- noise -------------------------------------------------------------------------------------------------------------


def noisy_scan(seed, threads=None, **options):
    scene = wrt.Scene([wall(10.0, 0.0, 100.0)], device="cpu", num_threads=threads)
    grid = LidarPattern.raster(100, 200, horizontal=60, vertical=30)
    return Lidar(pattern=grid, **options).scan(scene, np.eye(4), seed=seed)


def test_range_noise():
    """Of the given deviation, normally distributed, and only on hits."""
    true, noisy = noisy_scan(None, range_noise=0.05), noisy_scan(7, range_noise=0.05)
    np.testing.assert_array_equal(np.isfinite(true.range), np.isfinite(noisy.range))
    hit = np.isfinite(true.range)
    error = (noisy.range[hit] - true.range[hit]) / 0.05
    assert len(error) > 9000
    assert abs(error.mean()) < 4 / np.sqrt(len(error))
    assert abs(error.std() - 1) < 0.03
    assert abs((np.abs(error) < 1).mean() - 0.6827) < 0.02
    along = np.linalg.norm(noisy.point, axis=-1)
    np.testing.assert_allclose(along[np.isfinite(along)], noisy.range[np.isfinite(along)], rtol=1e-6)


def test_angle_noise():
    """Moves the reported point across the beam, not the range."""
    true, noisy = noisy_scan(None, angle_noise=0.01), noisy_scan(7, angle_noise=0.01)
    np.testing.assert_array_equal(true.range, noisy.range)
    hit = np.isfinite(true.range)
    across = (noisy.point - true.point)[hit] / true.range[hit, None]
    assert abs(np.sqrt((across**2).sum(axis=1).mean()) - 0.01 * np.sqrt(2)) < 3e-4


def test_dropout():
    true, noisy = noisy_scan(None, dropout=0.3), noisy_scan(7, dropout=0.3)
    hit, left = np.isfinite(true.range), np.isfinite(noisy.range)
    assert not (left & ~hit).any()
    assert abs(left[hit].mean() - 0.7) < 0.02
    np.testing.assert_array_equal(noisy.range[left], true.range[left])
    assert (noisy.instance_id[~left] == -1).all()


def test_noise_depends_on_the_seed_only():
    options = {"range_noise": 0.05, "angle_noise": 0.01, "dropout": 0.1}
    one, other, third = noisy_scan(7, 1, **options), noisy_scan(7, 2, **options), noisy_scan(8, 1, **options)
    np.testing.assert_array_equal(one.point, other.point)
    assert not np.array_equal(one.point, third.point, equal_nan=True)
    large = noisy_scan(7 + (1 << 40), 1, **options)
    assert not np.array_equal(one.point, large.point, equal_nan=True)


# -- patterns ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LIDARS)
def test_presets(name, head_on):
    """Each scans; directions are unit vectors; the sheet's field of view and rate hold."""
    lidar = Lidar.preset(name)
    assert LIDARS[name].source
    assert LIDARS[name].description
    np.testing.assert_allclose(np.linalg.norm(lidar.pattern.directions, axis=-1), 1.0, atol=1e-6)
    elevation = np.degrees(np.arcsin(lidar.pattern.directions[..., 2]))
    low, high, duration = {
        "velodyne_vlp16": (-15, 15, 0.1),
        "velodyne_hdl32e": (-30.67, 10.67, 0.1),
        "ouster_os1_64": (-16.611, 16.611, 0.1),
        "ouster_os1_128": (-22.5, 22.5, 0.1),
        "robosense_m1": (-12.4, 12.4, 0.1),
        "livox_mid40": (-19.2, 19.2, 0.1),
    }[name]
    np.testing.assert_allclose([elevation.min(), elevation.max()], [low, high], atol=0.2)
    assert 0.98 * duration < lidar.pattern.duration <= duration
    scan = lidar.scan(head_on["scene"], np.eye(4))
    assert np.isfinite(scan.range).mean() > 0.1


def test_velodyne_order():
    """The table of the manual: laser 1 fires second, at 1 degree; the lowest laser is ring 0 and fires first."""
    pattern = Lidar.preset("velodyne_vlp16").pattern
    elevation = np.degrees(np.arcsin(pattern.directions[:, 0, 2]))
    np.testing.assert_allclose(elevation, np.arange(15, -16, -2), atol=1e-5)
    np.testing.assert_array_equal(pattern.rings[:, 0], np.arange(15, -1, -1))
    fired = np.argsort(pattern.times[:, 0])
    np.testing.assert_allclose(elevation[fired][:4], [-15, 1, -13, 3], atol=1e-5)
    table = [-30.67, -9.33, -29.33, -8.0, -28.0, -6.66, -26.66, -5.33]
    pattern = Lidar.preset("velodyne_hdl32e").pattern
    fired = np.argsort(pattern.times[:, 0])
    np.testing.assert_allclose(np.degrees(np.arcsin(pattern.directions[fired[:8], 0, 2])), table, atol=0.011)


def test_spinning_turns_while_it_fires():
    """A laser that fires a quarter of a turn later points a quarter further; clockwise, seen from above, is to the right."""
    pattern = LidarPattern.spinning([0.0, 0.0], 4, rate=1.0, firing_times=[0.0, 0.25], radius=0.5)
    np.testing.assert_allclose(pattern.directions[0], [[1, 0, 0], [0, -1, 0], [-1, 0, 0], [0, 1, 0]], atol=1e-6)
    np.testing.assert_allclose(pattern.directions[1, 0], [0, -1, 0], atol=1e-6)
    np.testing.assert_allclose(pattern.offsets, 0.5 * pattern.directions, atol=1e-6)
    left = LidarPattern.spinning([0.0], 4, rate=1.0, clockwise=False)
    np.testing.assert_allclose(left.directions[0, 1], [0, 1, 0], atol=1e-6)


def test_offsets_move_the_start(head_on):
    """Range counts from where the beam starts."""
    pattern = LidarPattern(cone(0.5), offsets=[1.0, 0.5, 0.0])
    scan = Lidar(pattern=pattern).scan(head_on["scene"], np.eye(4))
    np.testing.assert_allclose(scan.range, 9 / exact(pattern)[..., 0], rtol=1e-6)
    np.testing.assert_allclose(scan.point[0, 0], [10.0, 0.5, 0.0], atol=1e-5)


def test_rosette_does_not_repeat():
    first, second = (Lidar.preset("livox_mid40", frame=n).pattern for n in (0, 1))
    assert np.abs(first.directions - second.directions).max() > 0.1
    joined = Lidar.preset("livox_mid40", duration=0.2).pattern
    np.testing.assert_allclose(joined.directions, np.concatenate([first.directions, second.directions]), atol=1e-6)


def test_warp_arrays(device):
    """Warp arrays in, Warp arrays out, with the same values."""
    scene, directions = wrt.Scene(wall(10.0), device=device), cone(0.9).astype(np.float32)
    own = Lidar(pattern=LidarPattern(wp.array(directions, dtype=wp.vec3, device=device))).scan(scene, np.eye(4))
    expected = Lidar(pattern=LidarPattern(directions)).scan(scene, np.eye(4))
    for name in ("range", "intensity", "point", "position", "normal", "instance_id", "primitive_id", "radial_velocity"):
        values = getattr(own, name)
        assert isinstance(values, wp.array)
        assert str(values.device) == str(scene.device)
        np.testing.assert_array_equal(values.numpy(), getattr(expected, name))
    np.testing.assert_array_equal(own.to_structured(), expected.to_structured())


def test_a_lidar_that_has_scanned_is_pickled(head_on):
    """For workers of a cluster; what is kept for a device stays behind."""
    lidar = Lidar(pattern=head_on["pattern"])
    before = lidar.scan(head_on["scene"], np.eye(4)).range
    again = pickle.loads(pickle.dumps(lidar))
    np.testing.assert_array_equal(again.scan(head_on["scene"], np.eye(4)).range, before)


def test_mask():
    scene = wrt.Scene([wrt.Instance(wall(1.0), mask=1), wrt.Instance(wall(10.0), mask=2)], device="cpu")
    lidar = Lidar(pattern=LidarPattern([[1.0, 0, 0]]))
    assert lidar.scan(scene, np.eye(4)).range == pytest.approx(1.0)
    assert lidar.scan(scene, np.eye(4), mask=2).range == pytest.approx(10.0)


BEAM = LidarPattern([[1.0, 0, 0]])
WRONG = [
    (lambda: LidarPattern([[2.0, 0, 0]]), ValueError, "unit vectors"),
    (lambda: LidarPattern([1.0, 0, 0]), ValueError, "leading axis"),
    (lambda: LidarPattern([["a", "b", "c"]]), TypeError, "real numbers"),
    (lambda: LidarPattern([[1.0, 0, 0]], times=[0.0, 1.0]), ValueError, "does not broadcast"),
    (lambda: LidarPattern([[1.0, 0, np.nan]]), ValueError, "finite"),
    (lambda: LidarPattern.spinning([0.0], 0), ValueError, "columns"),
    (lambda: Lidar(pattern="vlp16"), TypeError, "LidarPattern"),
    (lambda: Lidar(pattern=BEAM, keep="best"), ValueError, "strongest, first, last"),
    (lambda: Lidar(pattern=BEAM, bundle=0), ValueError, "bundle"),
    (lambda: Lidar(pattern=BEAM, min_range=2.0, max_range=1.0), ValueError, "max_range"),
    (lambda: Lidar(pattern=BEAM, dropout=1.0), ValueError, "dropout"),
    (lambda: Lidar.preset("vlp"), ValueError, "velodyne_vlp16"),
    (lambda: noisy_scan(-1), ValueError, "seed"),
    (
        lambda: Lidar(pattern=BEAM).scan(wrt.scenes.build("teapot", level=1), np.eye(4)),
        TypeError,
        "scene must be a wrt.Scene .*not TriangleMesh; make a scene",
    ),
    (lambda: noisy_scan(0.5), TypeError, "seed"),
]


@pytest.mark.parametrize("case", range(len(WRONG)))
def test_wrong_arguments(case):
    call, error, message = WRONG[case]
    with pytest.raises(error, match=message):
        call()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pose": np.diag([2.0, 2, 2, 1])}, "scale"),
        ({"pose": np.eye(3)}, "shape"),
        ({"reflectance": [0.1, 0.2]}, "reflectance"),
        ({"reflectance": -1.0}, "negative"),
        ({"mask": [1, 2]}, "mask"),
        ({"slices": 0, "motions": {0: 1}}, "instances"),
    ],
)
def test_wrong_scans(head_on, options, message):
    with pytest.raises(ValueError, match=message):
        Lidar(pattern=BEAM).scan(head_on["scene"], options.pop("pose", np.eye(4)), **options)


def test_presets_have_the_angles_of_their_manuals():
    """In the order of firings, to a hundredth of a degree; and the maker's default angles, to a thousandth."""
    pattern = Lidar.preset("velodyne_hdl32e").pattern
    fired = np.argsort(pattern.times[:, 0])
    elevations = np.degrees(np.arcsin(pattern.directions[fired, 0, 2]))
    manual = [
        -30.67,
        -9.33,
        -29.33,
        -8.00,
        -28.00,
        -6.66,
        -26.66,
        -5.33,
        -25.33,
        -4.00,
        -24.00,
        -2.67,
        -22.67,
        -1.33,
        -21.33,
        0.0,
    ]
    manual += [-20.0, 1.33, -18.67, 2.67, -17.33, 4.0, -16.0, 5.33, -14.67, 6.67, -13.33, 8.0, -12.0, 9.33, -10.67, 10.67]
    np.testing.assert_allclose(elevations, manual, atol=0.011)
    pattern = Lidar.preset("ouster_os1_64").pattern
    elevations = np.degrees(np.arcsin(pattern.directions[:, 0, 2]))
    np.testing.assert_allclose(elevations[:6], [16.611, 16.084, 15.557, 15.029, 14.502, 13.975], atol=1e-3)
    np.testing.assert_allclose(elevations[31:33], [0.264, -0.264], atol=1e-3)

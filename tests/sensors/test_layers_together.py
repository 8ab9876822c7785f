"""Layers that are made at once have the bits of those that are made one by one, and none is made that was not asked for."""

from __future__ import annotations

import numpy as np
import pytest
from support.sensed_scenes import wall

import wrt
from wrt.sensors import BrownConrady, Camera, Lidar, LidarPattern, Trajectory, look_at

ALL = ("range", "intensity", "point", "position", "instance_id", "geometry_id", "primitive_id", "semantic_id", "normal")
PATTERN = LidarPattern.raster(13, 41, horizontal=100, vertical=60)
POSE = np.eye(4)
POSE[:3, 3] = 0.0, 0.2, 0.1
LIDARS = {
    "whatever returns": Lidar(pattern=PATTERN, min_range=4.0, max_range=9.0),
    "with a threshold": Lidar(pattern=PATTERN, threshold=0.7, range_exponent=1.0, extinction=0.01),
    "noisy": Lidar(pattern=PATTERN, range_noise=0.02, angle_noise=0.001, dropout=0.2),
    "with lost returns": Lidar(pattern=PATTERN, dropout=0.5),
    "bundles": Lidar(pattern=PATTERN, bundle=3, divergence=0.02, returns=2),
}
PATHS = {"still": POSE, "moving": Trajectory([0.0, 0.2], [[0, 0, 0], [0.5, 0, 0]]), "many": np.stack([POSE, np.eye(4)])}
VIEWS = {
    "still": look_at([0, 0, 0], [1, 0.1, 0]),
    "moving": Trajectory([0.0, 0.2], [[0, 0, 0], [0, 0, 0.5]], [[0.5, 0.5, 0.5, 0.5], [0.5, 0.5, 0.5, 0.6]]),
    "many": np.stack([look_at([0, 0, 0], [1, 0.1, 0]), look_at([0, 1, 0], [1, 0.2, 0])]),
}
IMAGES = ("distance", "depth", "position", "normal", "camera_normal", *ALL[4:8])


@pytest.fixture(scope="module")
def scene():
    """Instances of two meshes, in no order of depth, and gaps between them."""
    far, near = wall(9.0, -3.0, 3.0), wall(6.0, -0.5, 0.5)
    moved = np.tile(np.eye(4), (3, 1, 1))
    moved[:, 1, 3] = -2.0, 0.3, 2.5
    instances = [wrt.Instance(near, moved[0]), wrt.Instance(far), *(wrt.Instance(near, at) for at in moved[1:])]
    return wrt.Scene(instances, device="cpu")


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("lidar", LIDARS)
def test_layers_of_scans(scene, lidar, path):
    """Those of one kernel are those that are read one by one, in the opposite order, too."""
    options = {"labels": [4, 7, 1, 0], "reflectance": [0.3, 0.8, 0.5, 1.0], "seed": 5}
    scan = lambda **more: LIDARS[lidar].scan(scene, PATHS[path], **options, **more)  # noqa: E731
    together, others, backwards = scan(layers=ALL), scan(), scan()
    assert 0.05 < np.isfinite(together.range).mean() < 0.9
    expected = {name: getattr(together, name) for name in ALL}
    for name in ALL:
        for found in (getattr(others, name), getattr(scan(layers=(name,)), name)):
            np.testing.assert_array_equal(found, expected[name], err_msg=name)
    for name in reversed(ALL):
        np.testing.assert_array_equal(getattr(backwards, name), expected[name], err_msg=name)


@pytest.mark.parametrize("layers", [None, ALL, ("range", "normal")])
@pytest.mark.parametrize("lidar", LIDARS)
def test_ranges_that_callers_change(scene, lidar, layers):
    """Layers that are read later are those of the scan."""
    scan = lambda: LIDARS[lidar].scan(scene, POSE, seed=5, layers=layers)  # noqa: E731
    expected, changed = scan(), scan()
    changed.range[:] = np.inf
    for name in layers or ALL:
        if name != "range":
            np.testing.assert_array_equal(getattr(changed, name), getattr(expected, name), err_msg=name)
    assert np.isinf(changed.range).all()


def test_ids_of_scans_are_those_of_their_rays(scene):
    lidar = LIDARS["whatever returns"].replace(min_range=0.0, max_range=np.inf)
    scan, hits = lidar.scan(scene, np.eye(4), labels=[4, 7, 1, 0]), scene.intersect([0.0, 0.0, 0.0], PATTERN.directions)
    assert set(np.unique(hits.instance_id)) == {-1, 0, 1, 2, 3}
    for name in ("instance_id", "geometry_id", "primitive_id"):
        np.testing.assert_array_equal(getattr(scan, name), getattr(hits, name))
    np.testing.assert_array_equal(scan.semantic_id, np.append([4, 7, 1, 0], -1)[hits.instance_id])


def test_ranges_alone_need_no_surface(scene):
    """Nor intensities, unless a threshold does; intensities that are read later leave given ranges as they are."""
    lidar, options = LIDARS["whatever returns"], {"reflectance": [0.3, 0.8, 0.5, 1.0]}
    scan = lidar.scan(scene, POSE, **options)
    expected = scan.range.copy()
    assert set(scan._layers.arrays) == {"range"}
    assert scan._layers._measured.__ctype__().intensity.shape[0] == 0
    scan.range[:] = 1.0
    both = lidar.scan(scene, POSE, **options, layers=("range", "intensity"))
    np.testing.assert_array_equal(both.range, expected)
    np.testing.assert_array_equal(scan.intensity, both.intensity)
    assert (scan.range == 1.0).all()
    np.testing.assert_array_equal(scan.position, lidar.scan(scene, POSE).position)  # by the measured ranges, not the changed
    weak = LIDARS["with a threshold"].scan(scene, POSE, **options)
    assert 0 < np.isfinite(weak.range).sum() < (scan.instance_id >= 0).sum()
    assert set(weak._layers.arrays) == {"range", "intensity"}


def test_labels_are_read_anew(scene):
    """Kept ones are those of equal labels, not of the same array."""
    labels, lidar = np.array([4, 7, 1, 0]), LIDARS["whatever returns"]
    before = lidar.scan(scene, POSE, labels=labels).semantic_id
    labels[:] = 2
    after = lidar.scan(scene, POSE, labels=labels).semantic_id
    np.testing.assert_array_equal(after, np.where(before < 0, -1, 2))
    with pytest.raises(ValueError, match="labels must be 4 numbers"):
        lidar.scan(scene, POSE, labels=labels[:3])
    with pytest.raises(TypeError, match="labels must hold integers"):
        lidar.scan(scene, POSE, labels=labels.astype(np.float64))


@pytest.mark.parametrize("view", VIEWS)
def test_layers_of_images(scene, view):
    camera = Camera(37, 23, BrownConrady(15, 15, 18, 11), line_delay=1e-4)
    image = lambda **more: camera.capture(scene, VIEWS[view], labels=[4, 7, 1, 0], **more)  # noqa: E731
    together, others = image(layers=IMAGES), image()
    assert 0.2 < np.isfinite(together.depth).mean() < 0.95
    for name in IMAGES:
        np.testing.assert_array_equal(getattr(others, name), getattr(together, name), err_msg=name)
    one = image()
    _ = one.depth
    assert set(one._layers.arrays) == {"depth"}


def test_tables_make_their_columns_at_once(scene):
    scan = LIDARS["noisy"].scan(scene, PATHS["many"], labels=[4, 7, 1, 0], seed=5)
    table = scan.to_structured("world")
    assert set(scan._layers.arrays) == {"range", "intensity", "position", "instance", "semantic"}
    other = LIDARS["noisy"].scan(scene, PATHS["many"], labels=[4, 7, 1, 0], seed=5)
    seen = other.instance_id >= 0
    np.testing.assert_array_equal(np.stack([table[name] for name in "xyz"], axis=-1), other.position[seen])
    for name in ("intensity", "instance_id", "semantic_id"):
        np.testing.assert_array_equal(table[name], getattr(other, name)[seen])
    np.testing.assert_array_equal(table["ring"], np.broadcast_to(PATTERN.rings, other.shape)[seen])

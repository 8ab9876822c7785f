"""What narrower fields do to numbers: nothing, or an error that names field, number and range. Rings wrapped before."""

from __future__ import annotations

import numpy as np
import pytest
from support.sensed_scenes import wall

import wrt
from wrt.sensors import POINT_TYPE, BrownConrady, Camera, Lidar, LidarPattern, look_at, write_bag, write_points
from wrt.sensors.checks import as_integers

AHEAD = np.array([[1.0, 0.0, 0.0], [0.8, 0.6, 0.0]])


@pytest.fixture(scope="module")
def scene():
    return wrt.Scene(wall(10.0), device="cpu")


def scan_of(scene, rings=None, times=None, **options):
    return Lidar(pattern=LidarPattern(AHEAD, times, rings)).scan(scene, np.eye(4), **options)


def table_with(**fields):
    """Two points with further fields."""
    table = np.zeros(2, dtype=[*[(axis, "f8") for axis in "xyz"], *[(name, values.dtype) for name, values in fields.items()]])
    for name, values in fields.items():
        table[name] = values
    return table


@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int32, np.uint32, np.int64, np.uint64])
@pytest.mark.parametrize("given", [np.float16, np.float32, np.float64, np.int64, np.uint64, bool])
def test_integers_fit_or_are_named(dtype, given):
    """Also at the ends of a range, which float32 rounds to a number beyond it."""
    limits = np.iinfo(dtype)
    for number in (0, 1):
        assert as_integers("numbers", np.array([number], dtype=given), dtype).tolist() == [number]
    if given is bool:
        return
    wide = [float(limits.max) + 1.0, 2.0 * float(limits.max) + 2.0, -1.0 if limits.min == 0 else 2.0 * float(limits.min)]
    for number in [*wide, 0.5, np.nan, np.inf, -np.inf]:
        with np.errstate(over="ignore", invalid="ignore"):
            array = np.array([0, number], dtype=np.float64).astype(given)
        if given in (np.int64, np.uint64) and float(array[1]) != number:
            continue
        with pytest.raises(ValueError, match=r"numbers holds .*; it must hold whole numbers from "):
            as_integers("numbers", array, dtype)


@pytest.mark.parametrize("rings", [[0, 2**40], [0, -(2**31) - 1], [0.0, 0.5], np.array([0, 2**63], dtype=np.uint64)])
def test_rings_of_a_pattern_do_not_wrap(rings):
    """2^40 was -2147483648, and 0.5 was 0."""
    with pytest.raises(ValueError, match="rings holds"):
        LidarPattern(AHEAD, rings=rings)


def test_tables_have_wider_fields_where_they_are_needed(scene):
    """Ring 70000 was 4464 in every table."""
    assert scan_of(scene, [0, 65535]).to_structured().dtype == POINT_TYPE
    for rings in ([3, 70000], [-2, 5]):
        table = scan_of(scene, rings).to_structured()
        assert table["ring"].tolist() == rings
    times = np.array([1e-3, 1.7e9 + 1e-3])
    table = scan_of(scene, times=times).to_structured()
    np.testing.assert_array_equal(table["time"], times)
    assert scan_of(scene, times=[0.0, 0.1]).to_structured()["time"].dtype == np.float32


@pytest.mark.parametrize(
    ("name", "values", "wanted"),
    [
        ("ring", np.array([3, 70000], np.int32), "70000.* from 0 to 65535"),
        ("ring", np.array([-1, 0], np.int16), "-1.* from 0 to 65535"),
        ("intensity", np.array([0.5, -0.5], np.float32), "-0.5.* 0 or more"),
        ("intensity", np.array([0.5, np.nan]), "nan.* 0 or more"),
        ("return_number", np.array([0, 15], np.uint8), "15.* from 0 to 14"),
        ("return_number", np.array([0, 255], np.uint8), "255.* from 0 to 14"),
        ("classification", np.array([2, 300], np.int32), "300.* from 0 to 255"),
        ("scanner_channel", np.array([2, 4], np.uint8), "4.* from 0 to 3"),
        ("a" * 33, np.array([2, 3]), "at most 32"),
        ("time", np.array([1.0, 2.0]), "gps_time"),
    ],
    ids=lambda value: value if isinstance(value, str) and value.isidentifier() and len(value) < 20 else "",
)
def test_las_fields_do_not_wrap(tmp_path, name, values, wanted):
    """Nothing is written, and an older file stays."""
    pytest.importorskip("laspy", reason='laspy is not installed: pip install "wrt[sensors]"')
    (tmp_path / "scan.las").write_bytes(b"old")
    fields = {name: values} | ({"gps_time": values} if name == "time" else {})
    with pytest.raises(ValueError, match=f"(?s){name}.*{wanted}"):
        write_points(tmp_path / "scan.las", table_with(**fields))
    assert (tmp_path / "scan.las").read_bytes() == b"old"


def test_las_saturates_as_detectors_do(tmp_path):
    """A preset gives intensities above 1 nearer than its reference range; they were clipped without a word."""
    laspy = pytest.importorskip("laspy", reason='laspy is not installed: pip install "wrt[sensors]"')
    with pytest.warns(UserWarning, match=r"1 of 2 intensities are above 1, up to 1\.5"):
        write_points(tmp_path / "scan.las", table_with(intensity=np.array([0.5, 1.5], np.float32)))
    assert np.asarray(laspy.read(tmp_path / "scan.las").intensity).tolist() == [32768, 65535]


def test_las_keeps_what_fits(tmp_path):
    """Fields of LAS under their names, booleans and large integers as extra bytes."""
    laspy = pytest.importorskip("laspy", reason='laspy is not installed: pip install "wrt[sensors]"')
    fields = {
        "classification": np.array([2, 255]),
        "scanner_channel": np.array([0, 3]),
        "return_number": np.array([0, 14]),
        "label": np.array([-(2**40), 2**40]),
        "seen": np.array([True, False]),
        "half": np.array([0.5, 2.0], np.float16),
    }
    write_points(tmp_path / "scan.las", table_with(**fields))
    read = laspy.read(tmp_path / "scan.las")
    for name, values in fields.items():
        assert np.asarray(read[name]).tolist() == [value + (name == "return_number") for value in values.tolist()], name


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
def test_integers_of_64_bits_become_32_if_they_fit(tmp_path, suffix):
    if suffix == ".pcd":
        pytest.importorskip("pypcd4", reason='pypcd4 is not installed: pip install "wrt[sensors]"')
    write_points(tmp_path / f"a{suffix}", table_with(label=np.array([-5, 2**31 - 1]), seen=np.array([True, False])))
    if suffix == ".ply":
        header, rows = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")
        assert header.endswith(b"property double z\nproperty int label\nproperty uchar seen\n")
        found = np.frombuffer(rows, dtype=[("xyz", "<f8", 3), ("label", "<i4"), ("seen", "u1")])
        assert found["label"].tolist() == [-5, 2**31 - 1]
        assert found["seen"].tolist() == [1, 0]
    with pytest.raises(ValueError, match=r"points\['label'\] holds 2147483648; .* from -2147483648 to 2147483647 in P"):
        write_points(tmp_path / f"b{suffix}", table_with(label=np.array([0, 2**31])))
    with pytest.raises(ValueError, match="name 'scan angle'"):
        write_points(tmp_path / f"b{suffix}", table_with(**{"scan angle": np.array([0, 1])}))
    assert not (tmp_path / f"b{suffix}").exists()


def test_a_topic_of_a_bag_has_one_kind(scene, tmp_path):
    """Scans and images in one topic made a bag that no reader could read; stamps wrapped, and images of many cameras failed in
    the middle of the bag."""
    pytest.importorskip("rosbags", reason='rosbags is not installed: pip install "wrt[sensors]"')
    camera, pose = Camera(12, 8, BrownConrady(20.0, 20.0, 5.5, 3.5)), look_at([0, 0, 0], [1, 0, 0])
    image, scan = camera.capture(scene, pose), scan_of(scene)
    both = {"/a": [scan, image]}
    late, early = scan_of(scene, time=2.0**31), scan_of(scene, time=-1.0)
    many = camera.capture(scene, np.stack([pose, pose]))
    for topics, frames, wanted in (
        (both, None, "'?/a'? holds scans and images"),
        ({"/a": [late]}, None, "/a holds a measurement at 2147483648.0 s"),
        ({"/a": [early]}, None, "/a holds a measurement at -1.0 s"),
        ({"/a": [many]}, None, r"/a holds a measurement of \(2,\) sensors"),
        ({"/a": [scan]}, {"/b": "lidar"}, "frames has '/b'"),
    ):
        with pytest.raises(ValueError, match=wanted):
            write_bag(tmp_path / "bag", topics, frames)
    assert not list(tmp_path.iterdir())


def test_stamps_are_right_to_the_nanosecond(scene, tmp_path):
    """1e9 times a time of today is beyond what float64 counts one by one."""
    pytest.importorskip("rosbags", reason='rosbags is not installed: pip install "wrt[sensors]"')
    from rosbags.rosbag2 import Reader

    start = 1.7e9 + 0.123
    write_bag(tmp_path / "bag", {"/points": [scan_of(scene, time=start), scan_of(scene, time=1e-9)]})
    with Reader(tmp_path / "bag") as reader:
        stamps = [stamp for _, stamp, _ in reader.messages()]
    exact = [1, 1_700_000_000 * 10**9 + round((start - 1_700_000_000) * 1e9)]
    assert stamps == exact
    assert exact[1] != round(1e9 * start)


def test_laz(scene, tmp_path, monkeypatch):
    """The extra brings what compresses; without it, the error was laspy's and named neither package nor extra."""
    laspy = pytest.importorskip("laspy", reason='laspy is not installed: pip install "wrt[sensors]"')
    table = scan_of(scene, reflectance=0.5).to_structured()
    if laspy.LazBackend.detect_available():
        write_points(tmp_path / "scan.laz", table)
        np.testing.assert_allclose(laspy.read(tmp_path / "scan.laz").x, table["x"], atol=1e-4)
    monkeypatch.setattr(laspy.LazBackend, "detect_available", classmethod(lambda cls: ()))
    monkeypatch.setitem(__import__("sys").modules, "lazrs", None)
    with pytest.raises(ImportError, match=r'LAZ files need lazrs: pip install "wrt\[sensors\]"'):
        write_points(tmp_path / "other.laz", table)
    assert not (tmp_path / "other.laz").exists()


def test_labels_and_organized_tables():
    """Labels are a column of tables; an organized table has the shape of the scan."""
    scene = wrt.Scene([wrt.Instance(wall(10.0, -100.0, 3.0)), wrt.Instance(wall(6.0, 0.0, 50.0))], device="cpu")
    lidar = Lidar(pattern=LidarPattern.raster(12, 40, horizontal=90, vertical=30), bundle=2, divergence=0.2, returns=2)
    scan = lidar.scan(scene, np.eye(4), labels=[4, 7])
    np.testing.assert_array_equal(scan.semantic_id, np.array([4, 7, -1])[scan.instance_id])
    table, every = scan.to_structured("world"), scan.to_structured("world", organized=True)
    assert every.shape == scan.shape == (12, 40, 2)
    seen = scan.instance_id >= 0
    assert 0.1 < seen.mean() < 0.9
    np.testing.assert_array_equal(table, every[seen])  # the order of a raster is that of time
    np.testing.assert_array_equal(table["semantic_id"], scan.semantic_id[seen])
    np.testing.assert_array_equal(np.stack([every[name] for name in "xyz"], axis=-1), scan.position)
    np.testing.assert_array_equal(every["return_number"], np.broadcast_to([0, 1], scan.shape))
    np.testing.assert_array_equal(every["ring"], np.broadcast_to(np.arange(12)[:, None, None], scan.shape))
    assert "semantic_id" not in lidar.scan(scene, np.eye(4)).to_structured().dtype.names
    with pytest.raises(TypeError, match="organized"):
        scan.to_structured(organized="yes")


def test_chosen_layers_as_warp_arrays():
    """Scans stay on the device on request, and make no layer that was not asked for."""
    scene = wrt.Scene([wrt.Instance(wall(10.0, -100.0, 3.0)), wrt.Instance(wall(6.0, 0.0, 50.0))], device="cpu")
    lidar = Lidar(pattern=LidarPattern.raster(12, 40, horizontal=90, vertical=30))
    pose, expected = look_at([0, 0, 0], [1, 0.1, 0]), lidar.scan(scene, look_at([0, 0, 0], [1, 0.1, 0]), labels=[4, 7])
    scan = lidar.scan(scene, pose, labels=[4, 7], layers=("position", "semantic_id"), to_warp=True)
    assert set(scan._layers.arrays) == {"range", "position", "semantic"}  # the first is of the measurement
    np.testing.assert_array_equal(scan.position.numpy(), expected.position)
    np.testing.assert_array_equal(scan.semantic_id.numpy(), expected.semantic_id)
    for name in ("range", "normal"):
        with pytest.raises(ValueError, match=f"{name} is none of the layers that were chosen"):
            getattr(scan, name)
    with pytest.raises(ValueError, match="layers"):
        lidar.scan(scene, pose, layers=("depth",))
    with pytest.raises(TypeError, match="to_warp"):
        lidar.scan(scene, pose, to_warp="yes")
    table = lidar.scan(scene, pose, labels=[4, 7], to_warp=True).to_structured("world")
    np.testing.assert_array_equal(table, expected.to_structured("world"))


def test_organized_clouds(tmp_path):
    """PCD files have rows and columns, and NaN for misses; other formats have neither."""
    scene = wrt.Scene(wall(6.0, 0.0, 50.0), device="cpu")
    lidar = Lidar(pattern=LidarPattern.raster(12, 40, horizontal=90, vertical=30))
    table = lidar.scan(scene, np.eye(4)).to_structured(organized=True)
    wrt.sensors.write_points(tmp_path / "scan.pcd", table)
    header, body = (tmp_path / "scan.pcd").read_bytes().split(b"DATA binary\n")
    assert b"WIDTH 40\nHEIGHT 12\n" in header
    assert b"POINTS 480\n" in header
    found = np.frombuffer(body, dtype=table.dtype).reshape(12, 40)
    assert 0.1 < np.isnan(found["x"]).mean() < 0.9
    assert found.tobytes() == table.tobytes()
    with pytest.raises(TypeError, match="PCD"):
        wrt.sensors.write_points(tmp_path / "scan.ply", table)


def test_open3d_reads_all_fields(tmp_path):
    """Also rings, which are uint16."""
    io = pytest.importorskip("open3d", reason="Open3D is not installed: pip install open3d").t.io
    table = np.zeros(5, dtype=wrt.sensors.POINT_TYPE)
    table["ring"], table["x"] = [0, 1, 40000, 65535, 7], np.arange(5)
    for suffix in ("ply", "pcd"):
        wrt.sensors.write_points(tmp_path / f"scan.{suffix}", table)
        cloud = io.read_point_cloud(str(tmp_path / f"scan.{suffix}"))
        np.testing.assert_array_equal(cloud.point["ring"].numpy().ravel(), table["ring"])
        np.testing.assert_array_equal(cloud.point.positions.numpy()[:, 0], table["x"])

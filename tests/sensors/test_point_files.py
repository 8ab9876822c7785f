"""Files of points: written, and read back by others."""

from __future__ import annotations

import numpy as np
import pytest
from support.sensed_scenes import wall

import wrt
from wrt.sensors import POINT_TYPE, BrownConrady, Camera, Lidar, look_at, write_bag, write_points


@pytest.fixture(scope="module")
def scan():
    scene = wrt.Scene(wall(10.0), device="cpu")
    return Lidar.preset("velodyne_vlp16").scan(scene, np.eye(4), time=3.25, seed=1, reflectance=0.5)


@pytest.fixture(scope="module")
def table(scan):
    points = scan.to_structured()
    assert points.dtype == POINT_TYPE
    assert len(points) > 10_000
    return points


def test_ply(table, tmp_path):
    """Read by trimesh, all fields."""
    import trimesh

    write_points(tmp_path / "scan.ply", table)
    cloud = trimesh.load(tmp_path / "scan.ply")
    np.testing.assert_array_equal(cloud.vertices, np.stack([table[axis] for axis in "xyz"], axis=1))
    raw = cloud.metadata["_ply_raw"]["vertex"]["data"]
    for name in table.dtype.names:
        np.testing.assert_array_equal(np.asarray(raw[name]).ravel(), table[name])


def test_kitti(table, tmp_path):
    write_points(tmp_path / "000000.bin", table)
    rows = np.fromfile(tmp_path / "000000.bin", dtype=np.float32).reshape(-1, 4)
    np.testing.assert_array_equal(rows, np.stack([table[name] for name in ("x", "y", "z", "intensity")], axis=1))


def test_pcd(table, tmp_path):
    pypcd4 = pytest.importorskip("pypcd4", reason="pypcd4 is not installed: pip install pypcd4")
    write_points(tmp_path / "scan.pcd", table)
    cloud = pypcd4.PointCloud.from_path(tmp_path / "scan.pcd")
    assert tuple(cloud.fields) == table.dtype.names
    for name in table.dtype.names:
        np.testing.assert_array_equal(cloud.pc_data[name].ravel(), table[name])


def test_las(table, tmp_path):
    laspy = pytest.importorskip("laspy", reason='laspy is not installed: pip install "wrt[sensors]"')
    write_points(tmp_path / "scan.las", table)
    read = laspy.read(tmp_path / "scan.las")
    for axis in "xyz":
        np.testing.assert_allclose(np.asarray(read[axis]), table[axis], atol=0.51e-4)
    np.testing.assert_allclose(np.asarray(read.intensity) / 65535, table["intensity"], atol=1e-5)
    np.testing.assert_array_equal(np.asarray(read.point_source_id), table["ring"])
    np.testing.assert_array_equal(np.asarray(read.gps_time), table["time"])
    np.testing.assert_array_equal(np.asarray(read.return_number), table["return_number"] + 1)
    np.testing.assert_array_equal(np.asarray(read["instance_id"]), table["instance_id"])


def test_ros_bag(scan, table, tmp_path):
    """The reader of rosbags gives back the bytes of the table, and the depth image."""
    pytest.importorskip("rosbags", reason='rosbags is not installed: pip install "wrt[sensors]"')
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    scene = wrt.Scene(wall(10.0), device="cpu")
    camera = Camera(12, 8, BrownConrady(20.0, 20.0, 5.5, 3.5))
    images = [camera.capture(scene, look_at([0, 0, 0], [1, 0, 0]), time=t) for t in (4.0, 1.0)]
    write_bag(tmp_path / "bag", {"/points": [scan], "/depth": images}, {"/depth": "front"})
    store, seen = get_typestore(Stores.ROS2_HUMBLE), []
    with Reader(tmp_path / "bag") as reader:
        for connection, stamp, raw in reader.messages():
            message = store.deserialize_cdr(raw, connection.msgtype)
            seen.append((connection.topic, stamp))
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp
            if connection.topic == "/points":
                np.testing.assert_array_equal(np.frombuffer(message.data.tobytes(), dtype=POINT_TYPE), table)
                assert [(f.name, f.offset) for f in message.fields] == [(n, POINT_TYPE.fields[n][1]) for n in POINT_TYPE.names]
                assert (message.width, message.height, message.header.frame_id) == (len(table), 1, "lidar")
            else:
                assert (message.encoding, message.header.frame_id) == ("32FC1", "front")
                depth = np.frombuffer(message.data.tobytes(), dtype="<f4").reshape(message.height, message.width)
                np.testing.assert_array_equal(depth, images[0].depth)
    assert seen == [("/depth", 10**9), ("/points", 3_250_000_000), ("/depth", 4 * 10**9)]


def test_frames(scan):
    """The world's and the sensor's coordinates; unknown names are refused."""
    world = scan.to_structured("world")
    np.testing.assert_array_equal(world.astype(POINT_TYPE), scan.to_structured())  # a sensor at the origin
    assert {str(world.dtype[axis]) for axis in "xyz"} == {"float64"}
    with pytest.raises(ValueError, match="sensor, world, start"):
        scan.to_structured("map")


UTM = np.array([500_000.125, 5_400_000.25, 200.5])


@pytest.fixture(scope="module")
def far():
    """A scan in UTM coordinates, as a table, and the same points in float64."""
    mesh = wrt.TriangleMesh(wall(10.0).vertices + UTM, wall(10.0).faces)
    pose = np.eye(4)
    pose[:3, 3] = UTM
    scan = Lidar.preset("velodyne_vlp16").scan(wrt.Scene(mesh, device="cpu"), pose, reflectance=0.5)
    table = scan.to_structured("world")
    exact = (scan.position - UTM)[np.isfinite(scan.range)]
    assert np.abs(exact[:, 0] - 10.0).max() < 1e-4
    return scan, table, np.sort(exact[:, 1])


def apart(coordinates, exact) -> float:
    """The largest error of y coordinates in the world, in any order."""
    assert np.asarray(coordinates).dtype == np.float64
    return np.abs(np.sort(np.asarray(coordinates) - UTM[1]) - exact).max()


def test_tables_and_files_in_utm_coordinates(far, tmp_path):
    """Tables held float32, whose steps are half a metre there; so PLY and LAS files had points in stripes."""
    import trimesh

    (scan, table, exact), of_sensor = far, far[0].to_structured()
    assert apart(table["y"], exact) < 1e-8
    write_points(tmp_path / "scan.ply", table)
    assert apart(trimesh.load(tmp_path / "scan.ply").vertices[:, 1], exact) < 1e-8
    assert of_sensor["y"].dtype == scan.to_structured("start")["y"].dtype == np.float32
    assert apart(of_sensor["y"].astype(np.float64) + UTM[1], exact) < 1e-4
    with pytest.raises(ValueError, match=r"float32 of KITTI's .bin files would move by 0\.\d+"):
        write_points(tmp_path / "scan.bin", table)
    assert not (tmp_path / "scan.bin").exists()


def test_pcd_in_utm_coordinates(far, tmp_path):
    pypcd4 = pytest.importorskip("pypcd4", reason="pypcd4 is not installed: pip install pypcd4")
    write_points(tmp_path / "scan.pcd", far[1])
    assert apart(pypcd4.PointCloud.from_path(tmp_path / "scan.pcd").pc_data["y"].ravel(), far[2]) < 1e-8


@pytest.mark.parametrize(("size", "step"), [(1.0, 1e-4), (1e-4, 1e-6), (1e4, 1e-3)])
def test_las_steps_follow_from_the_data(far, tmp_path, size, step):
    """0.1 mm for a scan of metres; a coin keeps its relief, and a country fits."""
    laspy = pytest.importorskip("laspy", reason='laspy is not installed: pip install "wrt[sensors]"')
    table = far[1].copy()
    for axis, place in zip("xyz", UTM, strict=True):
        table[axis] = place + size * (table[axis] - place)
    write_points(tmp_path / "scan.las", table)
    read = laspy.read(tmp_path / "scan.las")
    np.testing.assert_allclose(read.header.scales, step, rtol=1e-9)
    assert apart(read.y, size * far[2]) < 0.51 * step + 2e-9
    table["x"][0] = UTM[0] + 1e7
    with pytest.raises(ValueError, match="too far for LAS"):
        write_points(tmp_path / "other.las", table)
    table["x"][0] = np.nan
    with pytest.raises(ValueError, match="x = nan"):
        write_points(tmp_path / "other.las", table)


def test_camera_positions_in_utm_coordinates():
    mesh = wrt.TriangleMesh(wall(10.0).vertices + UTM, wall(10.0).faces)
    camera = Camera(12, 8, BrownConrady(20.0, 20.0, 5.5, 3.5))
    images = camera.capture(wrt.Scene(mesh, device="cpu"), look_at(UTM, UTM + np.array([1.0, 0.0, 0.0])))
    assert images.position.dtype == np.float64
    assert np.abs(images.position[..., 0] - UTM[0] - 10.0).max() < 1e-4


def test_wrong_files(table, tmp_path):
    with pytest.raises(ValueError, match=r"\.ply, \.bin, \.pcd"):
        write_points(tmp_path / "scan.txt", table)
    with pytest.raises(ValueError, match="masked values"):
        write_points(tmp_path / "scan.ply", np.ma.masked_array(table, mask=np.arange(len(table)) == 0))
    with pytest.raises(TypeError, match="to_structured"):
        write_points(tmp_path / "scan.ply", np.zeros((5, 3)))
    with pytest.raises(ValueError, match="'x' of type"):
        write_points(tmp_path / "scan.ply", np.zeros(5, dtype=[("x", "c8"), ("y", "f4"), ("z", "f4")]))


@pytest.mark.parametrize(("suffix", "name"), [(".las", "laspy"), (".laz", "laspy")])
def test_a_missing_library_is_named(table, tmp_path, monkeypatch, suffix, name):
    monkeypatch.setitem(__import__("sys").modules, name, None)
    with pytest.raises(ImportError, match=rf'need {name}: pip install "wrt\[sensors\]"'):
        write_points(tmp_path / f"scan{suffix}", table)

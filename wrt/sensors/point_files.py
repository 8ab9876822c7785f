"""Tables of points and scans in files: PLY and KITTI's .bin here, PCD, LAS and ROS 2 bags by libraries.

`pip install "wrt[sensors]"` installs the libraries: pypcd4 (PCD), laspy (LAS, LAZ) and rosbags (ROS 2 bags).
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.sensors.image_sensor import CameraImages
from wrt.sensors.lidar_scan import LidarScan
from wrt.tables import lookup

if TYPE_CHECKING:
    from types import ModuleType

PLY_TYPES = {
    "f4": "float",
    "f8": "double",
    "i1": "char",
    "u1": "uchar",
    "i2": "short",
    "u2": "ushort",
    "i4": "int",
    "u4": "uint",
}
ROS_TYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
"""Numbers of types in sensor_msgs/PointField."""

LAS_SCALE = 1e-4
"""Metres: LAS stores coordinates as integers of 32 bits."""


def write_points(path: str | Path, points: Any) -> None:
    """Writes a table of points to a file, in the format of its suffix.

        wrt.sensors.write_points("scan.ply", scan.to_structured("world"))

    * .ply and .pcd hold all fields, in binary.
    * .bin is KITTI's: rows of four float32, x, y, z and intensity.
    * .las and .laz hold coordinates in steps of 0.1 mm, intensities in [0, 1] as 16 bits, time, return number, the ring as the
      point source, and other fields as extra bytes.

    Args:
        path: path of the file, which is replaced if it exists.
        points: (N,) structured array with the fields x, y, z and any others, such as `LidarScan.to_structured` gives.

    Raises:
        TypeError: not a structured array with x, y and z.
        ValueError: an unknown suffix, or points that the format cannot hold.
        ImportError: the library of the format is missing.
        OSError: the file cannot be written.
    """
    points = np.asarray(points)
    names = points.dtype.names or ()
    if not {"x", "y", "z"} <= set(names) or points.ndim != 1:
        raise TypeError("points must be an (N,) structured array with the fields x, y and z; call scan.to_structured()")
    path = Path(path)
    lookup(WRITERS, path.suffix.lower(), "suffix of path")(path, points)


def _write_ply(path: Path, points: np.ndarray) -> None:
    packed = _packed(points)
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(packed)}"]
    lines += [f"property {PLY_TYPES[packed.dtype[name].str[1:]]} {name}" for name in packed.dtype.names]
    path.write_bytes("\n".join([*lines, "end_header", ""]).encode() + packed.tobytes())


def _write_kitti(path: Path, points: np.ndarray) -> None:
    rows = np.zeros((len(points), 4), dtype="<f4")
    for column, name in enumerate(("x", "y", "z", "intensity")):
        if name in points.dtype.names:
            rows[:, column] = points[name]
    path.write_bytes(rows.tobytes())


def _write_pcd(path: Path, points: np.ndarray) -> None:
    library, packed = _library("pypcd4", "PCD files"), _packed(points)
    names = packed.dtype.names
    types = [packed.dtype[name].newbyteorder("=").type for name in names]
    cloud = library.PointCloud.from_points([packed[name] for name in names], names, types)
    cloud.save(path)


def _write_las(path: Path, points: np.ndarray) -> None:
    library, names = _library("laspy", "LAS files"), points.dtype.names
    header = library.LasHeader(point_format=6, version="1.4")
    header.scales, known = np.full(3, LAS_SCALE), ("x", "y", "z", "intensity", "ring", "time", "return_number")
    corners = np.stack([points[axis].astype(np.float64) for axis in "xyz"], axis=1)
    header.offsets = np.floor(corners.min(axis=0)) if len(points) else np.zeros(3)
    if len(points) and not np.ptp(corners, axis=0).max() < LAS_SCALE * (2**31 - 1):
        raise ValueError("the points are too far apart, or not finite, for LAS files in steps of 0.1 mm; write a .ply file")
    others = [name for name in names if name not in known]
    header.add_extra_dims([library.ExtraBytesParams(name=name, type=points.dtype[name].newbyteorder("=")) for name in others])
    table = library.LasData(header)
    table.x, table.y, table.z = corners.T
    if "intensity" in names:
        table.intensity = np.round(65535.0 * np.clip(points["intensity"], 0.0, 1.0)).astype(np.uint16)
    if "ring" in names:
        table.point_source_id = points["ring"].astype(np.uint16)
    if "time" in names:
        table.gps_time = points["time"].astype(np.float64)
    if "return_number" in names:
        table.return_number = np.minimum(points["return_number"].astype(np.uint8) + 1, 15)
    for name in others:
        table[name] = points[name]
    table.write(str(path))


WRITERS: Mapping[str, Callable[[Path, np.ndarray], None]] = {
    ".ply": _write_ply,
    ".bin": _write_kitti,
    ".pcd": _write_pcd,
    ".las": _write_las,
    ".laz": _write_las,
}


def write_bag(path: str | Path, topics: Mapping[str, Iterable[LidarScan | CameraImages]], frames: Any = None) -> None:
    """Writes scans and images to a ROS 2 bag: a folder.

        wrt.sensors.write_bag("drive", {"/points": scans, "/depth": images}, {"/points": "lidar", "/depth": "camera"})

    A scan becomes a sensor_msgs/PointCloud2 of all returns in the sensor's frame, with the fields of `POINT_TYPE`; an image
    becomes a sensor_msgs/Image of its depth (32FC1, inf or the miss value where there is nothing). Stamps are the starts of
    scans and images, in seconds from 0 up.

    Args:
        path: path of the folder, which must not exist.
        topics: scans or images by topic.
        frames: frame_id by topic; "lidar" and "camera" if left out.

    Raises:
        TypeError: neither scans nor images.
        ValueError: a start before 0.
        ImportError: rosbags is missing.
        OSError: the bag cannot be written.
    """
    _library("rosbags", "ROS 2 bags")
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store, messages = get_typestore(Stores.ROS2_HUMBLE), []
    for topic, measured in topics.items():
        for one in measured:
            if not isinstance(one, LidarScan | CameraImages):
                raise TypeError(f"{topic} must hold scans or images of wrt.sensors, not {type(one).__name__}")
            if one.start < 0.0:
                raise ValueError(f"{topic} holds a measurement at {one.start} s; stamps of ROS 2 begin at 0: shift the clock")
            messages.append((round(1e9 * one.start), topic, one))
    with Writer(Path(path), version=9) as writer:
        opened: dict[str, Any] = {}
        for stamp, topic, one in sorted(messages, key=lambda message: message[:2]):
            kind, make = ("PointCloud2", _point_cloud) if isinstance(one, LidarScan) else ("Image", _depth_image)
            name = f"sensor_msgs/msg/{kind}"
            frame = (frames or {}).get(topic, "lidar" if kind == "PointCloud2" else "camera")
            types = store.types
            header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9)), frame)
            if topic not in opened:
                opened[topic] = writer.add_connection(topic, name, typestore=store)
            writer.write(opened[topic], stamp, store.serialize_cdr(make(one, header, types), name))


def _point_cloud(scan: LidarScan, header: Any, types: Mapping[str, Any]) -> Any:
    """The message of a scan."""
    table = _packed(scan.to_structured())
    field = types["sensor_msgs/msg/PointField"]
    fields = [field(n, table.dtype.fields[n][1], ROS_TYPES[table.dtype[n].str[1:]], 1) for n in table.dtype.names]
    step, data = table.dtype.itemsize, np.frombuffer(table.tobytes(), dtype=np.uint8)
    message = types["sensor_msgs/msg/PointCloud2"]
    return message(header, 1, len(table), fields, False, step, step * len(table), data, True)


def _depth_image(images: CameraImages, header: Any, types: Mapping[str, Any]) -> Any:
    """The message of a depth image."""
    depth = images.depth if isinstance(images.depth, np.ndarray) else images.depth.numpy()
    data = np.frombuffer(depth.astype("<f4").tobytes(), dtype=np.uint8)
    return types["sensor_msgs/msg/Image"](header, *depth.shape, "32FC1", 0, 4 * depth.shape[1], data)


def _packed(points: np.ndarray) -> np.ndarray:
    """The table in little endian without gaps.

    Raises:
        ValueError: a field of a type that no format holds.
    """
    kinds = [(name, points.dtype[name].newbyteorder("<")) for name in points.dtype.names]
    for name, kind in kinds:
        if kind.str[1:] not in PLY_TYPES:
            raise ValueError(f"points has the field {name!r} of type {kind}; use numbers of up to 32 bits, or float64")
    return points.astype(np.dtype(kinds))


def _library(name: str, what: str) -> ModuleType:
    """A library.

    Raises:
        ImportError: it is missing; the message says how to install it.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(f'{what} need {name}: pip install "wrt[sensors]"') from error

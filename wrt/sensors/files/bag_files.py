"""ROS 2 bags of scans and images, by rosbags (`pip install "wrt[sensors]"`).

A bag appears whole or not at all. Points are in the frame of the sensor, in which float32 is enough wherever the sensor is. A
bag holds no poses: publish them as transforms (tf), which are float64, from `scan.trajectory`.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Mapping
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from wrt.atomic_files import new_folder
from wrt.sensors.files.table_fields import needed, packed
from wrt.sensors.image_sensor import CameraImages
from wrt.sensors.lidar_scan import LidarScan

ROS_TYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
"""Numbers of types in sensor_msgs/PointField."""

MAX_SECONDS = 1 << 31
"""Seconds of a stamp (builtin_interfaces/Time) are integers of 32 bits."""

MAX_BYTES = (1 << 32) - 1
"""Bytes of the data of a message, whose length has 32 bits."""


def write_bag(
    path: str | Path, topics: Mapping[str, Iterable[LidarScan | CameraImages]], frames: Mapping[str, str] | None = None
) -> None:
    """Writes scans and images to a ROS 2 bag: a folder.

        wrt.sensors.write_bag("drive", {"/points": scans, "/depth": images}, {"/points": "lidar", "/depth": "camera"})

    A scan becomes a sensor_msgs/PointCloud2 of all returns in the sensor's frame, with the fields of `LidarScan.to_structured`;
    an image becomes a sensor_msgs/Image of its depth (32FC1, inf or the miss value where there is nothing). Stamps are the
    starts of scans and images, in seconds from 0 up, to the nanosecond. Poses are not stored.

    Args:
        path: path of the folder, which must not exist.
        topics: scans or images, one kind for each topic.
        frames: frame_id by topic; "lidar" and "camera" if left out.

    Raises:
        TypeError: neither scans nor images.
        ValueError: scans and images in one topic, those of many sensors at once, a start below 0 or beyond 2^31 seconds, a
            message of 4 GB, or a frame of no topic.
        ImportError: rosbags is missing.
        OSError: the bag cannot be written, or something is at the path.
    """
    needed("rosbags", "ROS 2 bags")
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store, frames = get_typestore(Stores.ROS2_HUMBLE), dict(frames or {})
    measured = {topic: list(values) for topic, values in topics.items()}
    if unknown := frames.keys() - measured.keys():
        raise ValueError(f"frames has {', '.join(map(repr, sorted(unknown)))}, and topics has not")
    kinds = {topic: check_topic(topic, values) for topic, values in measured.items()}
    messages = chain.from_iterable(((stamp_of(one), topic, one) for one in values) for topic, values in measured.items())
    with new_folder(path) as folder:
        try:
            with Writer(folder, version=9) as writer:
                names = {topic: f"sensor_msgs/msg/{kind}" for topic, kind in kinds.items() if measured[topic]}
                opened = {topic: writer.add_connection(topic, name, typestore=store) for topic, name in names.items()}
                for stamp, topic, one in sorted(messages, key=lambda message: message[:2]):
                    frame = frames.get(topic, "lidar" if isinstance(one, LidarScan) else "camera")
                    message = message_of(one, stamp, frame, store.types)
                    seconds, nanoseconds = stamp
                    data = store.serialize_cdr(message, names[topic])
                    writer.write(opened[topic], seconds * 10**9 + nanoseconds, data)
        except sqlite3.Error as error:
            raise OSError(str(error)) from error


def check_topic(topic: str, measured: list[Any]) -> str:
    """The kind of message of a topic.

    Raises:
        TypeError, ValueError: as `write_bag`.
    """
    for one in measured:
        if not isinstance(one, LidarScan | CameraImages):
            raise TypeError(f"{topic} must hold scans or images of wrt.sensors, not {type(one).__name__}")
        if not 0.0 <= one.start < MAX_SECONDS:
            raise ValueError(
                f"{topic} holds a measurement at {one.start} s; stamps of ROS 2 are from 0 to 2^31 seconds: shift the clock"
            )
        if sensors := getattr(one.trajectory, "shape", ()):
            raise ValueError(
                f"{topic} holds a measurement of {sensors} sensors; give each sensor a topic, and its own scan or images"
            )
    kinds = {"PointCloud2" if isinstance(one, LidarScan) else "Image" for one in measured}
    if len(kinds) > 1:
        raise ValueError(f"{topic} holds scans and images; a topic has messages of one kind: give each kind its own topic")
    return kinds.pop() if kinds else ""


def stamp_of(measured: LidarScan | CameraImages) -> tuple[int, int]:
    """Seconds and nanoseconds of the start."""
    seconds = int(measured.start)
    return divmod(seconds * 10**9 + round((measured.start - seconds) * 1e9), 10**9)


def message_of(measured: LidarScan | CameraImages, stamp: tuple[int, int], frame: str, types: Mapping[str, Any]) -> Any:
    """The message of a scan or an image.

    Raises:
        ValueError: it is larger than a message can be.
    """
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](*stamp), frame)
    if isinstance(measured, CameraImages):
        depth = measured.depth if isinstance(measured.depth, np.ndarray) else measured.depth.numpy()
        check_bytes(depth.size * 4)
        data = np.frombuffer(depth.astype("<f4").tobytes(), dtype=np.uint8)
        return types["sensor_msgs/msg/Image"](header, *depth.shape, "32FC1", 0, 4 * depth.shape[1], data)
    table = packed(measured.to_structured(), "ROS 2 bags")
    field, step = types["sensor_msgs/msg/PointField"], table.dtype.itemsize
    check_bytes(step * len(table))
    fields = [field(n, table.dtype.fields[n][1], ROS_TYPES[table.dtype[n].str[1:]], 1) for n in table.dtype.names]
    data = np.frombuffer(table.tobytes(), dtype=np.uint8)
    return types["sensor_msgs/msg/PointCloud2"](header, 1, len(table), fields, False, step, step * len(table), data, True)


def check_bytes(size: int) -> None:
    """Refuses a message that is too large.

    Raises:
        ValueError: it is.
    """
    if size > MAX_BYTES:
        raise ValueError(
            f"a message would hold {size:,} bytes, and those of ROS 2 hold {MAX_BYTES:,}; use fewer beams or pixels"
        )

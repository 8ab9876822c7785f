"""Tables of points in files: PLY, PCD and KITTI's .bin here, LAS and LAZ in `wrt.sensors.files.las_files`.

`pip install "wrt[sensors]"` installs the libraries. Files are written beside the old ones, which they then replace
(`wrt.atomic_files`). No number is changed on the way into a narrower field: it fits, or an error names it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np

from wrt.atomic_files import replaced
from wrt.sensors.files.table_fields import as_table, packed
from wrt.tables import lookup

PLY_TYPES = {
    "f4": "float",
    "f8": "double",
    "i1": "char",
    "u1": "uchar",
    "i2": "short",
    "u2": "uint16",  # "ushort" to most; Open3D reads this name only
    "i4": "int",
    "u4": "uint",
}

KITTI_ERROR = 1e-3
"""Metres by which float32 may move a point of KITTI's files, whose coordinates are relative to the sensor."""


def write_points(path: str | Path, points: np.ndarray) -> None:
    """Writes a table of points to a file, in the format of its suffix.

        wrt.sensors.write_points("scan.ply", scan.to_structured("world"))

    * .ply and .pcd hold all fields, in binary; coordinates are float64 if the table's are, as those of the world.
    * .bin is KITTI's: rows of four float32, x, y, z and intensity, relative to the sensor.
    * .las and .laz hold coordinates as integers of 32 bits, with an offset and a step that follow from the data: 0.1 mm, less
      for points closer together than 1 m, 1 mm if they are further apart than 214 km. Intensities in [0, 1] become 16 bits
      (larger ones the largest, with a warning), the ring the point source, time the GPS time. Other fields of LAS, such as
      classification, keep their names, and all others are extra bytes.

    An existing file is replaced when the new one is complete; a pipe is written through.

    Args:
        path: path of the file.
        points: (N,) structured array with the fields x, y, z and any others, such as `LidarScan.to_structured` gives; in PCD
            files (H, W), too: an organized cloud, whose misses are NaN.

    Raises:
        TypeError: not a structured array with x, y and z.
        ValueError: an unknown suffix, or a number that the format cannot hold; the message names the field.
        ImportError: the library of the format is missing.
        OSError: the file cannot be written. The old one is as it was.
    """
    path = Path(path)
    write = lookup(WRITERS, suffix := path.suffix.lower(), "suffix of path")(as_table(points, organized=suffix == ".pcd"))
    with replaced(path, streams=True) as file:
        write(file)


Write = Callable[[BinaryIO], object]
"""Writes a table, which was found to fit, to an open file."""


def _ply(points: np.ndarray) -> Write:
    table = packed(points, "PLY files")
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    lines += [f"property {PLY_TYPES[table.dtype[name].str[1:]]} {name}" for name in table.dtype.names]
    return _with_header([*lines, "end_header"], table)


def _with_header(lines: list[str], table: np.ndarray) -> Write:
    """Lines of text, and the table as it is in memory."""

    def write(file: BinaryIO) -> None:
        file.write("\n".join([*lines, ""]).encode())
        file.write(table.view(np.uint8).data if len(table) else b"")

    return write


def _kitti(points: np.ndarray) -> Write:
    rows = np.zeros((len(points), 4), dtype="<f4")
    for column, name in enumerate(("x", "y", "z", "intensity")):
        if name in points.dtype.names:
            with np.errstate(over="ignore"):
                rows[:, column] = points[name]
    for column, name in enumerate("xyz"):
        with np.errstate(invalid="ignore"):
            moved = np.abs(rows[:, column] - points[name].astype(np.float64))
        if (moved > KITTI_ERROR).any():
            raise ValueError(
                f"points have {name} = {points[name][np.nanargmax(moved)]}, which float32 of KITTI's .bin files would move by "
                f"{np.nanmax(moved):.2g}; write the sensor's coordinates, scan.to_structured(), or a .ply, .pcd or .las file"
            )
    return lambda file: file.write(rows.tobytes())


def _pcd(points: np.ndarray) -> Write:
    table = packed(points.ravel(), "PCD files")
    kinds, count = [table.dtype[name] for name in table.dtype.names], len(table)
    height, width = points.shape if points.ndim == 2 else (1, count)
    lines = ["# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7", f"FIELDS {' '.join(table.dtype.names)}"]
    lines += [f"SIZE {' '.join(str(kind.itemsize) for kind in kinds)}", f"TYPE {' '.join(kind.kind.upper() for kind in kinds)}"]
    lines += [f"COUNT {' '.join('1' for _ in kinds)}", f"WIDTH {width}", f"HEIGHT {height}", "VIEWPOINT 0 0 0 1 0 0 0"]
    return _with_header([*lines, f"POINTS {count}", "DATA binary"], table)


def _las(points: np.ndarray, is_compressed: bool = False) -> Write:
    from wrt.sensors.files.las_files import las_writer

    return las_writer(points, is_compressed)


WRITERS: Mapping[str, Callable[[np.ndarray], Write]] = {
    ".ply": _ply,
    ".bin": _kitti,
    ".pcd": _pcd,
    ".las": _las,
    ".laz": lambda points: _las(points, is_compressed=True),
}

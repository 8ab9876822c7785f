"""Tables of points in files: PLY and KITTI's .bin here, PCD by pypcd4, LAS and LAZ in `wrt.sensors.files.las_files`.

`pip install "wrt[sensors]"` installs the libraries. Files are written beside the old ones, which they then replace
(`wrt.atomic_files`). No number is changed on the way into a narrower field: it fits, or an error names it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from wrt.atomic_files import replaced
from wrt.sensors.files.table_fields import as_table, needed, packed
from wrt.tables import lookup

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

KITTI_ERROR = 1e-3
"""Metres by which float32 may move a point of KITTI's files, whose coordinates are relative to the sensor."""


def write_points(path: str | Path, points: Any) -> None:
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
        points: (N,) structured array with the fields x, y, z and any others, such as `LidarScan.to_structured` gives.

    Raises:
        TypeError: not a structured array with x, y and z.
        ValueError: an unknown suffix, or a number that the format cannot hold; the message names the field.
        ImportError: the library of the format is missing.
        OSError: the file cannot be written. The old one is as it was.
    """
    points, path = as_table(points), Path(path)
    write = lookup(WRITERS, path.suffix.lower(), "suffix of path")(points)
    with replaced(path, streams=True) as file:
        write(file)


Write = Callable[[BinaryIO], object]
"""Writes a table, which was found to fit, to an open file."""


def _ply(points: np.ndarray) -> Write:
    table = packed(points, "PLY files")
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    lines += [f"property {PLY_TYPES[table.dtype[name].str[1:]]} {name}" for name in table.dtype.names]
    return lambda file: file.write("\n".join([*lines, "end_header", ""]).encode() + table.tobytes())


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
    library, table = needed("pypcd4", "PCD files"), packed(points, "PCD files")
    names = table.dtype.names
    types = [table.dtype[name].newbyteorder("=").type for name in names]
    cloud = library.PointCloud.from_points([table[name] for name in names], names, types)
    return cloud.save


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

"""Tables of points from files: PLY, PCD and KITTI's .bin here, LAS and LAZ by laspy."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from wrt.meshes.files.mesh_source import read_regular_file
from wrt.meshes.files.ply_rows import read_elements, read_header
from wrt.sensors.files.pcd_file import read_pcd
from wrt.sensors.files.table_fields import needed
from wrt.tables import lookup

__all__ = ["read_points"]

WHAT = "a file of points"

KITTI_TYPE = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])


def read_points(path: str | Path) -> np.ndarray:
    """The points of a file, such as a map for `PointCloud`, with all that the file says of them.

        table = wrt.sensors.read_points("map.laz")
        map = wrt.sensors.PointCloud(table, radius=0.1)

    * .ply: the element 'vertex', as text or binary; lists are left out.
    * .pcd: ascii, binary and binary_compressed. Fields whose name begins with an underscore are left out.
    * .bin is KITTI's: rows of four float32, x, y, z and intensity.
    * .las and .laz, by laspy: x, y and z in float64, and all other dimensions as the file has them: intensity as 16 bits, no
      share of 1.

    Points that are NaN, as those of sensors that met nothing, are in the table; `PointCloud` refuses them:
    `table[np.isfinite(table["x"])]` leaves them out.

    Args:
        path: path of the file.

    Returns:
        (N,) structured array with the fields x, y, z and others, of the types of the file; units are those of the file.

    Raises:
        ValueError: an unknown suffix, or a file that is damaged, is cut off, or has no x, y or z; the message says which.
        ImportError: laspy is missing.
        OSError: the file cannot be read.
    """
    path = Path(path)
    read = lookup(READERS, path.suffix.lower(), "suffix of path")
    try:
        table = read(path)
    except ValueError as error:
        raise ValueError(f"'{path}' cannot be read: {error}") from None
    missing = [axis for axis in "xyz" if axis not in (table.dtype.names or ()) or table.dtype[axis].shape]
    if missing:
        raise ValueError(
            f"'{path}' has no coordinates {', '.join(missing)}; its fields are {', '.join(table.dtype.names or ())}"
        )
    return table


def _ply(path: Path) -> np.ndarray:
    data = read_regular_file(path, WHAT)
    found, _ = read_elements(data, read_header(data), ("vertex",))
    columns = {name: values for name, values in found.get("vertex", {}).items() if isinstance(values, np.ndarray)}
    if not columns:
        raise ValueError("its header announces no element 'vertex' with numbers")
    count = len(next(iter(columns.values())))
    table = np.empty(count, dtype=[(name, values.dtype.newbyteorder("=")) for name, values in columns.items()])
    for name, values in columns.items():
        table[name] = values
    return table


def _kitti(path: Path) -> np.ndarray:
    data = read_regular_file(path, WHAT)
    if len(data) % KITTI_TYPE.itemsize:
        raise ValueError(f"it has {len(data)} bytes, no whole number of rows of four float32")
    return np.frombuffer(data, dtype=KITTI_TYPE).copy()


def _las(path: Path) -> np.ndarray:
    library = needed("laspy", "LAS files")
    if path.suffix.lower() == ".laz" and not library.LazBackend.detect_available():
        needed("lazrs", "LAZ files")
    data = read_regular_file(path, WHAT)
    try:
        read = library.read(io.BytesIO(data))
        columns = {name: np.asarray(read[name]) for name in read.point_format.dimension_names if name not in "XYZ"}
        columns = {axis: np.asarray(read[axis], dtype=np.float64) for axis in "xyz"} | columns
        count, announced = len(columns["x"]), read.header.point_count
    except Exception as error:  # the libraries raise errors of their own, and those of NumPy and struct
        raise ValueError(f"{type(error).__name__}: {error}") from None
    if count != announced:
        raise ValueError(f"its header announces {announced} points, but {count} follow; is the file complete?")
    table = np.empty(count, dtype=[(name, values.dtype, values.shape[1:]) for name, values in columns.items()])
    for name, values in columns.items():
        table[name] = values
    return table


READERS: Mapping[str, Callable[[Path], np.ndarray]] = {
    ".ply": _ply,
    ".bin": _kitti,
    ".pcd": lambda path: read_pcd(read_regular_file(path, WHAT)),
    ".las": _las,
    ".laz": _las,
}
"""What reads the points of a file, by suffix."""

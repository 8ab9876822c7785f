"""LAS and LAZ files, by laspy: point format 6 of version 1.4.

LAS stores coordinates as integers of 32 bits, x = offset + scale * X. Both follow from the data, so that points far from 0, as
in UTM coordinates, are as precise as points near 0.

References: asprs-2019.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from math import floor, log10
from typing import Any, BinaryIO

import numpy as np

from wrt.sensors.checks import as_integers
from wrt.sensors.files.table_fields import WIDER, needed

STEP, MIN_STEP, MAX_STEP = 1e-4, 1e-9, 1e-3
"""Metres between coordinates: of points 1 m to 214 km apart, and the limits for others."""

MAX_RETURNS = 15
"""Returns of a pulse in point format 6, whose field has 4 bits."""

LONGEST_NAME = 32
"""Bytes of the name of extra bytes."""

OWN_TYPES = ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8")
"""Types of extra bytes."""


def las_writer(points: np.ndarray, is_compressed: bool) -> Callable[[BinaryIO], object]:
    """What writes a table to an open file.

    Args:
        points: the table.
        is_compressed: whether as LAZ.

    Raises:
        ValueError: a number that LAS does not hold.
        ImportError: a library is missing.
    """
    library = needed("laspy", "LAS files")
    if is_compressed and not library.LazBackend.detect_available():
        needed("lazrs", "LAZ files")
    header = library.LasHeader(point_format=6, version="1.4")
    corners = np.stack([points[axis].astype(np.float64) for axis in "xyz"], axis=1)
    header.offsets, header.scales = offsets_and_step(corners)
    special = {"x", "y", "z", *FIELDS} & set(points.dtype.names)
    standard = set(header.point_format.standard_dimension_names) - {"X", "Y", "Z"}
    others = [name for name in points.dtype.names if name not in special | standard]
    header.add_extra_dims([library.ExtraBytesParams(name=name, type=extra_type(points, name)) for name in others])
    table = library.LasData(header)
    table.x, table.y, table.z = corners.T
    for name in points.dtype.names:
        if name in FIELDS:
            field, values = FIELDS[name](points[name])
            if field != name and field in points.dtype.names:
                raise ValueError(
                    f"points has the fields {name!r} and {field!r}, which are the same in LAS files; leave one out"
                )
            table[field] = values
        elif name in standard:
            table[name] = fitting(header.point_format.dimension_by_name(name), points[name])
        elif name in others:
            table[name] = points[name]
    if not is_compressed:
        return lambda file: table.write(file, do_compress=False)
    content = io.BytesIO()  # lazrs does not tell why a file cannot be written
    table.write(content, do_compress=True)
    return lambda file: file.write(content.getbuffer())


def offsets_and_step(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(3,) offsets, whole numbers, and (3,) steps for (N, 3) coordinates.

    Raises:
        ValueError: they are not finite, or too far apart.
    """
    if len(corners) == 0:
        return np.zeros(3), np.full(3, STEP)
    wrong = ~np.isfinite(corners)
    if wrong.any():
        point, axis = np.argwhere(wrong)[0]
        raise ValueError(f"points have {'xyz'[axis]} = {corners[point, axis]}; LAS files hold finite coordinates only")
    low, extent = np.floor(corners.min(axis=0)), np.ptp(corners, axis=0).max()
    step = STEP if extent >= 1.0 else max(STEP * 10.0 ** floor(log10(max(extent, MIN_STEP))), MIN_STEP)
    coarsest = np.ceil(corners.max(axis=0) - low).max() / (2**31 - 1)
    if coarsest > step:
        step = MAX_STEP
    if coarsest > step:
        raise ValueError(f"points are {extent:g} apart, too far for LAS files in steps of 1 mm; write a .ply or .pcd file")
    return low, np.full(3, step)


def extra_type(points: np.ndarray, name: str) -> np.dtype:
    """The type of the extra bytes for a field.

    Raises:
        ValueError: there is none, or its name is too long.
    """
    kind = points.dtype[name].newbyteorder("=").str.lstrip("<>=|")
    kind = WIDER.get(kind, kind)
    if kind not in OWN_TYPES:
        raise ValueError(f"points has the field {name!r} of type {points.dtype[name]}; LAS files hold numbers")
    if len(name) > LONGEST_NAME:
        raise ValueError(f"points has the field {name!r}; names in LAS files have at most {LONGEST_NAME} letters")
    return np.dtype(kind)


def fitting(dimension: Any, values: np.ndarray) -> np.ndarray:
    """Values of a field that LAS has itself, unchanged.

    Raises:
        ValueError: it does not hold them.
    """
    if dimension.kind.name == "FloatingPoint":
        return values.astype(np.float64)
    if dimension.num_bits < 8:  # of a byte that several fields share
        small, limit = (
            as_integers(f"points[{dimension.name!r}]", values, np.uint8, " in LAS files"),
            (1 << dimension.num_bits) - 1,
        )
        if small.size and small.max() > limit:
            raise ValueError(f"points[{dimension.name!r}] holds {small.max()}; it must be from 0 to {limit} in LAS files")
        return small
    kind = f"{'u' if dimension.kind.name == 'UnsignedInteger' else 'i'}{dimension.num_bits // 8}"
    return as_integers(f"points[{dimension.name!r}]", values, np.dtype(kind), " in LAS files")


def _intensity(values: np.ndarray) -> tuple[str, np.ndarray]:
    wrong = ~(values >= 0.0)
    if wrong.any():
        raise ValueError(f"points['intensity'] holds {values[wrong][0]}; it must be 0 or more in LAS files")
    above = values > 1.0
    if above.any():
        warnings.warn(
            f"{above.sum():,} of {values.size:,} intensities are above 1, up to {values.max():.3g}, and become 65535, the "
            "largest of a LAS file; to keep them apart, divide them by the largest, or choose a smaller reference_range of the "
            "lidar",
            stacklevel=6,
        )
    return "intensity", np.round(65535.0 * np.minimum(values, 1.0)).astype(np.uint16)


def _ring(values: np.ndarray) -> tuple[str, np.ndarray]:
    return "point_source_id", as_integers("points['ring']", values, np.uint16, " in LAS files")


def _time(values: np.ndarray) -> tuple[str, np.ndarray]:
    return "gps_time", values.astype(np.float64)


def _return_number(values: np.ndarray) -> tuple[str, np.ndarray]:
    numbers = as_integers("points['return_number']", values, np.uint8, " in LAS files")
    if numbers.size and numbers.max() >= MAX_RETURNS:
        raise ValueError(
            f"points['return_number'] holds {numbers.max()}; it must be from 0 to {MAX_RETURNS - 1} in LAS files, which count "
            "returns in 4 bits from 1 up"
        )
    return "return_number", numbers + 1


FIELDS = {"intensity": _intensity, "ring": _ring, "time": _time, "return_number": _return_number}
"""Fields of a lidar's table, and the fields of LAS that hold them."""

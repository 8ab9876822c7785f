"""Tables of points as files take them: checked, in little endian, each field of a type that the format has."""

from __future__ import annotations

import importlib
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.sensors.checks import as_integers

if TYPE_CHECKING:
    from types import ModuleType

WIDER = {"b1": "u1", "f2": "f4"}
"""Types that files have only wider ones for."""

NARROWER = {"i8": "i4", "u8": "u4"}
"""Integers of 64 bits, which PLY, PCD and ROS do not have, and what holds them if they are small enough."""

KNOWN = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
"""Types of fields."""


def as_table(points: Any, organized: bool = False) -> np.ndarray:
    """(N,) structured array with x, y and z.

    Args:
        points: the array.
        organized: whether it may have two dimensions.

    Raises:
        TypeError: another array.
        ValueError: masked values, or a field whose name has spaces, of which headers of files would make two.
    """
    if isinstance(points, np.ma.MaskedArray) and any(np.ma.getmaskarray(points).tobytes()):  # of fields: is_masked fails
        raise ValueError("points has masked values; replace them with .filled(value), or leave these points out")
    points = np.asarray(points)
    names = points.dtype.names or ()
    if not {"x", "y", "z"} <= set(names) or points.ndim not in ((1, 2) if organized else (1,)):
        raise TypeError(
            "points must be an (N,) structured array with the fields x, y and z, such as scan.to_structured() (in PCD files, "
            f"(H, W), too), not of {points.dtype} and shape {points.shape}"
        )
    for name in names:
        if not re.fullmatch(r"[!-~]+", name):
            raise ValueError(f"points has a field with the name {name!r}; use letters, digits and underscores")
    return points


def packed(points: np.ndarray, what: str) -> np.ndarray:
    """The table in little endian without gaps, its integers of 64 bits in 32; the table itself if it is so.

    Args:
        points: the table.
        what: the files, for errors.

    Raises:
        ValueError: a field of a type that the format does not hold, or a number beyond 32 bits.
    """
    kinds, columns = [], []
    for name in points.dtype.names:
        kind = points.dtype[name].newbyteorder("<").str.lstrip("<|")
        kind, column = WIDER.get(kind, kind), points[name]
        if kind in NARROWER:
            kind = NARROWER[kind]
            column = as_integers(f"points[{name!r}]", column, np.dtype(kind), f" in {what}")
        if kind not in KNOWN:
            raise ValueError(
                f"points has the field {name!r} of type {points.dtype[name]}; use numbers of up to 32 bits, or float64"
            )
        kinds.append((name, "<" + kind))
        columns.append(column)
    if np.dtype(kinds) == points.dtype:
        return np.ascontiguousarray(points)
    table = np.empty(len(points), dtype=np.dtype(kinds))
    for name, column in zip(points.dtype.names, columns, strict=True):
        table[name] = column
    return table


def needed(name: str, what: str) -> ModuleType:
    """A library.

    Raises:
        ImportError: it is missing; the message says how to install it.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(f'{what} need {name}: pip install "wrt[sensors]"') from error

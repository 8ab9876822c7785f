"""Argument validation for sensors."""

from __future__ import annotations

from typing import Any

import numpy as np

from wrt.kernels.validation import as_float, as_numbers

SAME_STRETCH = 1e-6
"""Relative difference up to which two matrices count as having the same scale and shear."""


def check_scene(scene: Any) -> None:
    """Refuses what sensors cannot look at.

    Raises:
        TypeError: neither a scene in memory nor a cloud.
    """
    from wrt.clouds.point_cloud import PointCloud
    from wrt.query.api import Queries

    if not isinstance(scene, (Queries, PointCloud)):
        found = type(scene).__name__
        raise TypeError(
            f"scene must be a wrt.Scene or a wrt.sensors.PointCloud, not {found}; make a scene with wrt.Scene(mesh)"
        )


def check_real(name: str, values: Any, shape: tuple[int | None, ...] | None = None) -> np.ndarray:
    """A fresh float64 array of finite numbers.

    Args:
        name: of the argument.
        values: what was passed.
        shape: what it must have; None for a length that may be any, or for any shape.

    Raises:
        TypeError: the values are not real numbers.
        ValueError: another shape, NaN or an infinity.
    """
    return as_numbers(name, values, shape)


def as_time(time: Any) -> float:
    """A finite number of seconds.

    Raises:
        TypeError: not a number.
        ValueError: NaN or infinite.
    """
    return as_float("time", time, finite=True)


def check_at_least(name: str, value: Any, minimum: float, below: float = np.inf) -> float:
    """A number of at least `minimum` and below `below`.

    Raises:
        TypeError: not a number.
        ValueError: out of range.
    """
    value = as_float(name, value)
    if not minimum <= value < below:
        raise ValueError(
            f"{name} is {value}; it must be at least {minimum:g} and " + ("finite" if below == np.inf else f"below {below:g}")
        )
    return value


def check_matrix(name: str, matrix: np.ndarray) -> None:
    """Refuses a (4, 4) matrix that is not affine or that is singular.

    Raises:
        ValueError: it is.
    """
    if not np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]):
        raise ValueError(f"{name} holds a matrix with the last row {matrix[3].tolist()}; it must be (0, 0, 0, 1)")
    if np.linalg.matrix_rank(matrix[:3, :3]) < 3:
        raise ValueError(f"{name} holds a singular matrix: {matrix.tolist()}")


def as_integers(name: str, values: np.ndarray, dtype: Any, holder: str = "") -> np.ndarray:
    """Numbers as integers of a type, none of them changed.

    Args:
        name: of the values.
        values: integers, booleans, or floats that are whole numbers.
        dtype: of the result.
        holder: what has this type, as " in LAS files", for errors.

    Raises:
        ValueError: a number is not whole, or beyond the range of the type; the message names it.
    """
    values, limits = np.asarray(values), np.iinfo(dtype)
    if values.dtype.kind == "f":
        wide = values.astype(np.float64)  # of which the ends of a range are exact
        fits = (wide >= limits.min) & (wide < float(limits.max) + 1.0) & (wide == np.floor(wide))
    else:
        values = values.astype(np.uint8) if values.dtype.kind == "b" else values
        fits = (values >= limits.min) & (values <= limits.max)
    if not fits.all():
        wrong = values[~fits].flat[0]
        raise ValueError(f"{name} holds {wrong}; it must hold whole numbers from {limits.min} to {limits.max}{holder}")
    return values.astype(dtype)


def is_rigid(rows: list[list[float]]) -> bool:
    """Whether a (4, 4) matrix moves and turns only. In plain numbers, because NumPy takes longer for so few."""
    (a, b, c, _), (d, e, f, _), (g, h, i, _), last = rows
    products = a * d + b * e + c * f, a * g + b * h + c * i, d * g + e * h + f * i
    lengths = a * a + b * b + c * c, d * d + e * e + f * f, g * g + h * h + i * i
    worst = max(*map(abs, products), *(abs(length - 1.0) for length in lengths))
    turns = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0.0
    return worst <= SAME_STRETCH and turns and last == [0.0, 0.0, 0.0, 1.0]

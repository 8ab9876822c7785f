"""What callers pass as numbers, switches and arrays, converted to the types that everything behind expects.

A number may come as Python's or NumPy's, of any width, or as an array without dimensions: kernels, keys of caches and files
take Python's `int`, `float` and `bool` only. Public functions and dataclasses convert their arguments here before they do
anything else, so that a number means the same in whatever type it is passed, or is refused by an error that names the
argument. The rules:

* A whole number is an integer of any type. A float is not, even 64.0; neither is a bool.
* A number is a whole number, a float of any width, or a fraction. A bool is not; NaN is refused.
* A switch is Python's or NumPy's bool. A number is not, nor is text, of which "no" would count as true.
* An array holds integers or floats, in either byte order. Masked values, objects, text, dates and complex numbers are
  refused, because NumPy would convert them to something else without a word. So are tensors that record gradients.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from functools import cache
from numbers import Integral, Real
from typing import Any

import numpy as np

__all__ = [
    "as_bool",
    "as_direction",
    "as_float",
    "as_int",
    "as_numbers",
    "as_point",
    "as_real_array",
    "convert_fields",
    "host_array",
    "resolved",
    "unreadable",
]


def as_int(name: str, value: Any, minimum: int | None = None, maximum: int | None = None) -> int:
    """A whole number.

    Args:
        name: of the argument.
        value: what was passed.
        minimum, maximum: closed bounds; None for none.

    Raises:
        TypeError: not a whole number.
        ValueError: out of bounds.
    """
    if type(value) is not int:
        scalar = _scalar(name, value)
        if isinstance(scalar, _NO_NUMBERS) or not isinstance(scalar, Integral):
            whole = isinstance(scalar, (float, np.floating)) and float(scalar).is_integer()
            raise TypeError(f"{name} must be an int, not {_shown(value)}" + (f"; pass {int(scalar)}" if whole else ""))
        value = int(scalar)
    if (minimum is not None and value < minimum) or (maximum is not None and value > maximum):
        raise ValueError(f"{name} is {value}; it must be {_bounds(minimum, maximum)}")
    return value


def as_float(name: str, value: Any, *, finite: bool = False) -> float:
    """A number, as a Python float.

    Args:
        name: of the argument.
        value: what was passed.
        finite: whether infinities are refused.

    Raises:
        TypeError: not a number.
        ValueError: NaN, beyond the range of float64, or infinite.
    """
    if type(value) is not float:
        scalar = _scalar(name, value)
        if isinstance(scalar, _NO_NUMBERS) or not isinstance(scalar, Real):
            raise TypeError(f"{name} must be a number, not {_shown(value)}")
        try:
            value = float(scalar)
        except OverflowError:
            raise ValueError(f"{name} is beyond the range of float64; pass float('inf') for no bound") from None
    if value != value:
        raise ValueError(f"{name} is {value}; pass a number")
    if finite and value in (np.inf, -np.inf):
        raise ValueError(f"{name} is {value}; it must be finite")
    return value


def as_bool(name: str, value: Any) -> bool:
    """A switch.

    Raises:
        TypeError: not a bool.
    """
    if type(value) is not bool:
        scalar = _scalar(name, value)
        if not isinstance(scalar, (bool, np.bool_)):
            raise TypeError(f"{name} must be True or False, not {_shown(value)}")
        value = bool(scalar)
    return value


def as_numbers(name: str, values: Any, shape: tuple[int | None, ...] | None = None, *, finite: bool = True) -> np.ndarray:
    """A fresh float64 array of numbers.

    Args:
        name: of the argument.
        values: what was passed.
        shape: what it must have; None for a length that may be any, or for any shape.
        finite: whether NaN and infinities are refused.

    Raises:
        TypeError: the values are not real numbers.
        ValueError: another shape, NaN or an infinity.
    """
    array = as_real_array(name, values).astype(np.float64)
    if shape is not None and not _fits(array.shape, shape):
        wanted = ", ".join("N" if n is None else str(n) for n in shape)
        raise ValueError(f"{name} has the shape {array.shape}; it must be ({wanted}{',' if len(shape) == 1 else ''})")
    if finite and not np.isfinite(array).all():
        raise ValueError(f"{name}{first_bad(~np.isfinite(array), array)}; all must be finite")
    return array


def as_point(name: str, value: Any) -> np.ndarray:
    """A point or a direction, (3,) float64.

    Args:
        name: of the argument.
        value: what was passed.

    Raises:
        TypeError: not numbers.
        ValueError: another shape, NaN or infinite.
    """
    point = as_numbers(name, value, finite=False)
    if point.shape != (3,):
        raise ValueError(f"{name} must be three numbers x, y, z, not an array of shape {point.shape}")
    if not np.isfinite(point).all():
        text = ", ".join(f"{x:g}" for x in point)
        raise ValueError(f"{name} is ({text}); its three numbers must be finite")
    return point


def as_direction(name: str, value: Any) -> np.ndarray:
    """A unit vector, (3,) float64, of a direction of any length.

    Raises:
        TypeError, ValueError: as `as_point`, or zero.
    """
    vector = as_point(name, value)
    if not vector.any():
        raise ValueError(f"{name} is zero; give a direction of any length")
    if not 1e-150 < (largest := np.abs(vector).max()) < 1e150:  # squares would vanish or overflow
        vector /= largest
    return vector / np.linalg.norm(vector)


def as_real_array(name: str, values: Any) -> np.ndarray:
    """An array of integers or floats in this machine's byte order; a view of the values where that is possible.

    Raises:
        TypeError: the values are not real numbers, or record gradients.
        ValueError: masked values.
    """
    array = host_array(name, values)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name} must hold real numbers, not {array.dtype}; convert it to float32 or float64")
    return array if array.dtype.isnative else array.astype(array.dtype.newbyteorder("="))


def host_array(name: str, values: Any) -> np.ndarray:
    """A NumPy array of whatever NumPy converts without changing a value.

    Raises:
        TypeError: NumPy cannot convert the values; a tensor that records gradients or is on another device.
        ValueError: masked values.
    """
    if isinstance(values, np.ma.MaskedArray):
        if np.ma.is_masked(values):
            count = int(np.ma.getmaskarray(values).sum())
            raise ValueError(f"{name} has {count} masked values; replace them with .filled(value), or leave them out")
        return np.asarray(values.data)
    try:
        return np.asarray(resolved(values))
    except MemoryError:
        raise
    except Exception as error:  # each library has its own
        raise TypeError(unreadable(name, values, error)) from error


def resolved(values: Any) -> Any:
    """A tensor whose memory holds its own numbers, not their negatives, as PyTorch's do in a view such as `z.conj().imag`: a
    reader of the memory would not notice. Anything else as it is.
    """
    is_negative = getattr(values, "is_neg", None)
    return values.resolve_neg() if callable(is_negative) and is_negative() else values


def unreadable(name: str, values: Any, error: Exception) -> str:
    """What to say of an array of another library that cannot be read, for the error that the attempt raised."""
    if getattr(values, "requires_grad", False):
        return f"{name} records gradients, which queries do not pass on; pass {name}.detach()"
    return f"{name} is not an array that can be read here: {error}"


def convert_fields(instance: Any) -> None:
    """Converts the fields of a frozen dataclass that are declared as int, float or bool, or as one of these or None.

    Raises:
        TypeError, ValueError: as `as_int`, `as_float` and `as_bool`, with the name of the field.
    """
    for name, convert, optional in _numeric_fields(type(instance)):
        value = getattr(instance, name)
        if not (optional and value is None) and (converted := convert(name, value)) is not value:
            object.__setattr__(instance, name, converted)


@cache
def _numeric_fields(kind: type) -> tuple[tuple[str, Callable[[str, Any], Any], bool], ...]:
    """Name, conversion, and whether None is allowed, of the fields that `convert_fields` converts."""
    found = []
    for field in fields(kind):
        declared = field.type.__name__ if isinstance(field.type, type) else str(field.type)
        plain = declared.removesuffix(" | None")
        if plain in _CONVERSIONS:
            found.append((field.name, _CONVERSIONS[plain], plain != declared))
    return tuple(found)


_CONVERSIONS: dict[str, Callable[[str, Any], Any]] = {"int": as_int, "float": as_float, "bool": as_bool}

_NO_NUMBERS = (bool, np.timedelta64)
"""Types that Python or NumPy count among the integers."""


def _scalar(name: str, value: Any) -> Any:
    """The element of an array without dimensions; anything else as it is."""
    if isinstance(value, (np.generic, str, bytes)) or not hasattr(value, "__array__") or getattr(value, "shape", None) != ():
        return value
    return host_array(name, value)[()]


def _fits(shape: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    return len(shape) == len(wanted) and all(n in (None, own) for n, own in zip(wanted, shape, strict=True))


def first_bad(is_bad: Any, values: np.ndarray) -> str:
    """Place and value of the first element that is wrong, such as "[3, 0] is -0.5", to follow a name; empty if none is.

    Args:
        is_bad: which elements are wrong.
        values: of the same shape, or with further axes.
    """
    if not is_bad.any():
        return ""
    place = np.unravel_index(int(is_bad.argmax()), is_bad.shape)
    value = values[place]
    return f"{[int(i) for i in place] if place else ''} is {value.tolist() if isinstance(value, np.ndarray) else value}"


def _shown(value: Any) -> str:
    """The type of a value, and the value if that is short."""
    text = repr(value)
    return type(value).__name__ + (f" {text}" if value is not None and len(text) <= 60 else "")


def _bounds(minimum: int | None, maximum: int | None) -> str:
    if minimum is None:
        return f"at most {maximum}"
    return f"at least {minimum}" if maximum is None else f"from {minimum} to {maximum}"

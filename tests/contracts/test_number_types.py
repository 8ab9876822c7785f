"""Numbers, switches and small arrays of any type mean the same at every public border, or are refused by name.

People type 40 where 40.0 is declared, and pass what a NumPy computation gave them. `Lidar(max_range=40)` was an AttributeError
in its scan, and `np.int32(40)` made every range infinite without a word; `Camera(np.int64(64), ...)` failed inside Warp.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Callable, Iterator
from datetime import datetime
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import warp as wp
from support import public_calls
from support.call_objects import Call

import wrt

NUMERIC = re.compile(r"\b(int|float|bool)\b")
"""In an annotation, a number or a switch."""

INTEGERS = (np.int8, np.int16, np.int32, np.int64, np.uint8, np.uint16, np.uint32, np.uint64)
FLOATS = (np.float16, np.float32, np.float64, np.longdouble)

NO_NUMBERS = (
    "4",
    "four",
    4j,
    np.complex64(4),
    [4],
    np.array([4]),
    np.datetime64(4, "s"),
    np.timedelta64(4, "s"),
    datetime.now(),
)
"""What is neither a number nor a switch. Text may be an amount of memory."""

MAY_BE_ARRAYS = ("Any", "Numbers", "Numbers | None", "int | Sequence[int] | None")
"""Annotations of arguments that are one number or several."""

NAN_IS_FINE = {("Camera.capture", "miss")}

CALLS = list(public_calls.calls())


def public_callables() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Qualified names and all functions, classes and methods of the public modules, each once."""
    doors = [value for name in (*wrt.__all__, *wrt._BESIDE) if inspect.ismodule(value := getattr(wrt, name))]
    for module in (wrt, *doors):
        for name in module.__all__:
            value = getattr(module, name)
            if inspect.isclass(value):
                yield value.__qualname__, value
                methods = inspect.getmembers(value, lambda one: hasattr(one, "__qualname__") and callable(one))
                yield from ((one.__qualname__, one) for attribute, one in methods if not attribute.startswith("_"))
            elif inspect.isfunction(value):
                yield value.__qualname__, value


PUBLIC = dict(public_callables())


def numeric_parameters(function: Callable[..., Any]) -> list[str]:
    """Names of the parameters that are declared as numbers or switches."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except ValueError:  # an exception's class, and others that are not written in Python
        return []
    declared = {one.name: str(one.annotation) for one in parameters if one.kind is not one.VAR_KEYWORD}
    return [name for name, text in declared.items() if NUMERIC.search(re.sub(r"(Callable|Mapping|dict)\[.*\]", "", text))]


def test_every_public_callable_is_tried():
    """A new function, class or parameter fails here until `public_calls` has a row with its arguments."""
    left_out = {name for names in public_calls.FOR_THE_LIBRARY.values() for name in names.split()}
    tried: dict[str, set[str]] = {}
    for call in CALLS:
        tried.setdefault(call.name, set()).update(call.arguments)
    missing = []
    for name, function in PUBLIC.items():
        if name not in left_out:
            missing += [(name, one) for one in numeric_parameters(function) if one not in tried.get(name, ())]
    assert not missing
    assert not [name for name in left_out | set(tried) if name not in PUBLIC], "these are not public"


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.name)
def test_numbers_of_every_type(call):
    """Of the same value, the result is the same; what is no number is refused with the argument's name."""
    expected: dict[Any, Any] = {}

    def outcome(name: str, value: Any) -> Any:
        """The result, or what the error says."""
        try:
            return fingerprint(call.function(**{**call.arguments, name: value}))
        except (TypeError, ValueError) as error:
            return Refusal(str(error))

    def result(name: str, value: Any) -> Any:
        key = name, repr(value)
        if key not in expected:
            expected[key] = fingerprint(call.function(**{**call.arguments, name: value}))
        return expected[key]

    for name, plain in call.arguments.items():
        for other, same_as in accepted(plain):
            assert outcome(name, other) == result(name, same_as), f"{name}={other!r} of {type(other).__name__}"
        if isinstance(plain, float):  # where an array may be meant, it is one of objects
            found = outcome(name, Fraction(plain))
            assert found == result(name, plain) or found.names(name)
        for other in refused(call, name, plain):
            found = outcome(name, other)
            assert isinstance(found, Refusal), f"{name}={other!r}"
            assert found.names(name), f"{name}={other!r}: {found}"


class Refusal(str):
    """What an error says."""

    def names(self, argument: str) -> bool:
        """Whether it names an argument."""
        return re.search(rf"\b{argument}\b", self) is not None


def accepted(plain: Any) -> Iterator[tuple[Any, Any]]:
    """Values of other types, and the plain values that they mean."""
    if isinstance(plain, bool):
        for value in (np.bool_(plain), np.array(plain)):
            yield value, plain
    elif isinstance(plain, int):
        for kind in INTEGERS:
            if plain <= np.iinfo(kind).max:
                yield kind(plain), plain
        yield np.array(plain), plain
    elif isinstance(plain, float):
        whole = max(1, round(plain))
        for kind in FLOATS:
            yield kind(plain), plain
        for value in (np.array(plain, np.float32), np.array(plain, ">f8")):
            yield value, plain
        if whole == plain:
            yield from ((kind(whole), plain) for kind in (int, np.int8, np.int32, np.uint64))
    else:
        for value in arrays(plain):
            yield value, plain


def arrays(plain: Any) -> Iterator[Any]:
    """The numbers of a list or tuple in arrays of other types, orders of bytes and layouts in memory."""
    whole = np.array(plain)
    if whole.dtype.kind == "f":
        for kind in (np.float16, np.float32, np.float64, ">f4", ">f8"):
            yield np.array(plain, kind)
    rounded = whole.astype(int)
    if (rounded == whole).all():
        yield from (rounded, rounded.tolist(), rounded.astype(np.int8), rounded.astype(">i4"))
    yield np.ma.array(plain)
    yield np.repeat(whole, 2, axis=-1)[..., ::2]
    whole.flags.writeable = False
    yield whole


def refused(call: Call, name: str, plain: Any) -> Iterator[Any]:
    """Values that mean nothing as the argument."""
    declared = annotation(call.name, name)
    if isinstance(plain, (list, tuple)):
        array = np.array(plain, float)
        yield from ("four", array.astype(complex), array.astype(object), array.astype(str), array.astype("datetime64[s]"))
        yield from (array.astype(bool), np.ma.array(array, mask=True), array.astype([("x", float)]), [*plain, [1.0, 2.0]])
        return
    allowed = ((str,) if "str" in declared else ()) + ((list, np.ndarray) if declared in MAY_BE_ARRAYS else ())
    yield from (value for value in NO_NUMBERS if not isinstance(value, allowed))
    if isinstance(plain, bool):
        yield from (1, 0, 1.0, np.int64(1), np.float32(0))
        return
    yield from (True, np.True_, Decimal(4), np.ma.masked)
    if declared != "Any" and "None" not in declared:
        yield None
    if (call.name, name) not in NAN_IS_FINE:
        yield float("nan")
    if isinstance(plain, int):
        yield from (float(plain), np.float16(1), np.float32(1), np.float64(1), Fraction(1, 2))


def annotation(name: str, parameter: str) -> str:
    """What a parameter of a public callable is declared as; "Any" if it is one of `**options`."""
    found = inspect.signature(PUBLIC[name]).parameters.get(parameter)
    return "Any" if found is None else str(found.annotation)


def fingerprint(value: Any) -> Any:
    """All numbers within a result, and their types."""
    if isinstance(value, wp.array):
        value = value.numpy()
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if dataclasses.is_dataclass(value):
        return type(value).__name__, {one.name: fingerprint(getattr(value, one.name)) for one in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {key: fingerprint(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [fingerprint(one) for one in value]
    if isinstance(
        value, (wrt.PinholeCamera, wrt.OrthographicCamera, wrt.lights.PointLight, wrt.lights.DirectionalLight, wrt.lights.Sky)
    ):
        return fingerprint(vars(value))
    return type(value).__name__, value if isinstance(value, (bool, int, str)) else repr(value)

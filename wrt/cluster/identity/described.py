"""Options and functions as plain data that is the same in every process, to compare them and to show them.

A function is described by its name, its code and the values that it reads: defaults, closures, and globals that its code names.
An object is described by its class, the code of its methods and its attributes; an array by a hash. Functions and classes of
other packages than the one that the description began in are described by name. Code is that of one version of Python: with
another one, functions count as others.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from wrt.cluster.identity.scene_hashes import scene_hash

ADDRESS = re.compile(r" at 0x[0-9a-fA-F]+")
"""Where an object is in memory, as Python shows it."""

BY_NAME = ("builtins", "numpy", "warp", "wrt")
"""Packages whose functions and classes are described by name."""


class Inside(NamedTuple):
    """Where a value is.

    Attributes:
        above: identities of the objects that it is part of. One that refers to itself is not described again.
        package: of the function or class that it belongs to; None if there is none.
    """

    above: tuple[int, ...] = ()
    package: str | None = None


OUTSIDE = Inside()
"""Where a description begins."""


def options_text(value: Any) -> str:
    """Options as text, to compare and to show."""
    return json.dumps(described(value), sort_keys=True)


def described(value: Any, inside: Inside = OUTSIDE) -> Any:
    """A value as plain data."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if id(value) in inside.above:
        return ["part of itself", len(inside.above) - inside.above.index(id(value))]
    inside = inside._replace(above=(*inside.above, id(value)))
    if isinstance(value, Mapping):
        return {"mapping": sorted(([repr(key), described(one, inside)] for key, one in value.items()), key=lambda one: one[0])}
    if isinstance(value, (list, tuple)):
        return [described(one, inside) for one in value]
    if isinstance(value, (set, frozenset)):
        return ["set", *sorted(json.dumps(described(one, inside), sort_keys=True) for one in value)]
    if isinstance(value, (np.ndarray, np.generic, wp.array)):
        return described_array(value, inside)
    if isinstance(value, partial):
        return ["partial", *(described(one, inside) for one in (value.func, value.args, value.keywords))]
    if isinstance(value, MethodType):
        return ["method", described(value.__self__, inside), value.__func__.__qualname__]
    if isinstance(value, (ModuleType, np.ufunc)):
        return value.__name__
    if isinstance(value, FunctionType):
        return described_function(value, inside)
    if isinstance(value, type):
        return described_class(value, inside)
    if callable(value) and hasattr(value, "__qualname__"):  # functions in C, such as np.sum
        return [getattr(value, "__module__", None), value.__qualname__]
    return described_object(value, inside)


def described_array(values: Any, inside: Inside) -> Any:
    """Type, shape and hash of an array; of an array of objects, each of them."""
    array = np.asarray(values.numpy() if isinstance(values, wp.array) else values)
    if array.dtype.hasobject:
        return ["array", list(array.shape), [described(one, inside) for one in array.reshape(-1).tolist()]]
    content = hashlib.sha256(np.ascontiguousarray(array).reshape(-1).view(np.uint8)).hexdigest()  # type: ignore[arg-type]
    return ["array", array.dtype.str, list(array.shape), content]


def described_function(function: FunctionType, inside: Inside) -> Any:
    """Name and code of a function, and the values that it reads."""
    package = function.__module__.partition(".")[0] if function.__module__ else None
    if package in BY_NAME or inside.package not in (None, package):
        return ["function", function.__module__, function.__qualname__]
    code, inside = function.__code__, inside._replace(package=package)
    cells = dict(zip(code.co_freevars, map(cell_value, function.__closure__ or ()), strict=True))
    read = {name: function.__globals__[name] for name in names_in(code) if name in function.__globals__}
    values = [function.__defaults__, function.__kwdefaults__, cells, read]
    return ["function", function.__qualname__, code_hash(code), described(values, inside)]


def cell_value(cell: Any) -> Any:
    """What a closure holds in a cell; None if the cell is empty."""
    try:
        return cell.cell_contents
    except ValueError:
        return None


def names_in(code: CodeType) -> set[str]:
    """Names of globals and attributes in some code, and in the functions in it."""
    return set(code.co_names).union(*(names_in(one) for one in code.co_consts if isinstance(one, CodeType)))


def code_hash(code: CodeType) -> str:
    """SHA-256 of code, of its constants and names, and of the functions in it; not of lines and comments."""
    constants = [code_hash(one) if isinstance(one, CodeType) else constant_text(one) for one in code.co_consts]
    parts = [code.co_code.hex(), constants, code.co_names, code.co_varnames, code.co_freevars, code.co_flags]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def constant_text(value: Any) -> str:
    """A constant as text, the same in every process: the order of sets is not."""
    if isinstance(value, frozenset):
        return f"set {sorted(map(constant_text, value))}"
    if isinstance(value, tuple):
        return f"tuple {[constant_text(one) for one in value]}"
    return f"{type(value).__name__} {value!r}"


def described_class(cls: type, inside: Inside) -> Any:
    """Name of a class, and the functions and plain values in it and in those that it is derived from."""
    package = cls.__module__.partition(".")[0]
    if package in BY_NAME or inside.package not in (None, package):
        return ["class", cls.__module__, cls.__qualname__]
    inside, found = inside._replace(package=package), {}
    for depth, one in enumerate(cls.__mro__):
        for name, value in vars(one).items() if one.__module__.partition(".")[0] == package else ():
            value = getattr(value, "__func__", getattr(value, "fget", value))  # static methods and properties
            is_plain = not name.startswith("__") and isinstance(value, (bool, int, float, str, tuple, np.ndarray))
            if isinstance(value, FunctionType) or is_plain:
                found[f"{depth} {name}"] = value
    return ["class", cls.__qualname__, described(found, inside)]


def described_object(value: Any, inside: Inside) -> Any:
    """Class and attributes of an object, or what it shows itself as if it has none; of a scene, the hash of its geometry."""
    if hasattr(getattr(value, "state", None), "device_mesh"):
        return ["scene", scene_hash(value)]
    if is_dataclass(value):
        attributes = {field.name: getattr(value, field.name) for field in fields(value)}
    else:
        attributes = getattr(value, "__dict__", {})
    shown = described(attributes, inside) if attributes else ADDRESS.sub("", repr(value))
    return [described_class(type(value), inside), shown]


def code_of(function: Any) -> str:
    """SHA-256 of the code that makes rays, without the values that it reads: they may be other ones on another machine."""
    if hasattr(function, "code_hash"):
        return function.code_hash
    if isinstance(function, partial):
        return code_of(function.func)
    if isinstance(function, MethodType):
        return code_of(function.__func__)
    if isinstance(function, FunctionType):
        return code_hash(function.__code__)
    codes = {
        f"{depth} {name}": code_hash(value.__code__)
        for depth, one in enumerate(type(function).__mro__)
        for name, value in vars(one).items()
        if isinstance(value, FunctionType)
    }
    return hashlib.sha256(json.dumps(codes, sort_keys=True).encode()).hexdigest()

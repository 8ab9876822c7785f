"""Floating-point operations with which a triangle test computes its records, counted while the derivation runs.

A derivation (`Record.derive`) is Python source that Warp compiles. Here the same source runs in Python on numbers that count
what is done to them. A number remembers whether it depends on the rays' origin: what depends on it is done again for every
origin, the rest once for a triangle. The values come out as well, with the bits of the compiled derivation.

What is shared depends on how the source is written: a difference that stands there twice is computed, and counted, twice.
"""

from __future__ import annotations

import operator
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import FunctionType, SimpleNamespace
from typing import Any

import numpy as np
import warp as wp

from wrt.kernels.triangle.support.operation_counts import Operations
from wrt.kernels.triangle.support.record_blocks import Record

PER_TRIANGLE, PER_ORIGIN = 0, 1


@dataclass(frozen=True)
class Derivation:
    """What the derivation of one record did.

    Attributes:
        per_triangle: operations on numbers that do not depend on the origin.
        per_origin: the others.
        values: the record's own floats, float32.
    """

    per_triangle: Operations
    per_origin: Operations
    values: np.ndarray


Tally = tuple[Counter, Counter]
"""Kinds of operations, those on the triangle alone and those on the origin."""


def counted(kind: str, action: Callable[[Any, Any], Any]) -> Callable[[CountedFloat, CountedFloat | float], Any]:
    """An operator of `CountedFloat`."""

    def apply(self: CountedFloat, other: CountedFloat | float) -> Any:
        known = isinstance(other, CountedFloat)
        level = max(self.level, other.level) if known else self.level
        self.tally[level][kind] += 1
        with np.errstate(all="ignore"):
            result = action(self.value, other.value if known else type(self.value)(other))
        return bool(result) if kind == "compare" else CountedFloat(result, level, self.tally)

    return apply


class CountedFloat:
    """A NumPy float that counts what is done to it; `level` tells whether it depends on the origin."""

    def __init__(self, value: np.floating, level: int, tally: Tally) -> None:
        self.value, self.level, self.tally = value, level, tally

    __add__, __sub__ = counted("add", operator.add), counted("add", operator.sub)
    __mul__, __truediv__ = counted("multiply", operator.mul), counted("divide", operator.truediv)
    __ge__ = counted("compare", operator.ge)

    def __neg__(self) -> CountedFloat:
        return CountedFloat(-self.value, self.level, self.tally)

    def __abs__(self) -> CountedFloat:
        return CountedFloat(abs(self.value), self.level, self.tally)

    def rounded(self, dtype: type) -> CountedFloat:
        """The same number in another precision."""
        return CountedFloat(dtype(self.value), self.level, self.tally)


class CountedVector(list):
    """Counted components, or the rows of a matrix; operators work component by component."""

    def __init__(self, *components: Any) -> None:
        super().__init__(components[0] if len(components) == 1 else components)

    def __getitem__(self, at):
        return super().__getitem__(at[0])[at[1]] if isinstance(at, tuple) else super().__getitem__(at)

    def __sub__(self, other):
        return CountedVector([a - b for a, b in zip(self, other, strict=True)])

    def __neg__(self):
        return CountedVector([-a for a in self])


def rounded(value: Any, dtype: type) -> Any:
    """A number in another precision; an index stays what it is, as a plain float."""
    return value.rounded(dtype) if isinstance(value, CountedFloat) else float(value)


WARP = SimpleNamespace(
    vec3=CountedVector,
    vec3d=lambda *parts: CountedVector([rounded(value, np.float64) for value in CountedVector(*parts)]),
    matrix_from_rows=lambda *rows: CountedVector(rows),
    abs=abs,
    where=lambda condition, first, second: first if condition else second,
)
"""What derivations use of Warp, for counted numbers."""


def as_python(function: wp.Function, own: int) -> Callable[..., Any]:
    """The source of a Warp function, bound to counted numbers, with all functions that it calls."""
    source: FunctionType = function.func
    names: dict[str, Any] = {"wp": WARP, "float": lambda value: rounded(value, np.float32)}
    for name in source.__code__.co_names:
        value = source.__globals__.get(name)
        if isinstance(value, wp.Function):
            names[name] = as_python(value, own)
        elif isinstance(value, type) and getattr(value, "_length_", None) == own:
            names[name] = lambda: CountedVector([None] * own)
    return FunctionType(source.__code__, {**source.__globals__, **names})


def count_derivation(record: Record, corners: Sequence[Sequence[float]], origin: Sequence[float]) -> Derivation:
    """Runs the derivation of a record for one triangle.

    Args:
        record: of a test; one without values of its own takes no operations.
        corners: (3, 3), the triangle's vertices.
        origin: (3,), the common origin of the rays.
    """
    tally = Counter(), Counter()

    def vector(point: Sequence[float], level: int) -> CountedVector:
        return CountedVector([CountedFloat(np.float32(value), level, tally) for value in point])

    values: Sequence[Any] = ()
    if record.derive is not None:
        triangle = SimpleNamespace(**{name: vector(corner, PER_TRIANGLE) for name, corner in zip("abc", corners, strict=True)})
        values = as_python(record.derive, record.own)(triangle, vector(origin, PER_ORIGIN))
    plain = [value.value if isinstance(value, CountedFloat) else value for value in values]
    return Derivation(*(Operations(**kinds) for kinds in tally), np.array(plain, dtype=np.float32))

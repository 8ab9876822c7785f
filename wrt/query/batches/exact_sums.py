"""Exact sums of floats: they depend neither on the order of the values nor on how a batch is cut into blocks.

A value is an integer times a power of two. Integers are summed as int64, as long as the sum of as many values as there are
cannot overflow; values whose exponents differ by more are summed in bands of exponents, and float64 in two halves of its
mantissa. Sums of blocks are added as Python integers, which have any number of digits. The only rounding is at the end, to the
nearest float64. The idea of an accumulator as wide as all exponents is Kulisch's.

Reference:
    U. Kulisch: Very fast and exact accumulation of products. Computing 91(4), 2011.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

SMALLEST = -1074
"""Exponent of the smallest positive float64."""

MANTISSA = 27
"""Bits of a mantissa at most: of a float32, and of half a float64."""

BITS = 62
"""Bits of a sum in an int64."""


class ExactSum(NamedTuple):
    """A sum of floats.

    Attributes:
        total: int64, or Python integers in an array of objects: the sum of the finite values / 2^exponent.
        exponent: of the power of two.
        special: float64, the sum of the values that are not finite; 0 without any. Of the shape of `total`.
    """

    total: np.ndarray
    exponent: int
    special: np.ndarray

    def __add__(self, other: ExactSum) -> ExactSum:  # type: ignore[override]
        exponent = min(self.exponent, other.exponent)
        total = np.asarray(shifted(self, exponent) + shifted(other, exponent), dtype=object)
        with np.errstate(invalid="ignore"):
            return ExactSum(total, exponent, self.special + other.special)

    def rounded(self, divisor: int = 1) -> np.ndarray:
        """The float64 nearest to the sum / `divisor`; inf and NaN as they result from adding the values that are not finite."""
        flat = [nearest(int(number), self.exponent, divisor) for number in self.total.reshape(-1)]
        finite = np.array(flat, dtype=np.float64).reshape(self.total.shape)
        return np.where(self.special == 0.0, finite, self.special)


def exact_sum(values: np.ndarray, axes: tuple[int, ...]) -> ExactSum:
    """The sum of floats over some axes."""
    shape = tuple(n for axis, n in enumerate(values.shape) if axis not in axes)
    wide = values.astype(np.float64)
    finite = np.isfinite(wide)
    special = np.zeros(shape)
    if not finite.all():
        with np.errstate(invalid="ignore"):
            special = np.where(finite, 0.0, wide).sum(axis=axes)
        wide[~finite] = 0.0
    result = ExactSum(np.zeros(shape, dtype=np.int64), 0, special)
    parts = [wide]
    if values.dtype.itemsize > 4:
        high = (wide.view(np.int64) & ~np.int64((1 << MANTISSA - 1) - 1)).view(np.float64)
        parts = [high, wide - high]
    number = max(1, wide.size // max(1, int(np.prod(shape))))
    sums = [banded for part in parts for banded in band_sums(part, axes, number.bit_length())]
    for total, exponent in sums:
        band = ExactSum(total, exponent, np.zeros(shape))
        result = band._replace(special=special) if len(sums) == 1 else result + band
    return result


def band_sums(part: np.ndarray, axes: tuple[int, ...], digits: int) -> list[tuple[np.ndarray, int]]:
    """Sums of values with mantissas of at most `MANTISSA` bits, and their exponents: one for each band that values are in.

    Args:
        part: the values.
        axes: what is summed over.
        digits: bits of the number of values that go into one sum.
    """
    exponents = (part.view(np.int64) >> 52) & 0x7FF
    used = exponents[part != 0.0]
    if not used.size:
        return []
    sums = []
    low, high = int(used.min()), int(used.max())
    if low == 0:  # float64 below 2.2e-308, whose mantissas may have more bits; so rare that Python may add them
        tiny = np.ldexp(np.where(exponents == 0, part, 0.0), -SMALLEST).astype(np.int64)
        sums.append((np.asarray(tiny.astype(object).sum(axis=axes)), SMALLEST))
        low = 1
    while low <= high:
        unit = low - 1023 - MANTISSA + 1
        top = min(high, low + BITS - MANTISSA - digits)  # values are below 2^(top - 1022)
        is_all = low <= int(used.min()) and top == high
        inside = part if is_all else np.where((exponents >= low) & (exponents <= top), part, 0.0)
        sums.append((np.asarray(np.ldexp(inside, -unit).astype(np.int64).sum(axis=axes)), unit))
        low = top + 1
    return sums


def shifted(one: ExactSum, exponent: int) -> np.ndarray:
    """A total as Python integers, in units of a smaller power of two."""
    return one.total.astype(object) * (1 << one.exponent - exponent)


def nearest(number: int, exponent: int, divisor: int) -> float:
    """The float64 nearest to number * 2^exponent / divisor: Python rounds the quotient of integers correctly."""
    try:
        return (number << exponent) / divisor if exponent >= 0 else number / (divisor << -exponent)
    except OverflowError:
        return float("inf") if number > 0 else float("-inf")

"""Types of numbers on the command line: whole ones that kernels can count with, and real ones that float32 holds."""

from __future__ import annotations

from typing import Any

import click

MAX_INT = 2**31 - 1
"""Largest whole number: kernels count with 32 bits."""

LARGEST = 3.4e38
"""Largest real number, about that of float32."""


class Whole(click.IntRange):
    """A whole number from a least to a greatest one, both included.

    Args:
        min: least one; None for none.
        max: greatest one.
    """

    def __init__(self, min: int | None = None, max: int = MAX_INT) -> None:
        super().__init__(min, max)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        try:
            return super().convert(value, param, ctx)
        except ValueError:  # Python converts no more than some thousand digits
            self.fail(f"a number of {len(value):,} digits is out of range", param, ctx)

    def _describe_range(self) -> str:
        """The range in help pages and errors: without the bound that all have, unless it is the only one."""
        return f"x>={self.min}" if self.max == MAX_INT and self.min is not None else super()._describe_range()


class Real(click.FloatRange):
    """A real number in a range, finite as float32; arguments as in `click.FloatRange`."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = super().convert(value, param, ctx)
        if not abs(number) <= LARGEST:  # NaN, too, which every range has
            self.fail(f"{value!r} is not a finite number that float32 holds", param, ctx)
        return number

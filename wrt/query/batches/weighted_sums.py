"""Sums of weights, in groups: hours of shade by month, from the rays of a year.

Sums of float64 depend on their order, so that blocks of other sizes would have other results. So each weight is rounded to a
multiple of one power of two, of which all sums have fewer than 53 bits: they are exact, in any order. The product of weights
and booleans is by NumPy's own loops: threads of a BLAS wait for each other, which takes long where other programs use the
cores, too (notebooks/records/2026-11-28-whole-jobs.md).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from wrt.kernels.validation import as_numbers

PIECE = 1 << 17
"""Values that are converted at a time: 1 MB of float64."""

LEAST_EXPONENT = -1074
"""Of the smallest float64."""


@dataclass(frozen=True)
class WeightedSum:
    """Sums of the weights of what is true, along one axis of a batch; in groups, such as the hours of each month.

        months = hours * (month == np.arange(12)[:, None])                      # (12, suns)
        reduce = wrt.batches.WeightedSum(months)
        shade = scene.occluded_blocks(points, suns[:, None], reduce=reduce, axis=0).result()        # (points, 12)

    The same bits for any size of blocks and any executor: weights are rounded by at most 2^-52 of the sum of the absolute
    weights of a group, and their sums are exact.

    Attributes:
        weights: (D,) for the D rays along the axis, or (G, D) for G sums of each, which become the last axis of the result.

    Raises:
        TypeError: weights are not real numbers; later, answers that are not booleans.
        ValueError: weights of another shape, none, or ones that are not finite or whose sum is not; when blocks are made, an
            axis of another length, or more than one.
    """

    weights: Any
    _units: np.ndarray = field(init=False, repr=False, compare=False)
    _unit: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        weights = as_numbers("weights", self.weights, (None, None) if np.ndim(self.weights) == 2 else (None,))
        if not weights.size:
            raise ValueError(f"weights has the shape {weights.shape}; pass at least one")
        with np.errstate(over="ignore"):
            total = float(np.abs(weights).sum(axis=-1).max())
        if not np.isfinite(2.0 * total):
            raise ValueError("the sum of weights is too large for float64; pass smaller ones")
        unit = float(np.ldexp(1.0, max(int(np.frexp(total)[1]) - 51, LEAST_EXPONENT)))
        object.__setattr__(self, "weights", weights)
        object.__setattr__(self, "_units", np.rint(np.atleast_2d(weights) / unit))
        object.__setattr__(self, "_unit", unit)

    def check(self, shape: tuple[int, ...], axes: tuple[int, ...]) -> None:
        """Whether a batch fits.

        Args:
            shape: leading shape of the rays.
            axes: along which answers are reduced.

        Raises:
            ValueError: several axes, or one of another length than the weights.
        """
        if len(axes) != 1 or shape[axes[0]] != self.weights.shape[-1]:
            raise ValueError(
                f"weights of {self.weights.shape[-1]} rays need one axis of this length, and axis {list(axes)} of rays of "
                f"shape {tuple(shape)} was given; choose another axis, or other weights"
            )

    def part(self, values: np.ndarray, axes: tuple[int, ...], first: int = 0) -> Any:
        """The sums of a block, in units; arguments as in `Reduction`. first: number of the block's first row."""
        if values.dtype != np.bool_:
            raise TypeError(f"a wrt.batches.WeightedSum is of booleans, such as occlusion or is_hit, not of {values.dtype}")
        rows = np.moveaxis(values, axes[0], 0)
        begin = first if axes[0] == 0 else 0
        units, shape = self._units[:, begin : begin + len(rows)], rows.shape[1:]
        rows = rows.reshape(len(rows), -1)
        found = np.empty((rows.shape[1], len(units)))
        step = max(1, PIECE // max(len(rows), 1))
        for column in range(0, rows.shape[1], step):
            part = slice(column, column + step)
            found[part] = np.einsum("gd,dp->gp", units, rows[:, part].astype(np.float64)).T
        return found.reshape(*shape, len(units))

    def merge(self, one: Any, other: Any) -> Any:
        """The sums of two blocks; arguments as in `Reduction`."""
        return one + other

    def finish(self, state: Any) -> np.ndarray:
        """The sums, float64; the argument as in `Reduction`."""
        return state * self._unit if self.weights.ndim == 2 else state[..., 0] * self._unit

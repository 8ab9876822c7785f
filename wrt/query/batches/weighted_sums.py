"""Sums of weights, in groups: hours of shade by month, from the rays of a year.

Sums of float64 depend on their order, so that blocks of other sizes would have other results. So each weight is rounded to a
multiple of one power of two, of which all sums have fewer than 53 bits: they are exact, in any order, on all cores
(`wrt.kernels.fields.column_sums`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp

from wrt.instances.instance_boxes import address_of, on_device
from wrt.kernels.runtime.launch import launch
from wrt.kernels.validation import as_numbers

MIN_EXPONENT = -1074
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
        unit = float(np.ldexp(1.0, max(int(np.frexp(total)[1]) - 51, MIN_EXPONENT)))
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
        axis, begin = axes[0], first if axes[0] == 0 else 0
        units = self._units[:, begin : begin + values.shape[axis]]
        shape = values.shape[:axis] + values.shape[axis + 1 :]
        return sums_of_columns(np.moveaxis(values, axis, 0), units).reshape(*shape, len(units))

    def merge(self, one: Any, other: Any) -> Any:
        """The sums of two blocks; arguments as in `Reduction`."""
        return one + other

    def finish(self, state: Any) -> np.ndarray:
        """The sums, float64; the argument as in `Reduction`."""
        return state * self._unit if self.weights.ndim == 2 else state[..., 0] * self._unit


def sums_of_columns(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(P, G) sums of the weights of the rows in which each column is true; P is the product of the lengths of their axes.

    Args:
        values: (D, ...) booleans.
        weights: (G, D) whole numbers whose sums are exact.
    """
    from wrt.kernels.fields.column_sums import TILE, BooleanColumns, WeightedRows, sum_columns

    length, host, columns, rows = len(values), wp.get_device("cpu"), BooleanColumns(), WeightedRows()
    size = values.size // length if length else math.prod(values.shape[1:])
    sums = np.zeros((len(weights), size))
    if not values.size:
        return sums.T
    flat = values.reshape(length, size)  # a view of most arrays whose first or last axis is reduced
    if flat.strides not in ((size, 1), (1, length)):
        flat = np.ascontiguousarray(flat)
    groups, which = weights.T.nonzero()[::-1]
    begins = np.concatenate([[0], np.cumsum(np.bincount(which, minlength=length))])
    rows.count, rows.begins = len(weights), on_device(begins.astype(np.int32), wp.int32, host)
    rows.groups = on_device(groups.astype(np.int32), wp.int32, host)
    rows.weights = on_device(weights[groups, which], wp.float64, host)
    whole = flat if flat.strides[1] == 1 else flat.T
    columns.values = on_device(whole.view(np.uint8), wp.uint8, host)
    columns.row_stride, columns.column_stride = map(wp.int64, flat.strides)
    out = wp.array(ptr=address_of(sums), dtype=wp.float64, shape=sums.shape, device=host)
    launch(sum_columns, -(-size // TILE), [columns, rows, out], device=host, chunk=4)
    return np.ascontiguousarray(sums.T)

"""Reductions: what is kept of the answers to a batch while it runs, such as the number of rays of each point that are blocked.

A worker reduces its block to a **state**; states of blocks are merged, if the first axis is reduced too, and finished. Merging
gives the same bits in any order and for any size of blocks: counts are integers, sums of floats are exact
(`wrt.query.batches.exact_sums`) and rounded once, least and greatest values and logical ones have no rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
import warp as wp

from wrt.kernels.validation import as_numbers
from wrt.query.batches.block_outputs import ATTRIBUTES
from wrt.query.batches.exact_sums import ExactSum, exact_sum
from wrt.query.batches.weighted_sums import WeightedSum


class Reduction(Protocol):
    """A custom reduction implements these three methods, and its states can be pickled."""

    def part(self, values: np.ndarray, axes: tuple[int, ...]) -> Any:
        """The state of a block.

        Args:
            values: the answers for the block's rays, and for vectors a last axis of their components.
            axes: axes to reduce, from 0 up, of the rays' leading shape.
        """
        ...

    def merge(self, one: Any, other: Any) -> Any:
        """The state of two blocks together. The order must not matter.

        Args:
            one, other: states, of `part` or of `merge`.
        """
        ...

    def finish(self, state: Any) -> np.ndarray:
        """The result.

        Args:
            state: of all blocks.
        """
        ...


ReduceBy: TypeAlias = "str | Reduction | Callable[[np.ndarray, tuple[int, ...]], np.ndarray]"
"""What `reduce` takes, for one array."""


@dataclass(frozen=True)
class Sum:
    """Sums: of booleans and integers as int64, of floats the exact sum rounded to float64."""

    def part(self, values: np.ndarray, axes: tuple[int, ...]) -> Any:
        return exact_sum(values, axes) if values.dtype.kind == "f" else np.asarray(values.sum(axis=axes, dtype=np.int64))

    def merge(self, one: Any, other: Any) -> Any:
        return one + other

    def finish(self, state: Any) -> np.ndarray:
        return state.rounded() if isinstance(state, ExactSum) else state


@dataclass(frozen=True)
class Mean(Sum):
    """Means, float64: the exact sum divided by the number of values, and rounded once."""

    def part(self, values: np.ndarray, axes: tuple[int, ...]) -> Any:
        return super().part(values, axes), int(np.prod([values.shape[axis] for axis in axes]))

    def merge(self, one: Any, other: Any) -> Any:
        return one[0] + other[0], one[1] + other[1]

    def finish(self, state: Any) -> np.ndarray:
        total, number = state
        if number == 0:
            return np.full(total.total.shape if isinstance(total, ExactSum) else total.shape, np.nan)
        return total.rounded(number) if isinstance(total, ExactSum) else np.asarray(total / np.int64(number))


@dataclass(frozen=True)
class Extreme:
    """Least or greatest values; NaN if one of them is NaN. Of booleans: whether all or any are true."""

    function: np.ufunc

    def part(self, values: np.ndarray, axes: tuple[int, ...]) -> Any:
        values = values + values.dtype.type(0) if values.dtype.kind == "f" else values  # one zero, not two
        return np.asarray(self.function.reduce(values, axis=axes))

    def merge(self, one: Any, other: Any) -> Any:
        return self.function(one, other)

    def finish(self, state: Any) -> np.ndarray:
        return state


@dataclass(frozen=True)
class Histogram:
    """Numbers of values between edges, as `np.histogram` counts them: int64, with a last axis of one entry for each bin.

        scene.intersect_blocks(rays, reduce={"t": wrt.batches.Histogram(np.linspace(0.0, 100.0, 201))}).result()["t"]

    A bin contains its lower edge; the last one contains both. Values outside and NaN are not counted.

    Attributes:
        edges: (B + 1,) increasing numbers.

    Raises:
        ValueError: fewer than two edges, or edges that do not increase.
    """

    edges: Any

    def __post_init__(self) -> None:
        edges = as_numbers("edges", self.edges, finite=False)
        if edges.ndim != 1 or edges.size < 2 or not (np.diff(edges) > 0.0).all():
            raise ValueError(f"edges must be at least two increasing numbers, not {self.edges!r}")
        object.__setattr__(self, "edges", edges)

    def part(self, values: np.ndarray, axes: tuple[int, ...]) -> Any:
        """The counts of a block; arguments as in `Reduction`."""
        kept = [axis for axis in range(values.ndim) if axis not in axes]
        shape = tuple(values.shape[axis] for axis in kept)
        rows = values.transpose([*kept, *axes]).reshape(int(np.prod(shape)), -1)
        bins = self.edges.size - 1
        index = np.searchsorted(self.edges, rows, side="right") - 1
        index[rows == self.edges[-1]] = bins - 1
        inside = (index >= 0) & (index < bins)
        flat = (index + bins * np.arange(len(rows))[:, None])[inside]
        return np.bincount(flat, minlength=len(rows) * bins).astype(np.int64).reshape(*shape, bins)

    def merge(self, one: Any, other: Any) -> Any:
        """The counts of two blocks; arguments as in `Reduction`."""
        return one + other

    def finish(self, state: Any) -> np.ndarray:
        """The counts; the argument as in `Reduction`."""
        return state


@dataclass(frozen=True)
class OfRows:
    """A function of a block's answers: it is called with them and with the axes, and keeps the first axis."""

    function: Callable[[np.ndarray, tuple[int, ...]], Any]

    def part(self, values: np.ndarray, axes: tuple[int, ...]) -> Any:
        result = np.asarray(self.function(values, axes))
        if result.shape[:1] != values.shape[:1]:
            rows = values.shape[0]
            raise ValueError(f"the function of reduce returned shape {result.shape} for {rows} rows; keep the first axis")
        return result

    def merge(self, one: Any, other: Any) -> Any:
        raise ValueError(
            "reduce is a function, which cannot merge blocks along the first axis; leave axis 0 out of `axis`, or pass an "
            "object with the methods part, merge and finish (wrt.batches.Reduction)"
        )

    def finish(self, state: Any) -> np.ndarray:
        return state


REDUCTIONS: Mapping[str, Reduction] = {
    "sum": Sum(),
    "mean": Mean(),
    "min": Extreme(np.minimum),
    "max": Extreme(np.maximum),
    "any": Extreme(np.logical_or),
    "all": Extreme(np.logical_and),
}
"""Reductions by name."""


def as_reduction(given: Any, name: str) -> Reduction:
    """A reduction by its name, an object with the methods of one, or a function of rows.

    Raises:
        TypeError: none of them.
        ValueError: an unknown name.
    """
    if isinstance(given, str):
        if given == "histogram":
            raise ValueError(f"{name} 'histogram' needs edges; pass wrt.batches.Histogram(edges)")
        if given not in REDUCTIONS:
            raise ValueError(f"{name} {given!r} is unknown; choose from {', '.join(REDUCTIONS)}, or pass wrt.batches.Histogram")
        return REDUCTIONS[given]
    if all(hasattr(given, method) for method in ("part", "merge", "finish")):
        return given
    if not callable(given):
        raise TypeError(f"{name} must be a name, a wrt.batches.Reduction or a function, not {type(given).__name__}")
    return OfRows(given)


@dataclass(frozen=True)
class BlockReduction:
    """The reductions of a batch.

    Attributes:
        reductions: by attribute of hits; of a query with one value for each ray by "".
        axis: as the caller gave it: an axis or several of the rays' leading shape, or None for all.
    """

    reductions: Mapping[str, Reduction]
    axis: int | tuple[int, ...] | None

    def axes(self, dimensions: int) -> tuple[int, ...]:
        """The reduced axes of an N-dimensional batch, sorted.

        Raises:
            ValueError: there is no such axis, or it is named twice.
        """
        given = range(dimensions) if self.axis is None else np.atleast_1d(self.axis).tolist()
        axes = sorted(axis + dimensions if axis < 0 else axis for axis in given)
        if not axes or axes[0] < 0 or axes[-1] >= dimensions or len(set(axes)) < len(axes):
            raise ValueError(f"axis is {self.axis!r}, and rays have {dimensions} leading axes, numbered from 0; name each once")
        return tuple(axes)

    def check(self, shape: tuple[int, ...]) -> None:
        """Whether a batch of a leading shape can be reduced.

        Raises:
            ValueError: there is no such axis, or weights are for another length.
        """
        axes = self.axes(len(shape))
        for one in self.reductions.values():
            if isinstance(one, WeightedSum):
                one.check(shape, axes)

    def part(self, answer: Any, dimensions: int, first: int) -> dict[str, Any]:
        """The states of a block, whose first row has this number."""
        axes, states = self.axes(dimensions), {}
        for name, one in self.reductions.items():
            values = as_array(getattr(answer, name) if name else answer)
            states[name] = one.part(values, axes, first) if isinstance(one, WeightedSum) else one.part(values, axes)
        return states

    def merge(self, one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
        """The states of two blocks together."""
        return {name: reduction.merge(one[name], other[name]) for name, reduction in self.reductions.items()}

    def finish(self, states: dict[str, Any]) -> Any:
        """The results by attribute, or the one result."""
        results = {name: reduction.finish(states[name]) for name, reduction in self.reductions.items()}
        return results.get("", results)


def as_block_reduction(reduce: Any, axis: Any, is_closest: bool) -> BlockReduction | None:
    """The reductions of the arguments `reduce` and `axis`.

    Raises:
        TypeError, ValueError: as `wrt.Scene.intersect_blocks`.
    """
    if reduce is None:
        if axis is not None:
            raise ValueError("axis needs reduce: name what to do along it, such as reduce='sum'")
        return None
    if axis is not None and np.asarray(axis).dtype.kind not in "iu":
        raise TypeError(f"axis must be an int, several, or None for all, not {axis!r}")
    if not is_closest:
        return BlockReduction({"": as_reduction(reduce, "reduce")}, axis)
    if not isinstance(reduce, Mapping) or not reduce:
        raise ValueError(
            f"reduce must be a dict from attributes of wrt.Hits to reductions here, such as {{'t': 'min'}}, not {reduce!r}"
        )
    for name in reduce:
        if name not in ATTRIBUTES:
            raise ValueError(f"reduce has the key {name!r}; choose from {', '.join(ATTRIBUTES)}")
    return BlockReduction({name: as_reduction(given, f"reduce[{name!r}]") for name, given in reduce.items()}, axis)


def as_array(values: Any) -> np.ndarray:
    """An answer as a NumPy array."""
    return values.numpy() if isinstance(values, wp.array) else np.asarray(values)

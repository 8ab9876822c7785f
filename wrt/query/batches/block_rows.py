"""Where the rays of a batch come from, and the rows of a block cut out of them.

Sources: arrays and whatever else has a shape and slices (`np.memmap`, zarr, columns of parquet files), iterators, and functions
that make the rays of given numbers (`GeneratedRays`), so that no ray need be stored.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np
import warp as wp

from wrt.engine.rays.rays import Rays, leading_shape
from wrt.kernels.validation import as_float, as_int, convert_fields
from wrt.query.hits import Hits
from wrt.query.skip import SceneTriangles

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike


class HasRows(Protocol):
    """Arrays of which rows are read as they are needed, such as those of zarr."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    def __getitem__(self, rows: slice, /) -> Any: ...


RayRows: TypeAlias = "ArrayLike | HasRows | Rays | GeneratedRays | Iterable[tuple[ArrayLike, ArrayLike]] | Iterable[Rays]"
"""Origins of any number of rays, or the rays themselves."""

PointRows: TypeAlias = "ArrayLike | HasRows | Iterable[ArrayLike]"


@dataclass(frozen=True)
class GeneratedRays:
    """Rays that a function makes when a block needs them. They are never stored as a whole.

        def around(first, count):
            directions = np.random.default_rng(first).normal(size=(count, 3))
            return np.zeros(3), directions

        scene.occluded_blocks(wrt.batches.GeneratedRays(around, 10**12), reduce="sum", executor=executor)

    Attributes:
        function: called with the number of the first row and the number of rows; returns the pair (origins, directions) or the
            `wrt.Rays` of these rows. Workers in other processes get a pickle of it (by cloudpickle where that is installed). A
            batch is the same however it is cut only if a row depends on nothing but its number.
        shape: leading shape of the whole batch: the number of rows, or a tuple that begins with it.
        t_min, t_max: numbers, for functions that return a pair.

    Raises:
        TypeError: `function` cannot be called.
        ValueError: `shape` has no axis or a negative length.
    """

    function: Callable[[int, int], Any]
    shape: Any
    t_min: float = 0.0
    t_max: float = math.inf

    def __post_init__(self) -> None:
        convert_fields(self)
        lengths = self.shape if isinstance(self.shape, Iterable) and np.shape(self.shape) else (self.shape,)  # type: ignore[call-overload]
        shape = tuple(as_int("shape", length) for length in lengths)
        if not callable(self.function):
            raise TypeError(f"function must be called as function(first, count), not be {type(self.function).__name__}")
        if not shape or min(shape) < 0:
            raise ValueError(f"shape is {self.shape!r}; give the number of rows, or a tuple that begins with it")
        object.__setattr__(self, "shape", shape)

    def rows(self, begin: int, end: int) -> Rays:
        """The rays of rows begin .. end - 1.

        Raises:
            TypeError: the function returned something else than rays.
            ValueError: it returned another number of rays.
        """
        made, wanted = self.function(begin, end - begin), (end - begin, *self.shape[1:])
        rays = _as_item(made, self.t_min, self.t_max, f"function({begin}, {end - begin})")
        if rays.shape != wanted:
            raise ValueError(f"function({begin}, {end - begin}) returned rays of shape {rays.shape}; they must be {wanted}")
        return rays


class SkippedTriangles:
    """Triangles to skip, numbered through all meshes: those of the hits at which rays start. They can be cut into rows.

    Args:
        numbers: (...) int32, -1 for none.
    """

    def __init__(self, numbers: np.ndarray) -> None:
        self.numbers, self.shape = numbers, numbers.shape

    def __getitem__(self, rows: slice) -> SkippedTriangles:
        return SkippedTriangles(self.numbers[rows])

    def on(self, device: wp.Device) -> SceneTriangles:
        """The triangles on a scene's device."""
        return SceneTriangles(wp.array(np.ascontiguousarray(self.numbers), dtype=wp.int32, device=device))


Source = Rays | GeneratedRays | Iterator[Rays]


def as_source(origins: Any, directions: Any, t_min: Any, t_max: Any) -> Any:
    """Rays whose arrays can be sliced, a function that makes them, or an iterator over such rays."""
    if isinstance(origins, GeneratedRays):
        if directions is not None:
            raise TypeError("pass either wrt.batches.GeneratedRays, or origins and directions, not both")
        if np.ndim(t_min) or np.ndim(t_max):
            raise ValueError(
                f"t_min and t_max must be numbers, not of shapes {np.shape(t_min)} and {np.shape(t_max)}, if a function makes "
                "the rays; let it return wrt.Rays instead"
            )
        t_min, t_max = as_float("t_min", t_min), as_float("t_max", t_max)
        return replace(origins, t_min=max(origins.t_min, t_min), t_max=min(origins.t_max, t_max))
    if isinstance(origins, Rays):
        if directions is not None:
            raise TypeError("pass either a wrt.Rays, or origins and directions, not both")
        return Rays(*(sliceable(a) for a in (origins.origins, origins.directions, origins.t_min, origins.t_max)))
    if directions is not None:
        return Rays(*(sliceable(a) for a in (origins, directions, t_min, t_max)))
    if hasattr(origins, "shape") or not isinstance(origins, Iterable):
        raise TypeError("directions is missing; pass origins and directions, a wrt.Rays, or an iterator of pairs of them")
    if np.ndim(t_min) or np.ndim(t_max):
        raise ValueError(
            f"t_min and t_max must be numbers, not of shapes {np.shape(t_min)} and {np.shape(t_max)}, if the rays come from an "
            "iterator; let it give wrt.Rays instead"
        )
    return _items(origins, t_min, t_max)


def _items(source: Iterable[Any], t_min: float, t_max: float) -> Iterator[Rays]:
    for number, item in enumerate(source):
        yield _as_item(item, t_min, t_max, f"item {number} of the iterator")


def _as_item(item: Any, t_min: float, t_max: float, name: str) -> Rays:
    """Rays from an iterator or a function: a pair of arrays, or a `wrt.Rays`."""
    if isinstance(item, Rays):
        return as_source(item, None, 0.0, 0.0)
    if isinstance(item, (tuple, list)) and len(item) == 2:
        return as_source(*item, t_min, t_max)  # type: ignore[call-arg]
    raise TypeError(f"{name} must be (origins, directions) or a wrt.Rays, not {item!r:.60}")


def as_column(values: Any, name: str, scene: Any, source: Source) -> Any:
    """A mask, environment or `skip` as a number, or as rows that are cut with the rays.

    Raises:
        ValueError: rows, and the rays come from an iterator; hits of another scene.
    """
    if isinstance(values, Hits):
        if not values.is_of(scene.state):
            raise ValueError(f"{name} holds hits of another scene; pass hits of this scene")
        values = SkippedTriangles(values.batch.primitive.numpy().reshape(values.shape))
    if values is None or np.isscalar(values):
        return values
    values = sliceable(values)
    if len(values.shape) and not isinstance(source, (Rays, GeneratedRays)):
        raise ValueError(
            f"{name} must be one number, not of shape {values.shape}, if the rays come from an iterator; pass rays and {name} "
            "as arrays instead"
        )
    return values


def rows_of(rays: Rays | GeneratedRays, axes: int, begin: int, end: int) -> Rays:
    """Rows begin .. end - 1 of rays with `axes` leading axes; arrays shared by all rows stay whole."""
    if isinstance(rays, GeneratedRays):
        return rays.rows(begin, end)
    vectors = (cut_rows(a, leading_shape(a), axes, begin, end) for a in (rays.origins, rays.directions))
    return Rays(*vectors, *(cut_rows(a, np.shape(a), axes, begin, end) for a in (rays.t_min, rays.t_max)))


def cut_rows(values: Any, shape: tuple[int, ...], axes: int, begin: int, end: int) -> Any:
    """Rows begin .. end - 1 of an array with this leading shape; the whole array if all rows share it."""
    return values[begin:end] if is_cut(shape, axes) else values


def is_cut(shape: tuple[int, ...], axes: int) -> bool:
    """Whether each row of a batch with `axes` leading axes has its own part of an array with this leading shape."""
    return len(shape) == axes > 0 and shape[0] != 1


def sliceable(values: Any) -> Any:
    """What has a shape, and numbers, as they are; other sequences as arrays."""
    return values if hasattr(values, "shape") or np.isscalar(values) else np.asarray(values)


def rows_shape(rays: Rays | GeneratedRays, what: str) -> tuple[int, ...]:
    """The leading shape of rays.

    Raises:
        ValueError: there is no axis to cut.
    """
    shape = rays.shape
    if not shape:
        raise ValueError(f"{what} must have a leading axis to cut into blocks: pass origins or directions of shape (N, 3)")
    return shape

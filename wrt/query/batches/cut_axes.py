"""Along which axis a batch is cut into blocks: the first one, unless that is reduced and the state of a block is large.

**Problem.** Of 218,152 places and 420 suns, sums over the suns, axis 0, have a state of all places. A block of 200,000 rays is a
part of one sun then, and its state as large as what was computed.

**Method.** The first axis that is kept comes to the front of the batch: a block has all suns for some places, its sums are
finished, and nothing is merged. The rays of a block are traced in the order that the caller gave them, sun by sun.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from wrt.engine.rays.rays import Rays
from wrt.query.batches.block_rows import SkippedTriangles
from wrt.query.batches.block_work import BlockWork

SMALL_SHARE = 64
"""Rays of a block for each element of its state, from which the state counts little."""


def front_axis(work: BlockWork, shape: tuple[int, ...], most: int) -> int:
    """The axis along which a batch is cut best.

    Args:
        work: of the batch.
        shape: its leading shape.
        most: rays of a block at most.
    """
    rays, reduction, query = work.rays, work.query.reduction, work.query
    if reduction is None or not query.merges_rows(len(shape)) or query.method == "closest_point" or not reduction.is_built_in:
        return 0
    arrays = [*vars(rays).values(), *work.columns.values()] if isinstance(rays, Rays) else [None]
    kept = [axis for axis in range(len(shape)) if axis not in reduction.axes(len(shape))]
    if not kept or not all(isinstance(one, (np.ndarray, SkippedTriangles)) or np.isscalar(one) for one in arrays):
        return 0
    a_row = math.prod(shape) // max(shape[kept[0]], 1)
    if a_row > most or math.prod(shape) <= most or most // max(math.prod(shape[1:]), 1) >= SMALL_SHARE:
        return 0
    return kept[0]


def with_front(work: BlockWork, axis: int) -> BlockWork:
    """The work on a batch of which an axis has come to the front.

    Raises:
        ValueError: there is no such axis, or it is reduced, or rays of a function or an iterator.
    """
    query, axes = work.query, work.axes
    if not isinstance(work.rays, Rays) or query.reduction is None or axis >= axes or axis in query.reduction.axes(axes):
        raise ValueError(f"a batch of {axes} axes that is cut along axis {axis} is another one")
    rays = Rays(*(moved(values, axes, axis, name in ("origins", "directions")) for name, values in vars(work.rays).items()))
    columns = {name: moved(values, axes, axis) for name, values in work.columns.items()}
    reduced = tuple(one + 1 if one < axis else one for one in query.reduction.axes(axes))
    query = replace(query, reduction=replace(query.reduction, axis=reduced), front=axis)
    return replace(work, rays=rays, columns=columns, query=query)


def moved(values: Any, axes: int, axis: int, is_vector: bool = False) -> Any:
    """A view of an array that broadcasts to a batch of some axes, one of which has come to the front; numbers as they are."""
    if isinstance(values, SkippedTriangles):
        return SkippedTriangles(moved(values.numbers, axes, axis))
    leading = np.shape(values)[:-1] if is_vector else np.shape(values)
    if not leading:
        return values
    whole = values.reshape((1,) * (axes - len(leading)) + values.shape)
    return np.moveaxis(whole, axis, 0)

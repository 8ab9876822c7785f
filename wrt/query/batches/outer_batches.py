"""Batches whose first axis is reduced, such as the suns of `occluded_blocks(points, suns[:, None], reduce="sum", axis=0)`.

Cut along that axis, each block has a state for all points, which is stored, read and merged as often as there are blocks, and
that may take longer than the rays. Where every array varies along reduced axes or along others, but not along both, the axes
can be exchanged by views: those that are kept go first, and a block has few points with all of their suns. Answers are the
same, since reductions give the same bits in any order.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from wrt.engine.rays.rays import Rays
from wrt.query.batches.block_rows import SkippedTriangles
from wrt.query.batches.reductions import BlockReduction, OfRows

VECTORS = ("origins", "directions")
"""Arrays with a last axis of three components."""


def kept_axes_first(
    rays: Any, columns: Mapping[str, Any], reduction: BlockReduction | None
) -> tuple[Any, Mapping[str, Any], BlockReduction | None]:
    """A batch with the reduced axes last, if its first axis is reduced and views can exchange them; otherwise as it is.

    Args:
        rays: of the batch.
        columns: mask, environment and skip, as numbers or for each ray.
        reduction: of the answers.

    Raises:
        ValueError: there is no such axis, or weights are for another length.
    """
    if not isinstance(rays, Rays) or reduction is None or any(isinstance(one, OfRows) for one in reduction.reductions.values()):
        return rays, columns, reduction
    dimensions = len(rays.shape)
    if dimensions < 2:
        return rays, columns, reduction
    reduction.check(rays.shape)
    reduced = reduction.axes(dimensions)
    kept = [axis for axis in range(dimensions) if axis not in reduced]
    arrays = {**vars(rays), **columns}
    if reduced[0] != 0 or not kept or not all(_is_product(name, one, dimensions, reduced) for name, one in arrays.items()):
        return rays, columns, reduction
    order = [*kept, *reduced]
    turned = {name: _turned(name, one, dimensions, order) for name, one in arrays.items()}
    own = {name: turned.pop(name) for name in columns}
    return Rays(**turned), own, replace(reduction, axis=tuple(range(len(kept), dimensions)))


def _leading(name: str, values: Any, dimensions: int) -> np.ndarray:
    """An array with all leading axes of the batch, those along which it is the same with one entry."""
    values = values.numbers if isinstance(values, SkippedTriangles) else values
    missing = dimensions - (values.ndim - (name in VECTORS))
    return values.reshape((1,) * missing + values.shape)


def _is_product(name: str, values: Any, dimensions: int, reduced: tuple[int, ...]) -> bool:
    """Whether values are a number, or an array in memory that varies along reduced axes or along others only."""
    if np.isscalar(values):
        return True
    if type(values) is not np.ndarray and not isinstance(values, SkippedTriangles):
        return False
    lengths = _leading(name, values, dimensions).shape[:dimensions]
    return not (
        any(lengths[axis] > 1 for axis in reduced) and any(n > 1 for axis, n in enumerate(lengths) if axis not in reduced)
    )


def _turned(name: str, values: Any, dimensions: int, order: list[int]) -> Any:
    """Values with their leading axes in another order, as a view."""
    if np.isscalar(values):
        return values
    found = _leading(name, values, dimensions).transpose([*order, *([dimensions] if name in VECTORS else [])])
    return SkippedTriangles(found) if isinstance(values, SkippedTriangles) else found

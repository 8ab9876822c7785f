"""Batches whose first axis is reduced, such as the suns of `occluded_blocks(points, suns[:, None], reduce="sum", axis=0)`.

Cut along that axis, each block has a state for all points, which is stored, read and merged as often as there are blocks, and
that may take longer than the rays. Where every array varies along reduced axes or along others, but not along both, the axes
can be exchanged by views: those that are kept go first, and a block has few points with all of their suns. Answers are the
same, since reductions give the same bits in any order.

Within a block, neighbours are traced together: those of many columns and few rows. Where rows are places and columns
directions, the block is turned if that brings rays nearer to each other: if places are 0.2 m apart, say, and suns 1.4 degrees,
which are 0.2 m after 8 m.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from wrt.engine.rays.rays import Rays
from wrt.query.batches.block_rows import SkippedTriangles
from wrt.query.batches.reductions import BlockReduction, Extreme, OfRows, Sum
from wrt.query.batches.weighted_sums import WeightedSum

VECTORS = ("origins", "directions")
"""Arrays with a last axis of three components."""

COLUMNS = 32
"""Least number of places of a block that is turned: as many columns of packets are tested together
(`wrt.kernels.traversal.packet.core.joined_packets`)."""

LOOKS = 64
"""Neighbours whose distances are looked at."""

WAY = 0.25
"""Part of the diagonal of a scene after which rays to different directions are compared with rays from different places."""


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


def places_last(
    scene: Any, rays: Rays, columns: Mapping[str, Any], reduction: BlockReduction
) -> tuple[Rays, Mapping[str, Any]] | None:
    """A block of places (rows) and directions (columns), turned; None if it is another one, or better as it is.

    Args:
        scene: with `bounds`.
        rays: of the block.
        columns: mask, environment and skip, as numbers or for each ray.
        reduction: of the answers, one for each ray.
    """
    shape, arrays = rays.shape, {**vars(rays), **columns}
    origins, directions = rays.origins, rays.directions
    usual = all(isinstance(one, (Sum, Extreme, WeightedSum)) for one in reduction.reductions.values())
    if len(shape) != 2 or shape[0] < COLUMNS or shape[1] < 2 or not usual:
        return None
    if not all(np.isscalar(one) or isinstance(one, (np.ndarray, SkippedTriangles)) for one in arrays.values()):
        return None
    if _leading("origins", origins, 2).shape[:2] != (shape[0], 1) or _leading("directions", directions, 2).shape[:2] != (
        1,
        shape[1],
    ):
        return None
    ways = directions.reshape(-1, 3)
    lengths = np.linalg.norm(ways, axis=1, keepdims=True)
    way = WAY * np.linalg.norm(np.subtract(*scene.bounds))
    with np.errstate(all="ignore"):
        if not _step(origins.reshape(-1, 3)) < way * _step(ways / lengths):
            return None
    turned = {name: _turned(name, one, 2, [1, 0]) for name, one in arrays.items()}
    return Rays(**{name: turned.pop(name) for name in vars(rays)}), turned


def _step(points: np.ndarray) -> float:
    """The median of some distances of neighbours."""
    at = np.linspace(0, len(points) - 2, min(LOOKS, len(points) - 1)).astype(np.int64)
    return float(np.median(np.linalg.norm(points[at + 1] - points[at], axis=1)))


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

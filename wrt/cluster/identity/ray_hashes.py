"""Hashes of rays, by which a job notices that it is not the one that its folder began with.

Batches of arrays of up to 256 MB each are hashed whole, block by block, so that every block can be compared when it is
computed. Of larger arrays, 64 pieces of 1 MB that are spread evenly over them are hashed, and of files the size and the time of
the last change. Of rays that a function makes, up to a million (2^20) are made and hashed, in up to 64 pieces that are spread
evenly over the batch, and its code. What differs between these pieces only is not noticed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from wrt.cluster.identity.array_hashes import PIECES, array_hash, hashed, sampled_hash, size_of
from wrt.cluster.identity.described import code_of
from wrt.engine.rays.rays import Rays, leading_shape
from wrt.query.batches.block_rows import GeneratedRays, SkippedTriangles, cut_rows, is_cut
from wrt.query.batches.block_work import BlockWork

WHOLE = 1 << 28
"""Bytes up to which arrays are hashed whole."""

MADE = 1 << 20
"""Rays that a function makes for the hash at most, but one row a piece."""


def named_arrays(rays: Any, columns: Mapping[str, Any]) -> dict[str, Any]:
    """The arrays and numbers of some rays by name."""
    columns = {name: one.numbers if isinstance(one, SkippedTriangles) else one for name, one in columns.items()}
    return {**vars(rays), **columns}


def block_hash(rays: Rays, columns: Mapping[str, Any]) -> str:
    """The hash of the rays of a block, with their masks, environments and triangles to skip."""
    return joint_hash({name: array_hash(values) for name, values in named_arrays(rays, columns).items()})


def joint_hash(hashes: Mapping[str, str]) -> str:
    """The hash of arrays, from their own by name."""
    return hashed(sorted(hashes.items()))


def is_whole(work: BlockWork) -> bool:
    """Whether the rays of a batch are hashed whole, block by block."""
    return isinstance(work.rays, Rays) and all(size_of(one) <= WHOLE for one in named_arrays(work.rays, work.columns).values())


def hashes_of_blocks(work: BlockWork, length: int, rows: int) -> list[str]:
    """The hash of each block of a batch of arrays. Arrays that all blocks share are hashed once.

    Args:
        work: of the batch.
        length: number of rows.
        rows: of a block.
    """
    arrays, shared, cut = named_arrays(work.rays, work.columns), {}, {}
    for name, values in arrays.items():
        shape = leading_shape(values) if name in ("origins", "directions") else np.shape(values)
        if is_cut(shape, work.axes):
            cut[name] = values, shape
        else:
            shared[name] = array_hash(values)
    found = []
    for begin in range(0, length, rows):
        own = {name: cut_rows(values, shape, work.axes, begin, begin + rows) for name, (values, shape) in cut.items()}
        found.append(joint_hash(shared | {name: array_hash(values) for name, values in own.items()}))
    return found


def rays_hash(work: BlockWork, blocks: list[str] | None) -> str:
    """The hash of a batch of rays, and of its masks, environments and the triangles to skip.

    Args:
        work: of the batch.
        blocks: the hash of each block (`hashes_of_blocks`); None if the batch is not hashed whole.
    """
    if blocks is not None:
        return hashed(["whole", list(work.rays.shape), blocks])
    if isinstance(work.rays, GeneratedRays):
        arrays, made = named_arrays(Rays(0.0, 0.0), work.columns), generated_hash(work.rays)  # type: ignore[call-overload]
    else:
        arrays, made = named_arrays(work.rays, work.columns), None
    each = {name: (array_hash if size_of(one) <= WHOLE else sampled_hash)(one) for name, one in arrays.items()}
    return hashed(["parts", list(work.rays.shape), made, joint_hash(each)])


def generated_hash(source: Any) -> str:
    """The hash of rays that a function makes, from pieces of them, and of its code.

    Raises:
        TypeError, ValueError: as `wrt.batches.GeneratedRays.rows`; and what the function raises.
    """
    length, each = source.shape[0], max(1, math.prod(source.shape[1:]))
    rows = max(1, MADE // (PIECES * each))
    begins = range(0, length, rows)
    if len(begins) > PIECES:
        begins = np.unique(np.linspace(0, length - rows, max(2, min(PIECES, MADE // each))).astype(np.int64)).tolist()
    found = [block_hash(source.rows(begin, min(begin + rows, length)), {}) for begin in begins]
    return hashed(["generated", list(source.shape), source.t_min, source.t_max, code_of(source.function), *found])

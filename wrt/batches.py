"""Queries of more rays than memory holds, block by block.

rays = wrt.batches.GeneratedRays(count, make)                   # rays that a function makes, rows by rows
blocks = scene.occluded_blocks(rays, block_rays=1 << 22)        # a `Blocks`
histogram = wrt.batches.Histogram(edges)                        # a `Reduction`, for reduce=
"""

from __future__ import annotations

from wrt.lazy_names import lazy_names

_HOME = {
    "Blocks": "wrt.query.blocks",
    "GeneratedRays": "wrt.query.batches.block_rows",
    "Histogram": "wrt.query.batches.reductions",
    "Reduction": "wrt.query.batches.reductions",
}

__all__ = [*_HOME]

__getattr__, __dir__ = lazy_names(__name__, _HOME)

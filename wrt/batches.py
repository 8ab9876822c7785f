"""Queries of more rays than memory holds, block by block.

    rays = wrt.batches.GeneratedRays(make, 10**9)               # rays that a function makes, some rows at a time
    blocks = scene.intersect_blocks(rays, reduce={"t": wrt.batches.Histogram(edges)})
    blocks.result()["t"]                                        # of `Blocks`

Workers in other processes and on other machines are in `wrt.cluster`.
"""

from __future__ import annotations

from wrt.lazy_names import lazy_names

_HOME = {
    "Blocks": "wrt.query.blocks",
    "GeneratedRays": "wrt.query.batches.block_rows",
    "Histogram": "wrt.query.batches.reductions",
    "Reduction": "wrt.query.batches.reductions",
    "WeightedSum": "wrt.query.batches.weighted_sums",
}

__all__ = [*_HOME]

__getattr__, __dir__ = lazy_names(__name__, _HOME)

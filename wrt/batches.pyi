# Written by `python -m tests.typed.stubs` from the table of names in wrt/batches.py.
from wrt.query.batches.block_rows import GeneratedRays as GeneratedRays
from wrt.query.batches.reductions import Histogram as Histogram
from wrt.query.batches.reductions import Reduction as Reduction
from wrt.query.batches.weighted_sums import WeightedSum as WeightedSum
from wrt.query.blocks import Blocks as Blocks

__all__ = [
    "Blocks",
    "GeneratedRays",
    "Histogram",
    "Reduction",
    "WeightedSum",
]

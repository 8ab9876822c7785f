"""Whether a ray hits anything. The search ends at the first hit that is found."""

import warp as wp

from wrt.kernels.answers.answer_kind import AnswerKind, BestHit, Instances, Rules, Stored, join_nearest, start
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.simd.boxes import INFINITY


@wp.func
def load_any(hits: HitBatch, i: int, t_max: float):
    """No hit: rays with one are not traced again."""
    return start(t_max)


@wp.func
def store_any(hits: HitBatch, i: int, best: BestHit):
    """Stores whether ray i has a hit."""
    hits.occluded[i] = best.primitive >= 0


@wp.func
def bound_any(hits: HitBatch, i: int, t_max: float):
    """-inf for a ray with a hit."""
    return wp.where(hits.occluded[i], -INFINITY, t_max)


@wp.func
def copy_any(found: HitBatch, place: int, hits: HitBatch, i: int):
    """Copies whether there is a hit."""
    hits.occluded[i] = found.occluded[place]


@wp.func
def merge_any(found: HitBatch, place: int, primitive: int, hits: HitBatch, i: int):
    """Whether a hit was found, which ray i then has."""
    if found.occluded[place]:
        hits.occluded[i] = True
    return found.occluded[place]


KIND = AnswerKind(
    "any",
    Rules(ends_at_first=True),
    Stored(("occluded",), (), load_any, store_any, bound_any, copy_any, merge_any),
    instances=Instances(join_nearest),
)

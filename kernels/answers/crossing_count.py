"""The number of crossings of a ray with the surface."""

import warp as wp

from wrt.kernels.answers.answer_kind import AnswerKind, BestHit, Instances, Rules, Search, Stored, join_counts, start
from wrt.kernels.layout.ray_batch import HitBatch


@wp.func
def accept_count(hits: wp.ref[HitBatch], i: int, best: BestHit, t: float, primitive: int, u: float, v: float):
    """Counts a crossing."""
    best.primitive += 1
    return best


@wp.func
def load_count(hits: HitBatch, i: int, t_max: float):
    """The crossings of ray i that are stored."""
    best = start(t_max)
    best.primitive = hits.counts[i] - 1
    return best


@wp.func
def store_count(hits: HitBatch, i: int, best: BestHit):
    """Stores the number of crossings of ray i."""
    hits.counts[i] = best.primitive + 1


@wp.func
def bound_count(hits: HitBatch, i: int, t_max: float):
    """t_max: crossings do not shorten a ray."""
    return t_max


@wp.func
def copy_count(found: HitBatch, place: int, hits: HitBatch, i: int):
    """Copies a number of crossings."""
    hits.counts[i] = found.counts[place]


@wp.func
def merge_count(found: HitBatch, place: int, primitive: int, hits: HitBatch, i: int):
    """Adds the crossings that were found; whether that changed the number."""
    hits.counts[i] = hits.counts[i] + found.counts[place]
    return found.counts[place] != 0


COUNTS = Stored(("counts",), (), load_count, store_count, bound_count, copy_count, merge_count)
"""The numbers of crossings."""

KIND = AnswerKind("count", Rules(crossings=True, once=True), COUNTS, Search(accept=accept_count), Instances(join_counts))

"""The closest hit of a ray: t, triangle, and the weights of its vertices."""

import warp as wp

from wrt.kernels.answers.answer_kind import HIT_COLUMNS, AnswerKind, BestHit, Instances, Rules, Stored, join_nearest, start
from wrt.kernels.layout.ray_batch import HitBatch, store_hit


@wp.func
def load_closest(hits: HitBatch, i: int, t_max: float):
    """The best hit that is stored for ray i."""
    best = start(t_max)
    if hits.primitive[i] >= 0:
        best = BestHit(hits.t[i], hits.primitive[i], hits.uv[i][0], hits.uv[i][1])
    return best


@wp.func
def store_closest(hits: HitBatch, i: int, best: BestHit):
    """Stores the best hit of ray i."""
    store_hit(hits, i, best.t, best.primitive, best.u, best.v)


@wp.func
def bound_closest(hits: HitBatch, i: int, t_max: float):
    """t of the best hit of ray i, inf for none, or its t_max."""
    return wp.min(hits.t[i], t_max)


@wp.func
def copy_closest(found: HitBatch, place: int, hits: HitBatch, i: int):
    """Copies a hit."""
    hits.t[i] = found.t[place]
    hits.primitive[i] = found.primitive[place]
    hits.uv[i] = found.uv[place]


@wp.func
def merge_closest(found: HitBatch, place: int, primitive: int, hits: HitBatch, i: int):
    """Keeps the nearer hit, at the same t that of the smaller triangle id; whether it is the one that was found."""
    t = found.t[place]
    is_nearer = t < hits.t[i] or (t == hits.t[i] and primitive < hits.primitive[i])
    if is_nearer:
        hits.t[i] = t
        hits.primitive[i] = primitive
        hits.uv[i] = found.uv[place]
    return is_nearer


KIND = AnswerKind(
    "closest",
    Rules(shortens=True, front_to_back=True),
    Stored(HIT_COLUMNS, (), load_closest, store_closest, bound_closest, copy_closest, merge_closest),
    instances=Instances(join_nearest),
)

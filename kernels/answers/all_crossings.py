"""All crossings of a ray with the surface, in the order in which they are found; `wrt.kernels.query.hit_lists` sorts them.

The lists of parts are not merged: a scene on disk does not answer this query. Through instances, a ray's hits are counted first
and then written one after the other.
"""

from dataclasses import replace

import warp as wp

from wrt.kernels.answers.answer_kind import HIT_COLUMNS, AnswerKind, BestHit, Instances, Rules, Search, join_counts
from wrt.kernels.answers.crossing_count import COUNTS
from wrt.kernels.layout.ray_batch import HitBatch


@wp.func
def place_of(hits: wp.ref[HitBatch], i: int, number: int):
    """Element for hit `number` of ray i; -1 if it does not fit."""
    place = i * hits.room + number
    if hits.room == 0:
        place = hits.begins[i] + number
    elif number >= hits.room:
        place = -1
    return place


@wp.func
def accept_all(hits: wp.ref[HitBatch], i: int, best: BestHit, t: float, primitive: int, u: float, v: float):
    """Counts a crossing, and lists it if it fits."""
    best.primitive += 1
    place = place_of(hits, i, best.primitive)
    if place >= 0:
        hits.t[place] = t
        hits.primitive[place] = primitive
        hits.uv[place] = wp.vec2(u, v)
    return best


@wp.func
def renumber_all(hits: wp.ref[HitBatch], i: int, count: int, first: int):
    """Numbers the last `count` hits of ray i, of an instance whose triangles follow `first`, through the scene.

    The next hits of the ray are listed after them.
    """
    begin = hits.begins[i]
    for place in range(begin, begin + count):
        hits.primitive[place] = hits.primitive[place] + first
    hits.begins[i] = begin + count


KIND = AnswerKind(
    "all",
    Rules(crossings=True, once=True, front_to_back=True),
    replace(COUNTS, listed=HIT_COLUMNS, merge=None),
    Search(accept=accept_all),
    Instances(join_counts, renumber_all),
)

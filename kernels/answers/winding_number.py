"""The winding number of a ray's origin: the crossings of the ray with the surface, each with its sign.

A crossing counts 1 where the ray leaves through the front of a triangle, and -1 where it comes in through it. Around a closed
surface the sum does not depend on the direction: it says how often the surface winds around the origin. The signs are those of
the areas by which the triangle test decides about the crossing, so they are as exact as the crossings themselves.

References: jacobson-2013 (the same number for points, as a sum of solid angles).
"""

import warp as wp

from wrt.kernels.answers.answer_kind import AnswerKind, BestHit, Instances, Rules, Search, join_counts
from wrt.kernels.answers.crossing_count import COUNTS
from wrt.kernels.layout.ray_batch import HitBatch


@wp.func
def accept_signed(hits: wp.ref[HitBatch], i: int, best: BestHit, t: float, primitive: int, sign: float, v: float):
    """Adds the sign of a crossing."""
    best.primitive += wp.where(sign > 0.0, 1, -1)
    return best


KIND = AnswerKind(
    "winding",
    Rules(crossings=True, oriented=True, once=True),
    COUNTS,
    Search(accept=accept_signed),
    Instances(join_counts),
)

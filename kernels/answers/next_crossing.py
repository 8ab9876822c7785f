"""The crossing that follows a given one, by t, then by triangle.

Kernels of users ask for it (`wrt.kernels.query.device_functions`). If it is found in two leaves of a kd-tree, it is still the
same crossing.
"""

import warp as wp

from wrt.kernels.answers.answer_kind import AnswerKind, BestHit, Instances, Rules, Search, improves, join_nearest


@wp.struct
class PreviousCrossing:
    """Only crossings after this one count, ordered by t, then by triangle."""

    t: float
    primitive: int
    """-1 if there is none."""


@wp.func
def accept_next(previous: wp.ref[PreviousCrossing], i: int, best: BestHit, t: float, primitive: int, u: float, v: float):
    """Keeps the first crossing that follows the given one."""
    is_later = t > previous.t or (t == previous.t and primitive > previous.primitive)
    if is_later and improves(t, primitive, previous.t, best):
        best.t = t
        best.primitive = primitive
        best.u = u
        best.v = v
    return best


@wp.func
def next_within(first: int, previous: PreviousCrossing):
    """The crossing after which those of an instance count: a number below 0 precedes all its triangles."""
    own = previous  # a copy
    own.primitive = previous.primitive - first
    return own


KIND = AnswerKind(
    "next",
    Rules(shortens=True, crossings=True, front_to_back=True),
    search=Search(PreviousCrossing, accept_next),
    instances=Instances(join_nearest, within=next_within),
)

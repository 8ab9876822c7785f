"""The state of a search that fits in registers: the best hit so far, or the number of crossings so far.

Ties go to the smaller t, then to the smaller primitive id, so that no answer depends on the order in which hits are found.
"""

import warp as wp


@wp.struct
class BestHit:
    """The best hit so far."""

    t: float
    """t of the hit; before the first hit, the ray's t_max. Nothing beyond it is searched."""
    primitive: int
    """-1 before the first hit. In queries about crossings, their number so far minus one; t then stays the ray's t_max."""
    u: float
    v: float


@wp.func
def start(t_max: float):
    """The state before the first hit."""
    best = BestHit()
    best.t = t_max
    best.primitive = -1
    return best


@wp.func
def improves(t: float, primitive: int, t_min: float, best: BestHit):
    """Whether a hit at t (NaN for none) replaces the best so far. The range is closed: t_min <= t <= t_max."""
    return t >= t_min and (t < best.t or (t == best.t and (best.primitive < 0 or primitive < best.primitive)))


@wp.func
def join_nearest(found: BestHit, first: int, t_min: float, best: BestHit):
    """The nearer of the best hit so far and the one that was found among triangles which are numbered from `first` on."""
    if found.primitive >= 0 and improves(found.t, first + found.primitive, t_min, best):
        best = found
        best.primitive = first + found.primitive
    return best


@wp.func
def join_counts(found: BestHit, first: int, t_min: float, best: BestHit):
    """The crossings so far and those that were found among other triangles."""
    best.primitive += found.primitive + 1
    return best

"""A variant of other kinds, in which each ray ignores one triangle: the one on which it starts.

**Problem.** A ray that leaves a surface hits the triangle on which it starts again, at t near 0, in front or behind depending
on rounding. A lower bound for t also loses thin walls and corners; `wrt.kernels.query.spawn` moves the origin by more than the
rounding error. If the triangle is known, it can be excluded by its number: the origin stays unchanged, and no other hit is
lost, however near.

**Idea.** The candidate is dropped after its test and before it is compared with the best hit, so no hit that bounds the search
is on the triangle. Boxes are visited as usual. The result is that of the mesh without the triangle, in a scene with the same
bounding box.

**Limits.** Neighbouring triangles are not ignored. A ray from an edge, or within rounding of it, may hit the triangle on the
other side of the edge at t near 0, and a ray from one of two coincident triangles hits the other.
"""

from dataclasses import replace
from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import AnswerKind, BestHit, Search, improves
from wrt.kernels.layout.ray_batch import HitBatch


@wp.struct
class Skipping:
    """The triangle that a ray ignores."""

    t_min: float
    """t_min of the ray."""
    skipped: int
    """The ignored triangle; -1 if there is none."""


@wp.func
def skip_for(skipped: wp.array(dtype=int), hits: HitBatch, i: int, t_min: float):
    """What ray i ignores. skipped: (N,), or (n,) for rays in rows of n that share them by column."""
    return Skipping(t_min, skipped[i % skipped.shape[0]])


@wp.func
def accept_unskipped(search: wp.ref[Skipping], i: int, best: BestHit, t: float, primitive: int, u: float, v: float):
    """Keeps the closest hit that is not on the ignored triangle."""
    if primitive != search.skipped and improves(t, primitive, search.t_min, best):
        best = BestHit(t, primitive, u, v)
    return best


@wp.func
def count_unskipped(search: wp.ref[Skipping], i: int, best: BestHit, t: float, primitive: int, u: float, v: float):
    """Counts a crossing that is not on the ignored triangle."""
    best.primitive += wp.where(primitive == search.skipped, 0, 1)
    return best


@wp.func
def skip_within(first: int, search: Skipping):
    """What a ray ignores of an instance. Other numbers than those of its triangles ignore nothing."""
    own = search  # a copy
    own.skipped = search.skipped - first
    return own


@cache
def skipping(kind: AnswerKind) -> AnswerKind:
    """The variant of a kind of query that keeps the best hit, or counts crossings."""
    accept = accept_unskipped if kind.nearest else count_unskipped
    return replace(
        kind,
        search=Search(Skipping, accept, Given=wp.array(dtype=int), begin=skip_for),
        instances=replace(kind.instances, within=skip_within),
    )

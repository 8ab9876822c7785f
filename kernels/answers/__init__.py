"""Kinds of queries: one file for each, and the table of them.

**Contract.** A kind says what is asked of each ray, and engines ask its row in place of its name: kernels by `wp.static` of the
row's switches and by calling its functions, hosts for its arrays. The state of a search is a `BestHit`, in registers. Engines
offer hits to a kind in one of three ways:
* `nearest` kinds keep the best hit, by `improves`, or the first that is found. Engines compare hits for them, in lanes. All
  traversals answer them.
* Other kinds are offered each hit: `accept(search, i, best, t, primitive, u, v) -> best` of ray i. t is in the ray's range, and
  no more than `best.t`. Those traversals answer them that say so (`OnTree.each_hit` of `wrt.kernels.traversal`).
* A kind with a test of its own gets each triangle whose box its ray meets: `own_test(search, primitive)`, and `best_of(search,
  best) -> best` after each block. Only single-ray walks do that.

`search` is a `HitBatch`, into which the kind may write, or the kind's own struct, `Search.State`, which a kernel around the
walk fills (`walks_only`). The functions of `Stored`:
* `store(hits, i, best)` writes the answer of a ray, and `load(hits, i, t_max) -> best` continues from there;
* `bound(hits, i, t_max) -> t`: beyond it a ray with such an answer need not search, -inf if it is done;
* `copy(found, place, hits, i)`: the answer `place` of one batch is that of ray i of another;
* `merge(found, place, primitive, hits, i) -> bool`: the answer of ray i to a part of the triangles becomes the answer to all so
  far; whether it changed. primitive: the number that the hit's triangle has in the scene, if answers name triangles. None
  if parts do not answer the kind.

And those of `Instances`, for an instance whose triangles are numbered from `first` on:
* `within(first, search) -> search`: what is searched for in it, where the search names triangles;
* `join(found, first, t_min, best) -> best`: the same as `merge`, in registers;
* `renumber(hits, i, count, first)`: of the last `count` hits of a list.

A variant of several kinds is one file and one line in `VARIANTS`, too: it makes a row from a row. It says what its kernels get
besides, `Given`, and how a ray's search begins: `begin(given, hits, i, t_min) -> search`.

To add a kind, write its file and add one line to `ANSWERS` (docs/adding.md). Neither engines nor hosts ask for its name.
"""

from collections.abc import Callable

from wrt.kernels.answers import (
    all_crossings,
    alpha_mask,
    any_hit,
    closest_hit,
    crossing_count,
    exact_hit,
    next_crossing,
    skipped_triangle,
    winding_number,
)
from wrt.kernels.answers.answer_kind import AnswerKind

ANSWERS: dict[str, AnswerKind] = {
    kind.name: kind
    for kind in (
        closest_hit.KIND,
        any_hit.KIND,
        crossing_count.KIND,
        all_crossings.KIND,
        winding_number.KIND,
        next_crossing.KIND,
        exact_hit.KIND,
    )
}
"""Kinds of queries by name."""

PLAIN, SKIPPING, MASKED = "plain", "skipping", "masked"

VARIANTS: dict[str, Callable[[AnswerKind], AnswerKind]] = {
    PLAIN: lambda kind: kind,
    SKIPPING: skipped_triangle.skipping,
    MASKED: alpha_mask.masking,
}
"""Variants by name: what each makes of a kind."""


def batch_kinds() -> tuple[AnswerKind, ...]:
    """Those that a batch of rays can be asked, through any tree."""
    return tuple(kind for kind in ANSWERS.values() if not kind.walks_only)

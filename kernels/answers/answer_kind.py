"""What a row of `wrt.kernels.answers.ANSWERS` says, and the state of a search: the best hit so far, or the number of crossings
so far (`BestHit`).

The state fits in registers. Ties go to the smaller t, then to the smaller primitive id, so that no answer depends on the order
in which hits are found.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch


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


class Column(NamedTuple):
    """An array of answers.

    Attributes:
        dtype: of its elements.
        miss: the value for a ray without a hit.
    """

    dtype: type
    miss: float | bool


COLUMNS: Mapping[str, Column] = {
    "t": Column(wp.float32, float("inf")),
    "primitive": Column(wp.int32, -1),
    "uv": Column(wp.vec2, 0.0),
    "occluded": Column(wp.bool, False),
    "counts": Column(wp.int32, 0),
}
"""The arrays of a `wrt.kernels.layout.ray_batch.HitBatch`."""

HIT_COLUMNS = ("t", "primitive", "uv")
"""Those of a hit."""


@dataclass(frozen=True)
class Rules:
    """What is a hit, and where it is searched for.

    Attributes:
        shortens: whether a hit shortens the ray: nothing beyond it is searched.
        ends_at_first: whether a ray is done with the first hit that is found.
        front_to_back: whether boxes are best visited in the order in which a ray enters them: hits then shorten the ray, or
            lists are nearly sorted when they are found.
        crossings: whether a ray through an edge or a vertex crosses exactly one of the triangles there
            (`TriangleTest.crossing`), rather than hitting all of them.
        oriented: of crossings, whether a hit is offered with its sign in place of u (`TriangleTest.oriented`).
        once: whether a hit that is offered twice would change the answer.
    """

    shortens: bool = False
    ends_at_first: bool = False
    front_to_back: bool = False
    crossings: bool = False
    oriented: bool = False
    once: bool = False


@dataclass(frozen=True)
class Stored:
    """The arrays that answers are in. `wrt.kernels.answers` explains the functions; None where no engine asks.

    Attributes:
        columns: of `COLUMNS`, those with an element for each ray.
        listed: of `COLUMNS`, those with an element for each hit of a ray's list; none for answers of one element a ray.
        load, store, bound, copy, merge: what is done with the answer of a ray.
    """

    columns: tuple[str, ...] = ()
    listed: tuple[str, ...] = ()
    load: wp.Function | None = None
    store: wp.Function | None = None
    bound: wp.Function | None = None
    copy: wp.Function | None = None
    merge: wp.Function | None = None


@dataclass(frozen=True)
class Search:
    """What decides about hits, if not the engine.

    Attributes:
        State: struct that walks take as `hits`: where hits are stored, or one of the kind's own.
        accept: `wp.func(search, i, best, t, primitive, u, v) -> best`; None if the best hit is kept.
        own_test: `wp.func(search, primitive)`: tests a triangle, in place of the config's triangle test; None for that.
        best_of: `wp.func(search, best) -> best`: what the search has found by `own_test`.
        Given: of variants, the type of what their kernels get besides (`wrt.kernels.traversal.single.single_kernel`).
        begin: of variants, `wp.func(given, hits, i, t_min) -> search` of ray i.
    """

    State: type = HitBatch
    accept: wp.Function | None = None
    own_test: wp.Function | None = None
    best_of: wp.Function | None = None
    Given: Any = None
    begin: wp.Function | None = None


@dataclass(frozen=True)
class Instances:
    """How a walk goes through instances. `wrt.kernels.answers` explains the functions; None for kinds that need none.

    Attributes:
        join: of what was found in an instance with the best so far.
        renumber: of lists.
        within: of searches that name triangles.
    """

    join: wp.Function | None = None
    renumber: wp.Function | None = None
    within: wp.Function | None = None


@dataclass(frozen=True)
class AnswerKind:
    """A kind of query: what is asked of each ray.

    Attributes:
        name: key in `wrt.kernels.answers.ANSWERS`.
        rules: what is a hit.
        stored: where answers are.
        search: what decides about hits.
        instances: how hits of instances become hits of the scene.
    """

    name: str
    rules: Rules
    stored: Stored = Stored()
    search: Search = Search()
    instances: Instances = Instances()

    @property
    def nearest(self) -> bool:
        """Whether the best hit is all that is kept, so that engines may compare hits in lanes, without offering each."""
        return self.search.accept is None and self.search.own_test is None

    @property
    def names_triangles(self) -> bool:
        """Whether the answer of a ray names a triangle."""
        return "primitive" in self.stored.columns

    @property
    def walks_only(self) -> bool:
        """Whether only kernels that are built around the walk of one ray ask for it, with a search of its own."""
        return self.search.State is not HitBatch

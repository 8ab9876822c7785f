"""Paired timing: contenders take turns, and ratios are taken round by round.

A noisy machine slows down for seconds at a time. Contenders that run in turn (A B C A B C ...) see the same weather, so
the ratio of two times of one round means more than the ratio of two averages. Each is warmed up first, and a turn of a quick
contender is an untimed call and then the timed one: otherwise whoever comes after a contender that sweeps the caches pays
for it (the same engine, twice in one round, differed by a fifth). And every round begins with another contender,
since whoever is first takes longer: by 5 to 12 %, of one kd-tree five times in a round, traced in a millisecond.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from statistics import median
from time import perf_counter
from typing import Any

FAILURES = (ValueError, TypeError, RuntimeError, NotImplementedError, MemoryError, ImportError)
"""What a contender may raise to say that it cannot take part."""


@dataclass
class Contender:
    """Something to time.

    Attributes:
        name: unique among those that are timed together.
        run: what is timed; returns when its result is complete.
        items: how much a call does, so that contenders with different amounts compare.
        warm_up: called once before; None for `run` itself.
    """

    name: str
    run: Callable[[], Any]
    items: int = 1
    warm_up: Callable[[], Any] | None = None


@dataclass
class Timing:
    """What was measured of a contender.

    Attributes:
        items: as the contender's.
        seconds: of each round; None where it sat out.
        result: what the warm-up returned.
        error: why it did not take part.
    """

    items: int
    seconds: list[float | None] = field(default_factory=list)
    result: Any = None
    error: str | None = None

    @property
    def times(self) -> list[float]:
        """The rounds that it took part in."""
        return [seconds for seconds in self.seconds if seconds is not None]

    @property
    def median(self) -> float:
        """Median seconds a call."""
        return median(self.times)

    @property
    def spread(self) -> tuple[float, float]:
        """Least and greatest seconds a call."""
        return min(self.times), max(self.times)

    def ratio_to(self, reference: Timing) -> float | None:
        """Median over the rounds of time per item / the reference's time per item; None without a common round.

        Above one: slower than the reference.
        """
        ratios = self.ratios_to(reference)
        return median(ratios) if ratios else None

    def ratios_to(self, reference: Timing) -> list[float]:
        """Time per item / the reference's time per item, of each common round."""
        return [
            (own / self.items) / (other / reference.items)
            for own, other in zip(self.seconds, reference.seconds, strict=False)
            if own is not None and other is not None
        ]


def take_turns(
    contenders: Sequence[Contender],
    rounds: int,
    *,
    budget: float = float("inf"),
    settle: float = 0.0,
    warm: float = 0.0,
    clock: Callable[[], float] = perf_counter,
    on_turn: Callable[[str], None] = lambda name: None,
) -> dict[str, Timing]:
    """Warms up every contender, then times them in turn, round after round.

    Args:
        contenders: in the order of their turns; every round begins with the next of them. One whose warm-up raises one of
            `FAILURES` is left out, with the reason.
        rounds: how often each has its turn, at least once.
        budget: seconds for each contender; one whose next turn would exceed it sits out the rounds that are left.
        settle: a turn of a contender whose last call took less than this many seconds starts with an untimed call.
        warm: such a turn goes on with untimed calls until this many seconds have passed. Threads that the operating system has
            to wake, and cores that it has to bring to their frequency, are slow for some milliseconds.
        clock: seconds, from any start.
        on_turn: told the name of the contender before each warm-up and each turn.
    """
    timings = {contender.name: Timing(contender.items) for contender in contenders}
    last = {}
    for contender in contenders:
        on_turn(contender.name)
        start = clock()
        try:
            timings[contender.name].result = (contender.warm_up or contender.run)()
        except FAILURES as error:
            timings[contender.name].error = f"{type(error).__name__}: {error}"
        last[contender.name] = clock() - start if contender.warm_up is None else float("inf")
    ready = [contender for contender in contenders if timings[contender.name].error is None]
    for turn in range(rounds):
        gc.collect()
        first = turn % max(len(ready), 1)
        for contender in ready[first:] + ready[:first]:
            timing = timings[contender.name]
            if timing.times and sum(timing.times) + timing.median > budget:
                timing.seconds.append(None)
                continue
            on_turn(contender.name)
            if last[contender.name] < settle:
                until = clock() + warm
                contender.run()
                while clock() < until:
                    contender.run()
            last[contender.name] = time_call(contender.run, clock)
            timing.seconds.append(last[contender.name])
    return timings


def time_call(run: Callable[[], Any], clock: Callable[[], float] = perf_counter) -> float:
    """Seconds of one call, without garbage collection and without freeing its result."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        start = clock()
        result = run()
        elapsed = clock() - start
    finally:
        if enabled:
            gc.enable()
    del result
    return elapsed

"""Which of several ways takes the least time for calls of a kind: learned from the times of the calls.

All ways give the same answers, so a trial costs only time. In a trial each way has turns, whole calls of nearly the same rays,
and its rate is the least time per ray of its turns: what else runs on the machine only makes a turn longer. Between trials the
best way takes all calls, and its rate is followed. A trial is made

* once the calls have taken `FIRST_SECONDS`;
* again when the calls since the last one have taken so long that a trial costs a share of `AGED_SHARE` of them;
* sooner, at a share of `CHANGED_SHARE`, after a change: the rate is another one by a factor of `CHANGED`, or the caller says
  that the rays start elsewhere.

A way replaces the best one if it is faster by `MARGIN`, also after both had as many turns again. One that takes `HOPELESS`
times as long in its first turn has no other. What that costs and saves: notebooks/records/2026-11-27-measured-auto.md.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Container, Iterable, Mapping
from functools import wraps
from typing import TypeVar

FIRST_SECONDS = 0.005
"""Seconds of calls before the first trial: other calls take less than a trial can save."""

TURNS = 2
"""Turns of a way in a trial: one may be disturbed."""

AGED_SHARE, CHANGED_SHARE = 0.02, 0.04
"""Share of the time of calls that goes into trials: while nothing changes, and after a change."""

FEWEST_CALLS, FEWEST_CHANGED = 64, 8
"""Calls between two trials at least, in either case: ways that are equally fast cost nothing, but tell nothing either."""

MARGIN = 0.03
"""Share of the time that a way must save to replace another: less is noise."""

CHANGED = 1.3
"""Factor between rates that is no noise."""

SLOW_CALLS = 3
"""Calls in a row that take `CHANGED` times as long as usual when something has changed; fewer may be due to other programs."""

LOOKS_SHARE = 0.03
"""Share of the time of calls that goes into looking at rays that start elsewhere."""

CREEP = 1.005
"""Factor by which the usual rate may rise from call to call; it falls at once."""

HOPELESS = 2.0
"""Times the least time: a way that takes so long has no further turns in a trial."""


Result = TypeVar("Result")


def alone(method: Callable[..., Result]) -> Callable[..., Result | None]:
    """A method of `Learner` that others wait for; None at once in a signal handler that interrupts one of its own thread."""

    @wraps(method)
    def call(self: Learner, *arguments: object, **options: object) -> Result | None:
        with self._lock:
            if self._inside:
                return None
            self._inside = True
            try:
                return method(self, *arguments, **options)
            finally:
                self._inside = False

    return call


class Learner:
    """What the calls of a kind have told. Several threads may use it at once, and so may the handlers of signals that interrupt
    it: these get the best way, and what they tell is not noted.

    Args:
        guess: the way that is best by other knowledge.

    Attributes:
        guess: the same, or what replaced it.
        best: the way that takes the calls between trials.
        rates: seconds a ray of each way in the last trial.
        usual: seconds a ray of the best way since; None before the first call.
        spent: seconds of calls in all.
        lost: seconds that trials took longer than the best way would have.
        looked: seconds of looks at rays.
        trials: how many were completed.
    """

    def __init__(self, guess: str) -> None:
        self.guess = self.best = guess
        self.rates: dict[str, float] = {}
        self.usual: float | None = None
        self.spent = self.lost = self.looked = 0.0
        self.trials = 0
        self._since, self._calls = 0.0, 0
        self._slow, self._has_changed, self._is_told = 0, False, True
        self._queue: list[str] = []
        self._seen: dict[str, float] = {}
        self._took: list[tuple[str, float, float]] = []
        self._is_sure = False
        self._lock, self._inside = threading.RLock(), False

    @property
    def is_trying(self) -> bool:
        """Whether a trial is under way."""
        return bool(self._queue)

    def turn(self, ways: Iterable[str]) -> str:
        """The way that takes the next call.

        Args:
            ways: those that can.
        """
        with self._lock:  # as `alone`, which every call would feel
            if self._inside:
                return self.best
            self._inside = True
            try:
                able = [*ways]
                self._queue = [way for way in self._queue if way in able]
                if not self._queue and self._is_due(able):
                    first = [self.best, *(way for way in able if way != self.best)]
                    turns = [first if turn % 2 == 0 else first[::-1] for turn in range(TURNS)]
                    self._queue, self._seen, self._took = [way for one in turns for way in one], {}, []
                    self._is_sure = False
                return self._queue[0] if self._queue else self.best
            finally:
                self._inside = False

    @alone
    def is_due(self, ways: Iterable[str], turns: float = TURNS) -> bool:
        """Whether a trial of these ways would begin now, in which each has this many turns: parts are less than one."""
        return not self._queue and self._is_due([*ways], turns)

    def tell(self, way: str, rays: int, seconds: float, calls: int = 1) -> None:
        """What a call took.

        Args:
            way: what has carried it out.
            rays: how many it had.
            seconds: how long it took.
            calls: how many calls it stands for: the others were not timed.
        """
        rate = seconds / max(rays, 1)
        with self._lock:  # as `alone`, which every call would feel
            if self._inside:
                return
            self._inside = True
            try:
                self.spent += calls * seconds
                if not self._queue:
                    self._follow(way, rate, seconds, calls)
                elif way == self._queue[0]:
                    self._take(way, rays, seconds)
            finally:
                self._inside = False

    @alone
    def conclude(self, rates: Mapping[str, float], lost: float = 0.0) -> None:
        """Ends a trial.

        Args:
            rates: seconds a ray of each way, those that were dropped included.
            lost: seconds that it took longer than the best way would have.
        """
        self._conclude(dict(rates), lost)

    def may_look(self) -> bool:
        """Whether a look at rays that are others than before is worth its time."""
        return self.looked <= LOOKS_SHARE * self.spent

    @alone
    def leave_trial(self) -> None:
        """Ends a trial without a result: the next call has other rays than those before."""
        self._queue, self._seen = [], {}

    def renew_lock(self) -> None:
        """Makes a new lock, in a forked child: a thread that it does not have may hold the old one."""
        self._lock, self._inside = threading.RLock(), False

    @alone
    def changed(self, looked: float = 0.0) -> None:
        """The next calls may be others than those before, in spite of their kind; to look at them took some seconds."""
        self.looked += looked
        self._change()

    @alone
    def guessed(self, guess: str) -> None:
        """The way that other knowledge takes for the best for the next calls: followed if it is another one than before."""
        if guess != self.guess:
            self.guess = self.best = guess
            self.usual = self.rates.get(guess)
            self._change()

    @alone
    def keep_to(self, ways: Container[str]) -> None:
        """Returns to the guess if the best way is none of these."""
        if self.best not in ways:
            self.best, self.usual = self.guess, None

    @alone
    def takes_change(self) -> bool:
        """Whether the rate has changed since this was asked before."""
        told, self._is_told = self._is_told, True
        return not told

    def _change(self) -> None:
        self._has_changed, self._slow = True, 0
        self._queue, self._seen = [], {}

    def _is_due(self, ways: list[str], turns: float = TURNS) -> bool:
        if len(ways) < 2 or self.best not in ways or self.spent < FIRST_SECONDS:
            return False
        if not self.trials:
            return True
        calls, share = (FEWEST_CHANGED, CHANGED_SHARE) if self._has_changed else (FEWEST_CALLS, AGED_SHARE)
        affordable = self.lost <= CHANGED_SHARE * self.spent and self._cost(ways, turns) <= share * self._since
        return affordable and self._calls >= calls

    def _cost(self, ways: list[str], turns: float) -> float:
        """Seconds that a trial of this many turns will lose, by what is known of the ways."""
        usual = self.usual or 0.0
        if not usual:
            return 0.0
        fastest = max(usual, self.rates.get(self.best, 0.0))  # the rates of others changed, too
        ratios = [self.rates.get(way, fastest) / fastest for way in ways if way != self.best]
        calls = sum((ratio - 1.0) * (turns / TURNS if ratio >= HOPELESS else turns) for ratio in ratios if ratio > 1.0)
        return calls * self._since / max(self._calls, 1)

    def _take(self, way: str, rays: int, seconds: float) -> None:
        """A turn of a trial."""
        self._queue.pop(0)
        self._took.append((way, rays, seconds))
        self._seen[way] = min(self._seen.get(way, float("inf")), seconds / max(rays, 1))
        if len(self._took) == len(self._seen):  # the first round
            fastest = min(self._seen.values())
            self._queue = [one for one in self._queue if self._seen.get(one, fastest) < HOPELESS * fastest]
        first = min(self._seen, key=self._seen.__getitem__)
        if not self._queue and not self._is_sure and self._is_faster(self._seen, first):
            self._queue, self._is_sure = [self.best, first, first, self.best], True
        if not self._queue:
            fastest = self._seen[first]
            self._conclude(self._seen, sum(max(took - fastest * count, 0.0) for _, count, took in self._took))

    def _is_faster(self, rates: Mapping[str, float], way: str) -> bool:
        """Whether a way is to replace the best one by these rates."""
        return self.best not in rates or rates[way] < (1.0 - MARGIN) * rates[self.best]

    def _conclude(self, rates: dict[str, float], lost: float) -> None:
        self.rates = {**self.rates, **rates}
        self.trials, self.lost = self.trials + 1, self.lost + lost
        first = min(rates, key=rates.__getitem__)
        if self._is_faster(rates, first):
            self.best = first
        self.usual = self.rates[self.best]
        self._since, self._calls, self._slow, self._has_changed = 0.0, 0, 0, False
        self._queue, self._seen, self._took = [], {}, []

    def _follow(self, way: str, rate: float, seconds: float, calls: int) -> None:
        """A call between trials."""
        if way != self.best:
            return
        self._since, self._calls = self._since + calls * seconds, self._calls + calls
        if self.usual is None:
            self.usual = rate
            return
        self._slow = self._slow + 1 if rate > CHANGED * self.usual else 0
        if rate * CHANGED < self.usual or self._slow >= SLOW_CALLS:
            self._has_changed, self._is_told, self._slow = True, False, 0
            self.usual = rate
        else:
            self.usual = min(rate, CREEP * self.usual)

"""Verdicts on claims: holds, does not hold, undecided, not comparable.

A claim bounds a quantity from below, from above, or both. It is judged in each case (a scene, a view, a size) by all values
that were measured, not by their median: what is measured with a clock needs `ENOUGH_RUNS` runs, and if their spread contains
a bound, that case is undecided. What is counted is the same in every run, and one run decides.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import inf, isfinite
from statistics import median

HOLDS, FAILS, UNDECIDED, NOT_COMPARABLE = "holds", "does not hold", "undecided", "not comparable"

WORDS = (HOLDS, FAILS, UNDECIDED, NOT_COMPARABLE)

ENOUGH_RUNS = 5
"""Runs, or rounds in which contenders take turns, that show how far a measured value spreads."""


@dataclass(frozen=True)
class Measure:
    """A quantity of one case.

    Attributes:
        value: the median.
        least: of all runs.
        greatest: of all runs.
        runs: how often it was measured; 0 for what is counted.
        case: of what, for instance a scene.
    """

    value: float
    least: float
    greatest: float
    runs: int
    case: str = ""

    def __post_init__(self) -> None:
        if not (isfinite(self.value) and self.least <= self.value <= self.greatest):
            raise ValueError(f"{self.case}: value {self.value} does not lie between {self.least} and {self.greatest}")
        if self.runs < 0:
            raise ValueError(f"{self.case}: runs is {self.runs}; it is 0 for what is counted, else the number of runs")

    @property
    def spread_is_known(self) -> bool:
        """Whether a claim can be judged by it."""
        return self.runs == 0 or self.runs >= ENOUGH_RUNS


def measured(values: Sequence[float], case: str = "") -> Measure:
    """A quantity by the values of its runs."""
    return Measure(median(values), min(values), max(values), len(values), case)


def counted(value: float, case: str = "") -> Measure:
    """A quantity that is the same in every run."""
    return Measure(value, value, value, 0, case)


@dataclass(frozen=True)
class Verdict:
    """Attributes: word: one of `WORDS`. why: the cases that decided it, or why it cannot be compared."""

    word: str
    why: str = ""

    def __post_init__(self) -> None:
        if self.word not in WORDS:
            raise ValueError(f"{self.word!r} is no verdict; one of {', '.join(WORDS)}")
        if self.word == NOT_COMPARABLE and not self.why:
            raise ValueError("say why it is not comparable")

    def __str__(self) -> str:
        return f"{self.word} ({self.why})" if self.why else self.word


def not_comparable(why: str) -> Verdict:
    """That what is measured here is not what the document measured."""
    return Verdict(NOT_COMPARABLE, why)


def judge(cases: Iterable[Measure], at_least: float = -inf, at_most: float = inf) -> Verdict:
    """Whether a quantity lies in [at_least, at_most] in all cases.

    Args:
        cases: at least one.
        at_least: lower bound of the claim, included.
        at_most: upper bound of the claim, included.

    Returns:
        "does not hold" if all runs of one case lie outside; otherwise "undecided" if some run of a case does, or a case has
        fewer than `ENOUGH_RUNS` runs; otherwise "holds".

    Raises:
        ValueError: no case, no bound, or bounds that exclude every value.
    """
    cases = list(cases)
    if not cases:
        raise ValueError("there is no case to judge")
    if (at_least, at_most) == (-inf, inf) or at_least > at_most:
        raise ValueError(f"a claim has a bound: at_least is {at_least}, at_most is {at_most}")
    settled = [case for case in cases if case.spread_is_known]
    against = [case for case in settled if case.greatest < at_least or case.least > at_most]
    if against:
        return Verdict(FAILS, names(against, cases))
    unsettled = [case for case in cases if not case.spread_is_known]
    if unsettled:
        return Verdict(UNDECIDED, too_few(unsettled) + of(unsettled, cases))
    crossing = [case for case in cases if case.least < at_least or case.greatest > at_most]
    if crossing:
        return Verdict(UNDECIDED, "runs lie on both sides" + of(crossing, cases))
    return Verdict(HOLDS)


def smaller(left: Measure, right: Measure) -> Verdict:
    """Whether one quantity is smaller than another: runs of both must not overlap."""
    unsettled = [measure for measure in (left, right) if not measure.spread_is_known]
    if unsettled:
        return Verdict(UNDECIDED, too_few(unsettled))
    if left.greatest < right.least:
        return Verdict(HOLDS)
    return Verdict(FAILS) if left.least >= right.greatest else Verdict(UNDECIDED, "runs lie on both sides")


def all_of(verdicts: Iterable[Verdict]) -> Verdict:
    """The verdict on a claim with several parts: the first that fails, else that cannot be compared, else that is undecided."""
    verdicts = list(verdicts)
    for word in (FAILS, NOT_COMPARABLE, UNDECIDED):
        for verdict in verdicts:
            if verdict.word == word:
                return verdict
    if not verdicts:
        raise ValueError("there is no verdict")
    return Verdict(HOLDS)


def too_few(cases: Sequence[Measure]) -> str:
    """Why cases cannot be decided."""
    runs = max(case.runs for case in cases)
    return f"{runs} runs of at least {ENOUGH_RUNS}" if runs > 1 else "the spread over runs is not known"


def names(some: Sequence[Measure], cases: Sequence[Measure]) -> str:
    """Cases by number, and by name where they are not all and few."""
    if len(cases) == 1:
        return ""
    if len(some) == len(cases):
        return "in both cases" if len(cases) == 2 else f"in all {len(cases)} cases"
    listed = ": " + "; ".join(case.case for case in some) if len(some) <= 3 and some[0].case else ""
    return f"in {len(some)} of {len(cases)} cases{listed}"


def of(some: Sequence[Measure], cases: Sequence[Measure]) -> str:
    """Cases behind a reason."""
    return f", {names(some, cases)}" if 1 < len(cases) != len(some) else ""


def span(cases: Iterable[Measure], form: str = ".2f", factor: float = 1.0) -> str:
    """From the smallest to the greatest median, as text."""
    values = [case.value * factor for case in cases]
    low, high = format(min(values), form), format(max(values), form)
    return low if low == high else f"{low} to {high}"


def in_one_run(fulfilled: bool, is_counted: bool = False) -> str:
    """A verdict of a notebook, which runs once: what is timed is said to hold, or not, "in this run"."""
    return (HOLDS if fulfilled else FAILS) + ("" if is_counted else " in this run")

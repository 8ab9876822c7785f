"""Claims of the documents with verdicts that are computed from results: the registry, and what its functions share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from studies.evidence.results import Results
from studies.evidence.verdicts import Measure, Verdict

Found = tuple[Verdict, str]

Held = Mapping[str, Results]


@dataclass(frozen=True)
class Claim:
    """What a document says, and how it is judged.

    Attributes:
        name: short and unique; pages refer to it.
        document: key of `papers.DOCUMENTS`.
        place: table, figure, page or section.
        says: the claim, in our words.
        needs: names of results.
        judge: verdict and figures by these results.
    """

    name: str
    document: str
    place: str
    says: str
    needs: Sequence[str]
    judge: Callable[[Held], Found]


CLAIMS: dict[str, Claim] = {}


def claim(
    name: str, document: str, place: str, says: str, *needs: str
) -> Callable[[Callable[[Held], Found]], Callable[[Held], Found]]:
    """Registers a function that returns a verdict and the figures behind it."""

    def register(judge: Callable[[Held], Found]) -> Callable[[Held], Found]:
        if name in CLAIMS:
            raise ValueError(f"two claims are named {name!r}")
        CLAIMS[name] = Claim(name, document, place, says, needs, judge)
        return judge

    return register


def quotient(over: Measure, under: Measure) -> Measure:
    """One measure divided by another of the same case; its spread is the widest that both allow."""
    runs = 0 if over.runs == under.runs == 0 else min(m.runs for m in (over, under) if m.runs)
    return Measure(over.value / under.value, over.least / under.greatest, over.greatest / under.least, runs, over.case)


def inverse(measure: Measure) -> Measure:
    """A speed from a time, or the reverse."""
    return Measure(1 / measure.value, 1 / measure.greatest, 1 / measure.least, measure.runs, measure.case)


def speeds(results: Results, table: str, **key: object) -> list[Measure]:
    """Speeds against the reference of a table of time ratios."""
    return [inverse(ratio) for ratio in results.take(table, "ratio", **key)]


def pairs(over: Sequence[Measure], under: Sequence[Measure]) -> list[Measure]:
    """Quotients of the measures of the same cases."""
    below = {measure.case: measure for measure in under}
    return [quotient(measure, below[measure.case]) for measure in over]

"""The survey's claims about packets by bounce, each with a verdict computed from the figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median

from studies.light.bounce_comparison import BounceFigures

COMPARABLE = 1.05
"""Ratio of speeds up to which two ways count as equally fast."""

LATE = 5
"""First bounce at which Boulos et al. (2008) found repacking faster."""

MANY = 0.8
"""Share of the cases in which something must be found that a claim says of all."""


@dataclass(frozen=True)
class Verdict:
    """A claim beside what was found.

    Attributes:
        claim: what the survey says, with its source.
        paper: its figure.
        found: ours.
        holds: whether ours agrees.
    """

    claim: str
    paper: str
    found: str
    holds: bool


class _Table:
    """Figures by way, model and bounce."""

    def __init__(self, figures: Sequence[BounceFigures]) -> None:
        self._rows = {(row.way, row.model, row.bounce): row for row in figures}
        self.models = list(dict.fromkeys(row.model for row in figures))
        self.bounces = sorted({row.bounce for row in figures})
        self.secondary = [bounce for bounce in self.bounces if bounce > 0]

    def of(self, way: str, value: Callable[[BounceFigures], float], bounces: Sequence[int]) -> list[float]:
        """A value of a way, of every model and bounce that was measured."""
        keys = [(way, model, bounce) for bounce in bounces for model in self.models]
        return [value(self._rows[key]) for key in keys if key in self._rows]

    def speed(self, way: str, other: str, bounces: Sequence[int]) -> list[float]:
        """Speed of a way over another's."""
        return self.of(way, lambda row: row.ratios[other], bounces)

    def share(self, way: str, other: str, value: Callable[[BounceFigures], float], bounces: Sequence[int]) -> list[float]:
        """A value of a way over another's."""
        pairs = zip(self.of(way, value, bounces), self.of(other, value, bounces), strict=True)
        return [own / their for own, their in pairs if their > 0.0]


def judge(figures: Sequence[BounceFigures]) -> list[Verdict]:
    """The verdicts, for figures of all of `WAYS` with at least one bounce.

    Raises:
        ValueError: there are no figures of secondary rays.
    """
    table = _Table(figures)
    if not table.secondary:
        raise ValueError("the claims are about secondary rays, but there are figures of camera rays only")
    return [*_orders(table), *_repacking(table), *_omnidirectional(table), _two_planes(table)]


def _orders(table: _Table) -> list[Verdict]:
    later = table.secondary
    faster = table.speed("types", "runs", later)
    boxes = table.share("types", "runs", lambda row: row.boxes, later)
    triangles = table.share("types", "runs", lambda row: row.triangles, later)
    ends = [median(table.share("types", "runs", lambda row: row.triangles, [bounce])) for bounce in (later[0], later[-1])]
    cells = table.speed("sorted by cells", "blind", later)
    usage = table.of("group", lambda row: row.usage, later)
    return [
        Verdict("types is faster than runs (Boulos 2007)", "1.1 to 1.2", _spread(faster), median(faster) >= 1.1),
        Verdict("types needs fewer box tests at all bounces", "below 1", _spread(boxes), _often(boxes, below=1.0)),
        Verdict(
            "types needs fewer triangle tests, the more the later",
            "falling",
            f"{ends[0]:.2f} at bounce {later[0]}, {ends[1]:.2f} at bounce {later[-1]}",
            median(triangles) < 1.0 and ends[1] < ends[0],
        ),
        Verdict(
            "sorting before tracing does not pay (Månsson 2007)",
            "at most 1",
            _spread(cells),
            median(cells) <= COMPARABLE,
        ),
        Verdict("group leaves packets empty (Boulos 2007)", "up to a packet a ray", _spread(usage), median(usage) < 0.5),
    ]


def _repacking(table: _Table) -> list[Verdict]:
    early = [bounce for bounce in table.bounces if bounce < LATE]
    late = [bounce for bounce in table.bounces if bounce >= LATE]
    before = table.speed("repacked", "types", early)
    found = [
        Verdict("repacking is not faster at first (Boulos 2008)", "at most 1", _spread(before), median(before) <= COMPARABLE)
    ]
    if late:
        after = table.speed("repacked", "types", late)
        found.append(Verdict(f"and faster from bounce {LATE} to 10", "above 1", _spread(after), median(after) > 1.0))
    return found


def _omnidirectional(table: _Table) -> list[Verdict]:
    def steps(row: BounceFigures) -> float:
        return row.steps

    first, last = table.bounces[:1], table.bounces[-2:-1] or table.bounces[-1:]
    views = table.share("kd-tree packets", "omnidirectional", steps, first)
    later = table.share("kd-tree packets", "omnidirectional", steps, last)
    ends = [table.speed("omnidirectional", "kd-tree packets", bounces) for bounces in (first, last)]
    return [
        Verdict("omnidirectional: fewer steps for camera rays (Reshetov 2006)", "2", _spread(views), median(views) >= 1.5),
        Verdict(f"and by bounce {last[0]}", "1.5", _spread(later), median(later) >= 1.25),
        Verdict("omnidirectional: speed for camera rays", "2", _spread(ends[0]), median(ends[0]) >= 1.5),
        Verdict(f"falling until bounce {last[0]}", "0.9 to 1.2", _spread(ends[1]), 0.9 <= median(ends[1]) <= 1.2),
    ]


def _two_planes(table: _Table) -> Verdict:
    faster = table.speed("two-plane", "intervals", table.secondary)
    return Verdict("two planes against intervals (Overbeck 2008)", "1.2 to 1.3", _spread(faster), median(faster) >= 1.2)


def _spread(values: Sequence[float]) -> str:
    return f"{median(values):.2f} ({min(values):.2f} to {max(values):.2f})"


def _often(values: Sequence[float], below: float) -> bool:
    return sum(value < below for value in values) >= MANY * len(values)

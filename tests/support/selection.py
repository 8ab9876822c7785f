"""Which tests run: slow files, markers that `-m` must name, and samples of the cases of each test."""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Collection
from pathlib import Path
from typing import Any

import pytest

SLOW = frozenset(Path(__file__).parents[1].joinpath("slow.txt").read_text().split())
"""Files whose tests take more than some 6 s of a core even when all kernels are compiled."""

ASKED_FOR = ("exhaustive", "notebooks")
"""Markers of tests that run only where `-m` names them."""

LEFT_OUT = ("slow", "studies", "classics")
"""Markers of tests that `pytest` alone leaves out. Whoever names folders, files, tests, words or markers runs those, too."""

LONGEST = "tests/pages/test_notebooks.py::test_notebook["
"""How the names of the tests that take longest begin."""


def as_sample(text: str) -> tuple[int, int]:
    """The number and the turn of `--sample`.

    Raises:
        ArgumentTypeError: not two whole numbers, or the first is none of at least 1.
    """
    number, _, turn = text.partition(":")
    if not number.isdecimal() or int(number) < 1 or not turn.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not N:TURN, as 3:1042; N is at least 1")
    return int(number), int(turn)


def sample(items: list[pytest.Item], number: int, turn: int, markers: Collection[str] = ()) -> list[pytest.Item]:
    """One in `number` of the cases of each file, and at least one: others in each of `number` turns, all in all of these.

    Cases of one test follow each other, so that each test with `number` cases or more is in every sample. With markers, only
    what has one of them is a case: all else is in every sample.
    """
    cases, kept = defaultdict(list), set()
    for item in items:
        if not markers or any(name in item.keywords for name in markers):
            cases[item.nodeid.partition("::")[0]].append(item)
        else:
            kept.add(item)
    for own in cases.values():
        kept.update(own[turn % number :: number] or [own[turn % len(own)]])
    return [item for item in items if item in kept]


def named(items: list[pytest.Item], ids: list[str]) -> list[pytest.Item]:
    """The tests that ids name: those of a test, or of all in a file.

    Raises:
        UsageError: an id names none in a file that has others, as where a test was renamed; one without any is skipped again.
    """
    wanted, files = {*ids}, {item.nodeid.partition("::")[0] for item in items}
    found = {item: {item.nodeid, item.nodeid.partition("::")[0]} & wanted for item in items}
    if unknown := [name for name in sorted(wanted.difference(*found.values())) if name.partition("::")[0] in files]:
        raise pytest.UsageError(f"no test is called {unknown[0]}")
    return [item for item, by in found.items() if by]


def slow(*cases: Any) -> list[Any]:
    """Cases of a test with the marker `slow`; a tuple has a value for each of several parameters."""
    return [pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow) for case in cases]


def is_alone(config: pytest.Config) -> bool:
    """Whether pytest was called in the checkout with nothing that chooses tests; processes of pytest-xdist are told."""
    if hasattr(config, "workerinput"):
        return config.workerinput["is_alone"]
    chosen = config.args_source is not config.ArgsSource.TESTPATHS or config.option.markexpr or config.option.keyword
    return not (chosen or getattr(config.option, "lf", False))


class Skipped:
    """A plugin that writes the ids of skipped tests and files into a file, which `pytest @FILE` runs again."""

    def __init__(self, config: pytest.Config) -> None:
        self.config = config
        self.ids: list[str] = []

    def _note(self, report: pytest.CollectReport | pytest.TestReport) -> None:
        if report.skipped and not hasattr(report, "wasxfail"):
            self.ids.append(report.nodeid)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        self._note(report)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._note(report)

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """A process of pytest-xdist has ended: it alone knows all files that it skipped."""
        self.ids += getattr(node, "workeroutput", {}).get("skipped", [])

    def pytest_sessionfinish(self) -> None:
        if hasattr(self.config, "workeroutput"):
            self.config.workeroutput["skipped"] = self.ids
        else:
            Path(self.config.option.write_skipped).write_text(
                "".join(f"{one}\n" for one in sorted({*self.ids})), encoding="utf-8"
            )

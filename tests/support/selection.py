"""Which tests run: slow files, markers that `-m` must name, and samples of the cases of each test."""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

import pytest

SLOW = frozenset(Path(__file__).parents[1].joinpath("slow.txt").read_text().split())
"""Files whose tests take more than some 6 s of a core even when all kernels are compiled."""

ASKED_FOR = ("exhaustive", "notebooks")
"""Markers of tests that run only where `-m` names them."""

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


def sample(items: list[pytest.Item], number: int, turn: int) -> list[pytest.Item]:
    """One in `number` of the cases of each test, and at least one: others in each of `number` turns, all in all of these."""
    cases = defaultdict(list)
    for item in items:
        cases[item.nodeid.partition("[")[0]].append(item)
    kept = {one for own in cases.values() for one in (own[turn % number :: number] or [own[turn % len(own)]])}
    return [item for item in items if item in kept]

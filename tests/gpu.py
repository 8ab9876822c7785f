"""The tests that must run on a CUDA device: those that take each device found, with the CUDA ones, and those marked `cuda`.

    python -m tests.gpu [--part I/N] [--list] [--commit NAME] [arguments of pytest]

It says on which device and commit it runs, prints a summary by folder and the first line of each failure, and writes a dated
record of what ran, one for each part. `--part 2/6` runs the second of six parts, which have whole files and about as many tests
each: so a machine that is lent for minutes runs all, part after part. `--list` says which tests there are, and needs no device;
those for each device found are listed for CUDA where there is one. `--commit` names the commit of a copy without a repository.
The process ends as pytest does, and with 2 if there is no CUDA device, or tests are to run side by side.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import warp as wp

from tests.records import write_record

ROOT = Path(__file__).resolve().parents[1]
NO_DEVICE = 2

FILES = "| file | passed |"
"""The head of a record's last table."""


def needs_card(item: pytest.Item) -> bool:
    """Whether a test runs on a CUDA device: it is marked `cuda`, or `device` is one."""
    device = getattr(item, "callspec", None) and item.callspec.params.get("device")
    return item.get_closest_marker("cuda") is not None or str(device).startswith("cuda")


def file_of(name: str) -> str:
    """The file of a test."""
    return name.split("::")[0]


def part_of(tests: Sequence[str], part: int, parts: int) -> set[str]:
    """The files of a part, from 1 to `parts`: a file, largest first, goes to the part with the fewest tests."""
    counts, sizes, chosen = Counter(map(file_of, tests)), [0] * parts, set()
    for file, count in sorted(counts.items(), key=lambda entry: (-entry[1], entry[0])):
        least = sizes.index(min(sizes))
        sizes[least] += count
        if least == part - 1:
            chosen.add(file)
    return chosen


def first_line(report: Any) -> str:
    """What a failure says first: of the error's own lines, the first."""
    crash = getattr(report.longrepr, "reprcrash", None)
    text = str(report.longrepr) if crash is None else crash.message
    return next(iter(text.strip().splitlines()), "")[:200]


class Selection:
    """A plugin of pytest that keeps the tests of `needs_card`, and counts what becomes of them.

    Args:
        part, parts: which of how many parts is kept.

    Attributes:
        outcomes: tests by outcome.
        files: tests that passed, by file.
        kept: names of all tests that were to run.
        failed: names of those that did not pass or skip, with what they said first.
    """

    def __init__(self, part: int = 1, parts: int = 1) -> None:
        self.part, self.parts = part, parts
        self.outcomes: Counter[str] = Counter()
        self.files: Counter[str] = Counter()
        self.kept: list[str] = []
        self.failed: dict[str, str] = {}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        """Deselects all others."""
        files = part_of([item.nodeid for item in items if needs_card(item)], self.part, self.parts)
        kept = [needs_card(item) and file_of(item.nodeid) in files for item in items]
        config.hook.pytest_deselected(items=[item for item, keep in zip(items, kept, strict=True) if not keep])
        items[:] = [item for item, keep in zip(items, kept, strict=True) if keep]
        self.kept = [item.nodeid for item in items]

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Counts a test once: by its call, or by what kept that from happening."""
        if report.when == "call" or report.outcome != "passed":
            self.outcomes[report.outcome] += 1
            if report.failed:
                self.failed[report.nodeid] = first_line(report)
            elif report.passed:
                self.files[file_of(report.nodeid)] += 1

    def folders(self) -> list[tuple[str, int, int, int]]:
        """Each folder of tests, with how many of them were to run, passed and failed."""
        wanted, passed, failed = (Counter() for _ in range(3))  # type: ignore[var-annotated]
        for counter, names in ((wanted, self.kept), (failed, self.failed)):
            counter.update(file_of(name).rpartition("/")[0] for name in names)
        for file, count in self.files.items():
            passed[file.rpartition("/")[0]] += count
        return [(folder, wanted[folder], passed[folder], failed[folder]) for folder in sorted(wanted)]


def commit() -> str:
    """The commit of the checkout, marked if files differ from it; "unknown" outside a checkout."""
    done = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"


def lines_of(selection: Selection, device: wp.Device, seconds: float, ran: str) -> list[str]:
    """What a record says; ran: the commit."""
    counted = ", ".join(f"{count} {outcome}" for outcome, count in sorted(selection.outcomes.items()))
    where = f"{device.name} ({device.alias}, sm_{device.arch}), commit {ran}"
    part = "" if selection.parts == 1 else f" --part {selection.part}/{selection.parts}"
    return [
        f"`python -m tests.gpu{part}` on {where}: {counted} of {len(selection.kept)} tests in {seconds:.0f} s.",
        "",
        *(f"* failed: `{name}`: {line}" for name, line in selection.failed.items()),
        "",
        "| folder | tests | passed | failed |",
        "| --- | --- | --- | --- |",
        *(f"| {folder} | {wanted} | {passed} | {failed} |" for folder, wanted, passed, failed in selection.folders()),
        "",
        FILES,
        "| --- | --- |",
        *(f"| {name} | {count} |" for name, count in sorted(selection.files.items())),
    ]


def parsed(arguments: list[str]) -> tuple[argparse.Namespace, list[str]]:
    """The options of this program, with `part` as two ints, and those of pytest."""
    parser = argparse.ArgumentParser(prog="python -m tests.gpu", add_help=False, allow_abbrev=False)
    parser.add_argument("--part", default="1/1")
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--commit")
    own, others = parser.parse_known_args(arguments)
    own.part = tuple(map(int, own.part.split("/")))
    if len(own.part) != 2 or not 1 <= own.part[0] <= own.part[1]:
        parser.error("--part is I/N, with I from 1 to N")
    return own, others


def main(arguments: list[str]) -> int:
    """Runs the tests; returns the status of the process."""
    own, others = parsed(arguments)
    if any(argument.startswith("-n") for argument in others):
        print("the tests take turns on one device: leave -n out", file=sys.stderr)
        return NO_DEVICE
    wp.init()
    devices, selection, begin = wp.get_cuda_devices(), Selection(*own.part), time.perf_counter()
    if not (devices or own.list):
        print("there is no CUDA device here", file=sys.stderr)
        return NO_DEVICE
    asked = others or [str(ROOT / "tests")]
    if own.list:
        return int(pytest.main(["-q", "--collect-only", *asked], plugins=[selection]))
    device, ran = devices[0], own.commit or commit()
    print(f"{device.name}, commit {ran}", flush=True)
    status = pytest.main(["-q", *asked], plugins=[selection])
    lines = lines_of(selection, device, time.perf_counter() - begin, ran)
    part = "" if selection.parts == 1 else f"-{selection.part}-of-{selection.parts}"
    path = write_record(f"gpu-suite{part}", "Tests on a GPU", lines)
    print("\n".join(lines[: lines.index(FILES)]))
    print(f"record: {path}")
    return int(status)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

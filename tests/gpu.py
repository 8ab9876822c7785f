"""The tests that must run on a CUDA device: those that take each device found, with the CUDA ones, and those marked `cuda`.

    python -m tests.gpu [arguments of pytest]

It says on which device and commit it runs, and writes a dated record of what ran. The process ends as pytest does, and with 2
if there is no CUDA device, or tests are to run side by side.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import warp as wp

from tests.records import write_record

ROOT = Path(__file__).resolve().parents[1]
NO_DEVICE = 2


def needs_card(item: pytest.Item) -> bool:
    """Whether a test runs on a CUDA device: it is marked `cuda`, or `device` is one."""
    device = getattr(item, "callspec", None) and item.callspec.params.get("device")
    return item.get_closest_marker("cuda") is not None or str(device).startswith("cuda")


class Selection:
    """A plugin of pytest that keeps the tests of `needs_card`, and counts what becomes of them.

    Attributes:
        outcomes: tests by outcome.
        files: tests that passed, by file.
        failed: names of those that did not.
    """

    def __init__(self) -> None:
        self.outcomes: Counter[str] = Counter()
        self.files: Counter[str] = Counter()
        self.failed: list[str] = []

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        """Deselects all others."""
        others = [item for item in items if not needs_card(item)]
        items[:] = [item for item in items if needs_card(item)]
        config.hook.pytest_deselected(items=others)

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Counts a test once: by its call, or by what kept that from happening."""
        if report.when == "call" or report.outcome != "passed":
            self.outcomes[report.outcome] += 1
            if report.failed:
                self.failed.append(report.nodeid)
            elif report.passed:
                self.files[report.nodeid.split("::")[0]] += 1


def commit() -> str:
    """The commit of the checkout, marked if files differ from it; "unknown" outside a checkout."""
    done = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"


def lines_of(selection: Selection, device: wp.Device, seconds: float) -> list[str]:
    """What a record says."""
    counted = ", ".join(f"{count} {outcome}" for outcome, count in sorted(selection.outcomes.items()))
    where = f"{device.name} ({device.alias}, sm_{device.arch}), commit {commit()}"
    return [
        f"`python -m tests.gpu` on {where}: {counted} in {seconds:.0f} s.",
        "",
        *(f"* failed: `{name}`" for name in selection.failed),
        "",
        "| file | passed |",
        "| --- | --- |",
        *(f"| {name} | {count} |" for name, count in sorted(selection.files.items())),
    ]


def main(arguments: list[str]) -> int:
    """Runs the tests; returns the status of the process."""
    if any(argument.startswith("-n") for argument in arguments):
        print("the tests take turns on one device: leave -n out", file=sys.stderr)
        return NO_DEVICE
    wp.init()
    if not wp.get_cuda_devices():
        print("there is no CUDA device here", file=sys.stderr)
        return NO_DEVICE
    device, selection, begin = wp.get_cuda_devices()[0], Selection(), time.perf_counter()
    print(f"{device.name}, commit {commit()}", flush=True)
    status = pytest.main(["-q", *(arguments or [str(ROOT / "tests")])], plugins=[selection])
    path = write_record("gpu-suite", "Tests on a GPU", lines_of(selection, device, time.perf_counter() - begin))
    print(f"{dict(selection.outcomes)}; record: {path}")
    return int(status)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Runs children, one for each core, watches them, and keeps what fails.

A child that ends by a signal, or that works on one case for too long, failed at the case that its progress file names. The
case is made again from its number and kept, and a new child goes on behind it.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from .cases import Case
from .child import FIELDS, Job, case_of

ROOT = Path(__file__).resolve().parents[2]

LONGEST = 30.0
"""Seconds that a case may take."""

MAX_COMPILE_SECONDS = 90.0
"""The same for the first cases of a child, in which kernels may be compiled."""

FIRST_CASES = 2000
"""How many these are."""

LOG_LINES = 40
"""Of the log of a child that ended by a signal, what is kept."""


@dataclass
class Found:
    """What a run found.

    Attributes:
        done, refused: cases by kind.
        failures: what failed, in words, by the path of its case.
        seconds: by kind, of all its children together.
    """

    done: Counter = field(default_factory=Counter)
    refused: Counter = field(default_factory=Counter)
    failures: dict[Path, str] = field(default_factory=dict)
    seconds: Counter = field(default_factory=Counter)


class Child:
    """A process and how far it is."""

    def __init__(self, job: Job, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        np.zeros(len(FIELDS), dtype=np.int64).tofile(folder / "progress")
        self.job = replace(job, folder=str(folder))
        with open(folder / "log", "wb") as log:
            command = [sys.executable, "-m", "tests.fuzz.child", self.job.text()]
            self.process = subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=log)
        self.begin = self.changed = time.monotonic()
        self.last: dict[str, int] = dict.fromkeys(FIELDS, 0)

    def look(self) -> dict[str, int]:
        """How far it is by now."""
        now = dict(zip(FIELDS, np.fromfile(self.folder / "progress", dtype=np.int64).tolist(), strict=True))
        if now != self.last:
            self.last, self.changed = now, time.monotonic()
        return now

    def hangs(self) -> bool:
        """Whether it has been at one case for too long."""
        return self.process.poll() is None and time.monotonic() - self.changed > self.allowed

    @property
    def allowed(self) -> float:
        """Seconds that a case may take by now."""
        return LONGEST if self.last["done"] > FIRST_CASES else MAX_COMPILE_SECONDS

    def end(self) -> None:
        """Stops it."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()


def run_jobs(jobs: Sequence[Job], keep_in: Path, tell: Callable[[Found], None], processes: int) -> Found:
    """Runs jobs, so many at a time.

    Args:
        jobs: without folders.
        keep_in: where cases that fail are kept.
        tell: told now and then how far it is.
        processes: at a time.
    """
    found, waiting, running, ended = Found(), list(jobs), [], 0
    with TemporaryDirectory() as scratch:
        try:
            while waiting or running:
                while waiting and len(running) < processes:
                    running.append(Child(waiting.pop(0), Path(scratch) / str(ended + len(running))))
                time.sleep(0.2)
                for child in list(running):
                    child.look()
                    if child.process.poll() is not None or child.hangs():
                        running.remove(child)
                        ended += 1
                        waiting = [*rest_of(child, found, keep_in), *waiting]
                tell(so_far(found, running))
        finally:
            for child in running:
                child.end()
    return found


def so_far(found: Found, running: Sequence[Child]) -> Found:
    """What is found, and what children are about to find."""
    done, refused = Counter(found.done), Counter(found.refused)
    for child in running:
        done[child.job.what] += child.last["done"]
        refused[child.job.what] += child.last["refused"]
    return replace(found, done=done, refused=refused)


def rest_of(child: Child, found: Found, keep_in: Path) -> list[Job]:
    """Takes over what a child that has ended found; what is left of its job."""
    hung = child.hangs()
    child.end()
    now, job, took = child.look(), child.job, time.monotonic() - child.begin
    found.done[job.what] += now["done"]
    found.refused[job.what] += now["refused"]
    found.seconds[job.what] += took
    for path in sorted(child.folder.glob("*.npz")):
        keep_in.mkdir(parents=True, exist_ok=True)
        reason = path.with_suffix(".txt").read_text()
        (keep_in / path.name).write_bytes(path.read_bytes())
        (keep_in / path.name).with_suffix(".txt").write_text(reason)
        found.failures[keep_in / path.name] = reason.splitlines()[0]
    if child.process.returncode == 0 and not hung:
        return []
    number = now["number"]
    log = (child.folder / "log").read_text(errors="replace").splitlines()[:LOG_LINES]
    reason = f"took longer than {child.allowed:.0f} s" if hung else f"ended with status {child.process.returncode}"
    if not now["ready"]:
        raise RuntimeError("a child did not begin:\n" + "\n".join(log))
    case = Case.load(Path(job.replay[number])) if job.replay else case_of(job.what, job.seed, number)
    path = keep_in / f"{job.what}-{job.seed}-{number}.npz"
    case.save(path)
    path.with_suffix(".txt").write_text("\n".join([reason, "", str(case.options), "", *log]))
    found.failures[path] = reason
    if job.replay:
        left = job.replay[number + 1 :]
        return [replace(job, replay=left)] if left else []
    seconds, cases = job.seconds - took, job.cases - (number - job.first) // job.step - 1
    return [replace(job, first=number + job.step, cases=cases, seconds=seconds)] if seconds > 1.0 and cases > 0 else []

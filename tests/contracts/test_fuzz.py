"""The fuzzer itself: cases that once failed, a short run of each kind, and that it notices what it is there to notice.

For more: `python -m tests.fuzz --minutes 30`.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from fuzz import driver
from fuzz.cases import CORPUS, Case
from fuzz.child import Job, case_of

ROOT = Path(__file__).resolve().parents[2]
SHORT = {"meshes": 150, "rays": 6, "files": 60, "loaders": 500}
"""Cases of a short run."""


def job(what: str, cases: int, **options: object) -> Job:
    """A job of the test's, with the compiler flags of the tests."""
    given = {"seed": 1, "first": 0, "step": 1, "seconds": 300.0, "threads": 3, "folder": ""} | options
    return Job(what=what, cases=cases, compiler_flags=wp.config.cpu_compiler_flags, **given)


def run(jobs: list[Job], folder: Path) -> driver.Found:
    """Runs jobs as the command does, two at a time."""
    return driver.run_jobs(jobs, folder, lambda found: None, 2)


def test_what_once_failed(tmp_path):
    """Indices out of arrays, loops without end and errors without a message, of any builder: NaN or infinite prices, counts of
    a sweep that differ from the lists, events of which the end came before the start."""
    paths = sorted(CORPUS.glob("*.npz"))
    assert len(paths) >= 8
    kinds = {path: Case.load(path).what for path in paths}
    jobs = [
        job(what, 0, replay=tuple(str(path) for path in paths if kinds[path] == what)) for what in sorted(set(kinds.values()))
    ]
    found = run(jobs, tmp_path)
    assert not found.failures, found.failures
    assert sum(found.done.values()) == len(paths)


@pytest.mark.parametrize("what", SHORT)
def test_short_run(what, tmp_path):
    found = run([job(what, SHORT[what]), job(what, SHORT[what], first=10**6, threads=1)], tmp_path)
    assert not found.failures, found.failures
    assert found.done[what] == 2 * SHORT[what]


def test_cases_repeat():
    """A case follows from its seed and number, and survives a file."""
    for what in SHORT:
        one, other = case_of(what, 5, 17), case_of(what, 5, 17)
        assert one.options == other.options
        assert all(one.arrays[name].tobytes() == array.tobytes() for name, array in other.arrays.items())
        assert case_of(what, 5, 18).options != one.options or what in ("files", "loaders")


def test_a_case_survives_a_file(tmp_path):
    case = case_of("meshes", 5, 3)
    case.save(tmp_path / "case.npz")
    read = Case.load(tmp_path / "case.npz")
    assert (read.what, read.options) == (case.what, case.options)
    assert {name: array.tobytes() for name, array in read.arrays.items()} == {n: a.tobytes() for n, a in case.arrays.items()}


GUARDED = """
import warp as wp
from tests.fuzz.guards import GuardedAllocator
wp.config.log_level = wp.LOG_WARNING
wp.init()
GuardedAllocator.install()

@wp.func_native("values.data[i] = 1;")
def store(values: wp.array(dtype=int), i: int): ...

@wp.kernel
def write(values: wp.array(dtype=int), i: int):
    store(values, i)

arrays = [wp.empty(5, dtype=int, device="cpu") for _ in range(2)]
assert (arrays[0].numpy() == arrays[1].numpy()).all() and arrays[0].numpy()[0] < 0
for array in arrays:
    wp.launch(write, 1, [array, 4], device="cpu")
print("inside", flush=True)
for array in arrays:
    wp.launch(write, 1, [array, INDEX], device="cpu")
print("outside", flush=True)
del array, arrays
print("freed", flush=True)
"""


@pytest.mark.parametrize("index", [5, -1])
def test_guards(index, tmp_path):
    """One element too far, or below zero: at once where the array lies against a guard page, else when the array is freed."""
    program = tmp_path / "program.py"  # Warp reads a kernel's text from its file
    program.write_text(GUARDED.replace("INDEX", str(index)))
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    result = subprocess.run([sys.executable, program], env=environment, capture_output=True, text=True)
    assert "inside" in result.stdout, result.stderr
    assert "freed" not in result.stdout
    assert result.returncode in (-signal.SIGSEGV, -signal.SIGABRT)


def test_failures_are_kept(tmp_path):
    """An error of any kind is kept with its case; the others go on."""
    wrong, right = case_of("meshes", 1, 0), case_of("meshes", 1, 1)
    Case("meshes", wrong.options | {"builder": "nonsense"}, wrong.arrays).save(tmp_path / "wrong.npz")
    right.save(tmp_path / "right.npz")
    found = run([job("meshes", 0, replay=(str(tmp_path / "wrong.npz"), str(tmp_path / "right.npz")))], tmp_path / "kept")
    assert found.done["meshes"] == 2
    ((path, reason),) = found.failures.items()
    assert "nonsense" in reason
    assert Case.load(path).options["builder"] == "nonsense"


def test_a_child_that_ends_by_a_signal(tmp_path):
    """Its case is kept, and another child goes on behind it."""
    child = driver.Child(job("meshes", 10**9), tmp_path / "child")
    try:
        while child.look()["done"] < 3:
            assert child.process.poll() is None
            time.sleep(0.05)
        child.process.send_signal(signal.SIGSEGV)
        child.process.wait()
        found = driver.Found()
        (rest,) = driver.rest_of(child, found, tmp_path / "kept")
    finally:
        child.end()
    ((path, reason),) = found.failures.items()
    number = int(path.stem.split("-")[-1])
    assert "status -11" in reason
    assert rest.first == number + 1
    np.testing.assert_equal(Case.load(path).arrays, case_of("meshes", 1, number).arrays)

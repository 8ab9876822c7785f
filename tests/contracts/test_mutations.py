"""The tables of mutations fit the checkout, and their runner tells what is killed from what survives."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
import threading
from functools import cache
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.mutate.__main__ import main
from tests.mutate.mutation import Mutation, areas, choose, table
from tests.mutate.report import record_lines, summary
from tests.mutate.runner import ERROR, KILLED, SURVIVED, Processes, Runner

ROOT = Path(__file__).resolve().parents[2]
LEAST = 150
"""Mutations of all tables together."""


@cache
def names_in(path: str) -> set[str]:
    """Names of the tests of a file, as they stand in pytest ids without parameters."""
    found = set()
    for node in ast.parse((ROOT / path).read_text()).body:
        if isinstance(node, ast.FunctionDef):
            found.add(node.name)
        elif isinstance(node, ast.ClassDef):
            found |= {f"{node.name}::{one.name}" for one in node.body if isinstance(one, ast.FunctionDef)}
    return {name for name in found if name.rpartition("::")[2].startswith("test_")}


@pytest.mark.parametrize("area", areas())
def test_mutations_fit_the_checkout(area):
    """A table whose text has gone from the code would test nothing any more."""
    for name, mutation in table(area).items():
        text = (ROOT / mutation.path).read_text()
        mutated = mutation.applied_to(text)
        assert mutated != text, name
        assert not mutation.path.endswith(".py") or ast.parse(mutated), name
        assert mutation.promise, name
        for test in mutation.test_ids:
            path, _, function = test.partition("::")
            assert function.partition("[")[0] in names_in(path), f"{name}: no test {test}"


def test_there_are_many():
    assert len(choose()) >= LEAST


def test_choosing():
    first = next(iter(choose()))
    assert list(choose(only=[first])) == [first]
    with pytest.raises(ValueError, match="no mutation 'core:0'"):
        choose(areas()[:1], ["core:0"])
    with pytest.raises(ValueError, match="choose from"):
        table("nothing")


TOY = {
    "toy/__init__.py": "",
    "toy/sums.py": 'def add(a, b):\n    """Adds."""\n    return a + b\n\n\ndef twice(a):\n    return 2 * a\n',
    "test_toy.py": (
        "import pytest\nfrom toy.sums import add, twice\n\n"
        "def test_add():\n    assert add(2, 3) == 5\n\n"
        "def test_twice():\n    assert twice(0) == 0\n\n"
        "def test_fails():\n    assert add(1, 1) == 3\n\n"
        "def test_skipped():\n    pytest.skip('not here')\n"
    ),
}
TOY_MUTATIONS = {
    "killed": ("a + b", "a - b", "test_add"),
    "survived": ("2 * a", "3 * a", "test_twice"),
    "no Python": ("a + b", "a +", "test_add"),
    "undefined": ("a + b", "a + c", "test_add"),
    "comment": ('"""Adds."""', '"""Subtracts."""', "test_add"),
    "twice": ("def", "de", "test_add"),
    "fails before": ("a + b", "a - b", "test_fails"),
    "skipped": ("a + b", "a - b", "test_skipped"),
    "no test": ("a + b", "a - b", "test_nothing"),
}


@pytest.mark.slow
def test_the_runner_tells_what_is_killed(tmp_path, monkeypatch):
    """On a package without kernels: only a test that fails because of a mutation that runs kills it."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # starts in half the time
    for name, text in TOY.items():
        path = tmp_path / "checkout" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    subprocess.run(["git", "init", "-q", tmp_path / "checkout"], check=True)
    mutations = {
        f"toy:{name}": Mutation("toy/sums.py", old, new, f"test_toy.py::{test}", f"promise of {name}")
        for name, (old, new, test) in TOY_MUTATIONS.items()
    }
    said = []
    outcomes = Runner(tmp_path / "checkout", jobs=2, timeout=60.0, tell=said.append).run(mutations)
    states = {outcome.name.partition(":")[2]: outcome.state for outcome in outcomes}
    assert states == {"killed": KILLED, "survived": SURVIVED, **dict.fromkeys([*TOY_MUTATIONS][2:], ERROR)}
    assert any(line.startswith("killed toy:killed") for line in said)
    assert (tmp_path / "checkout" / "toy" / "sums.py").read_text() == TOY["toy/sums.py"]
    assert "1 killed, 1 survived, 7 errors" in summary(outcomes)
    assert "promise of survived" in summary(outcomes)
    lines = record_lines(outcomes, "python -m tests.mutate", 60.0)
    assert "| **all** | 9 | 1 | 1 | 7 |" in lines
    assert any(line.startswith("* survived `toy:survived`") for line in lines)


def test_endless_tests_are_errors(tmp_path):
    """A mutation after which tests never end proves nothing: on a slow machine, every mutation would count as killed."""
    runner = Runner(timeout=0.5)
    ended = runner.processes.run([sys.executable, "-c", "while True: pass"], tmp_path, dict(os.environ))
    assert ended.status is None
    endless = Mutation("toy.py", "old", "new", "test_toy.py::test_toy", "it ends")
    state, _, reason = runner.judged(None, endless, ended, tmp_path)
    assert state == ERROR
    assert "did not end" in reason


def test_stopped_processes_end(tmp_path):
    """Ctrl-C ends what runs, and nothing begins behind it."""
    processes = Processes(60.0)
    timer = threading.Timer(0.3, processes.stop)
    timer.start()
    with pytest.raises(InterruptedError):
        processes.run([sys.executable, "-c", "import time; time.sleep(60)"], tmp_path, dict(os.environ))
    with pytest.raises(InterruptedError):
        processes.run([sys.executable, "-c", "pass"], tmp_path, dict(os.environ))


def test_command_lists_and_refuses():
    listed = CliRunner().invoke(main, ["--list"])
    assert listed.exit_code == 0
    assert len(listed.stdout.splitlines()) == len(choose())
    refused = CliRunner().invoke(main, ["--only", "nothing:1"])
    assert refused.exit_code == 2
    assert "choose from" in refused.output

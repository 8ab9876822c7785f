"""`python -m tests.gpu`: what it picks, how it divides that, and what it says."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def gpu(monkeypatch):
    """The module; it is in a package below the checkout's root."""
    monkeypatch.syspath_prepend(ROOT)
    from tests import gpu

    return gpu


def test_what_is_picked(gpu):
    """Tests of a CUDA device, and those that are marked; not those of the CPU, and of no device."""

    def item(marked: bool = False, **parameters: str) -> SimpleNamespace:
        """As pytest has it."""
        return SimpleNamespace(callspec=SimpleNamespace(params=parameters), get_closest_marker=lambda name: marked or None)

    assert gpu.needs_card(item(device="cuda:1"))
    assert gpu.needs_card(item(marked=True))
    assert not gpu.needs_card(item(device="cpu"))
    assert not gpu.needs_card(item(kind="any"))
    assert not gpu.needs_card(SimpleNamespace(get_closest_marker=lambda name: None))


def test_tests_that_ask_for_a_card_are_marked():
    """What looks for CUDA devices by itself, and is not marked, would run on no card."""
    asks = re.compile(r"skipif\(not (?:wp\.get_cuda_devices|wp\.is_cuda_available|CUDA)\b|if not wp\.get_cuda_devices")
    own = Path(__file__).name
    found = [path for path in (ROOT / "tests").rglob("test_*.py") if path.name != own and asks.search(path.read_text())]
    assert len(found) >= 5
    assert [path.name for path in found if "mark.cuda" not in path.read_text()] == []


def test_parts_have_all_files_once(gpu):
    tests = [
        f"a/{name}.py::test_{number}" for name, count in (("x", 9), ("y", 4), ("z", 5), ("w", 1)) for number in range(count)
    ]
    parts = [gpu.part_of(tests, part, 3) for part in (1, 2, 3)]
    assert sorted(file for part in parts for file in part) == ["a/w.py", "a/x.py", "a/y.py", "a/z.py"]
    assert parts == [{"a/x.py"}, {"a/z.py"}, {"a/y.py", "a/w.py"}]
    for bad in ("0/3", "4/3", "1/2/3"):
        with pytest.raises(SystemExit):
            gpu.parsed(["--part", bad])


def test_what_is_said(gpu):
    selection = gpu.Selection(2, 3)
    selection.kept = ["tests/a/x.py::test_1", "tests/a/x.py::test_2[cuda:0]", "tests/b/y.py::test_3"]

    def report(name: str, outcome: str, when: str = "call", message: str = "") -> None:
        """Of one phase of a test."""
        crash = SimpleNamespace(reprcrash=SimpleNamespace(message=message))
        states = {state: state == outcome for state in ("passed", "failed", "skipped")}
        selection.pytest_runtest_logreport(SimpleNamespace(nodeid=name, when=when, outcome=outcome, longrepr=crash, **states))

    report(selection.kept[0], "passed", "setup")
    report(selection.kept[0], "passed")
    report(selection.kept[1], "failed", message="AssertionError: 3 != 4\nmore")
    report(selection.kept[2], "skipped", "setup")
    device = SimpleNamespace(name="a card", alias="cuda:0", arch=90)
    text = "\n".join(gpu.lines_of(selection, device, 7.4, "abc123"))
    assert "--part 2/3` on a card (cuda:0, sm_90), commit abc123: " in text
    assert "1 failed, 1 passed, 1 skipped of 3 tests in 7 s" in text
    assert "* failed: `tests/a/x.py::test_2[cuda:0]`: AssertionError: 3 != 4\n" in text
    assert "| tests/a | 2 | 1 | 1 |\n| tests/b | 1 | 0 | 0 |" in text


def test_a_list_needs_no_card():
    arguments = [
        "-m",
        "tests.gpu",
        "--list",
        "--part",
        "1/2",
        "tests/builders/test_builds_on_cuda.py",
        "tests/pages/test_pages.py",
    ]
    done = subprocess.run([sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    listed = [line for line in done.stdout.splitlines() if "::" in line]
    assert len(listed) > 5
    assert len({line.split("::")[0] for line in listed}) == 1

"""The commands that are run for hours, for seconds: they find nothing, and say what they did."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from wrt.kernels.runtime import pool as pools

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def at_the_root(monkeypatch):
    """The commands are modules of a package below the checkout's root."""
    monkeypatch.syspath_prepend(ROOT)


def test_rays_at_edges_and_vertices(tmp_path):
    from tests.leaks import Tally, run_batches, write_record

    tally, counted = Tally(), []
    run_batches(2e5, 3, tally, counted.append)
    assert tally.rays["all"] == sum(counted) >= 2e5
    write_record(tmp_path / "leaks.md", tally, 1.0, 3)
    assert "**0 batches with failures.**" in (tmp_path / "leaks.md").read_text()


@pytest.mark.skipif(not pools.is_available(), reason="native helpers need Linux")
def test_interrupts(tmp_path):
    record = tmp_path / "interrupts.md"
    arguments = ["-m", "tests.interrupts", "--count", "60", "--processes", "2", "--record", str(record)]
    done = subprocess.run([sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "60 interrupts" in record.read_text()
    assert "0 of 2 processes failed" in record.read_text()


def test_mixed_load():
    from tests.soak import run

    load = run(0.05, 0, lambda *_: None)
    assert not load.errors
    assert sum(load.done.values()) > 20
    assert load.memory


def test_browsers_that_come_and_leave():
    pytest.importorskip("viser", reason="the viewer needs viser: pip install 'wrt[view]'")
    from tests.viewer_soak import run

    tally = run(24, 0, lambda *_: None)
    assert not tally.failures
    assert sum(tally.stages.values()) == 24
    assert max(row[2] for row in tally.rows) - min(row[2] for row in tally.rows) < 5

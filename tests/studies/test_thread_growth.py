"""Numbers of threads take turns, and each call runs with the number that it is said to."""

from __future__ import annotations

import pytest

from studies.kdtrees import thread_growth as study
from wrt import get_num_threads
from wrt.scenes import build


def test_calls_run_with_their_threads(monkeypatch):
    monkeypatch.setattr(study, "available_cores", lambda: 4)
    monkeypatch.setattr(study, "SETTLE", 0.0)
    seen = []
    rows = study.growth("nothing", lambda: seen.append(get_num_threads()), rounds=2)
    assert [row["threads"] for row in rows] == ["1", "2", "4"]
    assert seen == [1, 2, 4, 1, 2, 4, 2, 4, 1]  # warm-up, and two rounds that begin with another one
    assert all(row["seconds"] > 0.0 for row in rows)
    assert rows[0]["speed"] == pytest.approx(1.0)


def test_all_that_the_claims_ask_for_is_measured(monkeypatch):
    monkeypatch.setattr(study, "available_cores", lambda: 1)
    monkeypatch.setattr(study, "SETTLE", 0.0)
    mesh = build("teapot", level=2, ground=False)
    rows = [*study.build_growth(mesh, rounds=1), *study.ray_growth(mesh, size=64, rounds=1)]
    rows += study.group_growth(rounds=1, groups=2, detail=3)
    assert [row["what"] for row in rows] == [*study.BUILDERS, "view", "random", "groups"]

"""`python -m studies scheduling`: every schedule in every job."""

from __future__ import annotations

import json

from click.testing import CliRunner

from studies.__main__ import studies
from wrt.kernels.runtime.schedules import DEFAULT_SCHEDULE, SCHEDULES


def test_scheduling(tmp_path):
    command = ["scheduling", "teapot", "--threads", "2", "--rounds", "1"]
    result = CliRunner().invoke(studies, [*command, "--json", str(tmp_path / "figures.json")])
    assert result.exit_code == 0, result.output
    jobs = json.loads((tmp_path / "figures.json").read_text())["jobs"]
    assert all(set(job["names"]) == set(SCHEDULES) and job["names"][0] == DEFAULT_SCHEDULE for job in jobs)

"""`python -m studies shadows`: both lights beside the engines of `occluded`, with the same answers."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

import wrt
from studies.__main__ import studies
from studies.light.shadow_comparison import ENGINES, compare_shadows


def test_figures():
    mesh = wrt.scenes.build("teapot", level=2)
    camera = wrt.PinholeCamera.framing(mesh, 24, 24)
    figures = compare_shadows(mesh, camera, (-4.0, -9.0, 12.0), samples=[3], rounds=1)
    assert [row.engine for row in figures] == ["light_buffer", *ENGINES, "light_buffer", *ENGINES, "multi_frusta", *ENGINES]
    assert all(row.same and row.megarays > 0 for row in figures)
    assert [row.ratio for row in figures if row.engine == ENGINES[0]] == [1.0, 1.0, 1.0]
    seen = int(np.asarray(wrt.Scene(mesh).intersect(camera.rays()).is_hit).sum())
    assert {row.light: row.rays for row in figures} == {"point": seen, "point, shuffled": seen, "area, 3 samples": 3 * seen}
    assert all((row.bytes is None) == (row.engine != "light_buffer") for row in figures)


def test_a_camera_that_sees_nothing():
    mesh = wrt.scenes.build("teapot", level=2)
    away = wrt.PinholeCamera(8, 8, position=(0, 0, 20), look_at=(0, 3, 40))
    with pytest.raises(ValueError, match="sees nothing"):
        compare_shadows(mesh, away, (0.0, 0.0, 9.0))


def test_command(tmp_path):
    target = tmp_path / "shadows.json"
    arguments = ["shadows", "teapot", "--size", "16", "--rounds", "1", "--samples", "2", "--resolution", "8", "--json", target]
    done = CliRunner().invoke(studies, [*map(str, arguments)])
    assert done.exit_code == 0, done.output
    assert "multi_frusta" in done.output
    written = json.loads(target.read_text())
    assert {row["light"] for row in written["shadows"]} == {"point", "point, shuffled", "area, 2 samples"}

"""`wrt render` with an integrator."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

from wrt.cli import main
from wrt.imaging.integrators.rendering_job import Rendering

SMALL = ["--width", "24", "--height", "20"]


def run(*arguments):
    return CliRunner().invoke(main, ["render", *map(str, arguments), *SMALL])


def test_the_cornell_box(tmp_path):
    result = run("--scene", "cornell_box", "--integrator", "path", "--samples", 4, "--depth", 4, "-o", tmp_path / "a.npy")
    assert result.exit_code == 0, result.output
    assert "4 samples" in result.output
    picture = np.load(tmp_path / "a.npy")
    assert picture.shape == (20, 24, 3)
    left, right = picture[8:12, 3].mean(axis=0), picture[8:12, 20].mean(axis=0)
    assert left[0] > 2 * left[1]  # the red wall
    assert right[1] > 2 * right[0]


@pytest.mark.parametrize("integrator", ["whitted", "distribution"])
def test_scenes_without_materials(tmp_path, integrator):
    result = run("--integrator", integrator, "--samples", 2, "--sky", 0.4, "--level", 2, "-o", tmp_path / "a.png")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "a.png").exists()


def test_ctrl_c_keeps_the_samples(tmp_path, monkeypatch):
    advance = Rendering.advance

    def interrupted(self, samples=None, progress=None):
        advance(self, 2)
        raise KeyboardInterrupt

    monkeypatch.setattr(Rendering, "advance", interrupted)
    result = run("--scene", "cornell_box", "--integrator", "path", "-o", tmp_path / "a.npy")
    assert result.exit_code == 0, result.output
    assert "2 of 16 samples" in result.output
    assert np.load(tmp_path / "a.npy").max() > 0.0


def test_options_of_other_integrators(tmp_path):
    result = run("--depth", 3, "-o", tmp_path / "a.png")
    assert result.exit_code == 2
    assert "--depth needs --integrator" in result.output
    result = run("--integrator", "path", "--sampler", "blue", "-o", tmp_path / "a.png")
    assert result.exit_code == 2
    assert "sampler 'blue' is unknown" in result.output

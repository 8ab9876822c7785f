"""A script prints what it prints: Warp's own lines are shown only to those who ask for them."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
import warp as wp

from wrt.kernels.compilation import target

SCRIPT = """
scene = wrt.Scene(wrt.scenes.build("teapot"), device="cpu")
print(scene.intersect([5.0, 5.0, 5.0], [-1.0, -1.0, -0.8]).t > 0)
"""
LEVEL = "wp.config.log_level = wp.LOG_{}\n"


def lines(before: str, **environment: str) -> list[str]:
    """What the script prints on stdout."""
    given = {name: value for name, value in os.environ.items() if name != "WRT_WARP_LOG"} | environment
    command = [sys.executable, "-c", before + SCRIPT]
    return subprocess.run(command, env=given, capture_output=True, text=True, check=True).stdout.splitlines()


def test_a_script_prints_its_own_lines():
    assert lines("import wrt") == ["True"]


def test_a_missing_driver_is_no_news_and_other_lines_stay(capfd, monkeypatch):
    """Every script on a machine without an NVIDIA GPU printed Warp's warning, whatever device it asked for."""
    monkeypatch.setattr(wp.config, "log_level", wp.LOG_WARNING)
    with target.without_driver_message():
        os.write(2, target.NO_DRIVER + b" GPU execution will not be available.\nanother line\n")
    assert capfd.readouterr().err == "another line\n"
    monkeypatch.setattr(wp.config, "log_level", wp.LOG_INFO)
    with target.without_driver_message():
        os.write(2, target.NO_DRIVER + b"\n")
    assert capfd.readouterr().err == target.NO_DRIVER.decode() + "\n"


def test_rays_of_a_camera_before_any_scene_are_quiet():
    """They started Warp with its warning that there is no driver."""
    code = "import wrt; wrt.PinholeCamera(2, 2, position=(0, -3, 1), look_at=(0, 0, 0)).rays()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert target.NO_DRIVER.decode() not in done.stderr


@pytest.mark.parametrize(
    ("before", "environment"),
    [
        ("import wrt", {"WRT_WARP_LOG": "1"}),
        ("import warp as wp\n" + LEVEL.format("DEBUG") + "import wrt", {}),
        ("import wrt, warp as wp\n" + LEVEL.format("DEBUG"), {}),
        ("import wrt, warp as wp\nwrt.Scene\n" + LEVEL.format("INFO"), {}),
        ("import warp as wp\nwp.init()\nimport wrt", {}),
    ],
)
def test_warp_speaks_where_it_is_asked_to(before, environment):
    found = lines(before, **environment)
    assert "True" in found
    assert any(line.startswith("Warp ") for line in found)
    assert any(line.startswith("Module ") for line in found)

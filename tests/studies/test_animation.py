"""Things that move, followed in every way: the hits of a tree that is built for each frame; and the benchmark that compares."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

import wrt
from studies import animation as animation_command
from studies.__main__ import studies
from studies.moving import animation_comparison as animation
from studies.moving.animation_comparison import ANIMATIONS, WAYS, Stage, compare_ways

CAMERA = wrt.PinholeCamera(32, 32, fov=55, position=(-6.0, -3.5, 2.0), look_at=(0.0, -0.6, 1.6), up=(0.0, 0.0, 1.0))
COURT = wrt.scenes.atrium(bays=(3, 2), storeys=1, detail=1)


@pytest.mark.parametrize("name", ANIMATIONS)
def test_every_way_finds_the_same_hits(name):
    """To the bit, but for two levels, where rays are transformed."""
    stage = Stage(COURT, ANIMATIONS[name](3, 4))
    figures = {row.way: row for row in compare_ways(stage, CAMERA)}
    able = [way for way in WAYS if name == "figure" or way != animation.LIMITS]  # a cloth has no joints
    assert list(figures) == [*able, "building while tracing"]
    assert figures.pop("two levels").same_triangle > 0.99
    for row in figures.values():
        assert (row.way, row.same_triangle, row.same_bits) == (row.way, 1.0, 1.0)
        assert len(row.update) == len(row.trace) == 3
        assert row.frames_per_second > 0.0
    fresh = wrt.Scene(stage.meshes(1), device="cpu").intersect(CAMERA.rays())
    assert (fresh.geometry_id == 1).sum() > 20, "it has to be seen to move"


def test_a_difference_would_show():
    figures = animation.WayFigures("some", 0.0)
    wanted = np.array([1, 2, 3, -1]), np.array([1.0, 1.0, 1.0, np.inf])
    figures.compare((np.array([1, 2, 4, -1]), np.array([1.0, 1.5, 1.0, np.inf])), wanted)
    assert (figures.same_triangle, figures.same_bits) == (0.75, 0.5)
    figures.add(0, 1.0, 1.0)
    figures.add(0, 0.5, 1.0)
    figures.add(0, 5.0, 1.0)
    assert figures.frames_per_second == pytest.approx(1 / 1.5)


def test_command(monkeypatch, tmp_path):
    monkeypatch.setattr(animation_command, "atrium", lambda: COURT)
    file = tmp_path / "figures.json"
    options = ["--frames", "2", "--detail", "4", "--size", "16", "--rounds", "1", "--way", "groups", "--json", str(file)]
    done = CliRunner().invoke(studies, ["animation", "cloth", *options])
    assert done.exit_code == 0, done.output
    assert "groups" in done.output
    assert '"same_bits": 1.0' in file.read_text()


@pytest.mark.parametrize("make", [wrt.scenes.waving_cloth, wrt.scenes.walking_figure])
def test_animations(make):
    one = make(8, 6)
    assert one.frames.shape[0] == len(one) == 8
    assert np.abs(np.diff(one.frames, axis=0)).max(axis=(1, 2)).min() > 0.01
    np.testing.assert_array_equal(one.frames, make(8, 6).frames)
    assert one.mesh(3).triangle_count == len(one.faces)
    assert make(8, 12).mesh(0).triangle_count > 3 * len(one.faces)
    moved = one.moved((1.0, 2.0, 3.0))
    np.testing.assert_allclose(moved.frames - one.frames, np.broadcast_to([1.0, 2.0, 3.0], one.frames.shape))


def test_the_figure_follows_its_bones():
    """Each closed limb keeps its shape away from the joints, feet swing in turn, and the figure advances."""
    figure = wrt.scenes.walking_figure(8, 6)
    assert all(figure.mesh(frame).is_closed for frame in (0, 3))
    rest = np.linalg.inv(figure.bones[0, 0]) @ np.append(figure.frames[0, 0], 1.0)  # of the trunk, which has one bone
    np.testing.assert_allclose((figure.bones[:, 0] @ rest)[:, :3], figure.frames[:, 0], atol=1e-12)
    assert figure.frames[-1, :, 0].mean() - figure.frames[0, :, 0].mean() > 0.8
    assert np.linalg.det(figure.bones[..., :3, :3]) == pytest.approx(1.0)
    with pytest.raises(ValueError, match="detail is 2; it must be at least 3"):
        wrt.scenes.walking_figure(8, 2)

"""Pictures that are continued: the same bit for bit, and nothing of another picture is taken."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

import wrt
from wrt.cli import main
from wrt.imaging.integrators.rendering_job import Rendering
from wrt.revisions import ANSWER_REVISION, SAMPLE_REVISION
from wrt.scene.archives import read_archive, write_archive

BOX = wrt.scenes.build("cornell_box", cells=1)
VIEW = wrt.scenes.BUILTIN_SCENES["cornell_box"].camera


def rendering(mesh=BOX, size=16, **options):
    camera = wrt.PinholeCamera(size, size, **VIEW)
    return wrt.pictures.Rendering(wrt.Scene(mesh, device="cpu"), camera, **{"samples": 6, "depth": 3, **options})


def test_continued_is_the_same(tmp_path):
    """Also with waves of another size: their number of samples does not change the sums."""
    path = tmp_path / "a.npz"
    rendering().advance(2).save_samples(path)
    continued = rendering(wave=100, exposure=2.0).load_samples(path)
    assert continued.done == 2
    whole = rendering().advance()
    assert np.array_equal(continued.advance().linear, whole.linear)
    assert np.array_equal(continued.noise, whole.noise)


MOVED = BOX.transformed(np.array([[1, 0, 0, 1e-3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]))
PAINTED = BOX.with_materials(wrt.Material(color=0.4, emission=1.0))


@pytest.mark.parametrize(
    "other",
    [
        {"mesh": MOVED},
        {"mesh": PAINTED},
        {"seed": 1},
        {"samples": 8},
        {"depth": 4},
        {"integrator": "distribution"},
        {"lights": [wrt.lights.PointLight((0, 2, 3), 1.0)]},
        {"materials": wrt.Material(emission=0.5)},
        {"size": 15},
    ],
    ids=str,
)
def test_other_pictures_are_refused(tmp_path, other):
    path = tmp_path / "a.npz"
    rendering().advance(1).save_samples(path)
    made = rendering(**other)
    with pytest.raises(ValueError, match="another picture"):
        made.load_samples(path)
    assert made.done == 0


def test_other_cameras_and_motions_are_refused(tmp_path):
    path, scene = tmp_path / "a.npz", wrt.Scene(BOX, device="cpu")
    rendering().advance(1).save_samples(path)
    camera = wrt.PinholeCamera(16, 16, **{**VIEW, "fov": 39.4})
    motion = wrt.moving.Motion(vertices={0: (BOX.vertices, BOX.vertices + np.array((0.1, 0, 0)))})
    for given in (camera, None), (wrt.PinholeCamera(16, 16, **VIEW), motion):
        with pytest.raises(ValueError, match="another picture"):
            wrt.pictures.Rendering(scene, given[0], samples=6, depth=3, motion=given[1]).load_samples(path)


@pytest.mark.parametrize("revisions", [(SAMPLE_REVISION + 1, ANSWER_REVISION), (SAMPLE_REVISION, ANSWER_REVISION + 1)])
def test_samples_of_other_revisions_are_refused(tmp_path, monkeypatch, revisions):
    """By the version of wrt, 0.1.0 throughout, samples of two versions of the code could not be told apart."""
    path = tmp_path / "a.npz"
    with monkeypatch.context() as other:
        other.setattr("wrt.imaging.integrators.saved_samples.REVISIONS", revisions)
        rendering().advance(1).save_samples(path)
    made = rendering()
    with pytest.raises(ValueError, match=rf"another version of wrt.*revisions \({revisions[0]}, {revisions[1]}\)"):
        made.load_samples(path)
    assert made.done == 0


def test_damaged_files(tmp_path):
    path = tmp_path / "a.npz"
    with pytest.raises(FileNotFoundError, match="no samples at"):
        rendering().load_samples(path)
    with pytest.raises(ValueError, match="no samples yet"):
        rendering().save_samples(path)
    rendering().advance(1).save_samples(path)
    arrays = read_archive(path)
    write_archive(path, arrays | {"done": np.array(7)})
    with pytest.raises(ValueError, match="damaged"):
        rendering().load_samples(path)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(ValueError, match="damaged"):
        rendering().load_samples(path)


def run(*arguments):
    options = ["--integrator", "path", "--samples", "5", "--depth", "3", "--width", "16", "--height", "12"]
    return CliRunner().invoke(main, ["render", "--scene", "cornell_box", *options, *map(str, arguments)])


def test_the_command_resumes(tmp_path, monkeypatch):
    advance = Rendering.advance

    def interrupted(self, samples=None, progress=None):
        advance(self, 2)
        raise KeyboardInterrupt

    part, whole, kept = tmp_path / "a.npy", tmp_path / "b.npy", tmp_path / "a.npy.samples.npz"
    assert run("-o", whole).exit_code == 0
    assert "there is no" in run("--resume", "-o", part).output
    with monkeypatch.context() as patch:
        patch.setattr(Rendering, "advance", interrupted)
        result = run("-o", part)
        assert result.exit_code == 0, result.output
        assert "--resume" in result.output
    assert kept.exists()
    assert not np.array_equal(np.load(part), np.load(whole))
    other = run("--resume", "-o", part, "--seed", 3)
    assert other.exit_code == 2
    assert "another picture" in other.output
    assert kept.exists()
    assert run("--resume", "-o", part).exit_code == 0
    assert np.array_equal(np.load(part), np.load(whole))
    assert not kept.exists()


def test_ambient_has_nothing_to_resume(tmp_path):
    result = CliRunner().invoke(main, ["render", "--resume", "-o", str(tmp_path / "a.png")])
    assert result.exit_code == 2
    assert "--resume needs --integrator" in result.output

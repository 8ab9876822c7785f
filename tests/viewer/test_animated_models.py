"""What `wrt view` makes of files and folders; no browser, no server."""

import socket

import click
import numpy as np
import pytest

import wrt
from wrt import scenes
from wrt.cli.animated_models import load_models

GIVEN = {"scene": None, "options": (), "level": None, "accelerator": "auto", "device": "cpu", "threads": None}


def shifted(mesh, x, y=0.0):
    return wrt.TriangleMesh(np.add(mesh.vertices, (x, y, 0.0)), mesh.faces)


@pytest.fixture(scope="module")
def mesh():
    return scenes.build("teapot", level=2)


@pytest.fixture(scope="module")
def folder(mesh, tmp_path_factory):
    """Twelve frames, of which the last two would come second and third in the order of letters."""
    made = tmp_path_factory.mktemp("frames")
    for frame in range(12):
        shifted(mesh, float(frame)).save(made / f"frame{frame}.ply")
    (made / "notes.txt").write_text("not a frame")
    return made


@pytest.fixture(scope="module")
def still(mesh, tmp_path_factory):
    path = tmp_path_factory.mktemp("still") / "still.ply"
    shifted(mesh, 0.0, 9.0).save(path)
    return path


def left_of(models, scene, frame, fuzzy=False):
    """Least x of a frame."""
    animate = models.animation(fuzzy) or (lambda scene, frame: scene.show(frame))
    animate(scene, frame)
    return float(scene.bounds[0, 0])


@pytest.mark.parametrize("fuzzy", [False, True])
def test_a_folder_is_an_animation(folder, mesh, fuzzy):
    models = load_models((folder,), GIVEN, False)
    scene = models.scene(GIVEN, fuzzy)
    assert models.frames == 12
    assert type(scene) is (wrt.moving.FuzzyScene if fuzzy else wrt.Scene)
    for frame in (11, 2, 0):
        assert left_of(models, scene, frame, fuzzy) == pytest.approx(mesh.bounds[0, 0] + frame, abs=1e-3)


def test_files_as_frames(folder, mesh):
    models = load_models((folder / "frame3.ply", folder / "frame5.ply"), GIVEN, True)
    assert models.frames == 2
    assert left_of(models, models.scene(GIVEN, False), 1) == pytest.approx(mesh.bounds[0, 0] + 5, abs=1e-3)


def test_some_meshes_move(folder, still, mesh):
    """Others rest; the shorter of two animations begins again."""
    models = load_models((still, folder), GIVEN, False)
    scene = models.scene(GIVEN, False)
    assert type(scene) is wrt.moving.GroupedScene
    models.animation(False)(scene, 14)
    assert scene.bounds[1, 1] == pytest.approx(mesh.bounds[1, 1] + 9, abs=1e-3)
    assert scene.meshes[1].bounds[0, 0] == pytest.approx(mesh.bounds[0, 0] + 2, abs=1e-3)


def test_files_that_rest(folder, still):
    models = load_models((still, folder / "frame1.ply"), GIVEN, False)
    assert models.frames == 0
    assert models.animation(False) is None
    assert type(models.scene(GIVEN, False)) is wrt.Scene


def test_what_is_no_animation(folder, still, tmp_path):
    scenes.build("teapot", level=3).save(tmp_path / "other.ply")
    with pytest.raises(click.UsageError, match="other triangles"):
        load_models((folder / "frame1.ply", tmp_path / "other.ply"), GIVEN, True)
    (tmp_path / "empty").mkdir()
    with pytest.raises(click.UsageError, match="no mesh files"):
        load_models((tmp_path / "empty",), GIVEN, False)
    with pytest.raises(click.UsageError, match="needs the frames"):
        load_models((), GIVEN, True)
    with pytest.raises(click.UsageError, match="single mesh"):
        load_models((still, folder), GIVEN, False).scene(GIVEN, True)
    with pytest.raises(FileNotFoundError, match="no mesh file"):
        load_models((tmp_path / "nothing.ply",), GIVEN, False)


def run(monkeypatch, capsys, *words):
    """`wrt view WORDS` until it would wait; what it had made by then, and what it had said."""
    pytest.importorskip("viser", reason="the viewer needs viser: pip install 'wrt[view]'")
    from wrt.cli import main
    from wrt.viewer.live_view import Viewer

    seen = []

    def wait(viewer):
        seen.append((viewer, viewer.shared.is_playing, viewer._panel.__dict__.get("_rate")))
        viewer.close()

    monkeypatch.setattr(Viewer, "wait", wait)
    with pytest.raises(SystemExit) as ended:
        main(["view", *map(str, words), "--port", "0", "--device", "cpu"], prog_name="wrt")
    return seen, capsys.readouterr(), ended.value.code


def test_view_plays_a_folder(monkeypatch, capsys, folder):
    (shown,), said, status = run(monkeypatch, capsys, folder, "--fps", "12.5")
    viewer, plays, rate = shown
    assert plays
    assert rate.value == 12.5
    assert viewer.shared.frames == 12
    assert said.out.splitlines()[0].startswith("http://127.0.0.1:")
    assert "12 frames" in said.out.splitlines()[1]
    assert status == 0


def test_view_says_what_is_wrong_and_ends_its_server(monkeypatch, capsys, tmp_path):
    seen, said, status = run(monkeypatch, capsys, tmp_path / "nothing.ply")
    assert (seen, status) == ([], 1)
    assert "no mesh file" in said.err
    port = int(said.out.split()[0].rsplit(":", 1)[1])
    with socket.socket() as free:
        free.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a connection that has just ended does not count
        free.bind(("127.0.0.1", port))


def test_view_with_a_token(monkeypatch, capsys, folder):
    (shown,), said, _ = run(monkeypatch, capsys, folder / "frame0.ply", "--host", "0.0.0.0")
    viewer, plays, _ = shown
    assert not plays
    assert viewer._web.gate.token in said.out.splitlines()[0]
    assert said.out.splitlines()[1].startswith("from other computers: http://")
    assert "warning" not in said.err
    with pytest.warns(UserWarning, match="without a password"):
        run(monkeypatch, capsys, folder / "frame0.ply", "--host", "0.0.0.0", "--no-token")

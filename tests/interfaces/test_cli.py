"""The command line: what it makes, what it says, and how it ends."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from PIL import Image
from support.commands import run

import wrt
import wrt.scene.scene
from wrt.builders.kdtree import KDTREE_BUILDERS
from wrt.cli import catalogue
from wrt.imaging.integrators import rendering_call
from wrt.kernels.runtime.schedules import SCHEDULES
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.scenes import BUILTIN_SCENES

SMALL = ["--width", "24", "--height", "16", "--samples", "1", "--ambient-samples", "2"]


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "tetra.ply"
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    wrt.TriangleMesh(vertices, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]).save(path)
    return path


# -- success -----------------------------------------------------------------------------------------------------------


def test_version_and_help():
    assert run("--version").output == f"wrt {wrt.__version__}\n"
    text = run("--help").output
    assert all(command in text for command in ("render", "info", "verify", "list"))
    for command in ("render", "info", "verify", "list"):
        result = run(command, "--help")
        assert result.exit_code == 0
        assert "Usage:" in result.output


def test_render_makes_the_teapot(tmp_path):
    result = run("render", "-o", tmp_path / "teapot.png", *SMALL)
    assert result.exit_code == 0, result.stderr
    assert "24 x 16" in result.stdout
    assert result.stderr == ""
    assert Image.open(tmp_path / "teapot.png").size == (24, 16)


def test_render_passes_its_options_on(tmp_path, monkeypatch):
    seen = {}

    class Picture:
        def __init__(self, scene, camera, **options):
            seen.update(options, scene=scene, camera=camera)

        def advance(self, progress):
            seen["advanced"] = True

        def save(self, path):
            path.write_bytes(b"")

    monkeypatch.setattr(rendering_call, "AmbientRendering", Picture)
    result = run(
        "render", "-o", tmp_path / "a.png", "--scene", "random_triangles", "--option", "count=7", "--option", "size=0.5",
        "--width", 20, "--height", 10, "--samples", 3, "--ambient-samples", 5, "--ambient-distance", 2.5,
        "--camera", "1,-2,3", "--look-at", "0,0.5,0", "--up", "-y", "--fov", 50, "--light", "9,8,7", "--no-shadows", "--flat",
        "--accelerator", "kdtree", "--triangle-test", "woop", "--traversal", "single", "--device", "cpu", "--threads", 1,
        "--seed", 4,
    )  # fmt: skip
    assert result.exit_code == 0, result.stderr
    assert seen["advanced"]
    assert (tmp_path / "a.png").exists()
    assert seen["scene"].triangle_count == 7
    assert seen["scene"].num_threads == 1
    camera = seen["camera"]
    assert (camera.width, camera.height, camera.fov) == (20, 10, 50.0)
    np.testing.assert_array_equal(camera.position, (1, -2, 3))
    np.testing.assert_array_equal(camera.look_at, (0, 0.5, 0))
    assert camera.up[1] < 0
    expected = {"samples": 3, "ambient_samples": 5, "ambient_distance": 2.5, "light": (9, 8, 7), "shadows": False}
    expected |= {"smooth": False, "seed": 4, "triangle_test": "woop", "traversal": "single"}
    assert {name: seen[name] for name in expected} == expected


@pytest.mark.parametrize("name", [name for name in BUILTIN_SCENES if name not in ("wood", "atrium")])
def test_render_every_small_scene(tmp_path, name):
    result = run("render", "--scene", name, "-o", tmp_path / "a.png", *SMALL)
    assert result.exit_code == 0, result.stderr


def test_level_is_the_scenes_option(tmp_path):
    result = run("render", "--level", 2, "--option", "ground=false", "-o", tmp_path / "a.png", *SMALL)
    assert " 240 triangles" in result.stdout


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".glb", ".obj"])
def test_render_frames_a_model(tmp_path, model, suffix):
    path = model.with_suffix(suffix)
    wrt.TriangleMesh.load(model).save(path)
    result = run("render", path, "-o", tmp_path / "a.npy", *SMALL)
    assert result.exit_code == 0, result.stderr
    image = np.load(tmp_path / "a.npy")
    inner = np.ptp(image[2:-2, 4:-4], axis=(0, 1)).max()
    assert inner > 0.1


def test_a_ground_goes_under_a_model(tmp_path, model):
    assert " 6 triangles" in run("render", model, "--ground", "-o", tmp_path / "a.png", *SMALL).stdout
    assert " 4 triangles" in run("render", model, "-o", tmp_path / "a.png", *SMALL).stdout


def test_list_shows_every_table():
    text = run("list").stdout
    tables = json.loads(run("list", "--json").stdout)
    for title, table in (
        ("kd-tree builders", KDTREE_BUILDERS),
        ("traversals", TRAVERSALS),
        ("triangle tests", TRIANGLE_TESTS),
        ("built-in scenes", BUILTIN_SCENES),
    ):
        assert [row["name"] for row in tables[title]] == list(table)
        assert all(name in text for name in table)
    assert all(row["paper"] for row in tables["traversals"])


def test_list_finds_words():
    """In names, papers, authors and years, whatever their capitals and accents; all of several words."""
    for words, name in (
        (["gunther"], "wrt.moving.FuzzyScene"),
        (["GÜNTHER", "skinned"], "wrt.moving.SkinnedScene"),
        (["2013", "woop"], "woop"),
    ):
        tables = json.loads(run("list", *words, "--json").stdout)
        rows = [(title, row) for title, found in tables.items() for row in found]
        assert name in [row["name"] for _, row in rows]
        for title, row in rows:
            text = catalogue.plain(" ".join([title, *map(str, row.values())]))
            assert all(catalogue.plain(word) in text for word in words)
    assert "wrt.moving.FuzzyScene" in run("list", "lloyd").stdout
    assert {row["name"] for row in json.loads(run("list", "schedules", "--json").stdout)["schedules"]} == set(SCHEDULES)
    result = run("list", "woop", "nobody")
    assert result.exit_code == 1
    assert result.stdout == ""
    assert result.stderr == "error: nothing has 'woop' and 'nobody' in it; wrt list without words lists everything\n"


def test_info_shows_the_mesh_and_the_tree(model, monkeypatch):
    class Figures:
        def to_dict(self):
            return {"tree": {"nodes": 12345, "by depth": {"0": 1}, "cost": 1.5}, "leaves": list(range(100)), "bytes": 7}

    monkeypatch.setattr(wrt.scene.scene.Scene, "statistics", lambda self: Figures())
    result = run("info", model)
    assert result.exit_code == 0, result.stderr
    assert all(word in result.stdout for word in ("triangles", "12,345", "by depth.0", "1.5", "leaves", "tetra"))
    assert "95 - 99" in result.stdout
    assert "485" in result.stdout
    figures = json.loads(run("info", model, "--json").stdout)
    assert figures["model"]["triangles"] == 4
    assert figures["model"]["is_closed"] is True
    assert figures["tree"]["nodes"] == 12345


def test_info_of_real_statistics(model):
    pytest.importorskip("wrt.scene.scene_statistics")
    assert run("info", model).exit_code == 0
    assert json.loads(run("info", "--json", "--level", 2).stdout)["tree"]["nodes"] > 0


def test_bench_is_imported_when_called():
    pytest.importorskip("wrt.bench.commands.benchmark")
    assert "bench" in run("--help").output
    result = run("bench", "--help")
    assert result.exit_code == 0
    assert "--workload" in result.output
    assert run("bench", "--size", "0").exit_code == 2


# -- errors ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no-such"], "No such command 'no-such'"),
        (["render"], "Missing option '-o'"),
        (["render", "-o", "a.png", "--width", "0"], "'--width'"),
        (["render", "-o", "a.png", "--fov", "180"], "'--fov'"),
        (["render", "-o", "a.png", "--camera", "1,2"], "'1,2' is not three numbers x,y,z"),
        (["render", "-o", "a.png", "--camera", "1,2,nan"], "is not three numbers"),
        (["render", "-o", "a.png", "--up", "w"], "'w' is not three numbers"),
        (["render", "-o", "a.png", "--up", "0,0,0"], "up is zero"),
        (["render", "-o", "a.png", "--camera", "0,0,9", "--look-at", "0,0,0"], "up is parallel"),
        (["render", "-o", "a.png", "--scene", "nowhere"], "'nowhere' is unknown; choose from teapot,"),
        (["render", "-o", "a.png", "--option", "level"], "'level' is not KEY=VALUE"),
        (["render", "-o", "a.png", "--option", "size=3"], "no option 'size'; its options are level, ground"),
        (["render", "-o", "a.png", "--option", "level=0"], "level is 0; it must be at least 1"),
        (["render", "-o", "a.png", "--accelerator", "octree"], "'octree' is unknown; choose from auto"),
        (["render", "-o", "a.png", "--traversal", "walk"], "'walk' is unknown; choose from auto, brute"),
        (["render", "-o", "a.png", "--triangle-test", "t"], "'t' is unknown; choose from auto, woop"),
        (["render", "-o", "a.png", "--device", "tpu"], "device 'tpu' does not exist; choose from cpu"),
        (["render", "-o", "a.png", "--threads", "0"], "'--threads'"),
        (["render", "-o", "a.png", "--ground"], "--ground needs a MODEL"),
        (["render", "-o", "a.xyz"], "unknown extension '.xyz'"),
        (["render", "tetra.ply", "-o", "a.png", "--scene", "teapot"], "leave MODEL out"),
        (["info", "--scene", "nowhere"], "'nowhere' is unknown"),
    ],
)
def test_wrong_calls_end_with_2(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    result = run(*arguments)
    assert result.exit_code == 2
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert message in result.stderr
    assert result.stderr.endswith(" --help')\n")
    assert "(see 'wrt " in result.stderr
    assert not list(tmp_path.iterdir())


def test_what_goes_wrong_on_the_way_ends_with_1(tmp_path, model, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.ply").write_bytes(b"ply\nnot really\n")
    (tmp_path / "points.obj").write_text("v 0 0 0\nv 1 0 0\n")
    for arguments, message in (
        (["render", "missing.ply", "-o", "a.png"], "no mesh file at 'missing.ply'"),
        (["render", "broken.ply", "-o", "a.png"], "cannot read 'broken.ply'"),
        (["render", "points.obj", "-o", "a.png"], "points.obj"),
        (["render", tmp_path, "-o", "a.png"], "no mesh file"),
        (["render", "-o", "nowhere/a.png"], "no folder 'nowhere'"),
        (["info", "missing.ply"], "no mesh file at 'missing.ply'"),
    ):
        result = run(*arguments)
        assert result.exit_code == 1
        assert result.stderr.startswith("error: ")
        assert result.stderr.count("\n") == 1
        assert message in result.stderr
    monkeypatch.setattr(rendering_call, "AmbientRendering", lambda *args, **options: (_ for _ in ()).throw(MemoryError()))
    assert run("render", model, "-o", "a.png").stderr == "error: out of memory; use a smaller mesh or image\n"


def test_interruption_ends_with_130(model, tmp_path, monkeypatch):
    def interrupted(*args, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(rendering_call, "AmbientRendering", interrupted)
    result = run("render", model, "-o", tmp_path / "a.png")
    assert result.exit_code == 130
    assert result.stderr.strip() == "interrupted"
    assert not (tmp_path / "a.png").exists()


# -- a real process ----------------------------------------------------------------------------------------------------


def test_as_a_process(tmp_path, model):
    command = [sys.executable, "-m", "wrt"]
    done = subprocess.run([*command, "render", model, "-o", "a.png", *SMALL], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""  # none of Warp's own lines, no progress bar: this is no terminal
    assert done.stdout.startswith("a.png: 24 x 16, 4 triangles")
    done = subprocess.run([*command, "render", "b.ply", "-o", "a.png"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.startswith("error: no mesh file at 'b.ply'")
    assert done.stderr.count("\n") == 1
    wrt.TriangleMesh([[0, 0, 0], [1e-12, 0, 0], [0, 1e-12, 0]], [[0, 1, 2]]).save(tmp_path / "c.ply")
    done = subprocess.run([*command, "info", "c.ply"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stderr.startswith("warning: the geometry is 1e-12 across")
    assert done.stderr.count("\n") == 1  # not the line of code that warns, which says nothing to whoever calls a command


def test_help_imports_nothing_heavy():
    code = "import sys; from wrt.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass\n"
    code += "print([m for m in ('warp', 'numpy', 'trimesh', 'rich') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_ctrl_c_ends_a_process_with_130(tmp_path):
    arguments = ["render", "-o", "a.png", "--samples", "4096", "--level", "2"]
    code = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a background job ignores it
    code += f"from wrt.cli import main; main({arguments})"
    process = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    try:
        time.sleep(4.0)
        process.send_signal(signal.SIGINT)
        _, message = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130
    assert message.strip() == "interrupted"
    assert not (tmp_path / "a.png").exists()


def test_info_shows_the_kernel_cache(model):
    kernels = json.loads(run("info", model, "--json").stdout)["kernels"]
    assert kernels["modules"] > 0
    assert kernels["bytes"] > 0
    assert os.path.isdir(kernels["cache"])
    assert kernels["shipped"] == "none that fit"

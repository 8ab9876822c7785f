"""Pictures of point clouds: by `wrt.render`, and by the command line; what other commands say of files of points."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner

import wrt
from wrt.cli import main
from wrt.cli.cloud_models import load_cloud
from wrt.clouds.spacing import spacing

SMALL = ["--width", "40", "--height", "30", "--samples", "1"]
GIVEN = {"accelerator": "auto", "device": "cpu", "threads": None}


def run(*arguments):
    return CliRunner().invoke(main, [*map(str, arguments)])


@pytest.fixture
def table():
    """A plane of points at z = 0, red for x < 0, else blue; one is NaN."""
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, 21), np.linspace(-1.0, 1.0, 21))
    table = np.zeros(x.size, dtype=[("x", "f4"), ("y", "f4"), ("z", "f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")])
    table["x"], table["y"] = x.ravel(), y.ravel()
    table["red"], table["blue"] = np.where(table["x"] < 0.0, 230, 10), np.where(table["x"] < 0.0, 10, 230)
    table["z"][-1] = np.nan
    return table


def test_boxes_look_like_meshes():
    """Light, shadows, ambient occlusion and colours of two boxes, one over the other."""
    centers, halves = np.array([[0.0, 0.0, 0.0], [0.3, -0.2, 1.0]]), np.array([[1.0, 1.0, 0.1], [0.3, 0.3, 0.2]])
    colors = np.array([[0.8, 0.3, 0.1], [0.1, 0.4, 0.9]])
    meshes = [trimesh.creation.box(2.0 * half).apply_translation(center) for center, half in zip(centers, halves, strict=True)]
    scene = wrt.Scene(meshes, device="cpu")
    cloud = wrt.sensors.PointCloud(centers, halves, boxes=True, device="cpu")
    camera = wrt.PinholeCamera(48, 36, position=[2.0, -3.0, 3.0], look_at=[0.0, 0.0, 0.3])
    options = {"samples": 2, "smooth": False, "seed": 3}
    made = wrt.render(cloud, camera, albedo=colors, **options)
    expected = wrt.render(scene, camera, albedo=np.repeat(colors, 12, axis=0), **options)
    assert np.abs(made - expected).mean() < 1e-3
    assert expected[:8].std() > 0.0  # not all is background
    again, known = (wrt.PinholeCamera.framing(shown, 48, 36).position for shown in (cloud, scene))
    np.testing.assert_allclose(again, known, atol=1e-6)


def test_framing_of_many_points(monkeypatch):
    """By cells: a little farther away than by the points themselves."""
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (5000, 3))
    cloud = wrt.sensors.PointCloud(points, 0.01, device="cpu")
    exact = wrt.PinholeCamera.framing(cloud, 40, 30)
    monkeypatch.setattr(wrt.imaging.view_frames, "FRAMED", 1000)
    coarse = wrt.PinholeCamera.framing(cloud, 40, 30)
    ratio = np.linalg.norm(coarse.position) / np.linalg.norm(exact.position)
    assert 1.0 <= ratio < 1.05


def test_integrators_that_need_materials():
    cloud = wrt.sensors.PointCloud([[0.0, 0.0, 0.0]], 1.0, device="cpu")
    camera = wrt.PinholeCamera.framing(cloud, 8, 8)
    with pytest.raises(TypeError, match="not PointCloud; integrator='ambient' renders points"):
        wrt.render(cloud, camera, integrator="path")
    with pytest.raises(ValueError, match="points have no triangles"):
        wrt.render(cloud, camera, triangle_test="woop")


def test_spacing():
    grid = np.stack(np.meshgrid(np.arange(12.0), np.arange(12.0), [5e5]), axis=-1).reshape(-1, 3)
    assert spacing(0.5 * grid, "cpu") == 0.5
    assert spacing(np.repeat(0.5 * grid, 9, axis=0), "cpu") == 0.5  # each place once
    assert spacing(grid[:2], "cpu") == 1.0
    assert spacing(grid[:1], "cpu") == spacing(np.repeat(grid[:1], 9, axis=0), "cpu") == 0.0


@pytest.mark.parametrize("suffix", ["pcd", "ply", "xyz", "las"])
def test_render(tmp_path, table, suffix):
    """Seen from above; the radius closes the plane."""
    path, picture, table = tmp_path / f"map.{suffix}", tmp_path / "map.npy", table[:-1]
    if suffix == "xyz":
        np.savetxt(path, np.stack([table[axis] for axis in "xyz"], axis=-1))
    else:
        if suffix == "las":
            pytest.importorskip("laspy")
        wrt.sensors.write_points(path, table)
    view = ["--camera", "0,0,1.5", "--look-at", "0,0,0", "--up", "y", "--no-shadows"]
    done = run("render", path, "-o", picture, *SMALL, *view)
    assert done.exit_code == 0, done.output
    assert "440 points of radius 0.1" in done.output
    made = np.load(picture)
    left, right = made[5:25, 8:18].reshape(-1, 3), made[5:25, 22:32].reshape(-1, 3)
    if suffix == "xyz":
        assert np.ptp(left, axis=1).max() < 0.1  # grey
    else:
        assert (left[:, 0] > 2.0 * left[:, 2]).all()
        assert (right[:, 2] > 2.0 * right[:, 0]).all()


def test_colors(tmp_path, table):
    """PCL's packed colours, as float and as integer; 16 bits; intensities; none."""
    places = {"x": table["x"], "y": table["y"], "z": table["x"]}
    bits = (table["red"].astype(np.uint32) << 16) | (7 << 8) | table["blue"]
    expected = np.stack([table["red"], np.full(len(table), 7), table["blue"]], axis=-1) / 255.0
    for name, values in (("rgb", bits.view(np.float32)), ("rgba", bits | 0xFF000000)):
        path = tmp_path / f"{name}.pcd"
        wrt.sensors.write_points(path, as_table(places | {name: values}))
        np.testing.assert_allclose(load_cloud(path, GIVEN).colors, expected, atol=1e-12)
    wide = {name: table[name].astype(np.uint16) * 257 for name in ("red", "green", "blue")}
    path = tmp_path / "wide.ply"
    wrt.sensors.write_points(path, as_table(places | wide))
    np.testing.assert_allclose(load_cloud(path, GIVEN).colors[:, 0], table["red"] / 255.0, atol=1e-12)
    wrt.sensors.write_points(path, as_table(places | {"intensity": table["x"] * 100.0}))
    grey = load_cloud(path, GIVEN).colors
    assert grey[0, 0] == pytest.approx(0.15)
    assert grey[20, 1] == pytest.approx(0.95)
    wrt.sensors.write_points(path, as_table(places))
    assert load_cloud(path, GIVEN).colors is None


def as_table(columns: dict[str, np.ndarray]) -> np.ndarray:
    """A structured array."""
    table = np.empty(len(columns["x"]), dtype=[(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        table[name] = values
    return table


def test_info(tmp_path, table):
    wrt.sensors.write_points(tmp_path / "map.pcd", table)
    done = run("info", tmp_path / "map.pcd", "--json")
    assert done.exit_code == 0, done.output
    figures = json.loads(done.output)["points"]
    assert (figures["points"], figures["points left out"]) == (440, 1)
    assert figures["spacing"] == figures["radius"] == pytest.approx(0.1)
    assert figures["low"] == [-1.0, -1.0, 0.0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["render", "map.pcd", "-o", "a.png", "--integrator", "path"], "needs materials"),
        (["render", "map.pcd", "-o", "a.png", "--ground"], "--ground is for triangles"),
        (["render", "map.pcd", "-o", "a.png", "--triangle-test", "woop"], "--triangle-test is for triangles"),
        (["render", "map.pcd", "-o", "a.png", "--accelerator", "kdtree"], "--accelerator kdtree is for triangles"),
        (["render", "map.pcd", "-o", "a.png", "--scene", "teapot"], "leave MODEL out"),
        (["render", "map.pcd", "-o", "a.png", "--radius", "0"], "--radius"),
        (["render", "one.pcd", "-o", "a.png"], "give their --radius"),
        (["render", "nan.pcd", "-o", "a.png"], "none with finite coordinates"),
        (["render", "--level", "2", "-o", "a.png", "--radius", "1"], "this model has triangles"),
        (["verify", "map.pcd"], "`wrt verify` needs triangles"),
        (["verify", "points.ply"], "`wrt verify` needs triangles"),
        (["view", "map.pcd", "--port", "0"], "`wrt view` needs triangles"),
    ],
)
def test_wrong_calls(tmp_path, monkeypatch, table, arguments, message):
    if arguments[0] == "view":
        pytest.importorskip("viser")
    monkeypatch.chdir(tmp_path)
    wrt.sensors.write_points("map.pcd", table[:30])
    wrt.sensors.write_points("points.ply", table[:30])
    wrt.sensors.write_points("one.pcd", np.repeat(table[:1], 6))
    wrt.sensors.write_points("nan.pcd", table[-1:])
    done = run(*arguments)
    assert done.exit_code == 2, done.output
    assert message in done.output


def test_damaged_files(tmp_path):
    for name, content in (("a.pcd", b"VERSION"), ("a.ply", b"ply\nformat"), ("a.xyz", b"one two three\n"), ("a.bin", b"123")):
        (tmp_path / name).write_bytes(content)
        done = run("render", tmp_path / name, "-o", tmp_path / "a.png")
        assert done.exit_code == 1, done.output
        assert name in done.output
        assert "Traceback" not in done.output

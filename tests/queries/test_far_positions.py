"""Positions that enter and leave far from 0: UTM coordinates, where float32 holds every half metre.

What the library computes is right to 2^-24 of the scene's extent; what it returned was then rounded to float32, by 0.25 m.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
import warp as wp
from support.sensed_scenes import wall

import wrt

UTM = np.array([500_000.123, 5_400_000.456, 200.789])
SIZE = 50.0
AHEAD = UTM + np.array([1.0, 0.0, 0.0])
EXACT = 2.0**-22 * SIZE
"""What rounding relative to the scene's centre may cost, about 0.01 mm."""


@pytest.fixture(scope="module")
def scene():
    """A wall 10 m north (x) of a point in UTM coordinates; its size is that of a house."""
    return wrt.Scene(house(), device="cpu")


def house() -> wrt.TriangleMesh:
    return wrt.TriangleMesh(wall(10.0).vertices * [1.0, 0.2, 0.2] + UTM, wall(10.0).faces)


def rays(count: int = 200) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Origins and directions in float64, and where they meet the wall."""
    rng = np.random.default_rng(0)
    origins = UTM + np.stack([np.zeros(count), *rng.uniform(-5, 5, (2, count))], axis=-1)
    directions = np.stack([np.ones(count), *rng.uniform(-0.5, 0.5, (2, count))], axis=-1)
    return origins, directions, origins + 10.0 * directions


def error_of(positions, expected) -> float:
    values = positions.numpy() if isinstance(positions, wp.array) else positions
    assert values.dtype == np.float64
    return float(np.abs(values - expected).max())


def test_hits_and_lists(scene):
    origins, directions, expected = rays()
    hits = scene.intersect(origins, directions)
    assert error_of(hits.position, expected) < EXACT
    assert error_of(scene.intersect_all(origins, directions).position, expected) < EXACT
    assert error_of(scene.intersect(origins, directions, precise=True).position, expected) < 2e-9
    assert error_of(hits.spawn([-1.0, 0.0, 0.0]), expected) < 1e-3


def test_rays_in_float32_find_points_that_are_on_the_surface(scene):
    """Their origins are where float32 puts them; positions were in stripes beside the wall, and are on it."""
    origins, directions, _ = (values.astype(np.float32) for values in rays())
    t = (UTM[0] + 10.0 - origins[:, 0].astype(np.float64)) / directions[:, 0]
    expected = origins.astype(np.float64) + t[:, None] * directions
    for hits in (scene.intersect(origins, directions), scene.intersect_all(origins, directions)):
        assert error_of(hits.position, expected) < EXACT
        assert hits.normal.dtype == hits.t.dtype == np.float32
    on_device = scene.intersect(*(wp.array(values, dtype=wp.vec3, device="cpu") for values in (origins, directions)))
    assert on_device.position.dtype is wp.vec3d
    assert error_of(on_device.position, expected) < EXACT


@pytest.mark.parametrize(("extents", "dtype"), [(0.0, np.float32), (7.0, np.float32), (9.0, np.float64), (1e5, np.float64)])
def test_where_float32_holds_positions_they_are_float32(extents, dtype):
    """Up to 8 extents from 0, rounding moves a position by less than 8 * 2^-24 of the extent."""
    mesh = wrt.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 0.001, 0]], [[0, 1, 2]])
    place = np.array([0.1, 0.1, extents - 0.05])
    far = wrt.Scene(wrt.TriangleMesh(mesh.vertices + place, mesh.faces), device="cpu")
    direction = np.array([0.0, 0.0, -1.0], dtype=np.float32)
    hits = far.intersect((place + np.array([0.1, 1e-4, 1.0])).astype(np.float32), direction)
    assert hits.position.dtype == dtype
    assert hits.is_far == (dtype is np.float64)


def test_instances_and_their_transforms():
    """Also after one has moved."""
    origins, directions, expected = rays()
    matrix = np.eye(4)
    matrix[:3, 3] = UTM
    mesh = wrt.TriangleMesh(house().vertices - UTM, house().faces)
    placed = wrt.Scene([wrt.Instance(mesh, matrix)], device="cpu")
    assert error_of(placed.intersect(origins, directions).position, expected) < EXACT
    matrix[0, 3] += 1.0
    placed.update([0], transform=[matrix])
    assert error_of(placed.intersect(origins, directions).position, expected + directions) < EXACT


def test_cameras_and_adapters(scene):
    camera = wrt.PinholeCamera(8, 6, position=UTM, look_at=AHEAD, fov=30.0)
    np.testing.assert_array_equal(camera.rays().origins[0, 0], UTM)
    assert np.abs(scene.intersect(camera.rays()).position[..., 0] - UTM[0] - 10.0).max() < EXACT
    origins, directions, expected = rays()
    found, ray, _ = wrt.compat.RayMeshIntersector(house().to_trimesh()).intersects_location(origins, directions)
    assert error_of(found[np.argsort(ray)], expected) < EXACT
    pinhole = wrt.compat.RaycastingScene.create_rays_pinhole(30.0, AHEAD, UTM, [0, 0, 1], 8, 6)
    assert error_of(pinhole[..., :3], UTM) < 1e-8
    assert wrt.compat.RaycastingScene.create_rays_pinhole(30.0, [1, 0, 0], [0, 0, 0], [0, 0, 1], 8, 6).dtype == np.float32


def test_blocks_refuse_arrays_that_would_move_positions(scene):
    origins, directions, expected = rays()
    for kind in (np.float32, np.float64):
        blocks = scene.intersect_blocks(origins.astype(kind), directions.astype(kind))
        with pytest.raises(ValueError, match=r"out\['position'\] holds float32, .* so far from 0; make it float64"):
            blocks.write({"position": np.zeros((200, 3), np.float32)})
    found = np.zeros((200, 3))
    scene.intersect_blocks(origins, directions).write({"position": found})
    assert error_of(found, expected) < EXACT


@pytest.mark.parametrize("suffix", ["ply", "obj", "off", "stl", "glb", "gltf", "dae"])
@pytest.mark.parametrize("scale", [1.0, 1e-9])
def test_mesh_files_keep_vertices_or_warn(tmp_path, suffix, scale):
    """PLY files were float32, and text of 8 decimals, in which a mesh of nanometres was a point; Collada lost 0.5 m at UTM."""
    if suffix == "dae":
        pytest.importorskip("collada")
    vertices = (house().vertices if scale == 1.0 else house().vertices - UTM) * scale
    mesh, path = wrt.TriangleMesh(vertices, house().faces), tmp_path / f"mesh.{suffix}"
    if suffix in ("ply", "obj", "off"):
        mesh.save(path)
        np.testing.assert_array_equal(np.asarray(trimesh.load(path, process=False).vertices), vertices)
    elif scale == 1.0:
        held = "seven digits" if suffix == "dae" else "float32"
        with pytest.warns(UserWarning, match=rf"\.{suffix} files hold {held}, which moves vertices by up to 0\.") as warned:
            mesh.save(path)
        assert warned[0].filename == __file__
        said = float(re.search(r"by up to ([0-9.e-]+)", str(warned[0].message))[1])
        again = wrt.TriangleMesh.load(path)
        assert np.abs(again.vertices[again.faces] - vertices[mesh.faces]).max() == pytest.approx(said, rel=0.05)
    else:
        mesh.save(path)
    assert [one.name for one in tmp_path.iterdir()] == [f"mesh.{suffix}"]  # all .gltf files of a folder had the same buffers


def test_the_ten_lines_of_the_readme(tmp_path, monkeypatch):
    """They made origins of float32, which were 0.4 m off on a mesh in UTM coordinates."""
    readme = (Path(wrt.__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", readme, flags=re.DOTALL)
    ball = trimesh.creation.icosphere(subdivisions=2, radius=20.0)
    wrt.TriangleMesh(ball.vertices + UTM, ball.faces).save(tmp_path / "model.ply")
    monkeypatch.chdir(tmp_path)
    names: dict = {"__name__": "readme"}
    exec(code.replace("1_000_000", "1_000").replace("640, 480", "64, 48"), names)
    hits, inner = names["hits"], np.linalg.norm(ball.triangles_center, axis=1).min()
    assert names["origins"].dtype == hits.position.dtype == np.float64
    away = np.linalg.norm(hits.position[hits.is_hit] - UTM, axis=1)
    assert (away < 20.001).all()
    assert (away > inner - 0.001).all()
    height = hits.position[..., 1] - UTM[1]
    assert names["lit"][height > 8.0].all()  # spawned above the ball
    assert not names["lit"][height < -8.0].any()  # which face down, and whose rays start inside

"""Coordinates that float32 cannot hold, and vertices that no triangle uses: refused by name, or without a part in any answer.

Once an OBJ with the line `v 1e39 0 0`, or an STL of one triangle with corners at +-3.4e38, ended the process ("free(): invalid
size") in `wrt info`, `verify`, `render`, `Scene` and `Scene.update`, or every ray missed. And a vertex at 0, 0, 0 that no
triangle used moved the centre of a scene away from a sphere at UTM coordinates: of the rays from inside of it 59 % missed, with
`precise=True` too.
"""

from __future__ import annotations

import struct
import warnings

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner

import wrt
from wrt.cli import main
from wrt.meshes.placement import MAX_COORDINATE, MAX_EXTENT, MIN_EXTENT

CUBE = trimesh.creation.box()
UTM = np.array([691000.0, 5334000.0, 520.0])
TREES = ("bvh", "kdtree")


def cube(size: float = 1.0, place: np.ndarray | float = 0.0, extra: np.ndarray | None = None) -> wrt.TriangleMesh:
    """A cube somewhere; extra: vertices that no triangle uses."""
    vertices = np.asarray(CUBE.vertices) * size + place
    return wrt.TriangleMesh(vertices if extra is None else np.concatenate([vertices, extra]), CUBE.faces, name="cube")


def spoiled(value: float, vertex: int = 5) -> np.ndarray:
    """The cube's vertices, with one coordinate replaced."""
    vertices = np.array(CUBE.vertices)
    vertices[vertex, 1] = value
    return vertices


# -- what float32 cannot hold ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [1e39, 3.4e38, -1e308, 1e20, 1e11])
@pytest.mark.parametrize("tree", [*TREES, wrt.KdTree(builder="lazy"), wrt.Bvh(builder="sweep")])
def test_too_large_for_a_scene(value, tree, device):
    """The vertex is named, its mesh, and the limit."""
    mesh = wrt.TriangleMesh(spoiled(value), CUBE.faces, name="spoiled")
    with pytest.raises(ValueError, match=r"(?=.*vertex 5 of mesh 1 \('spoiled'\)).*(6\.87e\+10|1\.33e\+36)"):
        wrt.Scene([cube(), mesh], tree, device=device)
    with pytest.raises(ValueError, match="vertex 5 of mesh 0"):
        wrt.Scene(mesh, tree, device=device)


@pytest.mark.parametrize("command", [["info"], ["verify"], ["render", "-o", "x.png"]])
def test_files_that_ended_the_process(command, tmp_path):
    """An OBJ with a coordinate of 1e39, and an STL of 134 bytes."""
    obj, stl = tmp_path / "far.obj", tmp_path / "far.stl"
    obj.write_text("v 1e39 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n")
    corners = [3.4e38, -3.4e38, 0.0, -3.4e38, 3.4e38, 0.0, 0.0, 3.4e38, 3.4e38]
    stl.write_bytes(b"\0" * 80 + struct.pack("<I12fH", 1, 0.0, 0.0, 0.0, *corners, 0))
    assert stl.stat().st_size == 134
    for path in (obj, stl):
        wanted = [str(tmp_path / part) if part == "x.png" else part for part in command]
        result = CliRunner().invoke(main, [wanted[0], str(path), *wanted[1:]])
        assert result.exit_code in (1, 2)
        assert "is beyond 1.33e+36" in result.output
        assert "vertex 0 of mesh 0 ('far')" in result.output
    assert not (tmp_path / "x.png").exists()


def answers(scene: wrt.Scene) -> bytes:
    """Hits of some rays, to the bit."""
    rng = np.random.default_rng(3)
    origins = rng.normal(size=(300, 3)) * 3
    hits = scene.intersect(origins, rng.uniform(-0.5, 0.5, (300, 3)) - origins)
    return hits.t.tobytes() + hits.primitive_id.tobytes() + hits.geometry_id.tobytes()


@pytest.mark.parametrize("value", [1e39, 1e20, np.nan])
@pytest.mark.parametrize(
    "make",
    [
        lambda: wrt.Scene(cube(), "bvh", device="cpu"),
        lambda: wrt.Scene([cube(), cube(place=2.0)], "kdtree", device="cpu"),
        lambda: wrt.Scene(cube(), wrt.KdTree(builder="lazy"), device="cpu"),
        lambda: wrt.moving.GroupedScene([cube(), cube(place=2.0)], device="cpu"),
        lambda: wrt.Scene([wrt.Instance(cube())], device="cpu"),
    ],
)
def test_a_refused_update_changes_nothing(make, value):
    scene = make()
    before, state = answers(scene), dict(scene.__dict__)
    with pytest.raises(ValueError, match="vertex 5"):
        scene.update(0, vertices=spoiled(value))
    assert {name: id(part) for name, part in scene.__dict__.items() if name in state} == {n: id(p) for n, p in state.items()}
    assert answers(scene) == before
    scene.update(0, vertices=spoiled(0.75))
    assert answers(scene) != before


def test_instances_beyond_float32():
    """By where they are, by how large, and by a mesh of theirs."""
    far, huge, small = np.eye(4), np.diag([1e35, 1e35, 1e35, 1.0]), np.diag([1e-35, 1e-35, 1e-35, 1.0])
    far[0, 3] = 1e37
    with pytest.raises(ValueError, match=r"instance 1 has coordinates up to 1e\+37.*1\.33e\+36"):
        wrt.Scene([wrt.Instance(cube()), wrt.Instance(cube(), far)], device="cpu")
    for matrix in (huge, small):
        with pytest.raises(ValueError, match=r"transform scales by .* another unit of length"):
            wrt.Instance(cube(), matrix)
    with pytest.raises(ValueError, match=r"mesh 1 of the instances: .*vertex 5"):
        wrt.Scene([wrt.Instance(cube()), wrt.Instance(wrt.TriangleMesh(spoiled(1e39), CUBE.faces))], device="cpu")
    scene = wrt.Scene([wrt.Instance(cube())], device="cpu")
    before = answers(scene)
    with pytest.raises(ValueError, match="instance 0 has coordinates up to"):
        scene.update(0, transform=far)
    assert answers(scene) == before


def test_frames_beyond_float32():
    frames = np.stack([np.asarray(CUBE.vertices), spoiled(1e39)])
    with pytest.raises(ValueError, match="vertex 5"):
        wrt.moving.FuzzyScene(frames, CUBE.faces, device="cpu")


@pytest.mark.parametrize("tree", TREES)
def test_up_to_the_limit(tree):
    """As large as a scene may be, with rays from ten sides away: the answers of a cube of size 1, to the bit."""
    rng = np.random.default_rng(1)
    targets = rng.uniform(-0.5, 0.5, (300, 3)).astype(np.float32).astype(np.float64)
    origins = (10.0 * rng.normal(size=(300, 3))).astype(np.float32).astype(np.float64)
    unit = (
        ((targets - origins) / np.linalg.norm(targets - origins, axis=1, keepdims=True)).astype(np.float32).astype(np.float64)
    )
    expected = wrt.Scene(cube(), tree, device="cpu").intersect(origins, unit)
    assert expected.is_hit.all()
    for scale in (MAX_EXTENT, 2.0**-30):
        hits = wrt.Scene(cube(scale), tree, device="cpu").intersect(origins * scale, unit)
        np.testing.assert_array_equal(hits.primitive_id, expected.primitive_id)
        np.testing.assert_array_equal(hits.t, expected.t * np.float32(scale))
    with pytest.raises(ValueError, match="across, more than the"):
        wrt.Scene(cube(MAX_EXTENT * 1.001), tree, device="cpu")
    far = wrt.Scene(wrt.TriangleMesh(np.full((3, 3), MAX_COORDINATE), [[0, 1, 2]]), tree, device="cpu")
    assert np.isfinite(far.bounds.astype(np.float32)).all()


@pytest.mark.parametrize("subdivisions", [1, 4])
def test_tiny_geometry_is_warned_of(subdivisions):
    """Of few triangles and of many. What is answered in float64 is right there, too."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.5)
    rng = np.random.default_rng(2)
    origins, directions = rng.uniform(-0.4, 0.4, (200, 3)), rng.normal(size=(200, 3))
    expected = wrt.Scene(wrt.TriangleMesh(ball.vertices, ball.faces), device="cpu").intersect(origins, directions, precise=True)
    with pytest.warns(UserWarning, match=r"the geometry is 8\.88e-16 across.*precise=True"):
        scene = wrt.Scene(wrt.TriangleMesh(ball.vertices * 2.0**-50, ball.faces), device="cpu")
    hits = scene.intersect(origins * 2.0**-50, directions, precise=True)
    np.testing.assert_array_equal(hits.t, expected.t * 2.0**-50)
    np.testing.assert_array_equal(hits.primitive_id, expected.primitive_id)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for vertices in (cube(MIN_EXTENT).vertices, np.zeros_like(cube().vertices)):
            wrt.Scene(wrt.TriangleMesh(vertices, cube().faces), device="cpu")


def test_builders_refuse_what_has_no_differences():
    """Whoever builds without a scene is told too: the box of all boxes tells whether one of them is NaN or infinite."""
    from wrt.builders.triangle_boxes import boxes_of

    low, high = np.zeros((4, 3)), np.ones((4, 3))
    for value in (np.nan, np.inf, 2e38):
        spoilt = high.copy()
        spoilt[2, 1] = value
        with pytest.raises(ValueError, match="trees can be built for coordinates up to"):
            boxes_of(low, spoilt)


# -- vertices that no triangle uses ------------------------------------------------------------------------------------


def sphere(extra: np.ndarray | None = None, dtype: type = np.float64) -> wrt.TriangleMesh:
    """A closed sphere of radius 1 far from the origin, perhaps with vertices that no triangle uses."""
    ball = trimesh.creation.icosphere(3)
    vertices = np.asarray(ball.vertices) + UTM
    return wrt.TriangleMesh((vertices if extra is None else np.concatenate([vertices, extra])).astype(dtype), ball.faces)


def from_inside(count: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Rays from around the sphere's centre, float64."""
    directions = np.random.default_rng(0).normal(size=(count, 3))
    return np.tile(UTM, (count, 1)), directions / np.linalg.norm(directions, axis=1, keepdims=True)


UNUSED = [np.zeros((1, 3)), np.full((2, 3), [[1e39, -1e39, 1e300]]), np.array([[1e-300, 5e6, 5e6]])]


@pytest.mark.parametrize("extra", UNUSED)
@pytest.mark.parametrize("tree", TREES)
def test_unused_vertices_have_no_part_in_answers(tree, extra, device):
    """The same to the bit as without them, from inside of the sphere, where every ray hits; precise=True too."""
    origins, directions = from_inside()
    plain, scene = wrt.Scene(sphere(), tree, device=device), wrt.Scene(sphere(extra), tree, device=device)
    np.testing.assert_array_equal(scene.center, plain.center)
    np.testing.assert_array_equal(scene.bounds, plain.bounds)
    for precise in (False, True):
        expected, hits = (one.intersect(origins, directions, precise=precise) for one in (plain, scene))
        assert hits.is_hit.all()
        np.testing.assert_array_equal(hits.t, expected.t)
        np.testing.assert_array_equal(hits.primitive_id, expected.primitive_id)
        assert (np.abs(hits.t - 0.99) < 0.011).all()
    assert scene.contains(UTM[None]).all()


def test_unused_vertices_of_other_scenes(tmp_path):
    """Of groups, instances, animations, saved scenes, and after an update."""
    origins, directions = from_inside()
    mesh = sphere(np.zeros((1, 3)))
    frames = np.stack([mesh.vertices, mesh.vertices + 0.25])
    wrt.Scene(mesh, device="cpu").save(tmp_path / "scene.npz")
    scenes = [
        wrt.moving.GroupedScene([mesh, mesh], device="cpu"),
        wrt.Scene([wrt.Instance(mesh), wrt.Instance(mesh)], device="cpu"),
        wrt.moving.FuzzyScene(frames, mesh.faces, clusters=2, device="cpu"),
        wrt.Scene.load(tmp_path / "scene.npz", device="cpu"),
    ]
    for scene in scenes:
        hits = scene.intersect(origins, directions)
        assert (np.abs(hits.t - 0.99) < 0.011).all(), scene
    for scene in (scenes[0], scenes[1], scenes[3]):  # a vertex that nobody uses moves, and then all others
        for vertices in (np.concatenate([mesh.vertices[:-1], [[9e99, 0.0, 1.0]]]), mesh.vertices + 1e-3):
            scene.update(0, vertices=vertices)
            assert (np.abs(scene.intersect(origins, directions).t - 0.99) < 0.02).all(), scene


@pytest.mark.parametrize("tree", TREES)
def test_moved_far_away(tree):
    """A mesh that an update takes far away, and back: the centre goes along."""
    ball = trimesh.creation.icosphere(3)
    directions = from_inside()[1]
    scene = wrt.Scene(wrt.TriangleMesh(np.asarray(ball.vertices), ball.faces), tree, device="cpu")
    for place in (UTM, -1e9, 0.0):
        scene.update(0, vertices=np.asarray(ball.vertices) + place)
        hits = scene.intersect(np.zeros(3) + place, directions)
        assert (np.abs(hits.t - 0.99) < 0.011).all()


def test_typical_motion_of_used_vertices():
    """Once a vertex that nobody used, moved by 1e300, made the planes of a kd-tree NaN, and triangles fell through them."""
    extra = np.array([[1e308, 0.0, 0.0]] * 30)
    scene = wrt.Scene(cube(extra=-extra), "kdtree", device="cpu")
    scene.update(0, vertices=np.concatenate([np.asarray(CUBE.vertices) + 0.1, extra]), rebuild="never")
    assert scene.last_update.action == "kept"
    rays = wrt.Rays(np.array([0.1, 0.1, 0.1]), np.random.default_rng(0).normal(size=(50, 3)))
    assert scene.intersect(rays).is_hit.all()


# -- what verify says --------------------------------------------------------------------------------------------------


def test_verify_names_causes():
    """Unused vertices, triangles too small for where they are, and meshes too small for float32."""
    far, tiny, unused = (
        "triangles too small for where they are",
        "triangles of a mesh too small for float32",
        "vertices that no",
    )
    report = wrt.Scene([cube(1e-3, 1000.0), cube(1e-3, -1000.0)], device="cpu").verify(40)
    assert report.mesh[far] == 24
    assert far in str(report)
    report = wrt.Scene(sphere(np.zeros((3, 3))), device="cpu").verify(40)
    assert report.ok
    assert report.mesh[f"{unused} triangle uses"] == 3
    assert report.mesh[far] == report.mesh[tiny] == 0
    assert wrt.Scene(cube(1e-12), device="cpu").verify(40).mesh[tiny] == 12
    apart = np.eye(4)
    apart[0, 3] = 1e6
    report = wrt.Scene([wrt.Instance(cube()), wrt.Instance(cube(), apart)], device="cpu").verify(40)
    assert report.mesh[far] == 0  # each instance has a centre of its own

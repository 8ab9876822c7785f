"""The built-in scenes: closed forms for the teapot, the same checks for every scene of the table."""

import subprocess
import sys
from math import comb

import numpy as np
import pytest

from wrt import scenes
from wrt.meshes.mesh import TriangleMesh
from wrt.scenes.newell_teapot import bernstein, teapot, teapot_patches
from wrt.scenes.shapes import boxes, copies, lathe, plane

NAMES = sorted(scenes.BUILTIN_SCENES)
SMALL = {
    "teapot": {"level": 2},
    "random_triangles": {"count": 10},
    "teapot_in_stadium": {"level": 1, "rows": 1, "segments": 8},
    "atrium": {"bays": (1, 1), "storeys": 1, "detail": 1},
    "cornell_box": {"cells": 1},
    "wood": {"trees": 1, "leaves": 0},
}
LARGER = {
    "teapot": {"level": 3},
    "random_triangles": {"count": 11},
    "teapot_in_stadium": {"level": 1, "rows": 2, "segments": 8},
    "atrium": {"bays": (2, 1), "storeys": 1, "detail": 1},
    "cornell_box": {"cells": 2},
    "wood": {"trees": 2, "leaves": 0},
}


def corners_of(mesh):
    return mesh.vertices[mesh.faces]


def signed_volume(mesh):
    a, b, c = np.moveaxis(corners_of(mesh), 1, 0)
    return float((np.cross(a, b) * c).sum() / 6.0)


def components(mesh):
    """The label of every triangle: the smallest vertex that can be reached from it over shared vertices."""
    labels = np.arange(mesh.vertex_count)
    while True:
        lower = labels.copy()
        np.minimum.at(lower, mesh.faces, labels[mesh.faces].min(axis=1)[:, None])
        lower = lower[lower]
        if np.array_equal(lower, labels):
            return labels[mesh.faces[:, 0]]
        labels = lower


def hits(mesh, origin, directions):
    """Distances (R,) along rays from one origin, inf for none: every ray against every triangle, float64."""
    a, b, c = (corner - origin for corner in np.moveaxis(corners_of(mesh), 1, 0))
    ab, bc, ca, abc = np.cross(a, b), np.cross(b, c), np.cross(c, a), (np.cross(a, b) * c).sum(axis=1)
    distances = np.full(len(directions), np.inf)
    for i, direction in enumerate(directions):
        weights = np.stack([bc @ direction, ca @ direction, ab @ direction])
        total = weights.sum(axis=0)
        inside = ((weights >= 0.0).all(axis=0) | (weights <= 0.0).all(axis=0)) & (total != 0.0)
        t = np.divide(abc, total, out=np.full(len(total), np.inf), where=inside)
        distances[i] = np.min(t, where=t > 1e-9, initial=np.inf)
    return distances


# -- the teapot --------------------------------------------------------------------------------------------------------


def test_bernstein_polynomials():
    t = np.linspace(0.0, 1.0, 8)
    expected = np.stack([comb(3, i) * t**i * (1.0 - t) ** (3 - i) for i in range(4)], axis=-1)
    np.testing.assert_allclose(bernstein(7), expected, atol=1e-15)
    np.testing.assert_array_equal(bernstein(7), bernstein(7)[::-1, ::-1])


def test_control_points_are_the_published_ones():
    """The file's signs were once lost, so that all four quadrants of the body coincided."""
    patches = teapot_patches()
    assert patches.shape == (32, 4, 4, 3)
    np.testing.assert_array_equal(patches.reshape(-1, 3).min(axis=0), [-3.0, -2.0, 0.0])
    np.testing.assert_array_equal(patches.reshape(-1, 3).max(axis=0), [3.525, 2.0, 3.15])
    np.testing.assert_array_equal(patches[0, 0], [[1.4, 0, 2.4], [1.4, -0.784, 2.4], [0.784, -1.4, 2.4], [0, -1.4, 2.4]])
    assert len(np.unique(patches.reshape(-1, 3), axis=0)) == 290
    signs = {tuple(np.sign(patch[..., :2].sum(axis=(0, 1))).astype(int)) for patch in patches[:4]}
    assert signs == {(1, -1), (-1, -1), (-1, 1), (1, 1)}
    assert patches[12:16, ..., 0].max() < 0.0 < patches[16:20, ..., 0].min()  # handle at -x, spout at +x


@pytest.mark.parametrize("level", [1, 2, 5, 16])
def test_teapot_passes_through_the_corners_of_its_patches(level):
    points = {tuple(point) for point in np.round(teapot(level, ground=False).vertices, 9).tolist()}
    for corner in teapot_patches()[:, ::3, ::3].reshape(-1, 3):
        assert tuple(np.round(corner, 9).tolist()) in points


def test_teapot_lies_on_the_patches():
    """Against the plain tensor product, at the parameters of the lattice."""
    level = 4
    t = np.arange(level + 1) / level
    basis = np.stack([comb(3, i) * t**i * (1.0 - t) ** (3 - i) for i in range(4)], axis=-1)
    expected = np.einsum("iu,jv,puvx->pijx", basis, basis, teapot_patches()).reshape(-1, 3)
    vertices = teapot(level, ground=False).vertices
    distance = np.linalg.norm(expected[:, None] - vertices[None], axis=-1)
    assert distance.min(axis=1).max() < 1e-11
    assert distance.min(axis=0).max() < 1e-11


@pytest.mark.parametrize("level", [1, 2, 3, 7, 16, 33])
def test_teapot_counts(level):
    mesh = teapot(level, ground=False)
    assert mesh.triangle_count == (52 if level == 1 else 64 * level**2 - 8 * level)
    assert mesh.face_normals.any(axis=1).all()
    assert mesh.summary()["degenerate_triangles"] == 0
    assert mesh.summary()["duplicate_triangles"] == 0
    assert teapot(level).triangle_count == mesh.triangle_count + 512


def test_teapot_bounds():
    mesh = teapot(16, ground=False)
    np.testing.assert_allclose(mesh.bounds, [[-3.0, -2.0, 0.0], [3.4335, 2.0, 3.15]], atol=1e-4)
    assert teapot(4).bounds[0, 2] == 0.0
    np.testing.assert_array_equal(teapot(1).face_normals[-512:], np.tile([0.0, 0.0, 1.0], (512, 1)))


@pytest.mark.parametrize("level", [2, 3, 16])
def test_teapot_seams_are_welded(level):
    """Three pieces: body with the handle (it touches the body in one control point), lid, spout."""
    mesh = teapot(level, ground=False)
    labels, sizes = np.unique(components(mesh), return_counts=True)
    assert len(labels) == 3
    assert len(np.unique(mesh.vertices, axis=0)) == mesh.vertex_count
    edges = np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    count = np.unique(edges, axis=0, return_counts=True)[1]
    assert count.max() == 2
    # The open rims: body 4 sides of a patch, lid 4, both ends of the handle 2 each, both ends of the spout 2 each.
    assert (count == 1).sum() == 16 * level
    directed = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert len(np.unique(directed, axis=0)) == len(directed)  # neighbours run along an edge in opposite directions
    assert sizes.sum() == mesh.triangle_count


@pytest.mark.parametrize("level", [2, 7])
def test_teapot_without_holes(level):
    """A fan in each of six rims; front sides stay outside, so that the volume is positive, and right for a finer one."""
    open_pot, mesh = teapot(level, ground=False), teapot(level, ground=False, closed=True)
    assert mesh.is_closed
    assert not open_pot.is_closed
    np.testing.assert_array_equal(mesh.faces[: open_pot.triangle_count], open_pot.faces)
    assert mesh.triangle_count == open_pot.triangle_count + 16 * level
    assert mesh.vertex_count == open_pot.vertex_count + 6
    directed = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert len(np.unique(directed, axis=0)) == len(directed)
    assert len(np.unique(np.concatenate([directed, directed[:, ::-1]]), axis=0)) == len(directed)  # each edge both ways
    assert 15.0 < signed_volume(mesh) < 40.0  # the spout and the handle are counted twice inside the pot
    with pytest.raises(ValueError, match="level"):
        teapot(1, closed=True)


def test_teapot_normals_point_outward():
    mesh = teapot(16, ground=False)
    assert signed_volume(mesh) > 20.0  # the surface is open: of the sum over its triangles the sign is what counts
    centroids, normals, labels = corners_of(mesh).mean(axis=1), mesh.face_normals, components(mesh)
    body = labels == labels[np.argmin(np.abs(centroids - [0.0, -2.0, 0.9]).sum(axis=1))]
    wall = body & (np.hypot(centroids[:, 0], centroids[:, 1]) < 2.01) & (centroids[:, 2] > 0.2) & (centroids[:, 2] < 2.3)
    wall &= centroids[:, 0] > -1.4  # not the ends of the handle, which are inside
    assert ((normals[wall, :2] * centroids[wall, :2]).sum(axis=1) > 0.0).all()
    assert (normals[body & (centroids[:, 2] < 0.05), 2] < 0.0).all()  # bottom
    lid = labels == labels[np.argmax(centroids[:, 2])]
    assert normals[np.argmax(centroids[:, 2]), 2] > 0.9
    assert (normals[lid & (centroids[:, 2] < 2.6), 2] > 0.0).all()
    handle = (centroids[:, 0] < -2.2) & (centroids[:, 2] > 1.2)
    centre_line = np.array([-2.85, 0.0, 1.8])
    grip = handle & (np.abs(centroids[:, 2] - 1.8) < 0.1)
    assert ((normals[grip] * (centroids[grip] - centre_line)).sum(axis=1) > 0.0).all()
    spout = (centroids[:, 0] > 2.3) & (centroids[:, 2] < 2.3)
    assert (normals[spout, 1] * centroids[spout, 1] > 0.0).all()


# -- shapes ------------------------------------------------------------------------------------------------------------


def test_boxes_are_closed_and_outward():
    mesh = boxes([[0, 0, 0], [5, 5, 5]], [[1, 2, 3], [6, 6, 7]])
    assert mesh.summary()["is_closed"]
    assert mesh.triangle_count == 24
    assert signed_volume(mesh) == pytest.approx(6.0 + 2.0)


def test_lathe_and_plane_and_copies():
    cylinder = lathe([(0.0, 0.0), (1.0, 0.0), (1.0, 2.0), (0.0, 2.0)], 12)
    assert cylinder.summary()["is_closed"]
    assert cylinder.summary()["degenerate_triangles"] == 0
    assert signed_volume(cylinder) == pytest.approx(2.0 * 12 * 0.5 * np.sin(np.pi / 6.0))
    three = copies(cylinder, [[0, 0, 0], [3, 0, 0], [6, 0, 0]])
    assert signed_volume(three) == pytest.approx(3.0 * signed_volume(cylinder))
    np.testing.assert_array_equal(plane((0, 0), (2, 1), z=4.0, cells=3).face_normals[:, 2], 1.0)


# -- every scene of the table ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_defaults(name):
    scene, mesh = scenes.BUILTIN_SCENES[name], scenes.build(name)
    assert isinstance(mesh, TriangleMesh)
    assert mesh.name == scene.name == name
    assert 1_000 <= mesh.triangle_count <= 300_000
    assert mesh.summary()["degenerate_triangles"] == 0
    assert mesh.triangle_count == scene.function().triangle_count  # the table and the signatures agree
    assert np.isfinite(mesh.vertices).all()
    assert 0.5 < mesh.extent < 1000.0
    assert scene.description
    assert set(scene.camera) == {"position", "look_at", "up", "fov"}
    assert 10.0 < scene.fov < 100.0


@pytest.mark.parametrize("name", NAMES)
def test_default_camera_sees_the_scene(name):
    """Rays through the picture hit something, and nothing stands right before the lens."""
    scene, mesh = scenes.BUILTIN_SCENES[name], scenes.build(name)
    position = np.array(scene.position)
    forward = np.array(scene.look_at) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, scene.up)
    right /= np.linalg.norm(right)
    up, reach = np.cross(right, forward), np.tan(np.radians(0.5 * scene.fov))
    steps = np.linspace(-0.6, 0.6, 7)
    directions = np.array([forward + reach * (x * right + y * up) for x in steps for y in steps])
    distances = hits(mesh, position, directions)
    assert np.isfinite(distances).mean() >= 0.25
    assert distances.min() > 0.01 * min(mesh.extent, 30.0)


@pytest.mark.parametrize("name", NAMES)
def test_the_same_arguments_give_the_same_scene(name):
    first, second = scenes.build(name, **SMALL[name]), scenes.build(name, **SMALL[name])
    np.testing.assert_array_equal(first.vertices, second.vertices)
    np.testing.assert_array_equal(first.faces, second.faces)


@pytest.mark.parametrize("name", NAMES)
def test_sizes_grow(name):
    small, larger = scenes.build(name, **SMALL[name]), scenes.build(name, **LARGER[name])
    assert small.triangle_count < larger.triangle_count < scenes.build(name).triangle_count
    assert np.isfinite(larger.vertices).all()


def test_blocks_of_the_cornell_box_face_outward():
    """So that they may be made of glass; the walls face the room, and the lamp hangs under the ceiling."""
    box, room = scenes.build("cornell_box", cells=1), scenes.build("cornell_box", cells=1, blocks=False)
    blocks = TriangleMesh(box.vertices, box.faces[room.triangle_count :])
    assert signed_volume(blocks) == pytest.approx(1.65 * 2.68 + 3.30 * 2.74, rel=0.02)  # height x base, about
    assert signed_volume(room) < 0.0
    assert box.triangle_count == 36
    emits = [box.materials.materials[number].emits for number in box.materials.of_face]
    lamp = corners_of(box)[emits]
    np.testing.assert_allclose(lamp[..., 2], 5.483)
    assert box.face_normals[emits][:, 2].max() == -1.0


@pytest.mark.parametrize("name", ["random_triangles", "wood"])
def test_seeds_differ(name):
    first, second = (scenes.build(name, **{**SMALL[name], "seed": seed}) for seed in (0, 1))
    assert first.triangle_count == second.triangle_count or name == "wood"
    assert not np.array_equal(first.vertices, second.vertices)


def test_unknown_names_and_options_fail_loudly():
    with pytest.raises(ValueError, match=r"unknown scene 'teapto'.*atrium.*wood"):
        scenes.build("teapto")
    with pytest.raises(TypeError, match=r"no option 'trees'.*level, ground"):
        scenes.build("teapot", trees=3)


@pytest.mark.parametrize(
    ("name", "options", "error"),
    [
        ("teapot", {"level": 0}, ValueError),
        ("teapot", {"level": 2.0}, TypeError),
        ("teapot", {"level": True}, TypeError),
        ("random_triangles", {"count": 0}, ValueError),
        ("random_triangles", {"size": 0.0}, ValueError),
        ("random_triangles", {"size": 1.5}, ValueError),
        ("random_triangles", {"size": np.nan}, ValueError),
        ("teapot_in_stadium", {"rows": 0}, ValueError),
        ("teapot_in_stadium", {"segments": 7}, ValueError),
        ("atrium", {"bays": 4}, TypeError),
        ("atrium", {"bays": (0, 3)}, ValueError),
        ("atrium", {"storeys": 0}, ValueError),
        ("atrium", {"detail": 0}, ValueError),
        ("wood", {"trees": 0}, ValueError),
        ("wood", {"leaves": -1}, ValueError),
    ],
)
def test_bad_options(name, options, error):
    with pytest.raises(error, match=next(iter(options))):
        scenes.build(name, **options)


# -- one by one --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "size"), [(1, 1.0), (5000, 0.1), (2000, 1e-3)])
def test_random_triangles_stay_in_the_unit_box(count, size):
    mesh = scenes.random_triangles(count, size)
    assert mesh.triangle_count == count
    assert mesh.vertices.min() >= 0.0
    assert mesh.vertices.max() <= 1.0
    assert np.ptp(corners_of(mesh), axis=1).max() <= size * (1.0 + 1e-12)
    if count > 1000:
        np.testing.assert_allclose(corners_of(mesh).mean(axis=(0, 1)), 0.5, atol=0.03)


def test_stadium_dwarfs_the_teapot():
    small = scenes.teapot_in_stadium(level=3)
    pot = 64 * 9 - 8 * 3
    pot_extent = TriangleMesh(small.vertices, small.faces[:pot]).extent
    assert 80.0 < small.extent / pot_extent < 130.0
    grown = scenes.teapot_in_stadium(level=6)
    assert grown.triangle_count - small.triangle_count == 64 * 36 - 8 * 6 - pot


def test_atrium_lets_light_in_through_the_roof_only():
    """Whatever leaves a dark corner of the gallery passes the rectangle of open sky."""
    mesh = scenes.atrium(bays=(2, 2), storeys=2, detail=1)
    directions = np.random.default_rng(3).normal(size=(600, 3))
    for origin in ([-7.7, -7.6, 1.0], [7.3, 0.4, 7.1], [0.3, -1.7, 0.5]):
        away = directions[np.isinf(hits(mesh, np.array(origin), directions))]
        assert (away[:, 2] > 0.0).all()
        at_roof = np.array(origin) + away * ((2 * 5.6 + 0.6 - origin[2]) / away[:, 2])[:, None]
        assert (np.abs(at_roof[:, :2]) < 4.0).all()
    assert len(away) > 10  # the middle of the court does see the sky


def test_atrium_has_thin_and_huge_triangles():
    corners = corners_of(scenes.atrium())
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert (edges.max(axis=1) / edges.min(axis=1)).max() > 40.0
    assert edges.max() > 20.0


def test_wood_stands_on_its_ground():
    mesh = scenes.wood(trees=4, leaves=3, seed=8)
    assert mesh.triangle_count - scenes.wood(trees=4, leaves=0, seed=8).triangle_count == 4 * 180 * 3 * 2
    assert -6.0 < mesh.bounds[0, 2] < 0.5
    assert 6.0 < mesh.bounds[1, 2] < 18.0
    trees = corners_of(mesh)[mesh.triangle_count - 4 * 180 * 3 * 2 :]
    assert trees[..., 2].min() > mesh.bounds[0, 2]


def test_the_package_does_not_import_trimesh_or_warp():
    code = "import sys, wrt.scenes; wrt.scenes.build('teapot'); assert not {'trimesh', 'warp'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)

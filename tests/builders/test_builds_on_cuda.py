"""Builders on a CUDA device: the trees of the CPU to the bit, and scenes whose trees are built where they are."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.environment import DEVICES
from support.hits import assert_same_hits, brute_force, mixed_rays
from support.meshes import SCENES

import wrt
from wrt.builders.bvh import BVH_BUILDERS
from wrt.builders.bvh.bvh_config import BvhConfig
from wrt.builders.bvh.update.bvh_update import refit
from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.kdtree import KDTREE_BUILDERS
from wrt.builders.tree import Bvh, KdTree
from wrt.builders.triangle_boxes import corner_bounds, triangle_boxes

pytestmark = pytest.mark.cuda

CUDA = DEVICES[1:]

on_cuda = pytest.mark.skipif(not CUDA, reason="there is no CUDA device here")

MESHES = {name: SCENES[name] for name in ("teapot", "grid", "degenerate", "needles")} | {
    "one triangle": lambda: soup(1),
    "two triangles": lambda: soup(2),
    "three triangles": lambda: soup(3),
    "one place": lambda: repeated(1000),
    "a series": lambda: series(120),
    "far away": lambda: soup(2000, 1e7),
}


def soup(count: int, offset: float = 0.0) -> wrt.TriangleMesh:
    """Small triangles in a cube."""
    rng = np.random.default_rng(count)
    corners = rng.random((count, 1, 3)) * 20 + rng.random((count, 3, 3)) + offset
    return wrt.TriangleMesh(corners.reshape(-1, 3).astype(np.float32), np.arange(3 * count).reshape(-1, 3))


def repeated(count: int) -> wrt.TriangleMesh:
    """One triangle, several times."""
    return wrt.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 1]], np.tile([0, 1, 2], (count, 1)))


def series(count: int) -> wrt.TriangleMesh:
    """Triangles of which each is larger than the one before."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 1]]) * 2.0 ** np.arange(30 - count, 30)[:, None, None]
    return wrt.TriangleMesh(corners.reshape(-1, 3).astype(np.float32), np.arange(3 * count).reshape(-1, 3))


def boxes_on(device: str, mesh: wrt.TriangleMesh):
    """Boxes of the triangles."""
    vertices = wp.array(mesh.vertices.astype(np.float32), dtype=wp.vec3, device=device)
    return triangle_boxes(vertices, wp.array(mesh.faces, dtype=wp.vec3i, device=device))


def assert_same_tree(found: Bvh | KdTree, expected: Bvh | KdTree) -> None:
    """Equal to the bit."""
    for name in ("bounds", "child") if isinstance(found, Bvh) else ("nodes",):
        one, other = getattr(found, name).numpy(), getattr(expected, name).numpy()
        np.testing.assert_array_equal(one.view(np.int32), other.view(np.int32))
    np.testing.assert_array_equal(found.primitive.numpy(), expected.primitive.numpy())
    assert (found.low, found.high) == (expected.low, expected.high)
    if isinstance(found, Bvh):
        assert found.level_first == expected.level_first


@on_cuda
@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("leaf", [1, 2])
@pytest.mark.parametrize("rounds", [0, 1, 6])
def test_hploc_gives_the_tree_of_the_cpu(name, rounds, leaf):
    mesh = MESHES[name]()
    config = BvhConfig(cost=SurfaceAreaCost(width=2, block=1.5), max_leaf_triangles=leaf, reinsertion=rounds)
    build = BVH_BUILDERS["hploc"].build
    expected = build(boxes_on("cpu", mesh), config)
    for _ in range(3):
        assert_same_tree(build(boxes_on(CUDA[0], mesh), config), expected)


@on_cuda
@pytest.mark.parametrize("rounds", [0, 4])
def test_hploc_gives_the_tree_of_the_cpu_for_many_triangles(rounds):
    mesh = soup(300_000)
    config = BvhConfig(cost=SurfaceAreaCost(width=2, block=1.5), max_leaf_triangles=2, reinsertion=rounds)
    build = BVH_BUILDERS["hploc"].build
    expected = build(boxes_on("cpu", mesh), config)
    for _ in range(5):
        assert_same_tree(build(boxes_on(CUDA[0], mesh), config), expected)


@on_cuda
@pytest.mark.parametrize("name", ["teapot", "grid", "degenerate"])
@pytest.mark.parametrize("builder", BVH_BUILDERS)
def test_bvh_builders_give_the_tree_of_the_cpu(builder, name):
    mesh = SCENES[name]()
    for width in (2, 8):
        config = BvhConfig(cost=SurfaceAreaCost(width=width))
        build = BVH_BUILDERS[builder].build
        assert_same_tree(build(boxes_on(CUDA[0], mesh), config), build(boxes_on("cpu", mesh), config))


@on_cuda
@pytest.mark.parametrize("name", ["teapot", "grid", "degenerate"])
@pytest.mark.parametrize("builder", KDTREE_BUILDERS)
def test_kdtree_builders_give_the_tree_of_the_cpu(builder, name):
    mesh = SCENES[name]()
    for width in (1, 8):
        config = wrt.KdTree(builder=builder).config(width)
        build = KDTREE_BUILDERS[builder].build
        assert_same_tree(build(boxes_on(CUDA[0], mesh), config), build(boxes_on("cpu", mesh), config))


@on_cuda
@pytest.mark.parametrize("name", MESHES)
def test_a_build_by_levels_gives_the_tree_of_the_cpu(name):
    """In place; in which order threads come makes no difference."""
    mesh, build = MESHES[name](), KDTREE_BUILDERS["in_place"].build
    for width in (1, 8):
        config = wrt.KdTree(mailbox=width == 8).config(width)
        expected = build(boxes_on("cpu", mesh), config)
        for _ in range(3):
            assert_same_tree(build(boxes_on(CUDA[0], mesh), config), expected)


@on_cuda
def test_a_build_by_levels_of_many_triangles_gives_the_tree_of_the_cpu():
    """Some ten thousand blocks of threads tell each other of their sums."""
    mesh, config, build = soup(300_000), wrt.KdTree().config(8), KDTREE_BUILDERS["in_place"].build
    expected = build(boxes_on("cpu", mesh), config)
    for _ in range(5):
        assert_same_tree(build(boxes_on(CUDA[0], mesh), config), expected)


@on_cuda
@pytest.mark.parametrize("rounds", [0, 2])
@pytest.mark.parametrize("name", MESHES)
def test_hits_are_those_of_brute_force(name, rounds):
    """Of scenes whose trees are built on the device: they hold the CPU's tree."""
    mesh, tree = MESHES[name](), wrt.Bvh(builder="hploc", reinsertion=rounds)
    scene = wrt.Scene(mesh, tree, device=CUDA[0])
    assert scene.state.tree.child.device == scene.device
    rays = wrt.Rays(*mixed_rays(mesh, 3000, seed=2))
    assert_same_hits(scene.intersect(rays), brute_force(scene, rays))


@on_cuda
@pytest.mark.parametrize("clips", [False, True])
@pytest.mark.parametrize("name", MESHES)
def test_kdtrees_of_scenes_are_those_of_the_cpu(name, clips):
    """Built on the device, unless triangles are clipped, and again after a motion."""
    mesh, tree = MESHES[name](), wrt.KdTree(split_clipping=clips)
    scene = wrt.Scene(mesh, tree, device=CUDA[0])
    alone = wrt.Scene(mesh, wrt.KdTree(split_clipping=clips, width=scene.state.width), device="cpu")
    assert_same_tree(scene.state.tree, alone.state.tree)
    rays = wrt.Rays(*mixed_rays(mesh, 3000, seed=2))
    assert_same_hits(scene.intersect(rays), brute_force(scene, rays))
    moved = mesh.vertices + np.sin(7.0 * mesh.vertices[:, ::-1])
    scene.update(0, vertices=moved)
    assert clips or scene.last_update.action == "built"
    assert_same_hits(scene.intersect(rays), brute_force(scene, rays))


@on_cuda
@pytest.mark.parametrize("width", [2, 8])
@pytest.mark.parametrize("name", MESHES)
def test_refits_give_the_tree_of_the_cpu(name, width):
    """By one launch, in which threads meet in any order; again and again."""
    mesh = MESHES[name]()
    tree = BVH_BUILDERS["binned"].build(boxes_on("cpu", mesh), BvhConfig(cost=SurfaceAreaCost(width=width)))
    found = tree.to(wp.get_device(CUDA[0]))
    for step in (0.0, 0.3, 0.5):
        moved = (mesh.vertices + step * np.sin(7.0 * mesh.vertices[:, ::-1])).astype(np.float32)
        arrays = [(moved, wp.vec3), (mesh.faces, wp.vec3i)]
        expected = refit(tree, *(wp.array(a, dtype=kind, device="cpu") for a, kind in arrays))
        for _ in range(3):
            found = refit(found, *(wp.array(a, dtype=kind, device=CUDA[0]) for a, kind in arrays))
            assert_same_tree(found, expected)


@on_cuda
def test_bounds_are_found_on_the_device():
    mesh = soup(5000)
    vertices = wp.array(mesh.vertices, dtype=wp.vec3, device=CUDA[0])
    faces = wp.array(mesh.faces, dtype=wp.vec3i, device=CUDA[0])
    np.testing.assert_array_equal(corner_bounds(vertices, faces), mesh.bounds.astype(np.float32))
    broken = mesh.vertices.copy()
    broken[77, 1] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        corner_bounds(wp.array(broken, dtype=wp.vec3, device=CUDA[0]), faces)


@on_cuda
def test_the_default_tree_gives_way_to_one_that_is_built_on_the_device():
    """Once vertices come from there; hits are those of brute force. What is built on the CPU wants them on the host."""
    mesh = MESHES["teapot"]()
    moved = (mesh.vertices + 0.3 * np.sin(5.0 * mesh.vertices[:, ::-1])).astype(np.float32)
    points = wp.array(moved, dtype=wp.vec3, device=CUDA[0])
    for rebuild in ("auto", "never"):
        scene = wrt.Scene(mesh, device=CUDA[0])
        scene.update(0, vertices=points, rebuild=rebuild)
        assert "_vertices" not in vars(scene.state.meshes[0])
        assert scene.last_update.action == ("kept" if rebuild == "never" else "built")
        rays = wrt.Rays(*mixed_rays(scene.meshes[0], 3000, seed=4))
        assert_same_hits(scene.intersect(rays), brute_force(scene, rays))
    for tree, rebuild in ((wrt.Bvh(), "always"), (wrt.Bvh(width=4), "auto")):
        with pytest.raises(TypeError, match="vertices"):
            wrt.Scene(mesh, tree, device=CUDA[0]).update(0, vertices=points, rebuild=rebuild)


@on_cuda
@pytest.mark.parametrize("rebuild", ["auto", "always", "never"])
@pytest.mark.parametrize("name", ["teapot", "degenerate", "one triangle", "far away"])
def test_vertices_on_the_device_move_there(name, rebuild):
    """The scene is what it is after an update with the same vertices on the host; its mesh has the new ones."""
    mesh, tree = MESHES[name](), wrt.Bvh(builder="hploc")
    scene, other = (wrt.Scene(mesh, tree, device=CUDA[0]) for _ in range(2))
    for step in (0.3, 0.7):
        moved = (mesh.vertices + step * np.sin(5.0 * mesh.vertices[:, ::-1])).astype(np.float32)
        points, held = wp.array(moved, dtype=wp.vec3, device=CUDA[0]), scene.state.meshes[0]
        scene.update(0, vertices=points, rebuild=rebuild)
        points.zero_()  # the scene has a copy
        other.update(0, vertices=moved, rebuild=rebuild)
        assert "_vertices" not in vars(scene.state.meshes[0])
        assert held is mesh or "_vertices" not in vars(held)
        assert scene.last_update.action == other.last_update.action == ("kept" if rebuild == "never" else "built")
        assert_same_tree(scene.state.tree, other.state.tree)
        rays = wrt.Rays(*mixed_rays(other.meshes[0], 3000, seed=3))
        assert_same_hits(scene.intersect(rays), other.intersect(rays))
        np.testing.assert_array_equal(scene.bounds, other.bounds)
    np.testing.assert_array_equal(scene.meshes[0].vertices, moved)
    broken = moved.copy()
    broken[mesh.faces[0, 0]] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        scene.update(0, vertices=wp.array(broken, dtype=wp.vec3, device=CUDA[0]), rebuild=rebuild)
    np.testing.assert_array_equal(scene.meshes[0].vertices, moved)

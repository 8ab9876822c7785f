"""Lazy kd-trees that start from groups of groups of meshes: the hits of brute force; no group is opened that no ray reaches."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import trimesh
from support.lazy_scenes import assert_brute, lazy_scene, random_rays

import wrt
from wrt import scenes
from wrt.builders.kdtree.kdtree_config import GROUPS, MESHES
from wrt.builders.kdtree.lazy import lazy_kdtree
from wrt.builders.kdtree.lazy.given_clusters import MeshBoxes
from wrt.builders.kdtree.lazy.scene_groups import SceneGroups
from wrt.meshes.placement import as_meshes, hierarchy_of

pytestmark = pytest.mark.width


@pytest.fixture(autouse=True)
def small_cells(monkeypatch):
    """Cells of some dozen triangles, and few nodes of a cell: small scenes are divided again and again."""
    monkeypatch.setattr(lazy_kdtree, "LARGE", 60)
    monkeypatch.setattr(lazy_kdtree, "OPENED", 4)


def part(place: np.ndarray, seed: int, count: int = 40) -> wrt.TriangleMesh:
    """Random triangles about a point."""
    mesh = scenes.build("random_triangles", count=count, size=0.1, seed=seed)
    return wrt.TriangleMesh(mesh.vertices + place, mesh.faces)


def house(place: np.ndarray, seed: int) -> list:
    """Four parts in one place, whose boxes all overlap."""
    return [part(place, seed + number, 30 + 10 * number) for number in range(4)]


def block(place: np.ndarray, seed: int) -> list:
    """Three houses in a row."""
    return [house(place + np.array([3.0 * number, 0, 0]), seed + 10 * number) for number in range(3)]


def town(blocks: int = 5, seed: int = 0) -> list:
    """Blocks at random places: groups of groups of groups."""
    places = 12.0 * np.random.default_rng(seed).random((blocks, 3))
    return [block(place, seed + 100 * number) for number, place in enumerate(places)]


def binary(meshes: list) -> list:
    """The meshes as a tree of pairs."""
    half = len(meshes) // 2
    return meshes if len(meshes) < 3 else [binary(meshes[:half]), binary(meshes[half:])]


def chain(meshes: list) -> list:
    """Each mesh hangs on the one before."""
    return [meshes[0], chain(meshes[1:])] if len(meshes) > 1 else [meshes[0]]


APART = [part(np.array([2.0 * number, number % 3, 0.5 * number]), number) for number in range(12)]


def rays_at(meshes: tuple, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Random rays, half of them at triangles."""
    mesh = wrt.TriangleMesh.concatenate(meshes)
    origins, directions = random_rays(mesh, count, seed)
    chosen = np.random.default_rng(seed).integers(mesh.triangle_count, size=count // 2)
    directions[: count // 2] = mesh.vertices[mesh.faces[chosen]].mean(axis=1) - origins[: count // 2]
    return origins, directions


GEOMETRIES = {
    "three levels": town(),
    "flat": APART,
    "pairs": binary(APART),
    "a chain": chain(APART),
    "one below another": [[[[[[APART[0]], [APART[1], [[APART[2]]]]]]]]],
    "empty groups": [[], [APART[0], []], [[], [[]]], [[APART[1], APART[5]], [APART[9]]]],
    "one mesh": [[[APART[3]]]],
    "in one place": [house(np.zeros(3), 0), house(np.zeros(3), 7)],
}


@pytest.mark.parametrize("name", GEOMETRIES)
def test_hits(name):
    """Two frames; the second moves a mesh out of its group's old box."""
    geometry = GEOMETRIES[name]
    scene = lazy_scene(geometry, GROUPS)
    for _ in range(2):
        rays = rays_at(scene.meshes, 300, seed=1)
        if name not in ("one mesh", "in one place"):
            assert scene.state.lazy_tree.current.unbuilt > 1
        brute = scene.intersect(*rays, traversal="brute")
        np.testing.assert_array_equal(scene.occluded(*rays, traversal="single"), brute.is_hit)
        assert_brute(scene, *rays)
        scene.update(0, vertices=scene.meshes[0].vertices + np.array([1.0, 2.0, -1.0]))


def test_many_queries():
    """Every hit of every ray, and their number: of a tree of which nothing is built but the top."""
    geometry = GEOMETRIES["three levels"]
    rays = rays_at(as_meshes(geometry), 200, seed=4)
    whole = wrt.Scene(geometry, wrt.KdTree(builder="binned"), device="cpu")
    np.testing.assert_array_equal(
        lazy_scene(geometry, GROUPS).count(*rays, traversal="single"), whole.count(*rays, traversal="single")
    )
    found, expected = (scene.intersect_all(*rays, traversal="single") for scene in (lazy_scene(geometry, GROUPS), whole))
    for name in ("t", "primitive_id", "uv"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("name", ["three levels", "pairs", "a chain", "empty groups"])
def test_the_whole_tree(name):
    """Every triangle is in it, whatever the number of threads."""
    trees = []
    for threads in (1, 3):
        scene = lazy_scene(GEOMETRIES[name], GROUPS, num_threads=threads)
        scene.state.complete()
        assert scene.state.lazy_tree.current.unbuilt == 0
        trees.append(scene.tree)
    for field in ("nodes", "primitive"):
        np.testing.assert_array_equal(*(getattr(tree, field).numpy() for tree in trees))
    ids = trees[0].primitive.numpy()
    assert set(ids[ids >= 0]) == set(range(scene.triangle_count))


def test_only_groups_that_rays_reach_are_opened():
    """A row of blocks, and a ray at one part of the last: blocks in between stay closed, and no triangle of theirs is read."""
    geometry = [block(np.array([0.0, 40.0 * number, 0.0]), 100 * number) for number in range(6)]
    scene = lazy_scene(geometry, GROUPS)
    tree = scene.state.lazy_tree
    assert tree.opened == {tree.groups.root}
    assert tree.sorted_triangles == 0
    target = scene.meshes[-1]
    corner = target.vertices[target.faces[0]].mean(axis=0)
    assert scene.intersect(corner - [1e-3, 2e-3, 3e-3], [1.0, 2.0, 3.0], traversal="single").is_hit
    last = tree.groups.triangles[sorted(tree.opened - {tree.groups.root}), 0]
    begin = scene.triangle_count // 6 * 5
    assert (last >= begin).all()
    assert 0 < len(last) <= 4  # the block, and some of its three houses
    ids = tree.current.tree.primitive.numpy()
    assert ids[ids >= 0].min() >= begin
    assert 0 < tree.sorted_triangles <= scene.triangle_count // 6


def test_nodes():
    """Chains and empty groups vanish; a group's triangles and box are those of its members, which it strictly contains."""
    meshes = as_meshes(GEOMETRIES["empty groups"])
    first = np.cumsum([0] + [mesh.triangle_count for mesh in meshes])
    bounds = np.array([mesh.bounds for mesh in meshes]).astype(np.float32)
    hierarchy = hierarchy_of(GEOMETRIES["empty groups"])
    groups = SceneGroups.of(MeshBoxes(first, bounds[:, 0], bounds[:, 1], hierarchy))
    assert [members.tolist() for members in groups.members] == [[1, 2], [4, 3], [0, 5]]
    np.testing.assert_array_equal(groups.triangles[groups.root], [0, first[-1]])
    for node, members in enumerate(groups.members, start=len(meshes)):
        assert (groups.low[node] == groups.low[members].min(axis=0)).all()
        assert (groups.high[node] == groups.high[members].max(axis=0)).all()
        assert groups.count(members) == groups.count(np.array([node]))
    assert (groups.low[: len(meshes)] < bounds[:, 0]).all()
    assert (groups.high[: len(meshes)] > bounds[:, 1]).all()
    assert SceneGroups.of(MeshBoxes(first[:2], bounds[:1, 0], bounds[:1, 1], 0)) is None
    without = SceneGroups.of(MeshBoxes(np.array([0, 5, 5, 9]), bounds[:3, 0], bounds[:3, 1], (0, (1, 2))))
    assert [members.tolist() for members in without.members] == [[0, 2]]  # mesh 1 has no triangles


def test_opening():
    """The largest first; members outside the cell are dropped; meshes come first."""
    low = np.array([[0, 0, 0], [4, 0, 0], [10, 0, 0], [11, 0, 0], [20, 0, 0]], dtype=np.float32)
    boxes = MeshBoxes(np.arange(6), low, low + np.float32(1), ((0, 1), (2, 3), 4))
    groups = SceneGroups.of(boxes)
    everywhere = np.full(3, -100.0, np.float32), np.full(3, 100.0, np.float32)
    nodes, opened = groups.opened(np.array([groups.root]), *everywhere, 4)
    assert (nodes.tolist(), opened) == ([0, 1, 4, 6], [7, 5])
    nodes, opened = groups.opened(nodes, np.full(3, 10.5, np.float32) * [1, 0, 0], everywhere[1], 9)
    assert (nodes.tolist(), opened) == ([0, 1, 2, 3, 4], [6])
    nodes, _ = groups.opened(np.array([groups.root]), np.float32([2, -1, -1]), np.float32([10.5, 2, 2]), 9)
    assert nodes.tolist() == [1, 2]
    nodes, _ = groups.opened(np.array([5]), np.float32([2, -1, -1]), np.float32([3, 2, 2]), 9)
    assert nodes.tolist() == []  # between the members


def test_a_cell_between_the_members_of_a_group(monkeypatch):
    """The box of a group meets a cell, and none of its members does: the cell is empty."""
    monkeypatch.setattr(lazy_kdtree, "OPENED", 3)
    first, second, third, fourth = (part(np.array([12.0 * number, 0, 0]), number, 200) for number in range(4))
    scene = lazy_scene([[first, fourth], second, third], GROUPS)
    tree = scene.state.lazy_tree
    assert tree.opened == {tree.groups.root}
    assert not scene.intersect([18.0, -5, 0.5], [0, 1.0, 0], traversal="single").is_hit  # builds that cell alone
    assert (tree.cells["clusters"][1:] == 0).any()
    origins = np.array([[18.0, -5, 0.5], [12.5, -5, 0.5], [36.5, -5, 0.5], [18.0, -5, 0.3]])
    hits, brute = (scene.intersect(origins, [[0, 1.0, 0]], traversal=name) for name in ("single", "brute"))
    np.testing.assert_array_equal(hits.t, brute.t)
    scene.state.complete()
    assert tree.current.unbuilt == 0


def test_pickle():
    """A copy knows the groups."""
    scene = lazy_scene(GEOMETRIES["three levels"], GROUPS)
    copy = pickle.loads(pickle.dumps(scene))
    assert copy.state.hierarchy == scene.state.hierarchy == hierarchy_of(GEOMETRIES["three levels"])
    assert len(copy.state.lazy_tree.groups.members) == len(scene.state.lazy_tree.groups.members) == 1 + 5 + 15
    assert lazy_scene(GEOMETRIES["three levels"], MESHES).state.hierarchy is None


def graph_of_three_levels() -> trimesh.Scene:
    """A box on a node that carries two others, one of them with two balls, mirrored; nodes without meshes in between."""
    scene, place = trimesh.Scene(), trimesh.transformations.translation_matrix
    box, ball = trimesh.creation.box(), trimesh.creation.icosphere(subdivisions=1)
    scene.graph.update("street", matrix=place([10, 0, 0]))
    scene.add_geometry(box, node_name="house", parent_node_name="street", transform=place([0, 2, 0]))
    scene.add_geometry(box, node_name="roof", parent_node_name="house", transform=place([0, 0, 2]), geom_name="box")
    scene.graph.update("garden", "house", matrix=np.diag([-1.0, 1, 1, 1]))
    scene.add_geometry(ball, node_name="bush", parent_node_name="garden", transform=place([3, 0, 0]))
    scene.add_geometry(ball, node_name="tree", parent_node_name="garden", transform=place([5, 0, 1]))
    scene.graph.update("nothing", "garden")
    return scene


def test_graphs():
    """The meshes of a trimesh.Scene as its graph nests them, at their places; both scenes of it hit the same."""
    graph = graph_of_three_levels()
    (nested,) = [wrt.moving.nested_meshes(graph)]
    ((house_mesh, roof, (bush, tree)),) = nested
    np.testing.assert_allclose(house_mesh.bounds, [[9.5, 1.5, -0.5], [10.5, 2.5, 0.5]])
    np.testing.assert_allclose(roof.bounds, [[9.5, 1.5, 1.5], [10.5, 2.5, 2.5]])
    np.testing.assert_allclose(bush.bounds.mean(axis=0), [7, 2, 0], atol=1e-12)
    np.testing.assert_allclose(tree.bounds.mean(axis=0), [5, 2, 1], atol=1e-12)
    scene, two_levels = lazy_scene(nested, GROUPS), wrt.Scene(graph, device="cpu")
    rays = rays_at(as_meshes(nested), 400, seed=3)
    assert_brute(scene, *rays)
    hits, expected = (one.intersect(*rays, traversal="single") for one in (scene, two_levels))
    assert (hits.is_hit != expected.is_hit).mean() < 0.01
    both = hits.is_hit & expected.is_hit
    np.testing.assert_allclose(hits.t[both], expected.t[both], rtol=1e-4)
    np.testing.assert_allclose(hits.normal[both], expected.normal[both], atol=1e-5)


def test_what_is_no_graph():
    with pytest.raises(TypeError, match=r"scene must be a trimesh.Scene, not TriangleMesh; pass meshes to wrt.Scene"):
        wrt.moving.nested_meshes(APART[0])
    with pytest.raises(ValueError, match=r"no triangles in the trimesh.Scene"):
        wrt.moving.nested_meshes(trimesh.Scene())

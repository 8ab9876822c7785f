"""Group trees: the hits of one tree over everything, and nothing touched that has not moved."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import trimesh
from conftest import assert_same_hits, mixed_rays, snapped_soup

import wrt
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH

BALL = wrt.TriangleMesh.from_trimesh(trimesh.creation.icosphere(2))
FEW = wrt.TriangleMesh(np.eye(3), [[0, 1, 2]])


def groups(count: int) -> list[wrt.TriangleMesh]:
    """Balls in a row, a single triangle and a soup, all within each other's reach."""
    balls = [BALL.transformed(trimesh.transformations.translation_matrix([1.5 * k, 0, 0])) for k in range(count - 2)]
    return [*balls, FEW, snapped_soup(200, 3)][-count:]


def assert_as_one_tree(scene: wrt.moving.GroupedScene) -> None:
    """By single rays, which walk the tree as it is."""
    plain = wrt.Scene(scene.meshes, device="cpu")
    rays = mixed_rays(scene.flattened(), 1500)
    expected = plain.intersect(*rays, traversal="single")
    assert expected.is_hit.mean() > 0.2
    assert_same_hits(scene.intersect(*rays, traversal="single"), expected)
    np.testing.assert_array_equal(scene.count(*rays, traversal="single"), plain.count(*rays, traversal="single"))
    np.testing.assert_array_equal(scene.bounds, plain.bounds)
    assert sorted(ids := scene.tree.primitive.numpy()[scene.tree.primitive.numpy() >= 0]) == list(range(len(ids)))


@pytest.mark.parametrize("count", [1, 2, 20])
def test_as_one_tree(count):
    scene = wrt.moving.GroupedScene(groups(count), device="cpu")
    assert_as_one_tree(scene)
    last = count - 1
    scene.update(last, vertices=scene.meshes[last].vertices + np.array([0.1, 0.0, 0.2]))
    assert list(scene.group_updates) == [last]
    assert_as_one_tree(scene)
    statistics = scene.statistics().tree
    assert statistics.leaf_size_histogram @ np.arange(len(statistics.leaf_size_histogram)) == scene.triangle_count


def test_only_what_moved_is_touched():
    """Unless the scene's centre moves: then boxes are fitted again, and nodes stay."""
    scene = wrt.moving.GroupedScene(groups(6), device="cpu")
    trees = scene.state.trees
    scene.move({1: scene.meshes[1].vertices * 0.9, 2: np.random.default_rng(0).permutation(scene.meshes[2].vertices)})
    assert {number: report.action for number, report in scene.group_updates.items()} == {1: "kept", 2: "built"}
    assert [one is other for one, other in zip(scene.state.trees, trees, strict=True)] == [True, False, False, True, True, True]
    assert_as_one_tree(scene)
    trees = scene.state.trees
    scene.move({0: scene.meshes[0].vertices - [30.0, 0.0, 0.0]})
    assert all(one is not other and one.child is other.child for one, other in zip(scene.state.trees, trees, strict=True))
    assert list(scene.group_updates) == [0]
    assert_as_one_tree(scene)


def test_bad_input():
    scene = wrt.moving.GroupedScene(groups(3), device="cpu")
    before = scene.tree
    with pytest.raises(ValueError, match="mesh indices go from 0 to 2"):
        scene.move({3: FEW.vertices})
    with pytest.raises(ValueError, match="2 points, but the mesh has 3"):
        scene.move({0: BALL.vertices, 1: np.zeros((2, 3))})
    area = wrt.known_rays.PlaneInfluenceArea(position=(0, 0, 9), direction=(0, 0, -1), width=1, height=1, depth=1)
    with pytest.raises(TypeError, match=r"must be a wrt\.Bvh or a wrt\.KdTree"):
        wrt.moving.GroupedScene(groups(3), wrt.known_rays.ProjectedBvh(areas=area))
    with pytest.raises(ValueError, match="not stored in a folder"):
        wrt.moving.GroupedScene(groups(3), cache=".")
    assert scene.tree is before


def test_pickled_and_saved(tmp_path):
    scene = wrt.moving.GroupedScene(groups(3), device="cpu")
    scene.update(0, vertices=1.5 * scene.meshes[0].vertices)
    again = pickle.loads(pickle.dumps(scene))
    again.move({1: 2.0 * FEW.vertices})
    assert list(again.group_updates) == [1]
    rays = mixed_rays(scene.flattened(), 300)
    scene.save(tmp_path / "groups.npz")
    loaded = wrt.Scene.load(tmp_path / "groups.npz", device="cpu")
    assert_same_hits(loaded.intersect(*rays, traversal="single"), scene.intersect(*rays, traversal="single"))


def test_a_deep_group(tmp_path):
    """A chain as deep as a tree may be, below an upper tree, once lay deeper than what is loaded again."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 1]]) * 2.0 ** np.arange(-86, 34)[:, None, None]  # as far as scenes go
    chain = wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(360).reshape(-1, 3))
    across = wrt.TriangleMesh(-corners[-1], [[0, 1, 2]])  # the scene's centre is where the chain begins
    scene = wrt.moving.GroupedScene([chain, across], wrt.Bvh(width=2, max_leaf_triangles=1, bins=2), device="cpu")
    assert scene.state.trees[0].depth == MAX_WIDE_DEPTH
    assert scene.tree.depth <= MAX_WIDE_DEPTH
    scene.move({1: across.vertices[::-1]})
    rays = mixed_rays(scene.flattened(), 300)
    scene.save(tmp_path / "deep.npz")
    loaded = wrt.Scene.load(tmp_path / "deep.npz", device="cpu")
    assert_same_hits(loaded.intersect(*rays, traversal="single"), scene.intersect(*rays, traversal="single"))
    assert_as_one_tree(scene)

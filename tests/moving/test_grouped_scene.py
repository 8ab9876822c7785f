"""Group trees: the hits of one tree over everything, and nothing touched that has not moved."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import trimesh
from support.hits import assert_same_hits, mixed_rays
from support.meshes import snapped_soup

import wrt
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.moving import grouped_scene

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
    scene.update({1: scene.meshes[1].vertices * 0.9, 2: np.random.default_rng(0).permutation(scene.meshes[2].vertices)})
    assert {number: report.action for number, report in scene.group_updates.items()} == {1: "kept", 2: "built"}
    assert [one is other for one, other in zip(scene.state.trees, trees, strict=True)] == [True, False, False, True, True, True]
    assert_as_one_tree(scene)
    trees = scene.state.trees
    scene.update({0: scene.meshes[0].vertices - [30.0, 0.0, 0.0]})
    assert all(one is not other and one.child is other.child for one, other in zip(scene.state.trees, trees, strict=True))
    assert list(scene.group_updates) == [0]
    assert_as_one_tree(scene)


def test_groups_share_the_threads(monkeypatch):
    """By their triangles; trees are the same with any number of threads."""
    seen, move = [], grouped_scene.move_tree

    def watched(recipe, tree, group, policy):
        seen.append(wrt.get_num_threads())
        return move(recipe, tree, group, policy)

    monkeypatch.setattr(grouped_scene, "move_tree", watched)
    balls = [BALL.transformed(trimesh.transformations.translation_matrix([3 * k, 0, 0])) for k in range(4)]
    one, four = (wrt.moving.GroupedScene(balls, device="cpu", num_threads=count) for count in (1, 4))
    half = [ball.vertices * 0.5 + [1.5 * k, 0, 0] for k, ball in enumerate(balls)]
    for scene, moving, expected in ((one, (1, 2), {1}), (four, (1, 2), {2}), (four, (1,), {4}), (four, (0, 1, 2, 3), {1})):
        seen.clear()
        scene.update({number: half[number] for number in moving}, rebuild="always")
        assert {*seen} == expected
        assert len(seen) == len(moving)
    one.update({0: half[0], 3: half[3]}, rebuild="always")
    np.testing.assert_array_equal(one.tree.primitive.numpy(), four.tree.primitive.numpy())


def test_bad_input():
    scene = wrt.moving.GroupedScene(groups(3), device="cpu")
    before = scene.tree
    with pytest.raises(ValueError, match="mesh indices go from 0 to 2"):
        scene.update({3: FEW.vertices})
    with pytest.raises(ValueError, match="2 points, but the mesh has 3"):
        scene.update({0: BALL.vertices, 1: np.zeros((2, 3))})
    area = wrt.known_rays.PlaneInfluenceArea(position=(0, 0, 9), direction=(0, 0, -1), width=1, height=1, depth=1)
    with pytest.raises(TypeError, match=r"must be a wrt\.Bvh or a wrt\.KdTree"):
        wrt.moving.GroupedScene(groups(3), wrt.known_rays.ProjectedBvh(areas=area))
    with pytest.raises(ValueError, match="not stored in a folder"):
        wrt.moving.GroupedScene(groups(3), cache=".")
    assert scene.tree is before


@pytest.mark.parametrize("make", [wrt.moving.GroupedScene, wrt.Scene])
def test_several_meshes_in_one_update(make):
    """A mapping, in scenes of every kind that have meshes; nothing changes if one of them is refused."""
    scene = make(groups(3), device="cpu")
    one, other = scene.meshes[1].vertices + 0.25, scene.meshes[2].vertices * 0.5
    scene.update({1: one, 2: other}, rebuild="never")
    moved = [wrt.TriangleMesh(points, mesh.faces) for points, mesh in zip((one, other), scene.meshes[1:], strict=True)]
    expected = make([scene.meshes[0], *moved])
    rays = mixed_rays(scene.flattened(), 300)
    assert_same_hits(scene.intersect(*rays, traversal="single"), expected.intersect(*rays, traversal="single"))
    before = scene.state
    with pytest.raises(TypeError, match="which holds the vertices of each mesh; leave vertices out"):
        scene.update({1: one}, vertices=other)
    with pytest.raises(TypeError, match="index is an empty mapping"):
        scene.update({})
    with pytest.raises(TypeError, match="index must be an int"):
        scene.update({"wall": one})
    with pytest.raises(ValueError, match="points, but the mesh has"):
        scene.update({1: one, 2: other[:-1]})
    with pytest.raises(ValueError, match="transform, mask and environment need instances"):
        scene.update({1: one}, mask=1)
    assert scene.state is before
    with scene.updating({1: other[: len(one)] if len(other) >= len(one) else one}):
        assert scene.state.meshes is before.meshes
    assert scene.state is not before


def test_a_mapping_needs_meshes():
    scene = wrt.Scene([wrt.Instance(BALL), wrt.Instance(FEW)], device="cpu")
    with pytest.raises(ValueError, match=r"one mesh at a time: update\(index, vertices=points\)"):
        scene.update({0: BALL.vertices})


def test_move_means_nodes_everywhere():
    """`move` of groups took vertices; it warns and does so still. Nodes are refused as in every scene without any."""
    scene = wrt.moving.GroupedScene(groups(3), device="cpu")
    plain = wrt.Scene(BALL, device="cpu")
    for call in (lambda: scene.move({"arm": np.eye(4)}), lambda: scene.move([1, 2]), lambda: plain.move({"a": np.eye(4)})):
        with pytest.raises(ValueError, match="move needs instances, and this scene has none"):
            call()
    points = scene.meshes[1].vertices * 0.5
    for call in (lambda: scene.move({1: points}, rebuild="always"), lambda: scene.move(vertices={1: points})):
        with pytest.warns(DeprecationWarning, match=r"^wrt\.moving\.GroupedScene\.move\(vertices\) is now update") as caught:
            call()
        assert [warning.filename for warning in caught] == [__file__]
    assert np.array_equal(scene.meshes[1].vertices, points)
    assert list(scene.group_updates) == [1]


def test_pickled_and_saved(tmp_path):
    scene = wrt.moving.GroupedScene(groups(3), device="cpu")
    scene.update(0, vertices=1.5 * scene.meshes[0].vertices)
    again = pickle.loads(pickle.dumps(scene))
    again.update({1: 2.0 * FEW.vertices})
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
    scene.update({1: across.vertices[::-1]})
    rays = mixed_rays(scene.flattened(), 300)
    scene.save(tmp_path / "deep.npz")
    loaded = wrt.Scene.load(tmp_path / "deep.npz", device="cpu")
    assert_same_hits(loaded.intersect(*rays, traversal="single"), scene.intersect(*rays, traversal="single"))
    assert_as_one_tree(scene)

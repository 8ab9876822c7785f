"""Groups with kd-trees, joined by links: nested, in lists, with leaves in place of trees; always the hits of brute force."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import trimesh
from support.hits import assert_same_hits, mixed_rays
from support.meshes import snapped_soup
from support.ptx import compile_to_ptx

import wrt
from wrt.builders.convert.kdtree_links import link_kdtrees
from wrt.kernels.traversal.traversal_config import StackConfig, TraversalConfig
from wrt.kernels.traversal.two_level.linked_kdtrees import make_linked_kernel
from wrt.meshes.placement import hierarchy_of, nested

BALL = wrt.TriangleMesh.from_trimesh(trimesh.creation.icosphere(2))
FEW = wrt.TriangleMesh(np.eye(3), [[0, 1, 2]])
ONE_LEAF = wrt.KdTree(max_depth=0)


def ball(place: float) -> wrt.TriangleMesh:
    """A ball on the x axis; neighbours overlap."""
    return BALL.transformed(trimesh.transformations.translation_matrix([1.5 * place, 0, 0]))


NESTED = [ball(0), [ball(1), [ball(2), snapped_soup(200, 3)], [[FEW]]], [ball(3), ball(4)], []]

ARRANGEMENTS = {
    "flat": ([ball(k) for k in range(6)], {}),
    "one": ([BALL], {}),
    "nested": (NESTED, {}),
    "nested lists": (NESTED, {"top": "list"}),
    "two trees": ([ball(0), ball(1)], {"top": "list"}),
    "one by one": ([ball(0), FEW, ball(1)], {"top": "list", "accelerators": {1: ONE_LEAF, 2: ONE_LEAF}}),
}


def assert_as_brute_force(scene: wrt.moving.GroupedScene) -> None:
    plain = wrt.Scene(scene.meshes, device="cpu")
    rays = mixed_rays(scene.flattened(), 1000)
    expected = plain.intersect(*rays, traversal="brute")
    assert expected.is_hit.mean() > 0.2
    hits = scene.intersect(*rays)
    assert_same_hits(hits, expected)
    np.testing.assert_array_equal(hits.geometry_id, expected.geometry_id)
    np.testing.assert_array_equal(scene.occluded(*rays), expected.is_hit)
    np.testing.assert_array_equal(scene.count(*rays), plain.count(*rays, traversal="single"))
    np.testing.assert_array_equal(scene.bounds, plain.bounds)


@pytest.mark.parametrize("name", ARRANGEMENTS)
def test_as_brute_force(name):
    """In every query, before and after groups move; a move of the centre shifts the planes of groups at rest."""
    geometry, options = ARRANGEMENTS[name]
    scene = wrt.moving.GroupedScene(geometry, "kdtree", device="cpu", **options)
    assert_as_brute_force(scene)
    trees, last = scene.state.trees, len(scene.meshes) - 1
    scene.update(last, vertices=np.random.default_rng(1).permutation(scene.meshes[last].vertices))
    assert list(scene.group_updates) == [last]
    assert_as_brute_force(scene)
    assert all(one is other for one, other in zip(scene.state.trees[:-1], trees[:-1], strict=True))
    scene.update(0, vertices=scene.meshes[0].vertices - [7.0, 1.0, 0.0])
    assert_as_brute_force(scene)


def test_nested_bvhs():
    """The same hierarchy of BVHs, joined to one."""
    scene = wrt.moving.GroupedScene(NESTED, "bvh", device="cpu")
    plain = wrt.Scene(scene.meshes, device="cpu")
    rays = mixed_rays(scene.flattened(), 1000)
    assert_same_hits(scene.intersect(*rays), plain.intersect(*rays, traversal="single"))
    scene.update({3: scene.meshes[3].vertices * 1.5})
    moved = wrt.Scene(scene.meshes, device="cpu")
    assert_same_hits(scene.intersect(*rays), moved.intersect(*rays, traversal="single"))
    ids = scene.tree.primitive.numpy()
    assert sorted(ids[ids >= 0]) == list(range(scene.triangle_count))


def test_hierarchies():
    """Groups of one are their member; empty groups are none."""
    assert hierarchy_of(NESTED) == (0, (1, (2, 3), 4), (5, 6))
    assert hierarchy_of([[BALL]]) == hierarchy_of(BALL) == 0
    meshes = wrt.moving.GroupedScene(NESTED, "kdtree", device="cpu").meshes
    assert hierarchy_of(nested(hierarchy_of(NESTED), meshes)) == hierarchy_of(NESTED)


def test_what_a_walk_visits():
    """Behind the planes of an upper tree lie fewer groups than in a list."""
    balls = [ball(4 * k) for k in range(30)]
    rays = mixed_rays(wrt.TriangleMesh.concatenate(balls), 500)
    boxes = {}
    for top in ("tree", "list"):
        scene = wrt.moving.GroupedScene(balls, "kdtree", top=top, device="cpu")
        boxes[top] = scene.intersect(*rays, counters=True).counters["boxes"].sum()
    assert 0 < boxes["tree"] < 0.5 * boxes["list"]


def test_links_of_a_list():
    """A list, and the list of all trees behind it: roots in one array, and whether another link follows."""
    trees = [wrt.Scene(mesh, "kdtree", device="cpu").tree for mesh in (BALL, FEW)]
    members = [np.arange(BALL.triangle_count), BALL.triangle_count + np.arange(1)]
    made = link_kdtrees(trees, members, (0, 1), None)
    assert made.root == -1
    assert [row[:2] for row in made.links] == [(0, 1), (len(trees[0].nodes), 0)] * 2
    assert set(made.primitive) == {-1, *range(BALL.triangle_count + 1)}


def test_pickled():
    scene = wrt.moving.GroupedScene(NESTED, wrt.KdTree(), accelerators={0: ONE_LEAF}, top="list", device="cpu")
    again = pickle.loads(pickle.dumps(scene))
    assert again.state.layout == scene.state.layout
    rays = mixed_rays(scene.flattened(), 300)
    assert_same_hits(again.intersect(*rays), scene.intersect(*rays))


BAD = {
    "top": (lambda: wrt.moving.GroupedScene(NESTED, "kdtree", top="heap"), ValueError, "tree, list"),
    "list of bvhs": (lambda: wrt.moving.GroupedScene(NESTED, "bvh", top="list"), ValueError, "needs groups with kd-trees"),
    "lazy": (lambda: wrt.moving.GroupedScene(NESTED, wrt.KdTree(builder="lazy")), ValueError, "not lazy"),
    "kinds": (lambda: wrt.moving.GroupedScene(NESTED, "kdtree", accelerators={0: wrt.Bvh()}), ValueError, "one kind and width"),
    "number": (lambda: wrt.moving.GroupedScene(NESTED, "kdtree", accelerators={9: ONE_LEAF}), ValueError, "from 0 to 6"),
    "nothing": (lambda: wrt.moving.GroupedScene([[], []], "kdtree"), ValueError, "empty sequence"),
    "packets": (
        lambda: wrt.moving.GroupedScene(NESTED, "kdtree", device="cpu").intersect(np.eye(3), np.eye(3), traversal="packet"),
        ValueError,
        "choose from auto",
    ),
    "precise": (
        lambda: wrt.moving.GroupedScene(NESTED, "kdtree", device="cpu").intersect(np.eye(3), np.eye(3), precise=True),
        ValueError,
        "single tree",
    ),
    "save": (lambda: wrt.moving.GroupedScene(NESTED, "kdtree", device="cpu").save("groups.npz"), ValueError, "cannot be saved"),
    "statistics": (
        lambda: wrt.moving.GroupedScene(NESTED, "kdtree", device="cpu").statistics(),
        ValueError,
        "several kd-trees",
    ),
    "handle": (lambda: wrt.moving.GroupedScene(NESTED, "kdtree", device="cpu").handle(), ValueError, "single tree"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input(case):
    call, error, message = BAD[case]
    with pytest.raises(error, match=message):
        call()


@pytest.mark.slow
def test_compiles_for_cuda(tmp_path):
    text = compile_to_ptx(make_linked_kernel(TraversalConfig("woop", 2, "closest", stack=StackConfig(72, 0))).module, tmp_path)
    assert ".entry" in text
    assert "fma.rn.f32" not in text

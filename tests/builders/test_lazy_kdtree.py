"""Trees that are built while rays ask for them: the same hits as brute force, and no more built than asked for."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from support.built_kdtrees import build, leaf_references
from support.lazy_scenes import random_rays
from support.meshes import SCENES

import wrt
from wrt import scenes
from wrt.builders.kdtree.kdtree_statistics import kdtree_statistics, unpack
from wrt.builders.kdtree.lazy import lazy_kdtree as lazy

pytestmark = pytest.mark.width


@pytest.fixture
def small_cells(monkeypatch):
    """Cells of some dozen triangles, divided again and again."""
    monkeypatch.setattr(lazy, "LARGE", 60)


def lazy_scene(mesh: wrt.TriangleMesh) -> wrt.Scene:
    return wrt.Scene(mesh, wrt.KdTree(builder="lazy"), device="cpu")


def a_side(mesh: wrt.TriangleMesh) -> tuple[np.ndarray, np.ndarray]:
    """Parallel rays at a corner of the mesh's box, 128 x 128."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    u, v = np.meshgrid(np.linspace(0.1, 0.35, 128), np.linspace(0.1, 0.35, 128), indexing="ij")
    origins = low + (high - low) * np.stack([u, v, np.full_like(u, 2.0)], axis=-1)
    return origins, np.broadcast_to(np.array([0.01, 0.02, -1.0]), origins.shape)


@pytest.mark.parametrize("name", ["random_triangles", "stadium", "grid", "degenerate"])
def test_queries(name, small_cells):
    """Every query, on a tree of which nothing is built but the top: the answers of a finished tree, and of brute force."""
    mesh = SCENES[name]()
    origins, directions = random_rays(mesh, 300, seed=1)
    t_max = np.random.default_rng(2).random(300) * 1.5

    whole = wrt.Scene(mesh, wrt.KdTree(builder="binned"), device="cpu")
    queries = {
        "closest": lambda scene: scene.intersect(origins, directions, 0.1, t_max, traversal="single"),
        "occluded": lambda scene: scene.occluded(origins, directions, traversal="single"),
        "count": lambda scene: scene.count(origins, directions, traversal="single"),
        "all": lambda scene: scene.intersect_all(origins, directions, traversal="single"),
    }
    for query, ask in queries.items():  # each of a tree of its own
        scene = lazy_scene(mesh)
        found, expected = ask(scene), ask(whole)
        if query in ("closest", "all"):
            for field in ("t", "primitive_id", "uv"):
                np.testing.assert_array_equal(getattr(found, field), getattr(expected, field))
        else:
            np.testing.assert_array_equal(found, expected)
    brute = scene.intersect(origins, directions, 0.1, t_max, traversal="brute")
    hits = queries["closest"](scene)
    np.testing.assert_array_equal(hits.t, brute.t)
    np.testing.assert_array_equal(hits.primitive_id, brute.primitive_id)
    assert 0.02 < brute.is_hit.mean() < 1.0


def test_only_what_is_asked_for_is_built(small_cells):
    """A view of a corner: packets, tiles and a part of the rays that goes ahead; the rest of the scene keeps waiting."""
    mesh = scenes.build("random_triangles", count=5000, size=0.05, seed=4)
    scene, whole = lazy_scene(mesh), wrt.Scene(mesh, wrt.KdTree(builder="binned"), device="cpu")
    before = scene.state.lazy_tree.current
    assert before.unbuilt > 20
    assert len(before.tree.primitive) == 0
    rays = a_side(mesh)
    hits, expected = scene.intersect(*rays), whole.intersect(*rays)
    assert hits.plan.traversal == "packet"
    assert 0.02 < expected.is_hit.mean() < 0.98
    for name in ("t", "primitive_id", "uv"):
        np.testing.assert_array_equal(getattr(hits, name), getattr(expected, name))
    after = scene.state.lazy_tree.current
    assert 0 < len(after.tree.primitive) < 0.4 * len(whole.tree.primitive)
    again = scene.intersect(*rays)
    assert scene.state.lazy_tree.current is after
    np.testing.assert_array_equal(again.t, expected.t)
    counted = scene.intersect(*rays, traversal="single", counters=True)
    np.testing.assert_array_equal(counted.t, expected.t)
    assert counted.counters["triangles"].sum() > 0
    assert scene.statistics().tree.references < whole.statistics().tree.references


def test_rays_that_miss_ask_for_nothing(small_cells):
    """NaN, infinity, a direction of zero, and rays past the scene."""
    mesh = SCENES["teapot"]()
    scene = lazy_scene(mesh)
    origins = np.array([[0, 0, np.nan], [0, 0, np.inf], [0, 0, 0], [100, 100, 100]])
    directions = np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0], [1, 0, 0.0]])
    unbuilt = scene.state.lazy_tree.current.unbuilt
    assert not scene.intersect(origins, directions).is_hit.any()
    assert not scene.occluded(origins, directions).any()
    assert scene.state.lazy_tree.current.unbuilt == unbuilt > 0


@pytest.mark.parametrize("large", [60, 1000])
def test_the_whole_tree(large, monkeypatch):
    """Built to the end: depth-first nodes, cells that tile the box, a cost near the binned tree's, no trace of the skeleton."""
    monkeypatch.setattr(lazy, "LARGE", large)
    mesh = scenes.build("teapot_in_stadium", level=8)
    (tree, config), (reference, _) = build(mesh, "lazy"), build(mesh, "binned")
    flat = unpack(tree)
    inner = np.flatnonzero(~flat.is_leaf)
    np.testing.assert_array_equal(flat.left[inner], inner + 1)
    assert np.unique(flat.right[inner]).size == inner.size
    volume = np.prod(flat.high - flat.low, axis=1)
    assert volume[flat.is_leaf].sum() == pytest.approx(volume[0])
    assert set(leaf_references(tree)[1]) == set(range(mesh.triangle_count))
    costs = [kdtree_statistics(t, mesh.triangle_count, config.cost).sah_cost for t in (tree, reference)]
    assert costs[0] <= 1.25 * costs[1]


def test_threads_may_ask_at_a_time(small_cells):
    """Several threads look at different parts of one scene; each gets the hits of a finished tree."""
    mesh = scenes.build("random_triangles", count=5000, size=0.05, seed=4)
    scene, whole = lazy_scene(mesh), wrt.Scene(mesh, wrt.KdTree(builder="binned"), device="cpu")
    origins, directions = a_side(mesh)
    rows = [slice(begin, begin + 16) for begin in range(0, 128, 16)]
    expected = whole.intersect(origins, directions, traversal="single").t
    found = np.zeros_like(expected)

    def work(row: slice) -> None:
        found[row] = scene.intersect(origins[row], directions[row], traversal="single").t

    threads = [threading.Thread(target=work, args=(row,)) for row in rows]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    np.testing.assert_array_equal(found, expected)
    assert scene.state.lazy_tree.current.unbuilt > 0
    ids = scene.state.lazy_tree.current.tree.primitive.numpy()
    assert 0 < np.unique(ids[ids >= 0]).size < mesh.triangle_count


def test_kernels_of_others_get_the_whole_tree(small_cells):
    """What walks a tree without asking for more gets all of it."""
    scene = lazy_scene(SCENES["teapot"]())
    assert scene.state.lazy_tree.current.unbuilt > 0
    scene.handle()
    assert scene.state.lazy_tree.current.unbuilt == 0
    ids = scene.tree.primitive.numpy()
    assert np.unique(ids[ids >= 0]).size == scene.triangle_count


def test_meshes_that_do_not_divide(small_cells):
    """All triangles in one point, all alike, and stop rules that forbid to divide: one cell, built as a whole."""
    one = np.random.default_rng(9).random((1, 3, 3))
    for corners in (np.full((200, 3, 3), 0.5), np.repeat(one, 200, axis=0)):
        tree, _ = build(wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(600).reshape(-1, 3)), "lazy")
        assert set(leaf_references(tree)[1]) == set(range(200))
    mesh = SCENES["teapot"]()
    for options in ({"max_depth": 0}, {"leaf_triangles": 10**6}, {"least_size": 0.999, "max_depth": 1}):
        tree, _ = build(mesh, "lazy", **options)
        assert unpack(tree).depth.max() <= options.get("max_depth", 0)

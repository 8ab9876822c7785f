"""Split clipping: leaves list the triangles that they meet, and no others; the hits stay those of brute force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.built_kdtrees import assert_leaves_list_what_they_meet, build, hard_meshes, leaf_references, part_in
from support.meshes import SCENES

import wrt
from wrt import scenes
from wrt.builders.classics.kdtree import streaming
from wrt.builders.classics.kdtree.nested import nested
from wrt.builders.core import levels as levels_engine
from wrt.builders.core import subtrees
from wrt.builders.core.clip import PAD
from wrt.builders.kdtree import KDTREE_BUILDERS, BuilderCapabilities, binned, in_place
from wrt.builders.kdtree.kdtree_statistics import kdtree_statistics, unpack
from wrt.builders.kdtree.phases import clipped_levels
from wrt.builders.kdtree.scan import scanning
from wrt.kernels.runtime.launch import use_threads


@pytest.mark.parametrize("builder", ["binned", "sweep"])
@pytest.mark.parametrize("name", ["random_triangles", "degenerate"])
def test_leaves_list_what_they_meet(builder, name):
    assert_leaves_list_what_they_meet(SCENES[name](), builder)


def test_planes_end_what_is_left_of_triangles():
    """Every plane is at an end of the part of a triangle in the node's cell, or as far beyond as boxes are enlarged."""
    mesh = SCENES["random_triangles"]()
    corners = mesh.vertices.astype(np.float32)[mesh.faces]
    size = float((corners.max((0, 1)) - corners.min((0, 1))).max())
    tree, _ = build(mesh, "sweep", split_clipping=True, width=1, block_cost=1.5)
    flat, (leaf, triangle) = unpack(tree), leaf_references(tree)
    whole, nodes = 0, np.flatnonzero(~flat.is_leaf)[::60]
    for node in nodes:
        end = node + 1  # of its subtree, which is in depth-first order
        while end < len(flat.depth) and flat.depth[end] > flat.depth[node]:
            end += 1
        axis, position = flat.axis[node], float(flat.position[node])
        distance, of_boxes = np.inf, np.inf
        for i in np.unique(triangle[(leaf >= node) & (leaf < end)]):
            part = part_in(corners[i], flat.low[node] - PAD * size, flat.high[node] + PAD * size)
            if len(part):
                ends = part[:, axis].min(), part[:, axis].max()
                distance = min(distance, *(abs(abs(position - at) - pad) for at in ends for pad in (0.0, PAD * size)))
                of_boxes = min(of_boxes, np.abs(corners[i][:, axis] - position).min())
        assert distance < 1e-6 * size
        whole += of_boxes < 1e-6 * size
    assert 10 < whole < 0.8 * len(nodes)  # the others are no planes of whole boxes


@pytest.mark.parametrize("builder", ["binned", "sweep"])
def test_no_hit_is_lost(scene_mesh, builder):
    """Closest hits and all hits, as with a tree of whole boxes, of rays from inside, from far outside, and at vertices."""
    scene = wrt.Scene(scene_mesh, wrt.KdTree(builder=builder, split_clipping=True), device="cpu")
    reference = wrt.Scene(scene_mesh, wrt.KdTree(builder="binned"), device="cpu")
    rng = np.random.default_rng(5)
    low, high = scene_mesh.vertices.min(axis=0), scene_mesh.vertices.max(axis=0)
    size = (high - low).max()
    origins = (low + high) / 2 + size * rng.normal(size=(1500, 3)) * rng.choice([0.3, 2.0, 10.0], (1500, 1))
    corner = scene_mesh.vertices[rng.integers(0, len(scene_mesh.vertices), 1500)]
    inside = low + (high - low) * rng.random((1500, 3))
    directions = np.where(rng.random((1500, 1)) < 0.5, corner, inside) - origins
    hits, expected = (s.intersect(origins, directions, traversal="single") for s in (scene, reference))
    for name in ("t", "primitive_id", "uv"):
        np.testing.assert_array_equal(getattr(hits, name), getattr(expected, name))
    lists, all_expected = (s.intersect_all(origins, directions) for s in (scene, reference))
    np.testing.assert_array_equal(lists.offsets, all_expected.offsets)
    np.testing.assert_array_equal(lists.primitive_id, all_expected.primitive_id)
    assert expected.is_hit.mean() > 0.2
    brute = scene.intersect(origins[:200], directions[:200], traversal="brute")
    np.testing.assert_array_equal(hits.t[:200], brute.t)


CLIPPING = [name for name, builder in KDTREE_BUILDERS.items() if BuilderCapabilities.CLIPS in builder.capabilities]


@pytest.mark.parametrize("far", [1.0, 1e2, 1e4])
@pytest.mark.parametrize("builder", CLIPPING)
def test_needles_are_crossed_once(builder, far):
    """Rays at needles, their edges and their vertices, from up to 10,000 times the scene's size away.

    Their computed hits were up to their own length off the triangle, and so in cells that they had been clipped away from: a
    count came out one short. From far away, leaves that a hit was ascribed to did not have the triangle."""
    mesh = SCENES["needles"]()
    rng = np.random.default_rng(4)
    corners = mesh.vertices[mesh.faces[rng.integers(0, mesh.triangle_count, 20000)]].astype(np.float64)
    weights, kind = rng.dirichlet((1, 1, 1), 20000), rng.integers(0, 3, 20000)
    weights[kind == 1, 2] = 0.0
    weights[kind == 2] = [1.0, 0.0, 0.0]
    targets = (corners * (weights / weights.sum(axis=1, keepdims=True))[:, :, None]).sum(axis=1)
    origins = mesh.center + far * mesh.extent * rng.normal(size=(20000, 3))
    scene = wrt.Scene(mesh, wrt.KdTree(builder=builder, split_clipping=True), device="cpu")
    reference = wrt.Scene(mesh, "bvh", device="cpu")
    hits, expected = (s.intersect(origins, targets - origins) for s in (scene, reference))
    np.testing.assert_array_equal(hits.t.view(np.int32), expected.t.view(np.int32))
    np.testing.assert_array_equal(hits.primitive_id, expected.primitive_id)
    lists, all_expected = (s.intersect_all(origins, targets - origins) for s in (scene, reference))
    np.testing.assert_array_equal(lists.offsets, all_expected.offsets)
    np.testing.assert_array_equal(lists.primitive_id, all_expected.primitive_id)
    np.testing.assert_array_equal(scene.count(origins, targets - origins), all_expected.count)
    assert all_expected.count.mean() > 0.3


@pytest.mark.parametrize(
    ("builder", "module", "threshold"),
    [
        ("binned", binned, "MIN_LARGE"),
        ("adaptive_sampling", scanning, "MIN_LARGE"),
        ("in_place", in_place, "MIN_TASKS"),
        ("nested", nested, "MIN_LARGE"),
        ("streaming", streaming, "EXACT"),
    ],
)
def test_the_tree_is_cheaper_for_any_number_of_threads(builder, module, threshold, monkeypatch):
    """Fewer references and a lower cost. Several threads split levels, which a single one does not; the tree is the same."""
    mesh = scenes.build("random_triangles", count=2000, size=0.3, seed=6)
    monkeypatch.setattr(module, threshold, 700)
    trees = []
    for threads in (1, 3):
        with use_threads(threads):
            trees.append(build(mesh, builder, split_clipping=True)[0])
    np.testing.assert_array_equal(trees[0].nodes.numpy(), trees[1].nodes.numpy())
    np.testing.assert_array_equal(trees[0].primitive.numpy(), trees[1].primitive.numpy())
    plain, config = build(mesh, builder)
    costs = [kdtree_statistics(tree, mesh.triangle_count, config.cost) for tree in (trees[0], plain)]
    assert costs[0].references < 0.95 * costs[1].references
    assert costs[0].sah_cost < 0.97 * costs[1].sah_cost


EXACT_CASES = SCENES | {name: lambda name=name: hard_meshes()[name] for name in ("identical", "coplanar", "needles")}


@pytest.mark.parametrize("options", [{}, {"width": 1, "block_cost": 1.5}], ids=["lanes", "one"])
@pytest.mark.parametrize("name", [name for name in EXACT_CASES if name not in ("stadium", "atrium", "wood")])
def test_merged_events_make_the_naive_tree(name, options):
    """Lists that are merged, sorted and scanned give the same nodes to the bit, and the same leaves."""
    mesh = EXACT_CASES[name]()
    reference, _ = build(mesh, "naive", split_clipping=True, **options)
    for builder in ("sweep", "sorting_sweep"):
        tree, _ = build(mesh, builder, split_clipping=True, **options)
        np.testing.assert_array_equal(tree.nodes.numpy(), reference.nodes.numpy())
        np.testing.assert_array_equal(leaf_references(tree), leaf_references(reference))


@pytest.mark.parametrize("tests", [{"split_clipping": True}, {"cell_tests": "nodes"}], ids=["clipped", "tested"])
@pytest.mark.parametrize("name", [name for name in EXACT_CASES if name not in ("stadium", "atrium", "wood")])
def test_levels_make_the_naive_tree(name, tests, monkeypatch):
    """Levels of the parallel builds clip too: they once left it to the tasks, which made another tree. The same nodes to the
    bit, wherever levels end and chunks begin."""
    mesh = EXACT_CASES[name]()
    for options in ({}, {"width": 1, "block_cost": 1.5}):
        reference, _ = build(mesh, "naive", **tests, **options)
        for threads, tasks, chunk in ((1, 4, 8192), (3, 12, 8192), (2, 40, 50)):
            monkeypatch.setattr(clipped_levels, "MERGE_CHUNK", chunk)
            monkeypatch.setattr(in_place, "task_target", lambda count, device, tasks=tasks: in_place.TaskTarget(tasks, count))
            with use_threads(threads):
                tree, _ = build(mesh, "in_place", **tests, **options)
            np.testing.assert_array_equal(tree.nodes.numpy(), reference.nodes.numpy())
            np.testing.assert_array_equal(leaf_references(tree), leaf_references(reference))
        for threads, least, chunk in ((2, 50, 8192), (3, 200, 7)):
            monkeypatch.setattr(levels_engine, "CHUNK", chunk)
            monkeypatch.setattr(nested, "MIN_LARGE", least)
            with use_threads(threads):
                tree, _ = build(mesh, "nested", **tests, **options)
            np.testing.assert_array_equal(tree.nodes.numpy(), reference.nodes.numpy())
            np.testing.assert_array_equal(leaf_references(tree), leaf_references(reference))


@pytest.mark.parametrize(("size", "share"), [(0.1, 0.96), (0.3, 0.55), (0.5, 0.35)])
def test_soups_get_cheaper_trees(size, share):
    """Triangles from a tenth of the scene's size up to half of it: in lanes, and one at a time, where trees are deep."""
    mesh = scenes.build("random_triangles", count=1000, size=size, seed=1)
    for options, most in (({}, 1.0), ({"width": 1, "block_cost": 1.5}, share)):
        (clipped, config), (plain, _) = (build(mesh, "sweep", split_clipping=clip, **options) for clip in (True, False))
        cost, reference = (kdtree_statistics(tree, mesh.triangle_count, config.cost).sah_cost for tree in (clipped, plain))
        assert cost < most * reference


@pytest.mark.parametrize("name", ["one huge, many tiny", "across each other", "needles", "identical"])
def test_hard_meshes_in_bounded_memory(name):
    """The same hits as by brute force; and where most triangles straddle most planes, references are bounded too."""
    mesh = hard_meshes()[name]
    rng = np.random.default_rng(8)
    scene = wrt.Scene(mesh, wrt.KdTree(builder="sweep", split_clipping=True, width=8), device="cpu")
    assert leaf_references(scene.tree).shape[1] <= 64 * mesh.triangle_count
    corners = mesh.vertices[mesh.faces[rng.integers(0, mesh.triangle_count, 300)]]
    targets = (rng.dirichlet([1, 1, 1], 300)[:, :, None] * corners).sum(axis=1)
    origins = targets + rng.normal(size=(300, 3))
    hits, brute = (scene.intersect(origins, targets - origins, traversal=way) for way in ("single", "brute"))
    np.testing.assert_array_equal(hits.t, brute.t)
    np.testing.assert_array_equal(hits.primitive_id, brute.primitive_id)


@pytest.mark.parametrize(("builder", "spare"), [("sweep", 0.01), ("streaming", 0.4)])
def test_small_shares_are_enlarged(builder, spare, monkeypatch):
    """A task leaves room for new events in its share; where that is too small, the build starts over, to the same tree."""
    mesh = scenes.build("random_triangles", count=1500, size=0.5, seed=9)
    reference, _ = build(mesh, builder, split_clipping=True)
    monkeypatch.setattr(subtrees, "SPARE_MEMORY", spare)
    tree, _ = build(mesh, builder, split_clipping=True)
    np.testing.assert_array_equal(tree.nodes.numpy(), reference.nodes.numpy())
    np.testing.assert_array_equal(tree.primitive.numpy(), reference.primitive.numpy())


def test_builders_that_do_not_clip_say_so(monkeypatch):
    entry = KDTREE_BUILDERS["sorting_sweep"]
    without = replace(entry, capabilities=entry.capabilities & ~BuilderCapabilities.CLIPS)
    monkeypatch.setitem(KDTREE_BUILDERS, "sorting_sweep", without)
    with pytest.raises(
        ValueError, match=r"'sorting_sweep' does not support split_clipping; choose from in_place, nested, binned"
    ):
        wrt.KdTree(builder="sorting_sweep", split_clipping=True)

"""Orders of a tree's nodes: the same tree in each, and the same hits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from support.meshes import SCENES, STORED

import wrt
from studies.kdtrees.layout_comparison import (
    ALLOCATIONS,
    compare_allocations,
    compare_compact,
    compare_layouts,
    trace_placed,
)
from wrt.builders.classics.kdtree.compact_subtrees import to_compact
from wrt.builders.classics.kdtree.node_layouts import in_records, lay_out, with_layout
from wrt.builders.kdtree import LAYOUTS
from wrt.builders.kdtree.kdtree_statistics import unpack
from wrt.builders.kdtree.update.refill import refill
from wrt.builders.tree_check import check_tree
from wrt.builders.triangle_boxes import triangle_boxes
from wrt.engine.facts.query_kinds import ANY, CLOSEST
from wrt.engine.rays.device_rays import to_device
from wrt.engine.rays.rays import Rays
from wrt.kernels.layout.compact_nodes import HEIGHTS
from wrt.kernels.traversal.traversal_config import SingleConfig

pytestmark = pytest.mark.classics


@pytest.fixture(scope="module")
def scene() -> wrt.Scene:
    return wrt.Scene(STORED["wood"](), wrt.KdTree(builder="binned", width=8), device="cpu")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_is_the_same_tree(scene, layout):
    """Followed from the root on, nodes are equal one by one; children stand side by side; hits are those of the tree."""
    tree = lay_out(scene.tree, layout)
    words, flat, original = tree.nodes.numpy(), unpack(scene.tree), scene.tree.nodes.numpy()
    assert tree.nodes.ptr % 64 == 0
    stack, places = [(0, 0)], []
    while stack:
        node, place = stack.pop()
        places.append(place)
        assert words[place, 0] == original[node, 0]
        assert words[place, 1] & 3 == original[node, 1] & 3
        if flat.is_leaf[node]:
            assert words[place, 1] == original[node, 1]
        else:
            first = words[place, 1] >> 2
            assert first % 2 == 0
            stack += [(flat.left[node], first), (flat.right[node], first + 1)]
    assert len(set(places)) == len(places) == len(original)

    rng = np.random.default_rng(3)
    low, high = scene.bounds
    origins, targets = low + (high - low) * rng.random((2, 500, 3))
    rays = to_device(Rays(origins, targets - origins), scene.device, scene.center)
    hits = trace_placed(scene, tree, rays, SingleConfig(pair_words=1))
    expected = scene.intersect(origins, targets - origins, traversal="single")
    np.testing.assert_array_equal(hits.t.numpy(), expected.t)
    np.testing.assert_array_equal(hits.primitive.numpy(), expected.primitive_id)
    assert 0.05 < expected.is_hit.mean() < 1.0


def test_refilled_trees_have_no_old_copy(scene):
    """Leaves of a refilled tree have other lists. A copy of the nodes in another order kept the old ones, so it is dropped."""
    boxes = triangle_boxes(scene.state.device_mesh.vertices, scene.state.device_mesh.faces)
    tree = refill(with_layout(scene.tree, "pages"), boxes, np.full(3, 0.01), 64 * boxes.count)
    assert not np.array_equal(tree.nodes.numpy(), scene.tree.nodes.numpy())
    check_tree(tree, boxes.count)
    assert tree.pairs is None


def test_what_layouts_promise(scene):
    """Depth first: a left child's pair is the next. Subtrees: from a node in the first pair of a line, two steps stay in it."""
    flat = unpack(scene.tree)
    inner = np.flatnonzero(~flat.is_leaf)
    deep = LAYOUTS["depth_first"](flat)
    followed = inner[~flat.is_leaf[flat.left[inner]]]
    np.testing.assert_array_equal(deep[flat.left[followed]], deep[followed] + 2)
    line = LAYOUTS["subtrees"](flat) // 8
    first_of_line = inner[(LAYOUTS["subtrees"](flat)[inner] % 8 == 0)]
    for children in (flat.left, flat.right):
        child = children[first_of_line]
        same = line[child] == line[first_of_line]
        assert (same | flat.is_leaf[child]).all()
    assert len(first_of_line) > 100
    for name, size in (("pages", 256), ("subtrees", 4)):
        lines, pages = LAYOUTS[name](flat)[inner] // 2, -(-len(inner) // size)
        assert lines.max() // size + 1 <= (pages + 1 if name == "pages" else len(inner))
    below = [len(np.unique(LAYOUTS[name](flat)[inner])) for name in LAYOUTS]
    assert below == [len(inner)] * len(LAYOUTS)


def van_emde_boas(flat, roots: list[int], levels: int) -> list[int]:
    """The recursive definition: inner nodes of the subtrees below some roots, cut off after so many levels."""
    found = []
    for root in roots:
        if flat.is_leaf[root]:
            continue
        if levels == 1:
            found.append(root)
            continue
        upper, below = levels // 2, [root]
        for _ in range(upper):
            below = [child for node in below if not flat.is_leaf[node] for child in (flat.left[node], flat.right[node])]
        found += van_emde_boas(flat, [root], upper) + van_emde_boas(flat, below, levels - upper)
    return found


def test_the_recursive_order(scene):
    """The order of van Emde Boas is that of its recursive definition."""
    flat = unpack(scene.tree)
    inner = np.flatnonzero(~flat.is_leaf)
    place = LAYOUTS["van_emde_boas"](flat)
    expected = van_emde_boas(flat, [0], int(flat.depth[inner].max()) + 1)
    assert inner[np.argsort(place[inner])].tolist() == expected


@pytest.mark.parametrize("layout", [name for name in LAYOUTS if name != "depth_first"])
def test_a_scene_has_its_layout(layout, tmp_path):
    """Hits of every traversal are those of brute force, counts and updates those of the builder's order; files keep it."""
    mesh = SCENES["random_triangles"]()
    made = wrt.Scene(mesh, wrt.KdTree(layout=layout), device="cpu", num_threads=2)
    made.save(tmp_path / "scene.npz")
    loaded = wrt.Scene.load(tmp_path / "scene.npz", device="cpu")
    assert loaded.tree.layout == layout == loaded.state.accelerator.layout
    np.testing.assert_array_equal(loaded.tree.pairs.numpy(), made.tree.pairs.numpy())
    assert made.tree.pairs.ptr % 64 == loaded.tree.pairs.ptr % 64 == 0
    plain = wrt.Scene(mesh, wrt.KdTree(), device="cpu")
    np.testing.assert_array_equal(made.tree.nodes.numpy(), plain.tree.nodes.numpy())
    assert made.tree.bytes > plain.tree.bytes
    rng = np.random.default_rng(3)
    origins, targets = rng.random((2, 2000, 3)) * 1.2
    brute = plain.intersect(origins, targets - origins, traversal="brute")
    for scene in (made, loaded):
        for count in (2000, 5):  # many rays, and a prepared query
            hits = scene.intersect(origins[:count], (targets - origins)[:count], traversal="single")
            np.testing.assert_array_equal(hits.t, brute.t[:count])
            np.testing.assert_array_equal(hits.primitive_id, brute.primitive_id[:count])
        dark = scene.occluded(origins, targets - origins, traversal="single")
        np.testing.assert_array_equal(dark, brute.is_hit)
    np.testing.assert_array_equal(made.count(origins, targets - origins), plain.count(origins, targets - origins))
    made.update(0, vertices=mesh.vertices * [1.0, 1.1, 0.9])
    hits, brute = (made.intersect(origins, targets - origins, traversal=way) for way in ("single", "brute"))
    np.testing.assert_array_equal(hits.t, brute.t)
    assert made.tree.layout == layout


def test_pairs_in_files_are_checked(scene):
    """Nodes in pairs that are not the tree's are refused: kernels follow their indices unchecked."""
    tree = with_layout(scene.tree, "breadth_first")
    check_tree(tree, scene.triangle_count)
    for at, value in ((1, 1 << 30), (1, 8 << 2), (5, 3), (4, 7)):
        pairs = tree.pairs.numpy().copy()
        pairs.ravel()[at] = value
        with pytest.raises(ValueError, match="pair"):
            check_tree(replace(tree, pairs=wp.array(pairs, dtype=wp.vec2i, device="cpu")), scene.triangle_count)
    with pytest.raises(ValueError, match="'lazy' does not support layout='pages'"):
        wrt.KdTree(builder="lazy", layout="pages")
    with pytest.raises(ValueError, match="layout 'none such' is unknown; choose from random"):
        wrt.KdTree(layout="none such")


def test_a_leaf_and_an_unknown_layout():
    leaf = wrt.Scene(SCENES["teapot"](), wrt.KdTree(builder="binned", max_depth=0), device="cpu").tree
    for layout in LAYOUTS:
        np.testing.assert_array_equal(lay_out(leaf, layout).nodes.numpy()[0], leaf.nodes.numpy()[0])
    with pytest.raises(ValueError, match="choose from random, breadth_first"):
        lay_out(leaf, "none such")


def test_cost_of_allocations(scene):
    """Nodes in larger records are the same tree; the bytes are those of the records."""
    mesh = scene.meshes[0]
    figures = compare_allocations(mesh, builder="binned", width=8, rounds=1, size=8)
    assert [row.layout.split(", ")[1] for row in figures[:3]] == list(ALLOCATIONS)
    assert figures[0].node_bytes == 7 * figures[2].node_bytes
    assert figures[0].ratios == {"near": 1.0, "random": 1.0}
    rays = to_device(Rays(np.zeros((64, 3)), np.random.default_rng(2).normal(size=(64, 3))), scene.device, scene.center)
    tree = lay_out(scene.tree, "random")
    found = [
        trace_placed(scene, in_records(tree, words), rays, SingleConfig(pair_words=words)).t.numpy()
        for words in ALLOCATIONS.values()
    ]
    np.testing.assert_array_equal(found[0], found[2])
    np.testing.assert_array_equal(found[1], found[2])


def test_cost_of_a_step(scene):
    """Figures of every layout, for both kinds of rays."""
    figures = compare_layouts(scene.meshes[0], builder="binned", width=8, rounds=1, size=8)
    assert [row.layout for row in figures] == list(LAYOUTS)
    for row in figures:
        assert set(row.step_ns) == set(row.ratios) == {"near", "random"}
        assert all(0.0 < step < 1e6 for step in row.step_ns.values())
        assert row.node_bytes % 64 == 0


def read_compact(words: np.ndarray, index: int, height: int):
    """(axis, position or first block, triangles, lower child) of the node at a word, by the text of the layout."""
    half = 1 << height
    subtree, at = divmod(int(index), 2 * half)
    if at >= half and words[index] >= 0:
        subtree, at = int(words[index]), 1
    begin = subtree * 2 * half
    axis = int(words[begin].view(np.uint32)) >> 2 * at & 3
    if at < half and axis != 3:
        return axis, words[begin + at], 0, begin + 2 * at
    while at < half:
        at *= 2
    first, triangles = ~words[begin + at] >> 6, ~words[begin + at] & 63
    if triangles == 63:
        first, triangles = words[2 * first], words[2 * first + 1] >> 2
    return 3, first, triangles, -1


@pytest.mark.parametrize(
    ("name", "most"),
    [("teapot", {}), ("random_triangles", {"max_depth": 4}), ("random_triangles", {"max_depth": 0})],
    ids=["short leaves", "long leaves", "one leaf"],
)
@pytest.mark.parametrize("height", HEIGHTS)
def test_compact_subtrees_are_the_same_tree(height, name, most):
    """Followed from the root on, nodes are equal one by one, also where leaves have more triangles than a word can tell."""
    scene = wrt.Scene(SCENES[name](), wrt.KdTree(builder="binned", width=8, **most), device="cpu")
    tree = to_compact(scene.tree, height)
    words, flat, original = tree.nodes.numpy().reshape(-1), unpack(scene.tree), scene.tree.nodes.numpy()
    assert tree.nodes.ptr % 64 == 0
    assert (flat.triangles.max() >= 63) == bool(most)
    stack, seen = [(0, 1)], 0
    while stack:
        node, index = stack.pop()
        seen += 1
        axis, value, triangles, lower = read_compact(words, index, height)
        assert axis == flat.axis[node]
        if axis == 3:
            assert triangles == flat.triangles[node]
            assert value == flat.first_block[node] or triangles == 0
        else:
            assert value == original[node, 0]
            stack += [(flat.left[node], lower), (flat.right[node], lower + 1)]
    assert seen == len(original)

    rng = np.random.default_rng(4)
    low, high = scene.bounds
    origins, targets = low + (high - low) * (1.2 * rng.random((2, 700, 3)) - 0.1)
    rays = to_device(Rays(origins, targets - origins), scene.device, scene.center)
    brute = scene.intersect(origins, targets - origins, traversal="brute")
    hits = trace_placed(scene, tree, rays, SingleConfig(compact=height), CLOSEST)
    np.testing.assert_array_equal(hits.t.numpy().view(np.int32), brute.t.view(np.int32))
    np.testing.assert_array_equal(hits.primitive.numpy(), brute.primitive_id)
    np.testing.assert_array_equal(hits.uv.numpy(), brute.uv)
    if height == 3:
        dark = trace_placed(scene, tree, rays, SingleConfig(compact=height), ANY)
        np.testing.assert_array_equal(dark.occluded.numpy(), brute.is_hit)
    assert 0.05 < brute.is_hit.mean() < 1.0


def test_memory_of_compact_subtrees(scene):
    """Lines without indices are fewer than those with, although not all are full; an unknown height is refused."""
    deep = wrt.Scene(scene.meshes[0], wrt.KdTree(builder="binned", width=1, block_cost=1.5), device="cpu").tree
    assert to_compact(deep, 3).nodes.shape[0] < 0.9 * lay_out(deep, "subtrees").nodes.shape[0]
    with pytest.raises(ValueError, match="height is 5; choose from 2, 3, 4"):
        to_compact(deep, 5)


def test_cost_of_indices(scene):
    """Figures of nodes with and without indices."""
    figures = compare_compact(scene.meshes[0], builder="binned", width=8, rounds=1, size=8)
    assert [row.layout for row in figures][2:] == ["compact, 32 bytes", "compact, 64 bytes", "compact, 128 bytes"]
    assert figures[0].ratios == {"near": 1.0, "random": 1.0}
    assert {row.nodes for row in figures} == {scene.tree.nodes.shape[0]}
    assert figures[1].node_bytes > figures[3].node_bytes > figures[2].node_bytes

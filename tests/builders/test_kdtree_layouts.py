"""Orders of a tree's nodes: the same tree in each, and the same hits."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import SCENES

import wrt
from wrt.bench.studies.kdtrees.layout_comparison import compare_layouts, trace_pairs
from wrt.builders.convert.node_layouts import LAYOUTS, lay_out
from wrt.builders.kdtree.kdtree_statistics import unpack
from wrt.rays.ray_buffers import to_device
from wrt.rays.rays import Rays


@pytest.fixture(scope="module")
def scene() -> wrt.Scene:
    return wrt.Scene(SCENES["wood"](), wrt.KdTree(builder="binned", width=8), device="cpu")


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
    hits = trace_pairs(scene, tree, to_device(Rays(origins, targets - origins), scene.device, scene.center))
    expected = scene.intersect(origins, targets - origins, traversal="single")
    np.testing.assert_array_equal(hits.t.numpy(), expected.t)
    np.testing.assert_array_equal(hits.primitive.numpy(), expected.primitive_id)
    assert 0.05 < expected.is_hit.mean() < 1.0


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
    below = [len(np.unique(LAYOUTS[name](flat)[inner])) for name in LAYOUTS]
    assert below == [len(inner)] * len(LAYOUTS)


def test_a_leaf_and_an_unknown_layout():
    leaf = wrt.Scene(SCENES["teapot"](), wrt.KdTree(builder="binned", max_depth=0), device="cpu").tree
    for layout in LAYOUTS:
        np.testing.assert_array_equal(lay_out(leaf, layout).nodes.numpy()[0], leaf.nodes.numpy()[0])
    with pytest.raises(ValueError, match="choose from random, breadth_first"):
        lay_out(leaf, "none such")


def test_cost_of_a_step(scene):
    """Figures of every layout, for both kinds of rays."""
    figures = compare_layouts(scene.meshes[0], builder="binned", width=8, rounds=1, size=8)
    assert [row.layout for row in figures] == list(LAYOUTS)
    for row in figures:
        assert set(row.step_ns) == set(row.ratios) == {"near", "random"}
        assert all(0.0 < step < 1e6 for step in row.step_ns.values())
        assert row.node_bytes % 64 == 0

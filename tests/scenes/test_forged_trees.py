"""Trees and graphs that somebody made by hand: what a file may hold beyond single changed numbers.

Kernels follow the indices of a tree unchecked, with a stack of fixed depth, so whatever leads out of it is refused before.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

import wrt
from wrt.builders.tree_check import check_tree
from wrt.kernels.layout.kdtree_nodes import LEAF, MAX_TREE_DEPTH
from wrt.meshes.node_graph import NOWHERE
from wrt.scene.storage import NODE_FIELDS, graph_of


@pytest.fixture(scope="module")
def tree():
    """A kd-tree with its nodes in pairs, too."""
    return wrt.Scene(wrt.scenes.build("teapot", level=2), wrt.KdTree(layout="pages"), device="cpu").tree


def chain(depth: int) -> np.ndarray:
    """(2 depth + 1, 2) int32: inner nodes one below the other, each with a leaf of its own as its right child."""
    inner = [[0, (2 * depth - i) << 2] for i in range(depth)]
    return np.array(inner + [[0, LEAF]] * (depth + 1), dtype=np.int32)


def test_the_depth_of_a_path_is_bounded(tree):
    """A tree that is right in all else, one level deeper than stacks: no node is reached twice, no index is out of range."""
    for depth, fits in ((MAX_TREE_DEPTH, True), (MAX_TREE_DEPTH + 1, False)):
        forged = replace(tree, pairs=None, nodes=wp.array(chain(depth), dtype=wp.vec2i, device="cpu"))
        if fits:
            check_tree(forged, 1 << 20)
        else:
            with pytest.raises(ValueError, match=f"deeper than {MAX_TREE_DEPTH}"):
                check_tree(forged, 1 << 20)


def inner_pair(tree) -> int:
    """The place in pairs of an inner node that is not the root."""
    axis = tree.pairs.numpy()[:, 1] & 3
    return int(np.flatnonzero(axis[2:] != LEAF)[0]) + 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda pairs, at: pairs[: len(pairs) // 2], "does not exist"),
        (lambda pairs, at: np.where(np.arange(len(pairs))[:, None] == [-1, 0], -5 << 2, pairs), "does not exist"),
        (lambda pairs, at: put(pairs, at, 0, 7), "not those of the tree"),
        (lambda pairs, at: put(pairs, at, 1, LEAF), "not those of the tree"),
    ],
    ids=["cut short", "negative", "another plane", "a leaf"],
)
def test_pairs_are_those_of_the_tree(tree, change, message):
    """Nodes in pairs are a second copy of the tree, which kernels follow in its place."""
    check_tree(tree, 1 << 20)
    pairs = change(tree.pairs.numpy().copy(), inner_pair(tree)).astype(np.int32)
    with pytest.raises(ValueError, match=message):
        check_tree(replace(tree, pairs=wp.array(pairs, dtype=wp.vec2i, device="cpu")), 1 << 20)


def put(pairs: np.ndarray, row: int, column: int, value: int) -> np.ndarray:
    pairs[row, column] = value
    return pairs


GRAPH = {
    "parents": np.array([NOWHERE, 0, 1]),
    "local": np.tile(np.eye(4), (3, 1, 1)),
    "node_of": np.array([2, NOWHERE]),
}


@pytest.mark.parametrize(
    ("field", "place", "value"),
    [("parents", 1, 1), ("parents", 2, 3), ("parents", 0, -2), ("node_of", 0, 3), ("node_of", 1, -2)],
)
def test_numbers_of_nodes_are_in_range(field, place, value):
    """A node after its parent, instances on nodes that exist: a negative number would have counted from the end, silently."""
    arrays = {f"nodes.{name}": GRAPH[name].copy() for name in NODE_FIELDS}
    graph = graph_of(["a", "b", "c"], arrays, 2)
    assert graph.node_of.tolist() == [2, NOWHERE]
    arrays[f"nodes.{field}"][place] = value
    with pytest.raises(ValueError, match="out of range"):
        graph_of(["a", "b", "c"], arrays, 2)

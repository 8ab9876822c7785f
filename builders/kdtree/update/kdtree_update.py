"""A kd-tree over moved triangles: refill, measure, and rebuild parts (`wrt.builders.rebuild_heuristic`).

**Subtrees** are replaced by rebuilt ones (Yang, Xu and Zhao 2008: the whole tree, or a subtree; `replace_subtrees`). The
triangles of a subtree are those in its leaves, with their boxes clamped to its cell. Nodes are in depth-first order
(`wrt.kernels.layout.kdtree_nodes`), so a subtree is a contiguous range of them. The new tree concatenates the ranges between
the replaced subtrees and the new subtrees.

References: yang-2008 (as described by rahikainen-2013); rahikainen-2013.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial

import numpy as np
import warp as wp

from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.kdtree_statistics import UnpackedKdTree, unpack
from wrt.builders.kdtree.update.refill import child_probabilities, node_costs, refill
from wrt.builders.leaf_blocks import gather_blocks
from wrt.builders.rebuild_heuristic import Part, degraded_subtrees
from wrt.builders.tree import MAX_GROWTH, BuildStats, KdTree
from wrt.builders.triangle_boxes import TriangleBoxes, boxes_of
from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.layout.kdtree_nodes import MAX_TREE_DEPTH


class RefilledKdTree:
    """The old planes with refilled leaves.

    Args:
        old: the tree before the motion, on the CPU.
        boxes: boxes of the moved triangles.
        shift: (3,) translation of most triangles.
        config: configuration of the tree's build.
        build: (boxes, config) -> tree.

    Attributes:
        tree: the refilled tree; None if its lists would hold more than 64 times the triangles.
    """

    def __init__(
        self,
        old: KdTree,
        boxes: TriangleBoxes,
        shift: np.ndarray,
        config: KdTreeConfig,
        build: Callable[[TriangleBoxes, KdTreeConfig], KdTree],
    ) -> None:
        self.tree = refill(old, boxes, shift, int(MAX_GROWTH + 1) * boxes.count)
        self._boxes, self._config, self._build = boxes, config, build

    @cached_property
    def _flat(self) -> UnpackedKdTree:
        return unpack(self.tree)

    @cached_property
    def costs(self) -> np.ndarray:
        """(nodes,) current cost of each subtree."""
        return node_costs(self._flat, self._config.cost)

    @cached_property
    def _probabilities(self) -> tuple[np.ndarray, np.ndarray]:
        return child_probabilities(self._flat)

    def children(self, node: int) -> tuple[np.ndarray, np.ndarray]:
        """The children of a node, and the probability that a ray that meets the node meets each; empty for a leaf."""
        flat, (left, right) = self._flat, self._probabilities
        if flat.is_leaf[node]:
            return np.empty(0, dtype=np.int64), np.empty(0)
        return np.array([flat.left[node], flat.right[node]]), np.array([left[node], right[node]])

    def parts(self, built: np.ndarray, tolerance: float) -> list[Part]:
        """The parts to rebuild, one node each; arguments as in `degraded_subtrees`."""
        listed = partial(subtree_triangles, self.tree, self._flat)
        return degraded_subtrees(self.costs, built, self.children, tolerance, triangles=listed)

    def triangles(self, part: Part) -> np.ndarray:
        """Ids of the triangles in the leaves below a node."""
        (node,) = part
        return subtree_triangles(self.tree, self._flat, node)

    def with_rebuilt(self, chosen: Sequence[Part], ids: Sequence[np.ndarray]) -> tuple[KdTree, np.ndarray]:
        """The tree with some subtrees rebuilt, and its nodes' old numbers.

        Args:
            chosen: parts of one node each, other than the root.
            ids: the triangles of each part.
        """
        low, high = self._boxes.boxes.low.numpy().T, self._boxes.boxes.high.numpy().T
        automatic = self._config.stop.limits(self._boxes.count).depth
        subtrees = {}
        for (node,), own in zip(chosen, ids, strict=True):
            room = min(MAX_TREE_DEPTH, max(automatic, 1)) - int(self._flat.depth[node])
            stop = replace(self._config.stop, max_depth=max(room, 0))
            config = replace(self._config, stop=stop)
            subtrees[node] = build_subtree(own, self._flat, node, low, high, lambda boxes, c=config: self._build(boxes, c))
        return replace_subtrees(self.tree, self._flat, subtrees)


Build = Callable[[TriangleBoxes], KdTree]


def subtree_end(flat: UnpackedKdTree, node: int) -> int:
    """One past the last node of a subtree."""
    while not flat.is_leaf[node]:
        node = int(flat.right[node])
    return node + 1


def subtree_triangles(tree: KdTree, flat: UnpackedKdTree, node: int) -> np.ndarray:
    """Ids of the triangles in a subtree's leaves, each once, in order."""
    own = np.arange(node, subtree_end(flat, node))
    own = own[flat.is_leaf[own]]
    lists, _ = gather_blocks(tree.primitive.numpy(), tree.width, flat.first_block[own], -(-flat.triangles[own] // tree.width))
    listed = np.zeros(lists.max(initial=-1) + 1, dtype=bool)
    listed[lists[lists >= 0]] = True
    return np.flatnonzero(listed)


def build_subtree(ids: np.ndarray, flat: UnpackedKdTree, node: int, low: np.ndarray, high: np.ndarray, build: Build) -> KdTree:
    """A tree over the cell's box for the triangles `ids` of a subtree. low, high: (T, 3) float32 boxes of all triangles."""
    cell = flat.low[node].astype(np.float32), flat.high[node].astype(np.float32)
    own = boxes_of(np.maximum(low[ids], cell[0]), np.minimum(high[ids], cell[1]))
    tree = build(replace(own, low=cell[0], high=cell[1]))
    lists = tree.primitive.numpy()
    numbers = np.where(lists >= 0, ids[lists], -1).astype(np.int32)
    return replace(tree, primitive=wp.array(numbers, dtype=int, device=tree.primitive.device))


def replace_subtrees(tree: KdTree, flat: UnpackedKdTree, subtrees: Mapping[int, KdTree]) -> tuple[KdTree, np.ndarray]:
    """Replaces some subtrees of a tree. No replaced node is below another.

    Args:
        tree: the tree.
        flat: its nodes as arrays.
        subtrees: the replacement of each node.

    Returns:
        The new tree, and for each of its nodes the number of the old node that it is, -1 for a node of a replacement.
    """
    pieces, origin, moved_to = [], [], np.zeros(len(flat.axis), dtype=np.int64)
    lists, block_base, begin, total = [tree.primitive.numpy()], len(tree.primitive) // tree.width, 0, 0
    words = tree.nodes.numpy().copy()
    for node in (*sorted(subtrees), len(words)):
        pieces.append(words[begin:node])
        origin.append(np.arange(begin, node))
        moved_to[begin:node] = total + np.arange(node - begin)
        total += node - begin
        if node == len(words):
            break
        new = subtrees[node].nodes.numpy().copy()
        leaf = new[:, 1] & 3 == kdtree.LEAF
        new[leaf, 0] += block_base
        new[~leaf, 1] += total << 2
        pieces.append(new)
        origin.append(np.full(len(new), -1))
        lists.append(subtrees[node].primitive.numpy())
        moved_to[node], total = total, total + len(new)
        block_base += len(lists[-1]) // tree.width
        begin = subtree_end(flat, node)
    joined, source = np.concatenate(pieces), np.concatenate(origin)
    inner = (source >= 0) & (joined[:, 1] & 3 != kdtree.LEAF)
    joined[inner, 1] = moved_to[joined[inner, 1] >> 2] << 2 | joined[inner, 1] & 3
    leaf = joined[:, 1] & 3 == kdtree.LEAF
    blocks = -(-(joined[leaf, 1] >> 2) // tree.width)
    primitive, joined[leaf, 0] = gather_blocks(np.concatenate(lists), tree.width, joined[leaf, 0], blocks)
    device = tree.nodes.device
    nodes, primitive = wp.array(joined, dtype=wp.vec2i, device=device), wp.array(primitive, dtype=int, device=device)
    stats = BuildStats(dict(tree.stats.seconds))
    stats.reserve(nodes, primitive)
    return replace(tree, nodes=nodes, primitive=primitive, stats=stats), source

"""A kd-tree over moved triangles: refill, measure, and rebuild parts (`wrt.builders.rebuild_heuristic`)."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, partial

import numpy as np

from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.kdtree_statistics import UnpackedKdTree, unpack
from wrt.builders.kdtree.update.refill import child_probabilities, node_costs, refill
from wrt.builders.kdtree.update.subtree_exchange import build_subtree, replace_subtrees, subtree_triangles
from wrt.builders.rebuild_heuristic import Part, degraded_subtrees
from wrt.builders.tree import MAX_GROWTH, KdTree
from wrt.builders.triangle_boxes import TriangleBoxes
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

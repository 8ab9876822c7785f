"""A kd-tree whose triangles have moved: refilled, then measured, and built again in parts
(`wrt.builders.rebuild_heuristic`)."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, partial

import numpy as np

from wrt.builders.kdtree.kdtree_config import KdTreeConfig
from wrt.builders.kdtree.kdtree_statistics import UnpackedKdTree, unpack
from wrt.builders.kdtree.update.refill import child_probabilities, node_costs, refill
from wrt.builders.kdtree.update.subtree_exchange import build_subtree, exchange, subtree_triangles
from wrt.builders.rebuild_heuristic import Part, worn_subtrees
from wrt.builders.tree import MAX_GROWTH, KdTree
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.layout.kdtree_nodes import MAX_TREE_DEPTH


class MovedKdTree:
    """The old planes with moved triangles between them.

    Args:
        old: the tree before, on the CPU.
        boxes: where the triangles are now.
        shift: (3,) by how much most triangles have moved.
        config: as the tree was built.
        build: (boxes, config) -> tree.

    Attributes:
        tree: None if its lists would hold more than 64 times the triangles.
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
        """(nodes,) what each subtree costs now."""
        return node_costs(self._flat, self._config.cost)

    @cached_property
    def _probabilities(self) -> tuple[np.ndarray, np.ndarray]:
        return child_probabilities(self._flat)

    def children(self, node: int) -> tuple[np.ndarray, np.ndarray]:
        """The children of a node, and how likely a ray that meets it meets each; none of a leaf."""
        flat, (left, right) = self._flat, self._probabilities
        if flat.is_leaf[node]:
            return np.empty(0, dtype=np.int64), np.empty(0)
        return np.array([flat.left[node], flat.right[node]]), np.array([left[node], right[node]])

    def parts(self, built: np.ndarray, tolerance: float) -> list[Part]:
        """What to build again, of one node each; arguments as of `worn_subtrees`."""
        listed = partial(subtree_triangles, self.tree, self._flat)
        return worn_subtrees(self.costs, built, self.children, tolerance, triangles=listed)

    def triangles(self, part: Part) -> np.ndarray:
        """Ids of the triangles in the leaves below a node."""
        (node,) = part
        return subtree_triangles(self.tree, self._flat, node)

    def with_rebuilt(self, chosen: Sequence[Part], ids: Sequence[np.ndarray]) -> tuple[KdTree, np.ndarray]:
        """The tree with some subtrees built again, and its nodes' old numbers.

        Args:
            chosen: their nodes, one each, not the root.
            ids: the triangles of each.
        """
        low, high = self._boxes.boxes.low.numpy().T, self._boxes.boxes.high.numpy().T
        automatic = self._config.stop.limits(self._boxes.count).depth
        subtrees = {}
        for (node,), own in zip(chosen, ids, strict=True):
            room = min(MAX_TREE_DEPTH, max(automatic, 1)) - int(self._flat.depth[node])
            stop = replace(self._config.stop, max_depth=max(room, 0))
            config = replace(self._config, stop=stop)
            subtrees[node] = build_subtree(own, self._flat, node, low, high, lambda boxes, c=config: self._build(boxes, c))
        return exchange(self.tree, self._flat, subtrees)

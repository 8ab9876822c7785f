"""A BVH whose triangles have moved: refitted, then measured, and built again in parts (`wrt.builders.worn_subtrees`)."""

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
import warp as wp

from wrt.builders.bvh.grafting import build_subtree, graft, subtree_triangles
from wrt.builders.bvh.node_costs import node_costs
from wrt.builders.bvh.refit import refit
from wrt.builders.bvh.statistics import half_area
from wrt.builders.common import Bvh
from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.triangles import TriangleBoxes
from wrt.kernels.bvh import MAX_WIDE_DEPTH


class MovedBvh:
    """The old nodes round moved triangles.

    Args:
        old: the tree before.
        vertices, faces: where the triangles are now, on the tree's device.
        boxes: makes their boxes, on the CPU.
        cost: by which the tree was built.
        build: boxes -> tree.
    """

    def __init__(
        self,
        old: Bvh,
        vertices: wp.array,
        faces: wp.array,
        boxes: Callable[[], TriangleBoxes],
        cost: SurfaceAreaCost,
        build: Callable[[TriangleBoxes], Bvh],
    ) -> None:
        self.tree = refit(old, vertices, faces)
        self._boxes, self._cost, self._build = boxes, cost, build

    @cached_property
    def costs(self) -> np.ndarray:
        """(nodes,) what each subtree costs now."""
        return node_costs(self.tree, self._cost)

    @cached_property
    def _lanes(self) -> tuple[np.ndarray, np.ndarray]:
        """(nodes, W) child words, and (nodes, 2, 3, W) corners of their boxes."""
        bounds = self.tree.bounds.numpy().reshape(-1, 2, 3, self.tree.width)
        child = self.tree.child.numpy().reshape(-1, self.tree.width)
        return child, bounds

    def children(self, node: int) -> tuple[np.ndarray, np.ndarray]:
        """The inner children of a node, and how likely a ray that meets it meets each."""
        child, bounds = self._lanes
        low, high = bounds[node].transpose(0, 2, 1)
        inner = child[node] >= 0
        area = half_area(low.min(axis=0), high.max(axis=0))
        probability = half_area(low[inner], high[inner]) / area if area > 0.0 else np.ones(int(inner.sum()))
        return child[node][inner], probability

    def triangles(self, node: int) -> np.ndarray:
        """Ids of the triangles below a node."""
        return subtree_triangles(self.tree, node)

    def with_rebuilt(self, chosen: Sequence[int], ids: Sequence[np.ndarray]) -> tuple[Bvh, np.ndarray] | None:
        """The tree with some subtrees built again, and its nodes' old numbers; None if it became too deep.

        Args:
            chosen: their nodes, not the root.
            ids: the triangles of each.
        """
        boxes = self._boxes().boxes
        low, high = boxes.low.numpy().T, boxes.high.numpy().T
        subtrees = {node: build_subtree(own, low, high, self._build) for node, own in zip(chosen, ids, strict=True)}
        depth = np.searchsorted(self.tree.level_first, chosen, side="right") - 1
        if max(int(at) + subtree.depth for at, subtree in zip(depth, subtrees.values(), strict=True)) > MAX_WIDE_DEPTH:
            return None
        return graft(self.tree, subtrees)

"""A BVH whose triangles have moved: refitted, then measured, and built again in parts (`wrt.builders.rebuild_heuristic`)."""

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
import warp as wp

from wrt.builders.bvh.bvh_statistics import half_area
from wrt.builders.bvh.update.bvh_grafting import build_subtree, graft, subtree_triangles
from wrt.builders.bvh.update.node_costs import node_costs
from wrt.builders.bvh.update.refit import refit
from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.rebuild_heuristic import Part, worn_subtrees
from wrt.builders.tree import Bvh
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.layout.bvh_nodes import EMPTY_LANE, MAX_WIDE_DEPTH


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

    def parts(self, built: np.ndarray, tolerance: float) -> list[Part]:
        """What to build again; arguments as of `worn_subtrees`."""
        return worn_subtrees(self.costs, built, self.children, tolerance, together=self.together)

    def together(self, node: int, siblings: np.ndarray, built: np.ndarray) -> float:
        """What some inner children would add to the cost of their node as one subtree; inf if there are no others.

        The rays that meet the box round all of them take one more step. How their triangles will share that box is not known
        yet. k boxes that fill another evenly have the cube root of k times its area between them: so many of the children does
        a ray meet, at what one cost on average when it was built.
        """
        child, bounds = self._lanes
        if len(siblings) == np.count_nonzero(child[node] != EMPTY_LANE):
            return np.inf
        low, high = bounds[node].transpose(0, 2, 1)
        own, area = np.isin(child[node], siblings), half_area(low.min(axis=0), high.max(axis=0))
        probability = half_area(low[own].min(axis=0), high[own].max(axis=0)) / area if area > 0.0 else 1.0
        return float(probability * (self._cost.traversal + np.cbrt(len(built)) * built.mean()))

    def triangles(self, part: Part) -> np.ndarray:
        """Ids of the triangles below a node, or below some siblings."""
        return np.sort(np.concatenate([subtree_triangles(self.tree, node) for node in part]))

    def with_rebuilt(self, chosen: Sequence[Part], ids: Sequence[np.ndarray]) -> tuple[Bvh, np.ndarray] | None:
        """The tree with some parts built again, and its nodes' old numbers; None if it became too deep.

        Args:
            chosen: none of them the root.
            ids: the triangles of each.
        """
        boxes = self._boxes().boxes
        low, high = boxes.low.numpy().T, boxes.high.numpy().T
        subtrees = {part: build_subtree(own, low, high, self._build) for part, own in zip(chosen, ids, strict=True)}
        depth = np.searchsorted(self.tree.level_first, [part[0] for part in chosen], side="right") - 1
        if max(int(at) + subtree.depth for at, subtree in zip(depth, subtrees.values(), strict=True)) > MAX_WIDE_DEPTH:
            return None
        return graft(self.tree, subtrees)

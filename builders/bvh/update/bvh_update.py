"""A BVH over moved triangles: refit, measure, and rebuild parts (`wrt.builders.rebuild_heuristic`).

**Refit** (`refit`) recomputes the boxes; nodes and leaves stay. Every triangle is read once and every node is written once,
from the deepest level up, in parallel over the nodes of a level; on CUDA by one launch, whose threads go up from nodes without
inner children, and of those that meet in a node the last goes on. The tree stays correct for any motion. Traversal slows down
as triangles that were close when it was built move apart.

References: wald-2007-deformable; lauterbach-2006.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from time import perf_counter

import numpy as np
import warp as wp

from wrt.builders.bvh.bvh_statistics import half_area
from wrt.builders.bvh.update.bvh_grafting import build_subtree, replace_subtrees, subtree_triangles
from wrt.builders.bvh.update.node_costs import node_costs
from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.rebuild_heuristic import Part, degraded_subtrees
from wrt.builders.tree import BuildStats, Bvh
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.layout.bvh_nodes import EMPTY_LANE, MAX_WIDE_DEPTH, first_block, leaf_triangles
from wrt.kernels.runtime.launch import launch, load
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.simd.boxes import INFINITY, max_of, min_of


@wp.func
def leaf_box(
    word: int,
    width: int,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    primitive: wp.array(dtype=int),
):
    """The corners of the box of a leaf."""
    low = wp.vec3(INFINITY, INFINITY, INFINITY)
    high = -low
    begin = first_block(word) * width
    for slot in range(begin, begin + leaf_triangles(word)):
        face = faces[primitive[slot]]
        for corner in range(3):
            point = vertices[face[corner]]
            low = min_of(low, point)
            high = max_of(high, point)
    return low, high


@exact_kernel
def refit_nodes(
    first: int,
    level_first: int,
    width: int,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    child: wp.array(dtype=int),
    primitive: wp.array(dtype=int),
    bounds: wp.array(dtype=float),
):
    """Item: a node of the level, after its inner children. Writes its boxes."""
    node = level_first + first + wp.tid()
    for lane in range(width):
        word = child[node * width + lane]
        low = wp.vec3(INFINITY, INFINITY, INFINITY)
        high = -low
        if word >= 0:
            for other in range(width):
                for axis in range(3):
                    at = (word * 6 + axis) * width + other
                    low[axis] = wp.where(bounds[at] < low[axis], bounds[at], low[axis])
                    at += 3 * width
                    high[axis] = wp.where(bounds[at] > high[axis], bounds[at], high[axis])
        elif word != EMPTY_LANE:
            low, high = leaf_box(word, width, vertices, faces, primitive)
        # adding 0 turns -0 into +0, as in `compute_boxes`
        for axis in range(3):
            bounds[(node * 6 + axis) * width + lane] = low[axis] + 0.0
            bounds[(node * 6 + 3 + axis) * width + lane] = high[axis] + 0.0


@wp.struct
class Upward:
    """How a thread goes up from a node."""

    parent: wp.array(dtype=int)
    """(nodes,) the lane of a node among all lanes; -1 for the root."""
    inner: wp.array(dtype=int)
    """(nodes,) its inner children."""
    arrived: wp.array(dtype=int)
    """(nodes,) those that are done; 0 before and after a launch."""


@exact_kernel
def link_upward(first: int, width: int, child: wp.array(dtype=int), links: Upward):
    """Item: a node."""
    node = first + wp.tid()
    inner = int(0)
    for lane in range(width):
        word = child[node * width + lane]
        if word >= 0:
            links.parent[word] = node * width + lane
            inner += 1
    links.inner[node] = inner
    links.arrived[node] = 0
    if node == 0:
        links.parent[0] = -1


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    __threadfence();
#endif
""")
def fence():
    """What this thread wrote is seen before what it writes from here on."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __ldcg(values.data + i);
#else
    return values.data[i];
#endif
""")
def load_written(values: wp.array(dtype=float), i: int) -> float:
    """values[i], which another thread of the launch may have written."""


@exact_kernel
def refit_upward(
    first: int,
    width: int,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    child: wp.array(dtype=int),
    primitive: wp.array(dtype=int),
    links: Upward,
    bounds: wp.array(dtype=float),
):
    """Item: a node. One without inner children writes its boxes and goes up; of the children of a node the last goes on."""
    node = first + wp.tid()
    going = links.inner[node] == 0
    while going:
        whole_low = wp.vec3(INFINITY, INFINITY, INFINITY)
        whole_high = -whole_low
        for lane in range(width):
            word = child[node * width + lane]
            at = node * 6 * width + lane
            low = wp.vec3(INFINITY, INFINITY, INFINITY)
            high = -low
            if word >= 0:
                for axis in range(3):
                    low[axis] = load_written(bounds, at + axis * width)
                    high[axis] = load_written(bounds, at + (3 + axis) * width)
            else:
                if word != EMPTY_LANE:
                    low, high = leaf_box(word, width, vertices, faces, primitive)
                for axis in range(3):
                    bounds[at + axis * width] = low[axis] + 0.0
                    bounds[at + (3 + axis) * width] = high[axis] + 0.0
            whole_low = min_of(whole_low, low)
            whole_high = max_of(whole_high, high)
        lane_above = links.parent[node]
        going = lane_above >= 0
        if going:
            node = lane_above / width
            at = node * 6 * width + lane_above % width
            for axis in range(3):
                bounds[at + axis * width] = whole_low[axis] + 0.0
                bounds[at + (3 + axis) * width] = whole_high[axis] + 0.0
            fence()
            before = wp.atomic_add(links.arrived, node, 1)
            fence()
            going = before + 1 == links.inner[node]
            if going:
                links.arrived[node] = 0


def upward_links(tree: Bvh) -> Upward:
    """The links of a tree, made once for all trees with these nodes."""
    if tree.upward is None:
        device, nodes = tree.child.device, tree.level_first[-1]
        links = Upward()
        links.parent, links.inner, links.arrived = (wp.empty(nodes, dtype=int, device=device) for _ in range(3))
        launch(link_upward, nodes, [tree.width, tree.child, links], device=device)
        tree.upward = links
    return tree.upward


def refit(tree: Bvh, vertices: wp.array, faces: wp.array) -> Bvh:
    """The same tree around moved vertices. It shares all arrays except the boxes with the old tree, which stays valid.

    Args:
        tree: a tree over the triangles of `faces`.
        vertices: (V,) vec3, finite, on the tree's device.
        faces: (F,) vec3i.
    """
    device = tree.bounds.device
    load([refit_nodes], device)
    start = perf_counter()
    bounds = wp.empty(len(tree.bounds), dtype=float, device=device)
    if device.is_cuda:
        inputs = [tree.width, vertices, faces, tree.child, tree.primitive, upward_links(tree), bounds]
        launch(refit_upward, tree.level_first[-1], inputs, device=device)
    else:
        levels = list(zip(tree.level_first, tree.level_first[1:], strict=False))
        for first, end in reversed(levels):
            inputs = [first, tree.width, vertices, faces, tree.child, tree.primitive, bounds]
            launch(refit_nodes, end - first, inputs, device=device, chunk=64)
    root = bounds[: 6 * tree.width].numpy().reshape(2, 3, tree.width)
    low, high = (wp.vec3(*map(float, corner)) for corner in (root[0].min(axis=1), root[1].max(axis=1)))
    stats = BuildStats({"refit": perf_counter() - start})
    stats.reserve(bounds)
    return Bvh(bounds, tree.child, tree.primitive, low, high, tree.width, tree.level_first, stats, upward=tree.upward)


class RefittedBvh:
    """The refitted nodes of a tree over moved triangles.

    Args:
        old: the tree before the motion.
        vertices, faces: the moved triangles, on the tree's device.
        boxes: returns their boxes, on the CPU.
        cost: the cost model of the tree.
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
        """(nodes,) current cost of each subtree."""
        return node_costs(self.tree, self._cost)

    @cached_property
    def _lanes(self) -> tuple[np.ndarray, np.ndarray]:
        """(nodes, W) child words, and (nodes, 2, 3, W) corners of their boxes."""
        bounds = self.tree.bounds.numpy().reshape(-1, 2, 3, self.tree.width)
        child = self.tree.child.numpy().reshape(-1, self.tree.width)
        return child, bounds

    def children(self, node: int) -> tuple[np.ndarray, np.ndarray]:
        """The inner children of a node, and the probability that a ray that meets the node meets each."""
        child, bounds = self._lanes
        low, high = bounds[node].transpose(0, 2, 1)
        inner = child[node] >= 0
        area = half_area(low.min(axis=0), high.max(axis=0))
        probability = half_area(low[inner], high[inner]) / area if area > 0.0 else np.ones(int(inner.sum()))
        return child[node][inner], probability

    def parts(self, built: np.ndarray, tolerance: float) -> list[Part]:
        """The parts to rebuild; arguments as in `degraded_subtrees`."""
        return degraded_subtrees(self.costs, built, self.children, tolerance, joined_cost=self.joined_cost)

    def joined_cost(self, node: int, siblings: np.ndarray, built: np.ndarray) -> float:
        """Estimated share of a node's cost that some inner children would have as one subtree; inf if there are no others.

        A ray that meets the box around all of them takes one more step. The distribution of their triangles in that box is not
        known yet. k boxes that fill another box evenly have the cube root of k times its area in total, so the estimate assumes
        that a ray meets that many of the children, each at their average cost when built.
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
        """The tree with some parts rebuilt, and its nodes' old numbers; None if it would be too deep.

        Args:
            chosen: parts other than the root.
            ids: the triangles of each part.
        """
        boxes = self._boxes().boxes
        low, high = boxes.low.numpy().T, boxes.high.numpy().T
        subtrees = {part: build_subtree(own, low, high, self._build) for part, own in zip(chosen, ids, strict=True)}
        depth = np.searchsorted(self.tree.level_first, [part[0] for part in chosen], side="right") - 1
        if max(int(at) + subtree.depth for at, subtree in zip(depth, subtrees.values(), strict=True)) > MAX_WIDE_DEPTH:
            return None
        return replace_subtrees(self.tree, subtrees)

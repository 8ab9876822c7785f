"""Statistics of a finished kd-tree: counts, histograms, and its cost by the surface area heuristic.

The expected cost of a ray that hits the root's box (Rahikainen 2013, equation 4.5, with blocks instead of triangles and no cost
for the visit of a leaf):

    sum over inner nodes of C_t SA(i) / SA(root)  +  sum over leaves of C_b blocks(n) SA(l) / SA(root)

References: macdonald-booth-1990; rahikainen-2013.
"""

from dataclasses import dataclass

import numpy as np

from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.tree import KdTree
from wrt.kernels.layout import kdtree_nodes as kdtree

LEAF = 3


@dataclass(frozen=True)
class KdTreeStatistics:
    """Statistics of a kd-tree.

    Attributes:
        nodes: inner nodes and leaves.
        leaves: leaves, including empty ones.
        empty_leaves: leaves without triangles.
        references: entries of all leaf lists.
        duplication: references per triangle.
        block_fill: share of the lanes of all blocks that hold a triangle.
        depth_histogram: number of leaves by depth, from 0.
        leaf_size_histogram: number of leaves by number of triangles, from 0.
        sah_cost: expected cost of a ray, see the module's docstring.
    """

    nodes: int
    leaves: int
    empty_leaves: int
    references: int
    duplication: float
    block_fill: float
    depth_histogram: np.ndarray
    leaf_size_histogram: np.ndarray
    sah_cost: float

    @property
    def max_depth(self) -> int:
        """Depth of the deepest leaf."""
        return len(self.depth_histogram) - 1


@dataclass(frozen=True)
class UnpackedKdTree:
    """The nodes of a tree as separate arrays on the host, one entry per node.

    Attributes:
        axis: 0, 1, 2, or 3 for a leaf.
        position: position of the splitting plane; 0 for a leaf.
        left, right: children; -1 for a leaf.
        first_block, triangles: first block and number of triangles of a leaf; 0 for an inner node.
        depth: depth of the node.
        low, high: (nodes, 3) float64, its box. A plane outside the box (`wrt.builders.kdtree.update.refill`) cuts off nothing.
    """

    axis: np.ndarray
    position: np.ndarray
    left: np.ndarray
    right: np.ndarray
    first_block: np.ndarray
    triangles: np.ndarray
    depth: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @property
    def is_leaf(self) -> np.ndarray:
        """(nodes,) bool."""
        return self.axis == LEAF


def unpack(tree: KdTree) -> UnpackedKdTree:
    """Unpacks a tree into arrays on the host, level by level."""
    words = tree.nodes.numpy()
    count = len(words)
    axis, payload = words[:, 1] & 3, words[:, 1] >> 2
    leaf = axis == LEAF
    low, high = np.empty((count, 3)), np.empty((count, 3))
    low[0], high[0] = tree.low, tree.high
    depth = np.zeros(count, dtype=np.int32)
    position = np.where(leaf, 0.0, words[:, 0].view(np.float32)).astype(np.float64)
    left = np.where(leaf, -1, np.arange(1, count + 1))
    right = np.where(leaf, -1, payload)
    level = np.zeros(1, dtype=np.int64)
    for step in range(1, kdtree.MAX_TREE_DEPTH + 1):
        inner = level[~leaf[level]]
        if len(inner) == 0:
            break
        for child, moved in ((left[inner], high), (right[inner], low)):
            low[child], high[child], depth[child] = low[inner], high[inner], step
            moved[child, axis[inner]] = np.clip(position[inner], low[inner, axis[inner]], high[inner, axis[inner]])
        level = np.concatenate([left[inner], right[inner]])
    return UnpackedKdTree(
        axis, position, left, right, np.where(leaf, words[:, 0], 0), np.where(leaf, payload, 0), depth, low, high
    )


def half_area(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Half the surface area of boxes (..., 3)."""
    x, y, z = np.moveaxis(high - low, -1, 0)
    return x * y + y * z + z * x


def kdtree_statistics(tree: KdTree, triangle_count: int, cost: SurfaceAreaCost) -> KdTreeStatistics:
    """Measures a tree.

    Args:
        tree: the tree.
        triangle_count: triangles of the mesh.
        cost: the cost model of its build.
    """
    flat = unpack(tree)
    leaf = flat.is_leaf
    sizes = flat.triangles[leaf]
    area = half_area(flat.low, flat.high)
    weights = np.where(leaf, cost.of_leaf(flat.triangles), cost.traversal)
    return KdTreeStatistics(
        nodes=len(leaf),
        leaves=int(leaf.sum()),
        empty_leaves=int((sizes == 0).sum()),
        references=int(sizes.sum()),
        duplication=float(sizes.sum() / triangle_count),
        block_fill=float(sizes.sum() / max(len(tree.primitive), 1)),
        depth_histogram=np.bincount(flat.depth[leaf]),
        leaf_size_histogram=np.bincount(sizes),
        sah_cost=float((weights * area).sum() / area[0]) if area[0] > 0 else float(weights.sum()),
    )

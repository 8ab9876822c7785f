"""Statistics of a finished bounding volume hierarchy: counts, histograms, and its cost by the surface area heuristic.

The expected cost of a ray that hits the root's box:

    sum over nodes of C_t SA(i) / SA(root)  +  sum over leaves of C_b blocks(n) SA(l) / SA(root)

References: goldsmith-salmon-1987.
"""

from dataclasses import dataclass

import numpy as np

from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.tree import Bvh
from wrt.kernels.layout.bvh_nodes import EMPTY_LANE


@dataclass(frozen=True)
class BvhStatistics:
    """Statistics of a bounding volume hierarchy.

    Attributes:
        nodes: inner nodes.
        leaves: leaves.
        node_fill: share of the lanes of all nodes that hold a child.
        block_fill: share of the lanes of all blocks that hold a triangle.
        depth_histogram: number of leaves by the number of inner nodes above them, from 0.
        leaf_size_histogram: number of leaves by number of triangles, from 0.
        sah_cost: expected cost of a ray, see the module's docstring.
        duplication: references in leaves per triangle: 1 without spatial splits.
    """

    nodes: int
    leaves: int
    node_fill: float
    block_fill: float
    depth_histogram: np.ndarray
    leaf_size_histogram: np.ndarray
    sah_cost: float
    duplication: float

    @property
    def max_depth(self) -> int:
        """Number of inner nodes above the deepest leaf."""
        return len(self.depth_histogram) - 1


@dataclass(frozen=True)
class UnpackedBvh:
    """The lanes of a tree as separate arrays on the host.

    Attributes:
        child: (nodes, W) child words.
        is_leaf, is_inner: (nodes, W) bool; a lane for which both are false is unused.
        first_block, triangles: (nodes, W) first block and number of triangles of a leaf; 0 in other lanes.
        low, high: (nodes, W, 3) float32 boxes of the lanes.
        depth: (nodes,) number of inner nodes above.
    """

    child: np.ndarray
    is_leaf: np.ndarray
    is_inner: np.ndarray
    first_block: np.ndarray
    triangles: np.ndarray
    low: np.ndarray
    high: np.ndarray
    depth: np.ndarray


def unpack(tree: Bvh) -> UnpackedBvh:
    """Unpacks a tree into arrays on the host."""
    width = tree.width
    child = tree.child.numpy().reshape(-1, width)
    bounds = tree.bounds.numpy().reshape(-1, 2, 3, width).transpose(1, 0, 3, 2)
    inner = child >= 0
    leaf = ~inner & (child != EMPTY_LANE)
    depth = np.repeat(np.arange(tree.depth), np.diff(tree.level_first))
    return UnpackedBvh(
        child, leaf, inner, np.where(leaf, ~child >> 6, 0), np.where(leaf, ~child & 63, 0), bounds[0], bounds[1], depth
    )


def half_area(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Half the surface area of boxes (..., 3), in float64."""
    x, y, z = np.moveaxis(high.astype(np.float64) - low, -1, 0)
    return x * y + y * z + z * x


def bvh_statistics(tree: Bvh, triangle_count: int, cost: SurfaceAreaCost) -> BvhStatistics:
    """Measures a tree.

    Args:
        tree: the tree.
        triangle_count: triangles of the mesh.
        cost: the cost model; its width is the tree's.
    """
    flat = unpack(tree)
    sizes = flat.triangles[flat.is_leaf]
    root = float(half_area(np.array(tree.low, np.float32), np.array(tree.high, np.float32)))
    leaf_weights = cost.of_leaf(sizes)
    inner_areas = np.append(half_area(flat.low[flat.is_inner], flat.high[flat.is_inner]), root)
    leaf_areas = half_area(flat.low[flat.is_leaf], flat.high[flat.is_leaf])
    if root > 0.0:
        sah_cost = (cost.traversal * inner_areas.sum() + (leaf_weights * leaf_areas).sum()) / root
    else:
        sah_cost = cost.traversal * len(inner_areas) + leaf_weights.sum()
    return BvhStatistics(
        nodes=len(flat.child),
        leaves=len(sizes),
        node_fill=float((flat.is_leaf | flat.is_inner).mean()),
        block_fill=float(sizes.sum() / len(tree.primitive)),
        depth_histogram=np.bincount((flat.depth[:, None] + 1 + 0 * flat.child)[flat.is_leaf]),
        leaf_size_histogram=np.bincount(sizes),
        sah_cost=float(sah_cost),
        duplication=float(sizes.sum() / triangle_count),
    )

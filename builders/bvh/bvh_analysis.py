"""Measures of a finished bounding volume hierarchy, box by box: hit probability, cost, and overlap of siblings.

**Measures.** A ray of an influence area that meets the root's box meets a box of the tree with probability

    p(box) = A(box) / A(root)

where A is the projected area within the area's window, or the surface area if no rays are known. A node of W children costs W
box tests, a leaf of n triangles n triangle tests. So a ray that meets the root's box and hits nothing costs on average

    sum over nodes of p W C_box  +  sum over leaves of p n C_triangle

(Falcone 2024, sections 1.3.3 and 2.4: 1 per box, 1.2 per triangle; section 5.1.2 has the two interchanged). The cost of a
traversal can be counted in the same units and compared. If V is the overlap of the projections of two siblings of areas A_1 and
A_2, their relative overlap is V / min(A_1, A_2). For many pairs it is the sum of all V over the sum of all minima (section
6.2.8). A wide node has W (W - 1) / 2 pairs.

References: falcone-2024; aila-2013.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp

from wrt.builders.bvh.bvh_statistics import half_area, unpack
from wrt.builders.influence.influence_area import InfluenceArea
from wrt.builders.influence.projected_cost import project
from wrt.builders.tree import Bvh
from wrt.kernels.influence.silhouette import shared_area
from wrt.kernels.influence.view import AreaView
from wrt.kernels.layout.bvh_nodes import EMPTY_LANE
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel


@exact_kernel
def measure_overlaps(
    first: int,
    view: AreaView,
    width: int,
    child: wp.array(dtype=int),
    low: wp.array(dtype=wp.vec3),
    high: wp.array(dtype=wp.vec3),
    areas: wp.array(dtype=float),
    overlaps: wp.array(dtype=wp.vec2),
):
    """Item: a node. areas: (nodes * W,) of the lanes. overlaps: (nodes,) sums over its pairs of V and of the smaller areas."""
    node = first + wp.tid()
    total = wp.vec2()
    for i in range(node * width, (node + 1) * width):
        for j in range(i + 1, (node + 1) * width):
            if child[i] != EMPTY_LANE and child[j] != EMPTY_LANE:
                smaller = wp.min(areas[i], areas[j])
                if smaller > 0.0:
                    total += wp.vec2(wp.min(shared_area(view, low[i], high[i], low[j], high[j]), smaller), smaller)
    overlaps[node] = total


@dataclass(frozen=True)
class BoxMeasures:
    """Measures of the boxes of a tree: the root's box, then those of all children, in the order of nodes and lanes.

    Attributes:
        parent: (boxes,) index of the enclosing box; -1 for the root.
        level: (boxes,) number of enclosing boxes.
        is_leaf: (boxes,) bool.
        triangles: (boxes,) triangles of a leaf; 0 for a node.
        low, high: (boxes, 3) float64, in the scene's coordinates.
        area: (boxes,) float64: projected area within the window, or half the surface area.
        hit_probability: (boxes,) area over the root's; 1 everywhere if that is 0.
        cost: (boxes,) cost of visiting the box, times its hit probability.
        overlap_area, smaller_area: (boxes,) sums, over the pairs of a node's children, of the overlap of their projections and
            of the smaller area; 0 for leaves, and if no rays are known.
    """

    parent: np.ndarray
    level: np.ndarray
    is_leaf: np.ndarray
    triangles: np.ndarray
    low: np.ndarray
    high: np.ndarray
    area: np.ndarray
    hit_probability: np.ndarray
    cost: np.ndarray
    overlap_area: np.ndarray
    smaller_area: np.ndarray

    @property
    def overlap(self) -> np.ndarray:
        """(boxes,) relative overlap of the children of each node, in [0, 1]; NaN if no two children have an area."""
        return _share(self.overlap_area, self.smaller_area)

    def overlap_by_level(self) -> np.ndarray:
        """(levels,) relative overlap of all pairs of children at each level, starting with level 0, which has none."""
        levels = [np.bincount(self.level + 1, sums)[: self.level.max() + 1] for sums in (self.overlap_area, self.smaller_area)]
        return _share(*levels)


def measure_boxes(
    tree: Bvh, area: InfluenceArea | None, center: np.ndarray, box_cost: float, triangle_cost: float
) -> BoxMeasures:
    """Measures every box of a tree.

    Args:
        tree: the tree.
        area: influence area of the expected rays; None for rays in all directions.
        center: (3,) the origin of the tree's positions.
        box_cost, triangle_cost: cost of one test.
    """
    tree = tree.to(wp.get_device("cpu"))
    flat = unpack(tree)
    lanes, width = (flat.is_leaf | flat.is_inner).reshape(-1), tree.width
    low = np.concatenate([[np.array(tree.low)], flat.low.reshape(-1, 3)[lanes]]).astype(np.float32)
    high = np.concatenate([[np.array(tree.high)], flat.high.reshape(-1, 3)[lanes]]).astype(np.float32)
    is_leaf = np.append(False, flat.is_leaf.reshape(-1)[lanes])
    triangles = np.append(0, flat.triangles.reshape(-1)[lanes])
    node_box = np.flatnonzero(~is_leaf)  # in the order of the nodes: siblings are adjacent, levels are contiguous
    box_node = np.repeat(np.arange(len(flat.child)), (flat.is_leaf | flat.is_inner).sum(axis=1))
    overlaps = np.zeros((len(low), 2))
    if area is None:
        areas = half_area(low, high)
    else:
        view = area.view(center)
        areas = project(view, *(wp.array(corner, dtype=wp.vec3, device="cpu") for corner in (low, high))).astype(np.float64)
        overlaps[node_box] = _overlaps(tree, flat.low, flat.high, view, areas[1:], lanes)
    probability = areas / areas[0] if areas[0] > 0.0 else np.ones(len(areas))
    node_cost = np.where(is_leaf, triangles * triangle_cost, width * box_cost)
    return BoxMeasures(
        parent=np.append(-1, node_box[box_node]),
        level=np.append(0, flat.depth[box_node] + 1),
        is_leaf=is_leaf,
        triangles=triangles,
        low=low + center,
        high=high + center,
        area=areas,
        hit_probability=probability,
        cost=probability * node_cost,
        overlap_area=overlaps[:, 0],
        smaller_area=overlaps[:, 1],
    )


def _overlaps(tree: Bvh, low: np.ndarray, high: np.ndarray, view: AreaView, areas: np.ndarray, lanes: np.ndarray) -> np.ndarray:
    """(nodes, 2) float64 results of `measure_overlaps`."""
    of_lanes = np.zeros(len(lanes), dtype=np.float32)
    of_lanes[lanes] = areas
    corners = [wp.array(corner.reshape(-1, 3), dtype=wp.vec3, device="cpu") for corner in (low, high)]
    overlaps = wp.empty(len(low), dtype=wp.vec2, device="cpu")
    inputs = [view, tree.width, tree.child, *corners, wp.array(of_lanes, dtype=float, device="cpu"), overlaps]
    launch(measure_overlaps, len(low), inputs, device=wp.get_device("cpu"), chunk=64)
    return overlaps.numpy().astype(np.float64)


def _share(part: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """part / whole; NaN where the whole is 0."""
    return np.divide(part, whole, out=np.full(len(whole), np.nan), where=whole > 0.0)

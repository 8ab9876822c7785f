"""Expected cost of a ray below each node of a wide BVH that it meets, by the surface area heuristic.

Costs are computed from the deepest level up, in parallel over the nodes of a level, as boxes are in
`wrt.builders.bvh.update.bvh_update`. The root's cost equals the tree's (`wrt.builders.bvh.bvh_statistics`), up to rounding.
"""

import numpy as np
import warp as wp

from wrt.builders.cost import SplitCost, SurfaceAreaCost, leaf_cost
from wrt.builders.tree import Bvh
from wrt.kernels.layout.bvh_nodes import EMPTY_LANE, leaf_triangles
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.simd.boxes import INFINITY, max_of, min_of


@wp.func
def area_of(low: wp.vec3, high: wp.vec3):
    """Half the surface area of a box."""
    size = high - low
    return size[0] * size[1] + size[1] * size[2] + size[2] * size[0]


@exact_kernel
def sum_costs(
    first: int,
    level_first: int,
    width: int,
    model: SplitCost,
    bounds: wp.array(dtype=float),
    child: wp.array(dtype=int),
    costs: wp.array(dtype=float),
):
    """Item: a node of the level, after its inner children. A ray that meets a node without area meets all its children."""
    node = level_first + first + wp.tid()
    low = wp.vec3(INFINITY, INFINITY, INFINITY)
    high = -low
    weighted = float(0.0)
    plain = float(0.0)
    for lane in range(width):
        word = child[node * width + lane]
        if word != EMPTY_LANE:
            at = node * 6 * width + lane
            own_low = wp.vec3(bounds[at], bounds[at + width], bounds[at + 2 * width])
            own_high = wp.vec3(bounds[at + 3 * width], bounds[at + 4 * width], bounds[at + 5 * width])
            low = min_of(low, own_low)
            high = max_of(high, own_high)
            cost = leaf_cost(model, leaf_triangles(word))
            if word >= 0:
                cost = costs[word]
            weighted += cost * area_of(own_low, own_high)
            plain += cost
    area = area_of(low, high)
    below = plain
    if area > 0.0:
        below = weighted / area
    costs[node] = model.traversal + below


def node_costs(tree: Bvh, cost: SurfaceAreaCost) -> np.ndarray:
    """(nodes,) float32 cost of each subtree."""
    device = tree.bounds.device
    costs = wp.empty(tree.level_first[-1], dtype=float, device=device)
    for first, end in reversed(list(zip(tree.level_first, tree.level_first[1:], strict=False))):
        inputs = [first, tree.width, cost.struct(), tree.bounds, tree.child, costs]
        launch(sum_costs, end - first, inputs, device=device, chunk=64)
    return costs.numpy()

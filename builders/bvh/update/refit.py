"""Refit: recomputes the boxes of a tree whose vertices have moved; nodes and leaves stay.

Every triangle is read once and every node is written once, from the deepest level up, in parallel over the nodes of a level.
The tree stays correct for any motion. Traversal slows down as triangles that were close when it was built move apart.

References: wald-2007-deformable; lauterbach-2006.
"""

from time import perf_counter

import warp as wp

from wrt.builders.tree import BuildStats, Bvh
from wrt.kernels.layout.bvh_nodes import EMPTY_LANE, first_block, leaf_triangles
from wrt.kernels.runtime.launch import launch, load
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import INFINITY, max_of, min_of

exact_module(__name__)


@wp.kernel
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
            begin = first_block(word) * width
            for slot in range(begin, begin + leaf_triangles(word)):
                face = faces[primitive[slot]]
                for corner in range(3):
                    point = vertices[face[corner]]
                    low = min_of(low, point)
                    high = max_of(high, point)
        # adding 0 turns -0 into +0, as in `compute_boxes`
        for axis in range(3):
            bounds[(node * 6 + axis) * width + lane] = low[axis] + 0.0
            bounds[(node * 6 + 3 + axis) * width + lane] = high[axis] + 0.0


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
    levels = list(zip(tree.level_first, tree.level_first[1:], strict=False))
    for first, end in reversed(levels):
        inputs = [first, tree.width, vertices, faces, tree.child, tree.primitive, bounds]
        launch(refit_nodes, end - first, inputs, device=device, chunk=64)
    root = bounds[: 6 * tree.width].numpy().reshape(2, 3, tree.width)
    low, high = (wp.vec3(*map(float, corner)) for corner in (root[0].min(axis=1), root[1].max(axis=1)))
    stats = BuildStats({"refit": perf_counter() - start})
    stats.reserve(bounds)
    return Bvh(bounds, tree.child, tree.primitive, low, high, tree.width, tree.level_first, stats)

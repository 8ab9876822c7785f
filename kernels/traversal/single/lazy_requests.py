"""Finds the unbuilt parts of a lazy tree that rays need.

A lazily built tree (`wrt.builders.kdtree.lazy.lazy_kdtree`) has a skeleton: the planes above its cells. A leaf of the skeleton
with triangles is a cell that is not built yet; its "first block" is the number of the cell. A leaf without triangles is built,
or empty. After rays have been traced through the built part, they traverse the skeleton as `single_kdtree` does, from the start
of their range to their hit, and mark the first unbuilt cells on the way. A ray that marks none has its final answer: everything
that could precede its hit was built when it was traced.

References: hunt-2007.
"""

import warp as wp

from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.layout.kdtree_nodes import LEAF, MAX_TREE_DEPTH, KdNodes
from wrt.kernels.layout.ray_batch import HitBatch, Ray, RayBatch, load_ray
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.simd.boxes import ray_slabs, reach
from wrt.kernels.traversal.leaf import enter
from wrt.kernels.traversal.single.single_kdtree import Cell, pop_cell, split_cell, step_guessing

UNTRACED = wp.constant(0)
TO_HIT = wp.constant(1)
TO_ANY = wp.constant(2)
"""Range in which a ray needs cells: its whole range, up to its closest hit, or none if it has any hit."""


@wp.func
def request_limit(query_range: int, ray: Ray, hits: HitBatch, i: int):
    """The t up to which a ray needs cells; below every t if it needs none."""
    bound = ray.t_max
    if query_range == TO_HIT:
        bound = wp.min(bound, hits.t[i])
    elif query_range == TO_ANY:
        bound = wp.where(hits.occluded[i], -1.0, bound)
    return wp.where(ray.valid, bound, -1.0)


@wp.func
def mark_unbuilt_cells(skeleton: KdNodes, ray: Ray, bound: float, max_cells: int, requested: wp.array(dtype=wp.uint8)):
    """Marks up to `max_cells` unbuilt cells that the ray reaches first; returns their number."""
    slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, skeleton.low, skeleton.high))
    interval = enter(slabs, skeleton.low, skeleton.high, ray.t_min, bound)
    cell = Cell()
    cell.entry = interval[0]
    cell.leave = interval[1]
    stack_node = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=int)
    stack_entry = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=float)
    stack_leave = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=float)
    size = int(0)
    found = int(0)
    searching = cell.entry <= cell.leave
    while searching:
        node = kdtree.load_node(skeleton.nodes, cell.node)
        if kdtree.split_axis(node) != LEAF:
            crossing = split_cell(slabs, node, cell)
            right = kdtree.right_child(node)
            step_guessing(crossing, cell.node + 1, right, cell, stack_node, stack_entry, stack_leave, size)
        else:
            if kdtree.leaf_triangles(node) > 0:
                requested[kdtree.first_block(node)] = wp.uint8(1)  # several threads may write here, all the same value
                found += 1
            searching = size > 0 and found < max_cells
            if searching:
                pop_cell(cell, stack_node, stack_entry, stack_leave, size)
    return found


@exact_kernel
def mark_requested_cells(
    first: int,
    skeleton: KdNodes,
    rays: RayBatch,
    hits: HitBatch,
    query_range: int,
    max_cells: int,
    requested: wp.array(dtype=wp.uint8),
    unfinished: wp.array(dtype=wp.bool),
):
    """Marks the unbuilt cells that a ray needs. Item: a ray.

    requested: (cells,) initially 0; set to 1 for the cells that are needed. unfinished: (rays,) whether the ray needs any.
    """
    i = first + wp.tid()
    ray = load_ray(rays, i)
    bound = request_limit(query_range, ray, hits, i)
    found = int(0)
    if bound >= 0.0:
        found = mark_unbuilt_cells(skeleton, ray, bound, max_cells, requested)
    unfinished[i] = found > 0

"""Single-ray traversal of a kd-tree with a stack (survey, chapter 5), robust by construction.

**Problem.** The classic recursive traversal compares the parameter of a splitting plane with the ray's interval in a node
and is wrong where they are equal: a ray whose origin lies on the plane, a ray that stays in the plane, an entry and an
exit both on it (Havran 2001).

**Here.** Each child gets an interval of its own and is visited if that is not empty. The near child (by the sign of the
direction, not by the side on which the origin lies) ends where the plane is left, the far one starts where it is entered,
and both are computed with the plane widened by the slack of `wrt.kernels.boxes`: they overlap by a hair.
* Plane behind the origin: the near interval ends below t_min, only the far child is visited. Beyond the exit: only near.
* Ray parallel to the plane: the parameter is +-inf; the child that holds the origin gets the whole interval, the other
  none. Origin exactly in the widened plane: NaN, which bounds nothing, so both get the whole interval.
* A triangle in the splitting plane lies in one child only; its t equals the plane's parameter, which both intervals hold.

The entry of a cell is never later than the t of a hit on a triangle in it (the consistency rule), so a waiting cell whose
entry lies beyond the best hit is dropped; at a tie it is visited, because a smaller primitive id may win there. The search
goes on to the next waiting cell, not to its end: where children overlap, an outer cell may start before an inner one.

References:
    V. Havran: Heuristic ray shooting algorithms. PhD thesis, Czech Technical University in Prague, 2001.
    J. Rahikainen: survey of real-time ray tracing, 2013, chapter 5.
"""

from functools import cache

import warp as wp

from wrt.kernels import kdtree
from wrt.kernels.boxes import ray_slabs, reach, slab_interval
from wrt.kernels.kdtree import LEAF, MAX_TREE_DEPTH, KdNodes
from wrt.kernels.rays import HitBatch, RayBatch, load_ray, store_hit
from wrt.kernels.traversal.config import ANY, TraversalConfig
from wrt.kernels.traversal.leaf import Counters, block_step, start
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.records import TriangleBlocks

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@cache
def make_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    prepare = TRIANGLE_TESTS[config.triangle_test].prepare
    step = block_step(config)
    width, counting, any_hit = config.width, config.counters, config.query == ANY

    def single_ray_kdtree(
        first: int,
        tree: KdNodes,
        triangles: TriangleBlocks,
        rays: RayBatch,
        hits: HitBatch,
        counters: wp.array(dtype=Counters),
    ):
        i = first + wp.tid()
        ray = load_ray(rays, i)
        best = start(ray.t_max)
        work = Counters()
        if ray.valid:
            slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, tree.low, tree.high))
            interval = slab_interval(slabs, tree.low, tree.high)
            state = prepare(ray.origin, ray.direction)
            entry = wp.max(interval[0], ray.t_min)
            leave = wp.min(interval[1], ray.t_max)
            stack_node = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=int)
            stack_entry = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=float)
            stack_leave = wp.zeros(shape=(MAX_TREE_DEPTH,), dtype=float)
            size = int(0)
            index = int(0)
            searching = entry <= leave
            while searching:
                node = kdtree.load_node(tree.nodes, index)
                axis = kdtree.split_axis(node)
                if axis != LEAF:
                    position = kdtree.split_position(node)
                    inverse = slabs.inverse[axis]
                    near_leave = (position - slabs.origin_out[axis]) * inverse
                    far_entry = (position - slabs.origin_in[axis]) * inverse
                    near_leave = wp.where(near_leave < leave, near_leave, leave)
                    far_entry = wp.where(far_entry > entry, far_entry, entry)
                    backward = inverse < 0.0
                    near = wp.where(backward, kdtree.right_child(node), index + 1)
                    far = wp.where(backward, index + 1, kdtree.right_child(node))
                    if wp.static(counting):
                        work.nodes += 1
                    if entry > near_leave:
                        index = far
                        entry = far_entry
                    else:
                        if far_entry <= leave:
                            stack_node[size] = far
                            stack_entry[size] = far_entry
                            stack_leave[size] = leave
                            size += 1
                        index = near
                        leave = near_leave
                else:
                    count = kdtree.leaf_triangles(node)
                    block = kdtree.first_block(node)
                    if wp.static(counting):
                        work.leaves += 1
                        work.triangles += count
                    while count > 0:
                        best = step(triangles, block, state, slabs, ray.t_min, best)
                        block += 1
                        count -= wp.static(width)
                    searching = bool(False)
                    if wp.static(any_hit):
                        size = wp.where(best.primitive < 0, size, 0)
                    while size > 0 and not searching:
                        size -= 1
                        index = stack_node[size]
                        entry = stack_entry[size]
                        leave = stack_leave[size]
                        searching = entry <= best.t
        if wp.static(any_hit):
            hits.occluded[i] = best.primitive >= 0
        else:
            store_hit(hits, i, best.t, best.primitive, best.u, best.v)
        if wp.static(counting):
            counters[i] = work

    return wp.kernel(single_ray_kdtree, module="unique", enable_backward=False, module_options={"fuse_fp": False})

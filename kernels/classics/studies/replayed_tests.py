"""Tests of the pairs of a ray and a triangle that a tree would test, one after the other, without the tree.

A leaf tests a triangle if the ray meets its box in front of the ray's closest hit. `make_lists` writes those triangles of
each ray, by the entry into their boxes as a tree that goes from front to back would find them. `make_kernel` then tests them
by the scalar form of a test, in which every exit is a branch, as one that tests a ray and a triangle at a time does. So the
time of a test is measured at a tree's share of hits, and nothing else.
"""

from functools import cache

import warp as wp

from wrt.kernels.classics.studies.exit_counts import exit_of
from wrt.kernels.layout.ray_batch import RayBatch, load_ray
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.simd.boxes import clamp_to_box, ray_slabs, reach
from wrt.kernels.traversal.brute_force import AllTriangles
from wrt.kernels.triangle.support.record_blocks import corners_high, corners_low, load_corners
from wrt.kernels.triangle.support.triangle_contract import TestForm


@cache
def make_lists(components: int) -> wp.Kernel:
    """Counts the triangles of each ray, or writes them if there is room.

    An item is a ray. `closest` holds its closest t, inf for a miss. Ray i writes from `begin[i]` on, if `slot` is not empty,
    and its number of triangles to `count[i]`.
    """
    load = load_corners(components)

    def list_triangles(
        first: int,
        tree: AllTriangles,
        records: wp.array(dtype=float),
        rays: RayBatch,
        closest: wp.array(dtype=float),
        begin: wp.array(dtype=int),
        count: wp.array(dtype=int),
        slot: wp.array(dtype=int),
        entry: wp.array(dtype=float),
    ):
        i = first + wp.tid()
        ray = load_ray(rays, i)
        found = int(0)
        if ray.valid:
            slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, tree.low, tree.high))
            for triangle in range(tree.count):
                corners = load(records, triangle, 1)
                t = clamp_to_box(slabs, corners_low(corners), corners_high(corners), ray.t_min)
                if t >= ray.t_min and t <= wp.min(closest[i], ray.t_max):
                    if slot.shape[0] > 0:
                        slot[begin[i] + found] = triangle
                        entry[begin[i] + found] = t
                    found += 1
        count[i] = found

    return specialised_kernel(list_triangles)


@cache
def make_kernel(test: TestForm, counted: bool) -> wp.Kernel:
    """Tests the triangles of each ray. An item is a ray.

    `far` is infinity for each ray, and afterwards the closest hit of a form that reads it. A row of `ends` is the number of a
    ray's hits, or, if `counted`, the number of tests at each exit, the hits last.
    """
    prepare, end = test.prepare, exit_of(test)
    exits = len(test.lanes.exits)

    def replay(
        first: int,
        records: wp.array(dtype=float),
        origins: wp.array(dtype=wp.vec3),
        directions: wp.array(dtype=wp.vec3),
        begin: wp.array(dtype=int),
        slot: wp.array(dtype=int),
        far: wp.array(dtype=float),
        ends: wp.array2d(dtype=int),
    ):
        i = first + wp.tid()
        ray = prepare(origins[i], directions[i])
        far[i] = wp.inf
        hits = int(0)
        for k in range(begin[i], begin[i + 1]):
            here = end(records, slot[k], 1, ray, far, i)
            if wp.static(counted):
                ends[i, here] = ends[i, here] + 1
            hits += wp.where(here == wp.static(exits), 1, 0)
        if not wp.static(counted):
            ends[i, 0] = hits

    return specialised_kernel(replay)

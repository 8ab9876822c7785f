"""All queue points of all rays: pairs (ray, point), sorted by point; count, scan, fill.

References: see `wrt.kernels.traversal.queued.next_queue`.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch, load_ray
from wrt.kernels.layout.unchecked import load_float, load_int, store_int
from wrt.kernels.runtime.options import exact_module, specialised_kernel
from wrt.kernels.simd.box_lanes import intersected_boxes
from wrt.kernels.simd.boxes import ray_slabs, reach
from wrt.kernels.simd.lanes import lanes, lowest_bit
from wrt.kernels.traversal.queued.next_queue import make_bound

exact_module(__name__)


@wp.struct
class QueuePairs:
    """Pairs of a ray and a queue point whose box it meets within its range."""

    ray: wp.array(dtype=int)
    """(pairs,) number of the ray."""
    entry: wp.array(dtype=float)
    """(pairs,) t of entry into the box."""


@cache
def make_list_points(width: int, levels: int, fill: bool) -> wp.Kernel:
    """The kernel that counts the pairs of a chunk of rays by queue point, or writes them. Item: a chunk of rays.

    Args:
        width, levels: of the upper tree (`wrt.kernels.traversal.queued.next_queue`).
        fill: whether `places`, (chunks, points), holds the positions of the next pairs, which are written there; otherwise
            zeros, to which the pairs are added.
    """
    test_boxes, Lanes, stack_size = intersected_boxes(width), lanes(width), levels * (width - 1) + 1

    def list_points(first: int, top: WideNodes, rays: RayBatch, chunk: int, places: wp.array2d(dtype=int), pairs: QueuePairs):
        item = first + wp.tid()
        row = places[item]
        waiting = wp.zeros(shape=(stack_size,), dtype=int)
        for i in range(item * chunk, wp.min(rays.count, (item + 1) * chunk)):
            ray = load_ray(rays, i)
            slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, top.low, top.high))
            store_int(waiting, 0, 0)
            left = wp.where(ray.valid, 1, 0)
            while left > 0:
                left -= 1
                node = load_int(waiting, left)
                entry = Lanes()
                met = test_boxes(top.bounds, node, slabs, ray.t_min, ray.t_max, entry)
                while met != wp.uint32(0):
                    lane = lowest_bit(met)
                    met = met & (met - wp.uint32(1))
                    child = load_int(top.child, node * wp.static(width) + lane)
                    if child >= 0:
                        store_int(waiting, left, child)
                        left += 1
                    else:
                        point = bvh.first_block(child)
                        place = row[point]
                        row[point] = place + 1
                        if wp.static(fill):
                            pairs.ray[place] = i
                            pairs.entry[place] = entry[lane]

    return specialised_kernel(list_points)


@cache
def make_list_live(query: str) -> wp.Kernel:
    """The kernel that lists the rays of a slice of pairs that enter the box no later than their best hits.

    Item: a slice of `size` pairs of those from `begin` to `end`. Its rays are written to `live` from item * size on, in order,
    and their number to `counts`.
    """
    bound_of = make_bound(query)

    def list_live(
        first: int,
        begin: int,
        end: int,
        size: int,
        rays: RayBatch,
        hits: HitBatch,
        pairs: QueuePairs,
        live: wp.array(dtype=int),
        counts: wp.array(dtype=int),
    ):
        item = first + wp.tid()
        place = item * size
        for pair in range(begin + item * size, wp.min(end, begin + (item + 1) * size)):
            i = load_int(pairs.ray, pair)
            if load_float(pairs.entry, pair) <= bound_of(hits, i, rays.t_max[i * rays.t_max_stride]):
                store_int(live, place, i)
                place += 1
        counts[item] = place - item * size

    return specialised_kernel(list_live)

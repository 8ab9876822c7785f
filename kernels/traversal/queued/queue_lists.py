"""All queue points of all rays: pairs (ray, point), sorted by point.

Each chunk of rays lists its pairs, ray by ray, and counts them by point; after a scan of the counts, it copies its pairs to
their places. To walk the upper tree twice, once to count and once to fill, would take almost twice as long.

References: see `wrt.kernels.traversal.queued.next_queue`.
"""

from functools import cache

import warp as wp

from wrt.kernels.answers import ANSWERS
from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch, load_ray
from wrt.kernels.layout.unchecked import load_float, load_int, store_float, store_int
from wrt.kernels.runtime.options import exact_kernel, specialised_kernel
from wrt.kernels.simd.box_lanes import intersected_boxes
from wrt.kernels.simd.boxes import ray_slabs, reach
from wrt.kernels.simd.lanes import lanes, lowest_bit


@wp.struct
class QueuePairs:
    """Pairs of a ray and a queue point whose box it meets within its range."""

    ray: wp.array(dtype=int)
    """(pairs,) number of the ray."""
    entry: wp.array(dtype=float)
    """(pairs,) t of entry into the box."""


@cache
def make_list_points(width: int, levels: int) -> wp.Kernel:
    """The kernel that lists the pairs of a chunk of rays, ray by ray, and counts them by queue point. Item: a chunk of rays.

    It lists them in `points` and `found`, from begins[item] to begins[item + 1] - 1. Pairs beyond are counted and not listed.

    Args:
        width, levels: of the upper tree (`wrt.kernels.traversal.queued.next_queue`).
    """
    test_boxes, Lanes, stack_size = intersected_boxes(width), lanes(width), levels * (width - 1) + 1

    def list_points(
        first: int,
        top: WideNodes,
        rays: RayBatch,
        chunk: int,
        begins: wp.array(dtype=int),
        counts: wp.array2d(dtype=int),
        points: wp.array(dtype=int),
        found: QueuePairs,
    ):
        item = first + wp.tid()
        row = counts[item]
        place = begins[item]
        end = begins[item + 1]
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
                        row[point] += 1
                        if place < end:
                            store_int(points, place, point)
                            store_int(found.ray, place, i)
                            store_float(found.entry, place, entry[lane])
                            place += 1

    return specialised_kernel(list_points)


@exact_kernel
def sort_pairs(
    first: int,
    begins: wp.array(dtype=int),
    listed: wp.array(dtype=int),
    points: wp.array(dtype=int),
    found: QueuePairs,
    places: wp.array2d(dtype=int),
    pairs: QueuePairs,
):
    """Copies the pairs that a chunk has listed to their places by point.

    Item: a chunk, which has listed listed[item] pairs from begins[item] on. places: (chunks, points), of its next pairs;
    advanced.
    """
    item = first + wp.tid()
    row = places[item]
    for k in range(begins[item], begins[item] + listed[item]):
        point = load_int(points, k)
        place = row[point]
        row[point] = place + 1
        store_int(pairs.ray, place, load_int(found.ray, k))
        store_float(pairs.entry, place, load_float(found.entry, k))


@cache
def make_list_live(query: str) -> wp.Kernel:
    """The kernel that lists the rays of a slice of pairs that enter the box no later than their best hits.

    Item: a slice of `size` pairs of those from `begin` to `end`. Its rays are written to `live` from item * size on, in order,
    and their number to `counts`.
    """
    bound_of = ANSWERS[query].stored.bound

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

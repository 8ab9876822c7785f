"""The path of a ray from queue to queue: the next leaf of an upper tree that the ray enters.

The leaves of the **upper tree** are queue points: subtrees of a tree in memory (`wrt.kernels.traversal.queued.queued_bvh`), or
parts of a scene on disk (`wrt.disk`). A ray passes the queue points whose boxes it meets in the order of (t of entry,
number of the point). It keeps only the last one, so the state of a waiting ray is 8 bytes beside the ray and its best hit. A
point whose box is entered beyond the best hit is skipped, and so are all after it.

The t of entry is a function of ray and box alone: it does not depend on hits. So a ray visits each point at most once, whatever
the order in which queues are processed.

References: pharr-1997; navratil-2007; rahikainen-2013 (section 3.1, Algorithm 3.1.1).
"""

from functools import cache

import warp as wp

from wrt.kernels.answers import ANSWERS
from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch, load_ray
from wrt.kernels.layout.unchecked import load_int, store_int
from wrt.kernels.runtime.options import exact_kernel, specialised_kernel
from wrt.kernels.simd.box_lanes import intersected_boxes
from wrt.kernels.simd.boxes import INFINITY, ray_slabs, reach
from wrt.kernels.simd.lanes import lanes, lowest_bit
from wrt.kernels.traversal.leaf import CounterRows

MAX_QUEUES = 65534
"""Greatest number of queues: numbers are sorted as 16 bits, and one more stands for rays that are done."""


@wp.struct
class RayQueue:
    """Where the N rays of a batch are on their way through the queues."""

    entry: wp.array(dtype=float)
    """(N,) t of entry into the box of the last queue point."""
    point: wp.array(dtype=int)
    """(N,) number of the last queue point; -1 if there is none."""


@wp.func
def precedes(entry: float, point: int, other_entry: float, other: int):
    """Whether a ray passes a queue point before another one."""
    return entry < other_entry or (entry == other_entry and point < other)


@cache
def make_advance(width: int, levels: int, query: str, counting: bool = False) -> wp.Kernel:
    """The kernel that takes rays to their next queue points. Item: a ray of the list `order`, or of the batch if it is empty.

    A leaf of the upper tree has the number of its queue point in the place of its first block. `bucket` gets the number of the
    queue, or `done` if there is none: one more than the greatest.

    Args:
        width, levels: of the upper tree.
        query: key in `ANSWERS`.
        counting: whether the nodes of the upper tree are counted.
    """
    test_boxes, Lanes, stack_size = intersected_boxes(width), lanes(width), levels * (width - 1) + 1
    bound_of = ANSWERS[query].stored.bound

    def advance_rays(
        first: int,
        top: WideNodes,
        rays: RayBatch,
        hits: HitBatch,
        order: wp.array(dtype=int),
        done: int,
        queue: RayQueue,
        bucket: wp.array(dtype=wp.uint16),
        counters: CounterRows,
    ):
        slot = first + wp.tid()
        i = int(slot)
        passed = float(-INFINITY)
        passed_point = int(-1)
        if order.shape[0] > 0:
            i = order[slot]
            passed = queue.entry[i]
            passed_point = queue.point[i]
        ray = load_ray(rays, i)
        slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, top.low, top.high))
        best = bound_of(hits, i, ray.t_max)
        point = int(-1)
        waiting = wp.zeros(shape=(stack_size,), dtype=int)
        left = wp.where(ray.valid, 1, 0)
        while left > 0:
            left -= 1
            node = load_int(waiting, left)
            entry = Lanes()
            met = test_boxes(top.bounds, node, slabs, ray.t_min, best, entry)
            if wp.static(counting):
                counters.rows[i].nodes += 1
                counters.rows[i].boxes += wp.static(width)
            while met != wp.uint32(0):
                lane = lowest_bit(met)
                met = met & (met - wp.uint32(1))
                child = load_int(top.child, node * wp.static(width) + lane)
                if child >= 0:
                    store_int(waiting, left, child)
                    left += 1
                else:
                    other = bvh.first_block(child)
                    comes = precedes(passed, passed_point, entry[lane], other)
                    if comes and (point < 0 or precedes(entry[lane], other, best, point)):
                        best = entry[lane]
                        point = other
        queue.entry[i] = best
        queue.point[i] = point
        bucket[slot] = wp.uint16(wp.where(point < 0, done, point))

    return specialised_kernel(advance_rays)


@exact_kernel
def gather_numbers(first: int, numbers: wp.array(dtype=int), order: wp.array(dtype=int), sorted_numbers: wp.array(dtype=int)):
    """Puts ray numbers in an order. Item: a place in the order."""
    place = first + wp.tid()
    sorted_numbers[place] = numbers[order[place]]

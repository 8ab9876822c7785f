"""Forwarding by queues: each ray waits for one part, the next that it enters, and moves on from part to part, front to back.

A part is chosen and loaded, and all rays of its queue are traced in it; each then moves on to the queue of its next part,
unless its best hit lies before that. The part chosen is the one with the largest benefit for its cost: rays that wait, over
bytes that are not in memory, plus a constant for handling a queue at all.

References: pharr-1997; navratil-2007.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from wrt.engine.launch.traversal_launch import counter_rows, no_work
from wrt.engine.memory import empty
from wrt.kernels.query.ordering.ray_order import sort_buckets
from wrt.kernels.runtime.launch import launch
from wrt.kernels.traversal.leaf import Counters
from wrt.kernels.traversal.queued.next_queue import RayQueue, gather_numbers, make_advance

if TYPE_CHECKING:
    from wrt.disk.ray_job import RayJob

HANDLING_BYTES = 1 << 20
"""What a queue costs beside loading its part, in bytes that could be read meanwhile."""

CHUNK = 1024
"""Rays that are worth a chunk of their own."""


def forward(job: RayJob) -> bool:
    """Traces all rays of a block by queues. Returns True."""
    queues = Queues(job)
    queues.move_on(wp.empty(0, dtype=int, device=job.device), job.rays.count)
    while queues.waiting.any():
        number = queues.choose()
        order = queues.take(number)
        job.trace(number, order, job.gathered(order))
        queues.move_on(order, len(order))
    return True


class Queues:
    """The rays that wait for each part.

    Attributes:
        waiting: (P,) number of rays.
    """

    def __init__(self, job: RayJob) -> None:
        self.job, self.waiting = job, np.zeros(job.parts)
        self._numbers: list[list[np.ndarray]] = [[] for _ in range(job.parts)]
        self._places, count = RayQueue(), job.rays.count
        self._places.entry, self._places.point = empty(count, wp.float32, job.device), empty(count, wp.int32, job.device)

    def choose(self) -> int:
        """The part with the largest benefit for its cost."""
        cost = np.where(self.job.cache.is_loaded, 0, self.job.expected_bytes) + HANDLING_BYTES
        return int(np.argmax(self.waiting / cost))

    def take(self, number: int) -> wp.array:
        """Numbers of the rays that wait for a part; they wait no longer."""
        numbers = np.concatenate(self._numbers[number])
        self._numbers[number], self.waiting[number] = [], 0
        return wp.array(numbers, dtype=int, device=self.job.device, copy=False)

    def move_on(self, order: wp.array, count: int) -> None:
        """Puts rays into the queues of their next parts; all rays of the block if `order` is empty."""
        job, device = self.job, self.job.device
        bucket = empty(count, wp.uint16, device)
        kernel, idle = make_advance(job.upper.width, job.upper.levels, job.query.kind), no_work(Counters, device.alias)
        inputs = [job.upper.nodes, job.rays, job.hits, order, job.parts, self._places, bucket, counter_rows(idle)]
        launch(kernel, count, inputs, device=device, chunk=CHUNK)
        numbers, begins = sort_buckets(bucket, job.parts + 1)
        left = begins[job.parts]
        if len(order):
            places, numbers = numbers, empty(left, wp.int32, device)
            launch(gather_numbers, left, [order, places, numbers], device=device, chunk=CHUNK)
        host = numbers.numpy()
        for number in np.flatnonzero(np.diff(begins[: job.parts + 1])).tolist():
            piece = host[begins[number] : begins[number + 1]]
            self._numbers[number].append(piece)
            self.waiting[number] += len(piece)

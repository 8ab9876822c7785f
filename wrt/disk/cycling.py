"""Cycling: each part is loaded once for a block of rays, and all rays that enter its box before their best hits are traced.

Pairs of a ray and a part whose box it meets are listed once, sorted by part (`wrt.kernels.traversal.queued.queue_lists`). Parts
in memory come first, before they are dropped; then the part that its rays enter earliest, on average. So near parts shorten
the rays, and a part that no ray reaches any more is not loaded.

Compared with forwarding (`wrt.disk.forwarding`), parts are loaded less often, and some rays are traced in parts behind
their hits.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from wrt.engine.memory import empty, new_rays
from wrt.kernels.query.ordering.ray_order import scan_counts
from wrt.kernels.query.part_queries import make_gather_live
from wrt.kernels.runtime.launch import get_num_threads, launch
from wrt.kernels.traversal.queued.queue_lists import QueuePairs, make_list_live, make_list_points, sort_pairs

if TYPE_CHECKING:
    from wrt.disk.ray_job import RayJob
    from wrt.kernels.layout.ray_batch import RayBatch

MIN_CHUNK = 1 << 12
"""Rays that are worth a row of counts."""

PAIRS_PER_RAY = 2
"""Pairs of each ray, on average, for which there is room at first."""

MAX_PAIRS = 1 << 26
"""Greatest number of pairs of a block, which take 20 bytes each until they are sorted, and then 8."""

SLICE, CUDA_SLICE = 512, 32
"""Pairs whose rays are listed by one item of a kernel."""


def cycle(job: RayJob) -> bool:
    """Traces all rays of a block part by part. Returns False, and does nothing, if they meet too many parts for one block."""
    listed = list_pairs(job)
    if listed is None:
        return False
    pairs, begins = listed
    entry = pairs.entry.numpy()
    distance = [entry[begin:end].mean() if end > begin else np.inf for begin, end in pairwise(begins)]
    turns = np.lexsort((distance, ~job.cache.is_loaded))  # type: ignore[arg-type]
    turns = turns[np.diff(begins)[turns] > 0]
    with job.cache.one_round():
        for number in turns.tolist():
            order, rays = live_rays(job, pairs, begins[number], begins[number + 1])
            if rays.count:
                job.trace(number, order, rays)
    return True


def list_pairs(job: RayJob) -> tuple[QueuePairs, list[int]] | None:
    """The pairs of all rays and parts, and the first pair of each part, followed by the number of pairs.

    None if there are more than `MAX_PAIRS`, unless there is but one ray.
    """
    count, device = job.rays.count, job.device
    chunk = max(MIN_CHUNK, -(-count // (4 * get_num_threads())))
    room = np.full(-(-count // chunk), PAIRS_PER_RAY * chunk)
    lists = PairLists(job, chunk, room)
    total = int(lists.lengths.sum())
    if total > MAX_PAIRS and count > 1:
        return None
    if (lists.lengths > room).any():
        lists = PairLists(job, chunk, lists.lengths)
    launch(scan_counts, 1, [lists.places], device=device)
    firsts, pairs = [*lists.places.numpy()[0].tolist(), total], new_pairs(total, device)
    lengths = wp.array(lists.lengths.astype(np.int32), dtype=int, device=device)
    inputs = [lists.begins, lengths, lists.points, lists.found, lists.places, pairs]
    launch(sort_pairs, len(room), inputs, device=device, chunk=1)
    return pairs, firsts


class PairLists:
    """The pairs of all rays and parts in the order of the rays, listed by chunks of rays.

    Args:
        job: the rays and the upper tree.
        chunk: number of rays of a chunk.
        room: (chunks,) number of pairs that a chunk can list.

    Attributes:
        lengths: (chunks,) int64, number of pairs of each chunk; those beyond its room are not listed.
        begins: (chunks + 1,) int32 on the device, where the pairs of each chunk begin.
        points, found: parts and pairs.
        places: (chunks, parts) int32, number of pairs of each chunk and part.
    """

    def __init__(self, job: RayJob, chunk: int, room: np.ndarray) -> None:
        device, upper, size = job.device, job.upper, int(room.sum())
        self.begins = wp.array(np.cumsum([0, *room], dtype=np.int32), dtype=int, device=device)
        self.places = wp.zeros((len(room), job.parts), dtype=int, device=device)
        self.points, self.found = empty(size, wp.int32, device), new_pairs(size, device)
        inputs = [upper.nodes, job.rays, chunk, self.begins, self.places, self.points, self.found]
        launch(make_list_points(upper.width, upper.levels), len(room), inputs, device=device, chunk=1)
        self.lengths = self.places.numpy().sum(axis=1, dtype=np.int64)


def new_pairs(count: int, device: wp.Device) -> QueuePairs:
    """Memory for pairs of a ray and a part."""
    pairs = QueuePairs()
    pairs.ray, pairs.entry = empty(count, wp.int32, device), empty(count, wp.float32, device)
    return pairs


def live_rays(job: RayJob, pairs: QueuePairs, begin: int, end: int) -> tuple[wp.array, RayBatch]:
    """The rays of a part that are not done before it: their numbers, and copies shortened to their best hits."""
    size = CUDA_SLICE if job.device.is_cuda else SLICE
    slices = -(-(end - begin) // size)
    live, counts = empty(end - begin, wp.int32, job.device), wp.empty(slices, dtype=int, device=job.device)
    inputs = [begin, end, size, job.rays, job.hits, pairs, live, counts]
    launch(make_list_live(job.query.kind), slices, inputs, device=job.device, chunk=1)
    begins = np.zeros(slices + 1, dtype=np.int32)
    np.cumsum(counts.numpy(), out=begins[1:])
    count = int(begins[-1])
    order, rays = empty(count, wp.int32, job.device), new_rays(count, job.device)
    inputs = [size, job.rays, job.hits, live, wp.array(begins, dtype=int, device=job.device, copy=False), order, rays]
    launch(make_gather_live(job.query.kind), slices if count else 0, inputs, device=job.device, chunk=1)
    return order, rays

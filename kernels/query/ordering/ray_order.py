"""Ray reordering: sorts rays by the grid cell of the origin and the octant of the direction.

**Problem.** Rays with scattered origins visit different parts of the tree. If tree and triangles exceed the caches, tracing
waits for memory.

**Idea.** Trace rays from the same region together and, within the region, rays with the same direction signs together. These
are the sort keys of Garanzha and Loop (2010), at low resolution; Pharr et al. (1997) queue rays by the cells of a grid. 8 x 8 x
8 cells and 8 octants are 4096 buckets, so one counting sort (count, scan, fill) orders the ray numbers. The rays are then
copied in that order, and their hits are copied back. Copying keeps many memory reads in flight; reading through the order
during tracing would wait once per ray.

**Limits.** The copies cost several cache misses per ray, so reordering pays only for large scenes
(notebooks/records/2026-11-21-streams.md).

References: pharr-1997; garanzha-loop-2010; rahikainen-2013 (section 3.1).
"""

from collections.abc import Callable
from functools import cache

import warp as wp

from wrt.kernels.answers import ANSWERS, batch_kinds
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch, load_ray
from wrt.kernels.runtime.launch import get_num_threads, launch
from wrt.kernels.runtime.options import exact_kernel, named_kernel

CELLS = wp.constant(8)
"""Number of grid cells per axis."""

BUCKETS = 8 * 8 * 8 * 8
"""Cells of the grid times octants."""

MIN_CHUNK = 1 << 14
"""Least number of rays per row of counts on the CPU."""

CUDA_CHUNK = 1 << 10
"""Rays per row of counts on CUDA, where one thread fills a row."""


@wp.func
def cell_of(offset: float, scale: float):
    """Grid cell of a coordinate; coordinates outside the grid, and NaN, are clamped to the first or last cell."""
    place = offset * scale
    inside = wp.where(place >= 0.0, wp.where(place < float(CELLS - 1), place, float(CELLS - 1)), 0.0)
    return int(inside)


@exact_kernel
def count_rays(
    first: int,
    rays: RayBatch,
    chunk: int,
    low: wp.vec3,
    scale: wp.vec3,
    bucket: wp.array(dtype=wp.uint16),
    counts: wp.array2d(dtype=int),
):
    """Counts the rays of a chunk by bucket. Item: a chunk of rays. counts: (chunks, BUCKETS), initially 0."""
    item = first + wp.tid()
    row = counts[item]
    for i in range(item * chunk, wp.min(rays.count, (item + 1) * chunk)):
        ray = load_ray(rays, i)
        place = ray.origin - low
        cell = (cell_of(place[0], scale[0]) * CELLS + cell_of(place[1], scale[1])) * CELLS + cell_of(place[2], scale[2])
        signs = (
            wp.where(ray.direction[0] < 0.0, 4, 0)
            + wp.where(ray.direction[1] < 0.0, 2, 0)
            + wp.where(ray.direction[2] < 0.0, 1, 0)
        )
        which = cell * 8 + signs
        bucket[i] = wp.uint16(which)
        row[which] += 1


@exact_kernel
def scan_counts(first: int, counts: wp.array2d(dtype=int)):
    """Turns counts into positions: an exclusive scan by bucket, then by chunk. Item: the whole table."""
    place = int(0)
    for which in range(counts.shape[1]):
        for item in range(counts.shape[0]):
            count = counts[item, which]
            counts[item, which] = place
            place += count


@exact_kernel
def fill_order(
    first: int,
    count: int,
    chunk: int,
    bucket: wp.array(dtype=wp.uint16),
    places: wp.array2d(dtype=int),
    order: wp.array(dtype=int),
):
    """Writes the ray numbers of a chunk to their sorted positions. Item: a chunk of rays. order: (rays,) ray numbers."""
    item = first + wp.tid()
    row = places[item]
    for i in range(item * chunk, wp.min(count, (item + 1) * chunk)):
        which = int(bucket[i])
        place = row[which]
        order[place] = i
        row[which] = place + 1


@exact_kernel
def gather_rays(first: int, rays: RayBatch, order: wp.array(dtype=int), sorted_rays: RayBatch):
    """Copies a ray to its place in the order. Item: a place in the order. Elements shared by all rays are not copied."""
    place = first + wp.tid()
    i = order[place]
    if rays.origin_stride != 0:
        sorted_rays.origins[place] = rays.origins[i]
    if rays.direction_stride != 0:
        sorted_rays.directions[place] = rays.directions[i]
    if rays.t_min_stride != 0:
        sorted_rays.t_min[place] = rays.t_min[i]
    if rays.t_max_stride != 0:
        sorted_rays.t_max[place] = rays.t_max[i]
    if rays.mask_stride != 0:
        sorted_rays.mask[place] = rays.mask[i]
    if rays.environment_stride != 0:
        sorted_rays.environment[place] = rays.environment[i]


@cache
def make_scatter(query: str) -> wp.Kernel:
    """The kernel that copies the answer of a ray back to its place; lists of hits stay. Item: a place in the order."""
    copy = ANSWERS[query].stored.copy

    def scatter(first: int, order: wp.array(dtype=int), sorted_hits: HitBatch, hits: HitBatch):
        place = first + wp.tid()
        copy(sorted_hits, place, hits, order[place])

    return named_kernel(scatter, f"scatter_{query}")


for kind in batch_kinds():
    make_scatter(kind.name)


@exact_kernel
def count_buckets(first: int, chunk: int, bucket: wp.array(dtype=wp.uint16), counts: wp.array2d(dtype=int)):
    """Counts the rays of a chunk by bucket. Item: a chunk of rays. counts: (chunks, buckets), initially 0."""
    item = first + wp.tid()
    row = counts[item]
    for i in range(item * chunk, wp.min(bucket.shape[0], (item + 1) * chunk)):
        row[int(bucket[i])] += 1


def sort_buckets(bucket: wp.array, buckets: int) -> tuple[wp.array, list[int]]:
    """Sorts rays by bucket, stably. Returns ((rays,) int32 ray numbers, starts of the buckets followed by the end).

    Args:
        bucket: (rays,) uint16 bucket of each ray, below `buckets`.
        buckets: number of buckets.
    """
    device, count = bucket.device, len(bucket)
    chunk = CUDA_CHUNK if device.is_cuda else max(MIN_CHUNK, -(-count // (4 * get_num_threads())))
    chunks = -(-count // chunk)
    counts = wp.zeros((chunks, buckets), dtype=int, device=device)
    order = wp.empty(count, dtype=int, device=device)
    launch(count_buckets, chunks, [chunk, bucket, counts], device=device, chunk=1)
    launch(scan_counts, 1, [counts], device=device)
    begins = [*counts[0].numpy().tolist(), count] if chunks else [0] * (buckets + 1)  # positions; the only read-back
    launch(fill_order, chunks, [count, chunk, bucket, counts, order], device=device, chunk=1)
    return order, begins


def find_order(rays: RayBatch, low: wp.vec3, high: wp.vec3, device: wp.Device) -> wp.array:
    """The order in which to trace the rays: (rays,) int32 ray numbers, independent of the number of threads.

    Args:
        rays: the batch.
        low, high: the scene's box, relative to its centre.
        device: device of the rays.
    """
    count = rays.count
    chunk = max(MIN_CHUNK, -(-count // (4 * get_num_threads())))
    chunks = -(-count // chunk)
    scale = wp.vec3(*(8.0 / max(float(b) - float(a), 1e-30) for a, b in zip(low, high, strict=True)))
    bucket = wp.empty(count, dtype=wp.uint16, device=device)
    counts = wp.zeros((chunks, BUCKETS), dtype=int, device=device)
    order = wp.empty(count, dtype=int, device=device)
    launch(count_rays, chunks, [rays, chunk, low, scale, bucket, counts], device=device, chunk=1)
    launch(scan_counts, 1, [counts], device=device)
    launch(fill_order, chunks, [count, chunk, bucket, counts, order], device=device, chunk=1)
    return order


def sort_rays(rays: RayBatch, order: wp.array, empty: Callable[[int, type, wp.Device], wp.array]) -> RayBatch:
    """The rays in the given order; `empty(count, dtype, device)` allocates their arrays."""
    device, count = order.device, len(order)
    result = RayBatch()
    result.count, result.center = count, rays.center
    fields = {"origin": wp.vec3, "direction": wp.vec3, "t_min": wp.float32, "t_max": wp.float32, "mask": wp.uint32}
    fields["environment"] = wp.int32
    for name, dtype in fields.items():
        field = name + "s" if dtype is wp.vec3 else name
        stride = getattr(rays, f"{name}_stride")
        setattr(result, f"{name}_stride", stride)
        setattr(result, field, empty(count, dtype, device) if stride else getattr(rays, field))
    launch(gather_rays, count, [rays, order, result], device=device, chunk=4096)
    return result


def unsort_hits(order: wp.array, sorted_hits: HitBatch, hits: HitBatch, query: str) -> None:
    """Copies the results of sorted rays to the places of the original rays."""
    launch(make_scatter(query), len(order), [order, sorted_hits, hits], device=order.device, chunk=4096)

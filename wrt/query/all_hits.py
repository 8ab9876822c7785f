"""All hits of each ray: lists of different lengths, concatenated in one array (compressed sparse rows).

A traversal visits each ray once and stores up to `ROOM` of its hits, and their number, in slots of that ray. So the place
of a hit depends on no other ray, thread or chunk. The numbers are summed up, and the hits of each ray are sorted and copied
to their places. Rays with more hits are traced again once their numbers are known, so the number of hits is not limited.
Large batches are processed in blocks that share this work space.

On a CPU, one pass with a few slots is faster than counting all hits first and tracing all rays twice
(notebooks/records/2026-11-21-queries.md). Persistent threads do the latter: numbers are summed up where they are, and the
host reads their sum alone, to know how much memory to take.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Generic

import numpy as np
import warp as wp

from wrt.array_types import ArrayT
from wrt.engine.device_hits import DeviceHits, shaped
from wrt.engine.executor import on_device
from wrt.engine.facts.query_kinds import ALL, COUNT, Query
from wrt.engine.launch.batch import run
from wrt.engine.launch.traversal_launch import divide, kernel_and_inputs, no_work
from wrt.engine.memory import empty
from wrt.engine.plan.choices import find_plan
from wrt.engine.plan.plan import Plan, traversal_config, traversal_of
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.runtime.launch import launch, refuse_capture, use_threads
from wrt.kernels.traversal.capabilities import Capabilities
from wrt.kernels.traversal.traversal_config import PersistentConfig
from wrt.kernels.validation import as_int
from wrt.query.hits import Hits

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.rays.device_rays import DeviceRays
    from wrt.engine.rays.rays import Rays, ResultForm

ROOM = 8
"""Slots for hits of each ray in the first pass, 16 bytes each; 4 to 8 are best (notebooks/records/2026-11-21-queries.md)."""

BLOCK = 1 << 18
"""Rays of a block: within 5 % of the speed of larger blocks, for 32 MB of slots (notebooks/records/2026-11-21-queries.md)."""

MAX_TOTAL = (1 << 31) - 1
"""Largest number of hits in one result, the length of the longest array."""


class AllHits(Generic[ArrayT]):
    """All hits of a batch of rays, ray after ray and sorted by t, then geometry, then triangle.

    The hits of ray i of the flattened batch are the elements offsets[i] .. offsets[i + 1] - 1 of the arrays of M hits. The
    attributes are NumPy arrays if the rays were, else Warp arrays on the scene's device. What the traversal does not store
    is computed on first access.

    Attributes:
        offsets: (N + 1,) int64, index of each ray's first hit; the last is M.
        count: (...) int32, number of each ray's hits, in the rays' leading shape.
        t: (M,) float32, in units of the direction's length.
        primitive_id: (M,) int32, index of the triangle within its geometry.
        geometry_id: (M,) int32, index of the mesh within the scene.
        instance_id: (M,) int32, index of the instance, or of the mesh in a scene without instances.
        uv: (M, 2) float32, weights of the triangle's second and third vertex.
        ray_id: (M,) int32, index of the ray in the flattened batch.
        position: (M, 3), in the scene's coordinates, of the type of `Hits.position`.
        normal: (M, 3), unit vectors, float64 if the rays were, else float32, from the triangle's winding; 0 for a triangle
            without area.
        plan: how the query was answered (`wrt.results.Plan`).
    """

    def __init__(
        self,
        batch: DeviceHits,
        offsets: wp.array,
        form: ResultForm,
        scene: SceneState,
        plan: Plan,
    ) -> None:
        self.plan = plan
        self._offsets, self._form, self._num_threads = offsets, form, scene.num_threads
        self._flat: Hits[ArrayT] = Hits(batch, form._replace(shape=(batch.count,)), scene, plan)

    def __repr__(self) -> str:
        return f"AllHits({len(self)} hits of rays of shape {self.shape})"

    def __len__(self) -> int:
        """M, the number of hits of all rays."""
        return self._flat.batch.count

    @property
    def shape(self) -> tuple[int, ...]:
        """The rays' leading shape."""
        return self._form.shape

    @property
    def offsets(self) -> ArrayT:
        return shaped(self._offsets, self._form._replace(shape=self._offsets.shape))

    @cached_property
    def count(self) -> ArrayT:
        from wrt.kernels.query.hit_lists import count_listed

        counts = empty(self._offsets.size - 1, wp.int32, self._offsets.device)
        self._for_each_ray(count_listed, counts)
        return shaped(counts, self._form)

    @cached_property
    def ray_id(self) -> ArrayT:
        from wrt.kernels.query.hit_lists import number_rays

        numbers = empty(len(self), wp.int32, self._offsets.device)
        self._for_each_ray(number_rays, numbers)
        return shaped(numbers, self._form._replace(shape=numbers.shape))

    @property
    def t(self) -> ArrayT:
        return self._flat.t

    @property
    def primitive_id(self) -> ArrayT:
        return self._flat.primitive_id

    @property
    def geometry_id(self) -> ArrayT:
        return self._flat.geometry_id

    @property
    def instance_id(self) -> ArrayT:
        return self._flat.instance_id

    @property
    def uv(self) -> ArrayT:
        return self._flat.uv

    @property
    def position(self) -> ArrayT:
        return self._flat.position

    @property
    def normal(self) -> ArrayT:
        return self._flat.normal

    def _for_each_ray(self, kernel: wp.Kernel, out: wp.array) -> None:
        with use_threads(self._num_threads):
            launch(kernel, self._offsets.size - 1, [self._offsets, out], device=self._offsets.device, chunk=4096)


def check_max_hits(max_hits: int | None) -> int:
    """The limit on the hits of a ray; `MAX_TOTAL` for None.

    Raises:
        TypeError: not an int.
        ValueError: not positive.
    """
    if max_hits is None:
        return MAX_TOTAL
    max_hits = as_int("max_hits", max_hits)
    if max_hits < 1:
        raise ValueError(f"max_hits is {max_hits}; it must be at least 1, or None for all hits")
    return min(max_hits, MAX_TOTAL)


def list_hits(scene: SceneState, rays: Rays, query: Query) -> AllHits:
    """All hits of rays; see `wrt.Scene.intersect_all`."""
    refuse_capture("intersect_all", scene.device)
    scene.require("count")
    bound = check_max_hits(query.max_hits)
    with use_threads(scene.num_threads):
        buffers = on_device(scene, rays, query)
        plan = find_plan(scene, buffers.facts, query, buffers.sample).plan
        if Capabilities.PERSISTENT in traversal_of(plan).capabilities:
            hits, offsets = find_counted(scene, plan, buffers, bound)
        else:
            hits, offsets = find_all(scene, plan, buffers.batch, bound)
    return AllHits(hits, offsets, buffers.form, scene, plan)


def find_all(scene: SceneState, plan: Plan, rays: RayBatch, max_hits: int) -> tuple[DeviceHits, wp.array]:
    """All hits of the rays, at most the `max_hits` nearest of each: (hits, (N + 1,) int64 offsets).

    Raises:
        ValueError: more than `MAX_TOTAL` hits.
    """
    begins = range(0, max(rays.count, 1), BLOCK)
    blocks = [find_block(scene, plan, part_of(rays, begin, min(begin + BLOCK, rays.count)), max_hits) for begin in begins]
    if len(blocks) == 1:
        (hits, offsets), device = blocks[0], scene.device
        return hits, wp.array(offsets, dtype=wp.int64, device=device, copy=False)
    return join_blocks(blocks, scene.device)


def find_counted(scene: SceneState, plan: Plan, rays: DeviceRays, max_hits: int) -> tuple[DeviceHits, wp.array]:
    """As `find_all`, in two passes: the first one counts the hits, the second one writes each to its ray's list."""
    from wrt.kernels.query.hit_lists import gather_hits, sort_lists

    device, batch, count = scene.device, rays.batch, rays.facts.count
    idle, counted, lists = no_work(traversal_of(plan).counters, device.alias), DeviceHits.new(COUNT, count, device), HitBatch()
    from_zero = PersistentConfig(rays.layout.from_zero)
    configs = [replace(traversal_config(plan, scene, query, False), persistent=from_zero) for query in (COUNT, ALL)]
    items = divide(scene, plan, configs[0], count)[1]
    kernel, inputs = kernel_and_inputs(scene, plan, configs[0], batch, counted.struct(), idle)
    launch(kernel, items, inputs, device=device, chunk=1024)
    kernel, inputs = kernel_and_inputs(scene, plan, configs[1], batch, lists, idle)  # while the first pass runs
    offsets, begins, total = sum_on_device(counted.counts, MAX_TOTAL)
    hits = DeviceHits.lists(0, total, 0, device)
    lists.t, lists.primitive, lists.uv, lists.counts, lists.begins = hits.t, hits.primitive, hits.uv, counted.counts, begins
    launch(kernel, items, inputs, device=device, chunk=1024)
    if max_hits == MAX_TOTAL:
        launch(sort_lists, count, [lists], device=device, chunk=1024)
        return hits, offsets
    offsets, _, total = sum_on_device(counted.counts, max_hits)
    nearest, order = DeviceHits.lists(0, total, 0, device), wp.empty(0, dtype=int, device=device)
    launch(gather_hits, count, [lists, order, offsets, nearest.struct()], device=device, chunk=1024)
    return nearest, offsets


def sum_on_device(counts: wp.array, max_length: int) -> tuple[wp.array, wp.array, int]:
    """Where the lists of rays begin, by the number of their hits, of which each holds at most `max_length`.

    Returns:
        (N + 1,) int64: the first index of each list, and the end of the last; (N,) int32, the same without the end; the end.

    Raises:
        ValueError: more than `MAX_TOTAL` elements.
    """
    from wrt.kernels.query.hit_lists import lengths_of_lists, narrow_offsets

    device, count = counts.device, counts.size
    lengths, offsets = empty(count + 1, wp.int64, device), empty(count + 1, wp.int64, device)
    launch(lengths_of_lists, count + 1, [counts, max_length, lengths], device=device, chunk=4096)
    wp.utils.array_scan(lengths, offsets, inclusive=False)
    begins = empty(count, wp.int32, device)
    launch(narrow_offsets, count, [offsets, begins], device=device, chunk=4096)
    total = int(offsets[count:].numpy()[0])
    check_total(total)
    return offsets, begins, total


def check_total(total: int) -> None:
    """Refuses more hits than a result holds.

    Raises:
        ValueError: more than `MAX_TOTAL`.
    """
    if total > MAX_TOTAL:
        raise ValueError(
            f"these rays have {total:,} hits or more, and one result holds {MAX_TOTAL:,}; pass fewer rays at a "
            "time, or limit the hits of each ray with max_hits"
        )


def find_block(scene: SceneState, plan: Plan, rays: RayBatch, max_hits: int) -> tuple[DeviceHits, np.ndarray]:
    """All hits of the rays of a block, and their offsets."""
    from wrt.kernels.query.hit_lists import gather_hits
    from wrt.kernels.query.ordering.ray_order import find_order, sort_rays, unsort_hits

    device = scene.device
    order = wp.empty(0, dtype=int, device=device)
    room = 0 if scene.instances else ROOM  # of instances, hits are counted before they are listed
    found = DeviceHits.lists(rays.count, rays.count * room, room, device)
    counts = found.counts
    if plan.reorder == "cells":
        order = find_order(rays, scene.tree.low, scene.tree.high, device)
        trace_lists(scene, plan, sort_rays(rays, order, empty), found)
        in_order = DeviceHits.lists(rays.count, 0, 0, device)
        unsort_hits(order, found.struct(), in_order.struct(), ALL)
        counts = in_order.counts
    else:
        trace_lists(scene, plan, rays, found)
    numbers = counts.numpy()  # the host must know how much memory to take
    offsets = sum_up(np.minimum(numbers, max_hits))
    hits = DeviceHits.lists(0, int(offsets[-1]), 0, device)
    device_offsets = wp.array(offsets, dtype=wp.int64, device=device, copy=False)
    if room:
        launch(gather_hits, rays.count, [found.struct(), order, device_offsets, hits.struct()], device=device, chunk=1024)
    crowded = np.flatnonzero(numbers > room).astype(np.int32)
    if len(crowded):
        begins = sum_up(numbers[crowded])
        order = wp.array(crowded, dtype=int, device=device)
        found = DeviceHits.lists(len(crowded), int(begins[-1]), 0, device)
        found.begins = wp.array(begins[:-1].astype(np.int32), dtype=int, device=device)
        trace_lists(scene, plan, sort_rays(rays, order, empty), found)
        launch(gather_hits, len(crowded), [found.struct(), order, device_offsets, hits.struct()], device=device, chunk=64)
    return hits, offsets


def trace_lists(scene: SceneState, plan: Plan, rays: RayBatch, found: DeviceHits) -> None:
    """Traces the rays in the given order. Without slots or places for lists, hits are only counted."""
    query = ALL if found.room or found.begins is not None else COUNT
    run(scene, plan, rays, found, query, no_work(traversal_of(plan).counters, scene.device.alias), False)


def sum_up(counts: np.ndarray) -> np.ndarray:
    """(N + 1,) int64: the first index of each of N lists, and the end of the last.

    Raises:
        ValueError: more than `MAX_TOTAL` elements.
    """
    offsets = np.zeros(len(counts) + 1, dtype=np.int64)
    np.cumsum(counts, dtype=np.int64, out=offsets[1:])
    check_total(int(offsets[-1]))
    return offsets


def join_blocks(blocks: list[tuple[DeviceHits, np.ndarray]], device: wp.Device) -> tuple[DeviceHits, wp.array]:
    """Concatenates the lists of several blocks."""
    starts = sum_up(np.array([offsets[-1] for _, offsets in blocks]))
    hits = DeviceHits.lists(0, int(starts[-1]), 0, device)
    for (part, _), start in zip(blocks, starts[:-1], strict=True):
        for name in ("t", "primitive", "uv"):
            if part.count:
                wp.copy(getattr(hits, name), getattr(part, name), dest_offset=int(start))
    offsets = np.concatenate([[0], *(own[1:] + start for (_, own), start in zip(blocks, starts[:-1], strict=True))])
    return hits, wp.array(offsets, dtype=wp.int64, device=device, copy=False)


def part_of(rays: RayBatch, begin: int, end: int) -> RayBatch:
    """The rays begin .. end - 1 of a batch, without a copy; the batch itself if these are all."""
    if end - begin == rays.count:
        return rays
    part = RayBatch()
    part.count, part.center = end - begin, rays.center
    for name, field in (
        ("origin", "origins"),
        ("direction", "directions"),
        ("t_min", "t_min"),
        ("t_max", "t_max"),
        ("mask", "mask"),
    ):
        stride, values = getattr(rays, f"{name}_stride"), getattr(rays, field)
        setattr(part, f"{name}_stride", stride)
        setattr(part, field, values[begin:end] if stride else values)
    return part

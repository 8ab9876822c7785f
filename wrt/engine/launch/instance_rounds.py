"""Many rays through a scene of instances in streams, round by round (`wrt.kernels.traversal.two_level.instance_streams`).

A round lists the next instances of each ray, sorts the rays by instance, traces each group through its mesh, and merges the
hits. notebooks/records/2026-11-21-instances.md compares that with packets, with single rays and with flattened scenes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from wrt.engine.device_hits import DeviceHits
from wrt.engine.launch.traversal_launch import counter_rows, no_work, run_kernel
from wrt.engine.memory import empty, new_rays
from wrt.engine.plan.plan import Plan, traversal_config, traversal_of
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.runtime.launch import get_num_threads, launch, specialise

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState
    from wrt.kernels.traversal.two_level.instance_streams import Sorted

CHUNKS_PER_THREAD = 4

MIN_CHUNK = 1 << 12
"""Smallest number of rays of a chunk, for which a row of counts pays."""

BLOCK = 1 << 20
"""Rays of a block, whose lists and copies take about 150 MB."""

MIN_ROUND_SHARE = 1 / 16
"""Smallest share of the rays for which a round pays. If fewer are left, they are traced one at a time, from their start."""

SEGMENT = 1024
"""Rays of a segment, the smallest unit that threads share out."""


def trace_rounds(scene: SceneState, plan: Plan, rays: RayBatch, hits: DeviceHits, query: str) -> None:
    """Answers the query "closest", "any" or "count" for rays on the CPU.

    Args:
        scene: a scene of instances with BVHs.
        plan: a plan for streams.
        rays: the batch.
        hits: receives the answers.
        query: the query.
    """
    hits.clear(query)
    for begin in range(0, rays.count, BLOCK):
        rounds = Rounds(scene, plan, rays, query, begin)
        rounds.list_instances(again=False)
        while rounds.trace_lists(hits):
            rounds.list_instances(again=True)


class Rounds:
    """The rounds of one block of a batch, from the ray `begin` on."""

    def __init__(self, scene: SceneState, plan: Plan, rays: RayBatch, query: str, begin: int) -> None:
        from wrt.kernels.traversal.two_level.instance_streams import MAX_LISTED, Search, make_stream_kernel

        self.scene, self.plan, self.rays, self.query, self.device = scene, plan, rays, query, scene.device
        config = traversal_config(plan, scene, query, False)
        self.kernel = specialise(make_stream_kernel, config)
        self.segment = max(SEGMENT, plan.stream)
        self.top, self.lower = scene.upper(), scene.lower(plan, rays)
        self.work = counter_rows(no_work(traversal_of(plan).counters, self.device.alias))
        self.count = min(BLOCK, rays.count - begin)
        self.chunk = max(MIN_CHUNK, -(-self.count // (CHUNKS_PER_THREAD * get_num_threads())))
        self.search = Search()
        self.search.begin = begin
        self.search.bound = empty(self.count, wp.float32, self.device)
        self.search.size = empty(self.count, wp.int32, self.device)
        self.search.instance = empty(MAX_LISTED * self.count, wp.int32, self.device)
        self.search.entry = empty(MAX_LISTED * self.count, wp.float32, self.device)

    def list_instances(self, again: bool) -> None:
        """Lists the first instances on each ray, or the next ones of rays whose list was full."""
        from wrt.kernels.traversal.two_level.instance_streams import make_list_instances

        levels = 1 << (self.scene.tree.depth - 1).bit_length()  # few specialisations serve all trees
        kernel = make_list_instances(self.scene.tree.width, levels)
        inputs = [self.top, self.rays, again, self.search]
        launch(kernel, self.count, inputs, device=self.device, chunk=1024)

    def trace_lists(self, hits: DeviceHits) -> bool:
        """Traces a round for each place of the lists. Returns whether some lists may have been too short."""
        from wrt.kernels.traversal.two_level.instance_streams import MAX_LISTED

        return all(self.trace_round(turn, hits) for turn in range(MAX_LISTED))

    def trace_round(self, turn: int, hits: DeviceHits) -> bool:
        """Traces the rays through their instances of this round. Returns whether there were any."""
        from wrt.kernels.query.ordering.ray_order import scan_counts
        from wrt.kernels.traversal.two_level.instance_streams import count_instances, make_round_merge, sort_by_instance

        chunks = -(-self.count // self.chunk)
        counts = wp.zeros((chunks, len(self.top.placements)), dtype=int, device=self.device)
        inputs = [self.chunk, turn, self.search, counts]
        launch(count_instances, chunks, inputs, device=self.device, chunk=1)
        totals = counts.numpy().sum(axis=0)
        count = int(totals.sum())
        if count == 0:
            return False
        launch(scan_counts, 1, [counts], device=self.device)
        sorted_rays, found = new_sorted(count, self.device), DeviceHits.new(self.query, count, self.device).struct()
        launch(sort_by_instance, chunks, [self.top, self.rays, *inputs, sorted_rays], device=self.device, chunk=1)
        if count < MIN_ROUND_SHARE * self.count:
            self.trace_single_rays(sorted_rays.order, hits)
            return False
        segments = wp.array(cut(totals, self.segment), dtype=wp.vec3i, device=self.device)
        work = [segments, self.top.placements, self.lower, sorted_rays.rays, found, self.work]
        launch(self.kernel, len(segments), work, device=self.device, chunk=1)
        work = [self.top.placements, sorted_rays, found, self.search, hits.struct()]
        launch(make_round_merge(self.query), count, work, device=self.device, chunk=4096)
        return True

    def trace_single_rays(self, order: wp.array, hits: DeviceHits) -> None:
        """Traces the rays with these numbers one at a time, ignoring what was found before."""
        from wrt.kernels.query.ordering.ray_order import sort_rays, unsort_hits

        rays, found = sort_rays(self.rays, order, empty), DeviceHits.new(self.query, len(order), self.device)
        plan = replace(self.plan, traversal="single")
        idle = no_work(traversal_of(plan).counters, self.device.alias)
        run_kernel(self.scene, plan, rays, found, self.query, idle, False)
        unsort_hits(order, found.struct(), hits.struct(), self.query)


def new_sorted(count: int, device: wp.Device) -> Sorted:
    """Memory for the rays of a round."""
    from wrt.kernels.traversal.two_level.instance_streams import Sorted

    result = Sorted()
    result.rays = new_rays(count, device)
    result.order, result.instance = empty(count, wp.int32, device), empty(count, wp.int32, device)
    return result


def cut(totals: np.ndarray, segment: int) -> np.ndarray:
    """(S, 3) int32: instance, first ray and end of each segment; totals: number of rays of each instance, stored in that
    order.
    """
    ends = np.cumsum(totals)
    pieces = -(-totals // segment)
    instance = np.repeat(np.arange(len(totals)), pieces)
    number = np.arange(len(instance)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    begin = (ends - totals)[instance] + number * segment
    return np.stack([instance, begin, np.minimum(begin + segment, ends[instance])], axis=1).astype(np.int32)

"""Traces rays that are relative to the scene's centre and lie in device memory: the rays of a wave.

They need no conversion, no check and no test for coherence, because the integrator made them and knows what they are.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import warp as wp

from wrt.engine.device_hits import DeviceHits
from wrt.engine.executor import trace_chosen
from wrt.engine.facts.facts import RayFacts
from wrt.engine.facts.query_kinds import ANY, AUTO, CLOSEST, Query
from wrt.engine.facts.scene_state import SceneState
from wrt.engine.launch.traversal_launch import RAYS, kernel_and_inputs, no_work
from wrt.engine.plan.choices import find_plan, is_changing
from wrt.engine.plan.plan import ChosenPlan, config_for_layout, traversal_config, traversal_of
from wrt.engine.plan.plan_checks import can_answer
from wrt.engine.rays.device_rays import DeviceRays, Layout
from wrt.engine.rays.rays import ResultForm
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime import pool as native
from wrt.kernels.runtime.launch import kept
from wrt.kernels.runtime.launch_chain import Stage
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.capabilities import Capabilities

STREAM = 2048
"""Rays of a stream at most, where tiles of them stay in the cache."""

INCOHERENT = "stream", "interleaved"
"""Traversals of incoherent rays. Which is faster depends on how incoherent they are, and on how many are left of a tile
(notebooks/records/2026-11-23-light-tiles.md)."""

TOGETHER = "packet"
"""The traversal of similar rays. Whether they are similar enough depends on the scene; no sample of them is needed if the other
way is tried, too."""

MIN_TRIANGLES = 1024
"""Triangles of a scene from which either may be the faster one. With fewer, streams are if the plan says so; if it does not,
they may be (notebooks/records/2026-11-23-last-generation.md)."""

ROUND = 1 << 12
"""Plans are made for numbers of rays rounded up to a power of two, not below this, so that few are made."""


class TileRays(NamedTuple):
    """Rays that a chain traces tile by tile.

    Attributes:
        origins, directions: (N,) vec3 as in `RayTracer.closest`; origins (1,) if all are the same.
        count: rays that there may be; plans are made for so many.
        tile: rays of a tile.
        similar: whether neighbouring rays are similar.
        are_segments: whether rays end at t = 1, as those of `RayTracer.blocked` do.
    """

    origins: wp.array
    directions: wp.array
    count: int  # type: ignore[assignment]
    tile: int
    similar: bool = False
    are_segments: bool = False


class RayTracer:
    """Closest hits and occlusion in one state of a scene.

    Args:
        state: the scene's.
        traversal, triangle_test: as in `Scene.intersect`.
    """

    def __init__(self, state: SceneState, traversal: str, triangle_test: str) -> None:
        self._state = state
        self._queries = {kind: Query(kind, traversal, triangle_test) for kind in (CLOSEST, ANY)}
        with kept(state.device):
            self._zero, self._one, self._infinity = (
                wp.array(np.array([value], np.float32), dtype=float, device=state.device) for value in (0.0, 1.0, np.inf)
            )

    def closest(
        self, origins: wp.array, directions: wp.array, count: int, *, similar: bool = False, from_one_point: bool = False
    ) -> DeviceHits:
        """Closest hits of the first `count` rays.

        Args:
            origins, directions: (>= count,) vec3; origins relative to the scene's centre.
            count: number of rays.
            similar: whether neighbouring rays are similar.
            from_one_point: whether all rays start at `origins[0]`.
        """
        return self._trace(CLOSEST, origins, directions, count, self._infinity, similar, from_one_point)

    def blocked(self, origins: wp.array, segments: wp.array, count: int, *, similar: bool = False) -> wp.array:
        """(count,) bool: whether anything is between the two ends of segments; False for segments of length 0."""
        return self._trace(ANY, origins, segments, count, self._one, similar, False).occluded

    def blocked_from_points(
        self, origins: wp.array, directions: wp.array, count: int, distance: wp.array, expected: RayFacts
    ) -> wp.array:
        """(count,) bool: whether rays in all directions from points that follow one another hit anything.

        Args:
            origins, directions, count: as in `closest`.
            distance: (1,) float32, the length of all rays in units of their directions.
            expected: the most rays that there can be; the plan is made for them, so that batches of any size have the same.
        """
        rays = self._rays(origins, directions, count, distance, False, False)
        chosen = find_plan(self._state, expected, self._queries[ANY])
        return trace_chosen(self._state, chosen, rays, ANY)[0].occluded

    def _trace(
        self, kind: str, origins: wp.array, directions: wp.array, count: int, t_max: wp.array, similar: bool, shared: bool
    ) -> DeviceHits:
        rays = self._rays(origins, directions, count, t_max, similar, not similar, shared)
        return trace_chosen(self._state, self._plan(rays, self._queries[kind]), rays, kind)[0]

    def _plan(self, rays: DeviceRays, query: Query) -> ChosenPlan:
        return find_plan(self._state, rays.facts, query, rays.sample)

    def _rays(
        self,
        origins: wp.array,
        directions: wp.array,
        count: int,
        t_max: wp.array,
        coherent: bool,
        scattered: bool,
        shared: bool = False,
    ) -> DeviceRays:
        shape, kept = (max(ROUND, 1 << (count - 1).bit_length()),), (origins, directions)
        layout, center = Layout(int(not shared), 1, 0, 0, True), self._state.center
        facts, form = RayFacts(count, shape, shared, coherent, scattered), ResultForm(shape, True, np.float32)
        return DeviceRays(origins, directions, self._zero, t_max, layout, center, facts, form, kept)

    def makes_stages(self, count: int) -> bool:
        """Whether rays of all kinds can be traced tile by tile: see `stages`. Not where a plan orders many rays at once (as
        similar rays go through instances), and where it may change."""
        state = self._state
        if (
            not native.is_available() or not state.device.is_cpu or state.device.is_capturing
        ):  # chains are as native as the pool
            return False
        if state.instances or state.area_trees is not None:
            return False
        for query in self._queries.values():
            rays = RayFacts(count, (count,), coherent=False, scattered=True)
            if is_changing(state, count) or not find_plan(state, rays, query).prepares:
                return False
        return True

    def stages(
        self,
        kind: str,
        traced: TileRays,
        hits: HitBatch,
        *,
        sample: tuple[wp.array, wp.array] | None = None,
        counts: wp.array | None = None,
    ) -> list[Stage]:
        """The tracing of rays as a stage of a chain, in one or two ways.

        Args:
            kind: "closest" or "any".
            traced: the rays. Where neighbouring ones are similar, the way is chosen by `sample`, or by speed if there is none.
            hits: what is written.
            sample: origins and directions of such rays, at least `traced.count` of them.
            counts: as in `Stage`.
        """
        origins, directions, count, tile, similar, are_segments = traced
        end, shared = self._one if are_segments else self._infinity, len(origins) < len(directions)
        rays = self._rays(origins, directions, count, end, similar, not similar, shared)
        known = rays if sample is None else self._rays(*sample, count, end, similar, not similar, shared)
        query, state = self._queries[kind], self._state
        by_speed = query.traversal == AUTO and (not similar or sample is None)
        scattered = self._rays(origins, directions, count, end, False, True, shared) if by_speed else known
        plan = self._plan(scattered, query).carried_out
        plans = [plan]
        if by_speed and similar:
            if can_answer(TRAVERSALS[TOGETHER], state.facts, kind, False):
                plans.insert(0, self._plan(rays, query._replace(traversal=TOGETHER)).carried_out)
        elif by_speed and plan.traversal in INCOHERENT[state.triangle_count < MIN_TRIANGLES :]:  # all, or all but streams
            plans += [replace(plan, traversal=name) for name in INCOHERENT if name != plan.traversal]
        made = []
        for plan in plans:
            batch = rays.new_batch()  # one for each plan, as the rays per item differ
            traversal = traversal_of(plan)
            streams = Capabilities.STREAMS in traversal.capabilities
            if streams:
                plan = replace(plan, stream=min(plan.stream, STREAM))
            config = config_for_layout(traversal_config(plan, self._state, kind, False), plan, self._state)
            run = tile if streams else traversal.rays_per_item(config)
            batch.run = min(run, tile) if Capabilities.LONG_ITEMS in traversal.capabilities else run
            work = no_work(traversal.counters, self._state.device.alias)
            kernel, inputs = kernel_and_inputs(self._state, plan, config, batch, hits, work)
            made.append(Stage(kernel, inputs, batch.run, (RAYS, "count"), counts))
        return made

"""Rays on their way through the parts of a scene.

A ray carries all that it needs: the closest hit so far, which shortens it, or the number of crossings. In a part it is an
ordinary ray, so every traversal and triangle test gives the hits of the whole scene
(`wrt.kernels.query.part_queries`).
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import warp as wp

from wrt.engine.executor import trace_chosen
from wrt.engine.facts.query_kinds import AUTO
from wrt.engine.memory import new_rays
from wrt.engine.plan.choices import find_plan
from wrt.engine.plan.plan import stack_levels
from wrt.engine.plan.planner import default_test
from wrt.engine.rays.device_rays import DeviceRays
from wrt.kernels.answers import ANSWERS
from wrt.kernels.query.part_queries import make_gather, make_part_merge
from wrt.kernels.runtime.launch import launch
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.triangle import TRIANGLE_TESTS

if TYPE_CHECKING:
    from wrt.disk.part_cache import PartCache
    from wrt.engine.facts.query_kinds import Query
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.plan.plan import ChosenPlan, Plan
    from wrt.kernels.layout.bvh_nodes import WideNodes
    from wrt.kernels.layout.ray_batch import HitBatch, RayBatch

CHUNK = 1024
"""Rays that are worth a chunk of their own."""


class UpperTree(NamedTuple):
    """The tree over the boxes of the parts.

    Attributes:
        nodes: its nodes; a leaf has the number of its part in the place of its first block.
        width, levels: children of a node, and levels of a stack for it.
    """

    nodes: WideNodes
    width: int
    levels: int


class RayJob:
    """Rays of a block on their way through the parts.

    Args:
        cache: the parts.
        upper: the tree over them.
        query: kind "closest", "any" or "count", and how parts are traced.
        rays: the block.
        coherent: whether neighbouring rays are similar.
        hits: receives the answers; those of rays that miss everything.
        corners: (3 N,) receives the corners of the triangles of closest hits.
        expected_bytes: (P,) memory of each part with the records of the query.
    """

    def __init__(
        self,
        cache: PartCache,
        upper: UpperTree,
        query: Query,
        rays: RayBatch,
        coherent: bool,
        hits: HitBatch,
        corners: wp.array,
        expected_bytes: np.ndarray,
    ) -> None:
        self.cache, self.upper, self.query, self.rays, self.coherent = cache, upper, query, rays, coherent
        self.hits, self.corners, self.expected_bytes = hits, corners, expected_bytes
        self.device, self.parts = cache.settings.device, len(cache.parts)
        by_tree = query.traversal == AUTO or TRAVERSALS[query.traversal].walks_tree
        test = (
            default_test(cache.settings.triangle_test, ANSWERS[query.kind].rules.crossings)
            if query.triangle_test == AUTO
            else query.triangle_test
        )
        self.record = TRIANGLE_TESTS[test].record if by_tree else None
        self.plan: Plan | None = None
        self._plans: dict[Hashable, ChosenPlan] = {}
        self.visits = self.traced = 0

    def gathered(self, order: wp.array) -> RayBatch:
        """Copies of the rays of a list, shortened to their best hits."""
        rays = new_rays(len(order), self.device)
        inputs = [self.rays, self.hits, order, rays]
        launch(make_gather(self.query.kind), len(order), inputs, device=self.device, chunk=CHUNK)
        return rays

    def trace(self, number: int, order: wp.array, rays: RayBatch) -> None:
        """Traces rays in a part, and merges what they find.

        Args:
            number: of the part.
            order: numbers of the rays.
            rays: copies of them (`gathered`).
        """
        part = self.cache.part(number, int(self.expected_bytes[number]), self.record)
        count, kind = len(order), self.query.kind
        known = self._known(rays)
        chosen = self._plan_for(part.state, known)
        found, _ = trace_chosen(part.state, chosen, known, kind)
        for prepared in chosen.prepared.items():
            prepared.let_go()  # of the part, which may leave memory
        inputs = [order, part.state.device_mesh, part.ids, found.struct(), self.hits, self.corners]
        launch(make_part_merge(kind), count, inputs, device=self.device, chunk=CHUNK)
        self.plan = self.plan or chosen.plan
        self.visits += 1
        self.traced += count
        self.cache.note_use(number)

    def _known(self, rays: RayBatch) -> DeviceRays:
        """Copies of rays: on the CPU with the layout of their arrays, so that queries about them are prepared."""
        known = DeviceRays.of_batch(rays, self.coherent, False)
        if self.device.is_cpu:
            del known.batch
        return known

    def _plan_for(self, state: SceneState, rays: DeviceRays) -> ChosenPlan:
        """The plan of a part's rays. On the CPU, parts and rays of similar numbers share a plan and what is prepared for it: to
        choose one and to prepare it takes Python longer than to trace some thousand rays."""
        if not self.device.is_cpu:
            return find_plan(state, rays.facts, self.query, rays.sample)
        sizes = rays.count.bit_length(), state.triangle_count.bit_length()
        key = *sizes, rays.count <= state.few_rays, stack_levels(state.depth)
        chosen = self._plans.get(key)
        if chosen is None:
            chosen = find_plan(state, rays.facts, self.query, rays.sample)
            if chosen.carried_out.accelerator == "bvh":
                self._plans[key] = chosen
        return chosen

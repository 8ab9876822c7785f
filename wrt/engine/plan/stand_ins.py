"""Stand-ins: single rays in place of a plan whose kernel is not compiled.

Kernels of packets and streams take several times as long to compile as that of single rays
(notebooks/records/2026-11-28-kernels-later.md), and all have the same hits. So the first calls of a kind go by single rays. The
kernel that they miss is compiled by another process once they have taken a while (`wrt.kernels.compilation.compile_later`), and
takes over when it is there.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from wrt.engine.facts.query_kinds import AUTO, Query
from wrt.engine.plan.plan import ChosenPlan, Plan, config_for_layout, kernel_factory, traversal_config, traversal_of
from wrt.engine.plan.plan_checks import can_answer
from wrt.engine.plan.planner import choose_plan, chosen_plan
from wrt.kernels.compilation.compile_later import MissingKernel, is_possible, missing_kernel
from wrt.kernels.runtime.launch import needs_no_compiling, specialise
from wrt.kernels.traversal import TRAVERSALS

if TYPE_CHECKING:
    from wrt.engine.facts.facts import RayFacts
    from wrt.engine.facts.scene_state import SceneState

SINGLE = "single"
"""The traversal that stands in for others."""

MAX_RAYS = 1 << 22
"""Most rays of a call that does without a kernel: more take as long by single rays as the kernel takes to compile."""


class StandIn(NamedTuple):
    """What carries out calls now.

    Attributes:
        chosen: the plan.
        missing: the kernel that it does without; None if the plan is that of the rules.
    """

    chosen: ChosenPlan
    missing: MissingKernel | None = None


def plan_for_now(scene: SceneState, rays: RayFacts, query: Query, chosen: ChosenPlan) -> StandIn:
    """The plan of the rules, or while its kernel is not compiled, that of single rays.

    Args:
        scene: what the rays meet.
        rays: what is known of the rays; many enough for calls to be measured.
        query: its kind and options.
        chosen: the plan of the rules.
    """
    plan = chosen.carried_out
    if not may_stand_in(scene, rays, query, plan) or not (chosen.prepares and is_possible()):
        return StandIn(chosen)
    factory = kernel_factory(plan, scene)
    config = config_for_layout(traversal_config(plan, scene, query.kind, False), plan, scene)
    kernel = specialise(factory, config)
    if needs_no_compiling(kernel, scene.device):
        return StandIn(chosen)
    alone = choose_plan(scene, rays, query._replace(traversal=SINGLE))
    alone = replace(alone, reason=f"{chosen.plan.reason}, but the kernel for {chosen.name} is not compiled")
    return StandIn(chosen_plan(scene, alone, rays.count, query.kind), missing_kernel(factory, config, kernel))


def may_stand_in(scene: SceneState, rays: RayFacts, query: Query, plan: Plan) -> bool:
    """Whether single rays can carry out a query in place of a plan, in about the time that compiling takes."""
    if traversal_of(plan).walks_single_rays or query.traversal != AUTO or rays.count > MAX_RAYS:
        return False
    if not scene.is_cpu or scene.instances or scene.facts.points:
        return False
    return can_answer(TRAVERSALS[SINGLE], scene.facts, query.kind, query.cull_backfaces, plan.triangle_test)

"""Choices: the plan of "auto" for rays of a kind, kept with the scene, and where calls are measured, what they have told.

Plans are made by rules (`wrt.engine.plan.planner`). For many rays on the CPU, a `wrt.engine.plan.contest.Contest` then compares
the plan with its rivals, unless `set_auto` leaves the choice to the rules.
"""

from __future__ import annotations

import os
from collections.abc import Hashable
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from wrt.engine.facts.query_kinds import AUTO, Query
from wrt.engine.plan.contest import Contest, learner_of
from wrt.engine.plan.plan import ChosenPlan, Plan
from wrt.engine.plan.plan_checks import check_plan
from wrt.engine.plan.planner import choose_plan, chosen_plan
from wrt.engine.plan.stand_ins import plan_for_now
from wrt.kernels.runtime.launch import get_num_threads
from wrt.kernels.traversal.traversal_scores import MIN_SAMPLED
from wrt.tables import one_of

if TYPE_CHECKING:
    from wrt.engine.facts.facts import RayFacts
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.plan.planner import Sample
    from wrt.engine.rays.device_rays import DeviceRays

MEASURED, RULES = "measured", "rules"
"""How "auto" chooses: by rules and then by what calls take, or by rules alone."""

VARIABLE = "WRT_AUTO"

CHOICE_USES = 64
"""Queries after which a choice for many rays is made again: it may depend on a sample of the rays, and a camera moves. A sample
takes some 0.2 ms (notebooks/records/2026-11-22-auto.md).
"""

MAX_SHARED = 256
"""Plans of few rays that scenes share: more than there are kinds of queries in one program."""

_few_ray_plans: dict[Hashable, Plan] = {}
"""Plans by kind of query, of rays and of scene: few rays go one by one, however many triangles there are."""

_auto: str | None = None


class Choice(NamedTuple):
    """What queries of a kind do with rays of a kind.

    Attributes:
        chosen: the plan by the rules, or as given.
        contest: what compares it with others; None if nothing does.
    """

    chosen: ChosenPlan
    contest: Contest | None = None


def get_auto() -> str:
    """How "auto" chooses between engines: `set_auto`, else WRT_AUTO, else "measured".

    Raises:
        ValueError: WRT_AUTO is neither "measured" nor "rules".
    """
    return _auto or one_of((MEASURED, RULES), os.environ.get(VARIABLE, "").strip() or MEASURED, VARIABLE)


def set_auto(how: str | None) -> None:
    """Sets how "auto" chooses between engines, whose hits are the same.

    Args:
        how: "measured": by rules at first, and by the time that calls of many rays take, so that two runs of a program may use
            different engines; "rules": by rules alone, so that the same calls always use the same engines; None restores the
            default.

    Raises:
        TypeError: not a string.
        ValueError: another string.
    """
    global _auto
    _auto = None if how is None else one_of((MEASURED, RULES), how, "how")


def make_plan(
    scene: SceneState,
    rays: DeviceRays,
    traversal: str | Plan,
    triangle_test: str,
    query: str,
    cull_backfaces: bool = False,
) -> Plan:
    """Chooses what the caller left on "auto". A given plan is checked.

    Raises:
        ValueError: an unknown name, a traversal that does not support the scene's tree or the query, or a plan that does
            not fit the scene and the rays.
    """
    return find_plan(scene, rays.facts, Query(query, traversal, triangle_test, cull_backfaces), rays.sample).plan


def find_plan(scene: SceneState, rays: RayFacts, query: Query, sample: Sample | None = None) -> ChosenPlan:
    """The plan of a query, from the scene's cache or made, for callers that measure nothing; errors as in `make_plan`.

    Args:
        scene: what the rays meet.
        rays: what is known of them.
        query: its kind and options.
        sample: makes a batch of which some rays may be traced, if only that can tell how; None if there are no rays yet.
    """
    choice = find_choice(scene, rays, query, sample)
    if choice.contest is None or choice.contest.missing is not None:  # who does not tell what calls take, waits for kernels
        return choice.chosen
    return choice.contest.best(scene)


def current_plan(scene: SceneState, rays: RayFacts, query: Query) -> ChosenPlan:
    """The plan of the next call of a query that is measured, if it can be; arguments and errors as in `find_plan`."""
    chosen = chosen_plan(scene, choose_plan(scene, rays, query), rays.count, query.kind)
    return plan_for_now(scene, rays, query, chosen).chosen if is_measured(scene, rays, query) else chosen


def find_choice(scene: SceneState, rays: RayFacts, query: Query, sample: Sample | None = None) -> Choice:
    """The plan of a query and what compares it with others; arguments and errors as in `find_plan`."""
    kind, traversal, triangle_test, cull_backfaces = query[:4]
    count = rays.count
    if isinstance(traversal, Plan):
        return given_choice(scene, rays, query, traversal)
    is_named = isinstance(traversal, str) and isinstance(triangle_test, str)
    if not is_named or (scene.changes_plans and is_changing(scene, count)):
        return Choice(chosen_plan(scene, choose_plan(scene, rays, query, sample), count, kind))
    # Plans are looked up: the longer Python takes for one, the longer a GPU waits for its kernel, and cores for theirs.
    each_alone = traversal == AUTO and (count <= scene.few_rays or not scene.is_cpu)
    known = (count > 1, rays[2:]) if each_alone else (rays[1:], get_num_threads())
    key = kind, traversal, triangle_test, cull_backfaces, known, _auto
    kept = scene.cache.choices.get(key)
    if kept is not None:
        kept[1] -= 1
        if kept[1] >= 0:
            return kept[0]
    shared = (key, scene.triangle_test, scene.width) if each_alone and scene.shares_few_rays else None
    plan = None if shared is None else _few_ray_plans.get(shared)
    if plan is None:
        plan = choose_plan(scene, rays, query, sample)
        if shared is not None and len(_few_ray_plans) < MAX_SHARED:
            _few_ray_plans[shared] = plan
    uses = float("inf") if each_alone else CHOICE_USES
    chosen = chosen_plan(scene, plan, count, kind)
    contest = None if each_alone else find_contest(scene, rays, query, chosen, kept[0].contest if kept else None)
    return scene.cache.keep_choice(key, Choice(chosen, contest), uses)


def given_choice(scene: SceneState, rays: RayFacts, query: Query, given: Plan) -> Choice:
    """The caller's plan; errors as in `make_plan`."""
    key = given, query.kind, query.cull_backfaces, rays
    try:
        kept = scene.cache.choices.get(key)
    except TypeError:  # a field that has no hash is refused below
        kept = None
    if kept is not None:
        return kept[0]
    culled = query.cull_backfaces or given.cull_backfaces
    plan = check_plan(replace(given, cull_backfaces=culled), scene.facts, rays, query.kind)
    return scene.cache.keep_choice(key, Choice(chosen_plan(scene, plan, rays.count, query.kind)), float("inf"))


def find_contest(scene: SceneState, rays: RayFacts, query: Query, chosen: ChosenPlan, known: Contest | None) -> Contest | None:
    """What compares a plan with its rivals, told what the rules say now; None if nothing does."""
    if not is_measured(scene, rays, query):
        return None
    contest = known or Contest(rays, query, chosen, learner_of(scene, rays, query, chosen.name))
    contest.renew(scene, chosen)
    return contest


def is_measured(scene: SceneState, rays: RayFacts, query: Query) -> bool:
    """Whether calls of a query are measured."""
    measured = scene.is_cpu and query.traversal == AUTO and rays.count >= MIN_SAMPLED and get_auto() == MEASURED
    return measured and scene.facts.tree == "bvh" and scene.area_trees is None and not scene.facts.has_masks


def is_changing(scene: SceneState, count: int) -> bool:
    """Whether the plan of this many rays depends on what came before."""
    return scene.changes_plans and (scene.lazy_tree is not None or (scene.cache.wide is None and count > scene.few_rays))

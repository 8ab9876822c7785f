"""Choosing a plan: what "auto" stands for, from the scene, the device and the rays."""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias

from wrt.engine.facts.query_kinds import AUTO, Query
from wrt.engine.facts.wide_trees import wide_form_pays, wide_form_savings, wide_width
from wrt.engine.plan.packet_sample import measure_overlap
from wrt.engine.plan.plan import ChosenPlan, Plan, plan_for_query, traversal_of
from wrt.engine.plan.plan_checks import can_answer, check_answer, check_origins, fits, longest_stream
from wrt.kernels.answers import ANSWERS
from wrt.kernels.compilation.cache_size import l3_bytes
from wrt.kernels.query.ordering.packet_overlap import SAMPLED_RAYS
from wrt.kernels.runtime.launch import get_num_threads
from wrt.kernels.traversal import TRAVERSALS, Traversal
from wrt.kernels.traversal.capabilities import Capabilities
from wrt.kernels.traversal.packet import CULLINGS
from wrt.kernels.traversal.traversal_scores import Overlap, Situation
from wrt.kernels.triangle import TRIANGLE_TESTS, TriangleTest
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.engine.facts.facts import RayFacts, SceneFacts
    from wrt.engine.facts.scene_state import SceneState
    from wrt.kernels.layout.ray_batch import RayBatch

Sample: TypeAlias = "Callable[[], RayBatch]"

DEFAULT_TEST = "woop"
"""The triangle test of "auto": the only watertight one. It costs a few per cent over Moeller and Trumbore's test at most
(notebooks/records/2026-11-21-plans.md).
"""

PACKET = 32
"""Rays of a packet on boxes of one level: with 16 lanes best or within 5 % of the best of 16, 32, 64 and 128
(notebooks/records/2026-11-21-plans.md), with 8 at least as fast as 64."""

SPARSE_PACKET, CROWDED_PACKET = 16, 64
"""The same of fewer rays than triangles, with 8 lanes, and of crowded rays (notebooks/records/2026-11-28-engines-by-name.md,
2026-11-28-auto.md)."""

MIN_VECTORS = 2
"""Vectors of a packet at least, through instances, and in the cells of a kd-tree."""

CROWDED = 8.0
"""Rays for each triangle from which rays from one point are crowded in a scene of one level: they meet few triangles at each
leaf."""

STREAMS, CUDA_STREAM = (16384, 4096, 1024, 256), 16
"""Rays of a stream, the largest first. Longer streams fill their vector lanes better, if each thread still has several
streams. On CUDA, a thread traces a stream and holds its rays in local memory (`MAX_CUDA_STREAM`).
"""

STREAMS_PER_THREAD = 4

HIT_BYTES = 16
"""Bytes of a closest hit: t, primitive, u and v. Hits of half of the last-level cache or more are written by non-temporal
stores (notebooks/records/2026-11-24-streams.md).
"""

MIN_RAYS_TO_REORDER = 1 << 16
"""Smallest batch whose rays are sorted before tracing."""

MAX_RIVALS = 3
"""Plans that are compared with the one of the rules: each costs time, and kernels."""

MANY = 1 << 30
"""More triangles, or rays, than any limit."""

CACHED_BYTES = 1 << 24
"""Bytes of triangle records that the caches of a core hold. Rays are not sorted for scenes with fewer."""


def choose_plan(scene: SceneState, rays: RayFacts, query: Query, sample: Sample | None = None) -> Plan:
    """A new plan for these rays; arguments and errors as in `find_plan`."""
    kind, given, triangle_test, cull_backfaces = query[:4]
    known = scene.facts
    wanted = default_test(known.triangle_test, ANSWERS[kind].rules.crossings) if triangle_test == AUTO else triangle_test
    test = TRIANGLE_TESTS[wanted] if known.points else lookup(TRIANGLE_TESTS, wanted, "triangle_test")
    if given == AUTO:
        situation = situation_of(known, rays, kind, cull_backfaces, has_wide_form=wide_form_pays(scene, rays))
        if situation.needs_sample and sample is not None and not known.points:
            packet = max(MIN_VECTORS * known.width, SAMPLED_RAYS)
            situation = situation._replace(overlap=measure_overlap(scene, sample(), packet, kind))
        name, reason = choose_traversal(known, situation, test.name)
        reason = "alpha masks decide hits one by one" if known.has_masks else reason
        reason = reason.partition(",")[0] if known.points else reason  # the rest is about triangles
    else:
        name, reason = given, "as given"
    chosen = lookup(TRAVERSALS, name, "traversal")
    check_origins(test, chosen, rays)
    tree = tree_for(chosen, known)
    check_answer(known, kind, chosen, tree, test, cull_backfaces)
    width = wide_width(known.width) if Capabilities.WIDE_FORM in chosen.capabilities else known.width
    options: dict[str, Any] = {}
    if Capabilities.PACKETS in chosen.capabilities:
        options["packet"] = packet_rays(known, rays, chosen, width)
        options["culling"] = choose_culling(known, rays, chosen, test)
    if Capabilities.STREAMS in chosen.capabilities:
        options["stream"] = stream_size(known, rays, chosen)
    if given == AUTO or "tiles" in chosen.orders:
        options["reorder"] = choose_order(scene, rays, chosen, test)
    if Capabilities.NON_TEMPORAL in chosen.capabilities and options["reorder"] != "tiles":
        options["non_temporal"] = stores_past_caches(known, rays, kind)
    return Plan(
        accelerator=tree,
        traversal=chosen.name,
        triangle_test=test.name,
        width=width,
        coherent=rays.coherent,
        shared_origin=rays.shared_origin and not known.instances,
        reason=reason,
        cull_backfaces=cull_backfaces,
        **options,
    )


def chosen_plan(scene: SceneState, plan: Plan, count: int, kind: str) -> ChosenPlan:
    """A plan for a kind of query about this many rays, with what is prepared for it in the scene's cache."""
    few = count <= scene.few_rays
    key = plan, kind, few
    return scene.cache.plan(key) or scene.cache.keep_plan(key, choose_for(scene, plan, few, kind))


def choose_for(scene: SceneState, plan: Plan, few: bool, kind: str) -> ChosenPlan:
    """A plan for a kind of query, and whether such queries can be prepared: see `wrt.engine.executor`."""
    carried_out = plan_for_query(plan, kind)
    traversal = traversal_of(carried_out)
    in_packets = scene.is_cpu and Capabilities.PACKETS in traversal.capabilities
    in_rounds = bool(scene.instances) and not (traversal.walks_single_rays or in_packets)
    by_area = scene.area_trees is not None and not (few and scene.is_cpu)
    by_origin = TRIANGLE_TESTS[carried_out.triangle_test].record.per_origin
    by_steps = carried_out.reorder == "cells" or Capabilities.QUEUED in traversal.capabilities
    prepares = not (scene.lazy_tree is not None or in_rounds or by_area or by_origin or by_steps)
    prepares = prepares and not scene.facts.has_masks
    no_savings = carried_out.is_wide or not scene.facts.can_be_wide
    missed_savings = 0.0 if no_savings else wide_form_savings(1, carried_out.coherent)
    return ChosenPlan(plan, carried_out, prepares, missed_savings)


def default_test(triangle_test: str, crossings: bool = False) -> str:
    """Name of the triangle test for queries that name none: the scene's, or the default test if the query asks for crossings
    and the scene's test has none.
    """
    if triangle_test == AUTO or (crossings and TRIANGLE_TESTS[triangle_test].crossing is None):
        return DEFAULT_TEST
    return triangle_test


def choose_traversal(scene: SceneFacts, situation: Situation, triangle_test: str = DEFAULT_TEST) -> tuple[str, str]:
    """Name of the traversal with the best score among those that can answer, and the reason for it."""
    best, name, reason = 0.0, "", ""
    for traversal in TRAVERSALS.values():
        score = None if traversal.score is None else traversal.score(situation)
        if score is None or score[0] <= best:
            continue
        if can_answer(traversal, scene, situation.query, situation.cull_backfaces, triangle_test):
            (best, reason), name = score, traversal.name
    return name, reason


def rival_plans(scene: SceneState, rays: RayFacts, query: Query, plan: Plan) -> list[Plan]:
    """A plan of the rules, and at most `MAX_RIVALS` others: packets with the other culling, and what the rules choose for a
    sample that shares all or nothing, and for few or many triangles, or rays through instances. Short rays take the same way,
    however different they are, so packets are compared for incoherent rays, too."""
    known, kind, found = scene.facts, query.kind, {plan.engine: plan}
    told = situation_of(known, rays, kind, query.cull_backfaces)
    if told.prefers_single:
        return [plan]
    together, parted = told._replace(coherent=True, overlap=Overlap(0.0, 0.0)), told._replace(overlap=Overlap(1.0, 0.0))
    ends = (0, MANY)
    walks = [parted, *(parted._replace(rays=end) if told.instances else parted._replace(triangles=end) for end in ends)]
    others = [together, *walks] if told.coherent else [*walks, together]
    test = plan.triangle_test
    if plan.culling and rays.shared_origin:
        for crowded in (True, False):
            culling = best_culling(known, crowded, traversal_of(plan), TRIANGLE_TESTS[test])
            rival = replace(plan, culling=culling)
            found.setdefault(rival.engine, rival)
    for one in others:
        name = choose_traversal(known, one, test)[0]
        if name not in {rival.traversal for rival in found.values()}:
            rival = choose_plan(scene, rays, query._replace(traversal=name))
            found.setdefault(rival.engine, replace(rival, reason=plan.reason))
    return [*found.values()][: 1 + MAX_RIVALS]


def situation_of(
    scene: SceneFacts, rays: RayFacts, query: str, cull_backfaces: bool = False, *, has_wide_form: bool = False
) -> Situation:
    """What the scores of traversals depend on, before any ray is traced.

    Rays through points part as those through many triangles do: interleaved walks were fastest in clouds of 100,000 points and
    of a million, whatever the rays (notebooks/records/2026-11-28-point-clouds.md).
    """
    return Situation(
        query=query,
        cull_backfaces=cull_backfaces,
        is_cuda=scene.is_cuda,
        tree=scene.tree,
        lanes=scene.width,
        triangles=MANY if scene.points else scene.triangles,
        instances=scene.instances,
        own_spaces=scene.own_spaces,
        has_wide_form=has_wide_form,
        rays=rays.count,
        few=rays.count <= scene.few_rays,
        coherent=rays.coherent,
        shared_origin=rays.shared_origin,
    )


def tree_for(traversal: Traversal, scene: SceneFacts) -> str:
    """Kind of tree that a traversal walks in a scene.

    Raises:
        ValueError: the traversal does not walk the scene's kind of tree.
    """
    kind = scene.tree
    if not traversal.walks_tree:
        return "none"
    if kind not in traversal.trees:
        able = ", ".join(name for name, entry in TRAVERSALS.items() if kind in entry.trees)
        other = f"make the scene with accelerator={traversal.trees[0]!r}"
        raise ValueError(f"traversal {traversal.name!r} does not walk a {kind}; {other}, or choose from auto, {able}")
    return kind


def stream_size(scene: SceneFacts, rays: RayFacts, traversal: Traversal) -> int:
    """Rays of a stream: fewer if the batch would not give each thread several streams."""
    if scene.is_cuda:
        return CUDA_STREAM
    share = rays.count / max(STREAMS_PER_THREAD * get_num_threads(), scene.instances)
    longest = min(share, longest_stream(scene, traversal))
    return next((size for size in STREAMS if size <= longest), STREAMS[-1])


def packet_rays(scene: SceneFacts, rays: RayFacts, traversal: Traversal, width: int) -> int:
    """Rays of a packet, a multiple of the width of the nodes that it walks."""
    if Capabilities.ONE_VECTOR in traversal.capabilities:
        return width
    by_boxes = traversal.walks_boxes(scene.tree) and not (scene.is_cuda or scene.instances)
    usual = PACKET if rays.count >= scene.triangles else SPARSE_PACKET
    smallest = CROWDED_PACKET if is_crowded(scene, rays) else usual if by_boxes else 0
    return max(smallest // width, MIN_VECTORS) * width


def is_crowded(scene: SceneFacts, rays: RayFacts) -> bool:
    """Whether rays from one point crowd in a scene of one level."""
    return rays.shared_origin and not scene.instances and rays.count >= CROWDED * scene.triangles


def choose_culling(scene: SceneFacts, rays: RayFacts, traversal: Traversal, test: TriangleTest) -> str:
    """Name of the culling with the best score among those that fit."""
    return best_culling(scene, is_crowded(scene, rays), traversal, test)


def best_culling(scene: SceneFacts, crowded: bool, traversal: Traversal, test: TriangleTest) -> str:
    """The same for rays of which it is known whether they crowd."""
    kind, best, name = scene.tree, 0.0, ""
    for culling in CULLINGS.values():
        crowded_score, usual_score = culling.filtered_scores if test.packet_form.pairs else culling.scores
        score = crowded_score if crowded else usual_score
        if score > best and fits(culling, traversal, kind, test):
            best, name = score, culling.name
    return name


def stores_past_caches(scene: SceneFacts, rays: RayFacts, query: str) -> bool:
    """Whether packets write closest hits by non-temporal stores: so numerous that few of them would be in a cache when read."""
    has_stores = not scene.is_cuda and platform.machine().lower() in ("x86_64", "amd64")
    return has_stores and ANSWERS[query].rules.shortens and not scene.instances and 2 * HIT_BYTES * rays.count >= l3_bytes()


def choose_order(scene: SceneState, rays: RayFacts, traversal: Traversal, test: TriangleTest) -> str:
    """The order in which rays are traced."""
    if "tiles" in traversal.orders:
        return "tiles" if rays.columns > 0 else "none"
    return "cells" if "cells" in traversal.orders and rays.scattered and is_large(scene, rays, test) else "none"


def is_large(scene: SceneState, rays: RayFacts, test: TriangleTest) -> bool:
    """Whether the batch and the triangle records are large enough for sorting the rays to pay."""
    return rays.count >= MIN_RAYS_TO_REORDER and scene.slots * 4 * test.record.components >= CACHED_BYTES

"""Inside tests: the number of times that a ray from a point crosses the surface, or the sum of these crossings by sign.

A ray from inside a closed surface to infinity crosses it an odd number of times, in any direction. Every crossing is
counted once, also at edges and vertices (`wrt.kernels.triangle.watertight.woop`), and the number of crossings of a whole line
is exactly even: one direction is enough, and the ray may follow it either way.

If a surface is not closed, rays through its holes give different answers in different directions. A second direction is
then tested, and where the first two disagree, a third decides.

**Rules.** With several meshes, or shells within each other, a point is inside by parity if an odd number of them contain it.
The sum of the crossings by sign is the winding number of the point (`wrt.kernels.answers.winding_number`): positive in the
union of bodies that overlap, nonzero also in bodies that are inside out. It takes one pass over the crossings, as their number
does.

A triangle that repeats an earlier one, the same side in front, is left out (`SceneState.distinct`): the surface is there once.
One that is turned over counts, so that bodies may touch: see `wrt.meshes.repeated_surfaces`.

References: shimrat-1962 (parity); jacobson-2013 (winding numbers).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np
import warp as wp

from wrt.engine.device_hits import DeviceHits
from wrt.engine.executor import trace
from wrt.engine.facts.query_kinds import ANY, AUTO, COUNT, WINDING
from wrt.engine.host_arrays import as_array
from wrt.engine.memory import empty
from wrt.engine.plan.choices import make_plan
from wrt.engine.plan.plan import Plan
from wrt.engine.rays.coherence import detect_coherence
from wrt.engine.rays.device_rays import DeviceRays, to_device
from wrt.engine.rays.rays import Rays, as_vectors
from wrt.kernels.query.hit_lists import (
    NONZERO,
    ODD,
    POSITIVE,
    aim_outwards,
    decide_inside,
    find_unequal,
    list_marked,
)
from wrt.kernels.runtime.launch import launch, refuse_capture, use_threads
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState

DIRECTIONS = ((0.5163, 0.3781, 0.7684), (-0.7911, 0.4892, 0.3674), (0.2769, -0.8472, 0.4534))
"""Directions far from each other, and from all axes and diagonals."""

InsideRule: TypeAlias = Literal["parity", "union", "winding"]

PARITY = "parity"


class Rule(NamedTuple):
    """When a point is inside.

    Attributes:
        query: what is asked of its ray: the number of crossings or their sum by sign.
        asked: what that must be, as `wrt.kernels.query.hit_lists.decide_inside` takes it.
    """

    query: str
    asked: int


RULES = {PARITY: Rule(COUNT, ODD), "winding": Rule(WINDING, NONZERO), "union": Rule(WINDING, POSITIVE)}
"""Rules by name."""


def contains(scene: SceneState, points: Any, traversal: str | Plan = AUTO, rule: str = PARITY) -> Any:
    """Whether points are inside the scene's meshes; see `wrt.Scene.contains`."""
    from wrt.kernels.query.ordering.ray_order import sort_rays, unsort_hits

    chosen = lookup(RULES, rule, "rule")
    refuse_capture("contains", scene.device)
    scene.require("count")
    points = as_vectors(points, "points", scene.device)
    with use_threads(scene.num_threads):
        scene = scene.distinct()
        buffers = to_device(Rays(points, np.array(DIRECTIONS[0], dtype=np.float32)), scene.device, scene.center)
        rays = aimed(buffers, DIRECTIONS[0], scene.device)
        _, scattered, _ = detect_coherence(rays.origins, rays.directions, scene.device)
        rays.facts = buffers.facts = buffers.facts._replace(scattered=scattered)
        plan = make_plan(scene, rays, traversal, AUTO, chosen.query)
        inside = decide(scene, plan, rays, chosen)
        if not scene.is_closed:
            rays = aimed(buffers, DIRECTIONS[1], scene.device)
            other = decide(scene, plan, rays, chosen)
            order = find_undecided(inside, other)
            if order is not None:
                few = DeviceRays.of_batch(sort_rays(rays.batch, order, empty), buffers.facts.coherent, scattered)
                few = aimed(few, DIRECTIONS[2], scene.device)
                unsort_hits(order, decide(scene, plan, few, chosen).struct(), inside.struct(), ANY)
    return inside.values(ANY, buffers.form)


def find_undecided(one: DeviceHits, other: DeviceHits) -> wp.array | None:
    """The numbers of the rays for which two answers differ, ascending; None if there are none. The host reads how many."""
    count, device = one.count, one.device
    unequal, places = empty(count, wp.int32, device), empty(count, wp.int32, device)
    launch(find_unequal, count, [one.occluded, other.occluded, unequal], device=device, chunk=4096)
    wp.utils.array_scan(unequal, places, inclusive=True)
    found = int(places[count - 1 :].numpy()[0]) if count else 0
    if not found:
        return None
    numbers = empty(found, wp.int32, device)
    launch(list_marked, count, [unequal, places, numbers], device=device, chunk=4096)
    return numbers


def aimed(points: DeviceRays, direction: tuple[float, ...], device: wp.Device) -> DeviceRays:
    """Rays along the direction or against it, whichever is probably the shorter way out of the scene."""
    count, layout = points.facts.count, points.layout
    directions, center = empty(count, wp.vec3, device), (0.0, 0.0, 0.0) if layout.centered else points.center.tolist()
    inputs = [as_array(points.origins), layout.origins, wp.vec3d(*center), wp.vec3(*direction), directions]
    launch(aim_outwards, count, inputs, device=device, chunk=4096)
    return replace(points, directions=directions, layout=layout._replace(directions=1))


def decide(scene: SceneState, plan: Plan, rays: DeviceRays, rule: Rule) -> DeviceHits:
    """Whether the origin of each ray is inside by what the ray crosses, stored as `occluded`."""
    crossings, _ = trace(scene, plan, rays, rule.query)
    inside = DeviceHits.new(ANY, rays.count, scene.device)
    inputs = [crossings.counts, rule.asked, inside.occluded]
    launch(decide_inside, rays.count, inputs, device=scene.device, chunk=4096)
    return inside

"""Calls with rays in Warp arrays on the scene's CUDA device: what an earlier call of the kind has found is looked up at once.

A GPU traces a large batch while Python checks and plans the next one, and waits for it
(notebooks/records/2026-11-27-gpu-traversal.md). A usual call has two flat or shaped arrays of vec3 with one shape, numbers as
bounds of t, and no options: then its plan, the layout of its rays and the arrays of its bounds are those of the last such call.
All other calls are checked and planned.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import warp as wp

from wrt.engine.facts.facts import RayFacts
from wrt.engine.launch.prepared import prepare
from wrt.engine.rays.rays import MAX_RAYS, Rays, ResultForm

if TYPE_CHECKING:
    from wrt.engine.device_hits import DeviceHits
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.plan.plan import ChosenPlan, Plan
    from wrt.engine.rays.device_rays import DeviceRays
    from wrt.engine.rays.host_rays import Layout
    from wrt.engine.rays.rays import GivenRays

IN_PLACE = (1, 1, 0, 0, False)
"""Of usual layouts: each ray has its own origin, in float32, and direction; all have one range."""

MAX_CALLS = 64
"""Kinds of calls that a scene's cache holds; one more clears them."""


class KnownCall(NamedTuple):
    """What usual calls have in common.

    Attributes:
        chosen: the plan, and the queries that are prepared for it.
        layout: of the rays.
        t_min, t_max: (1,) float32 on the device.
    """

    chosen: ChosenPlan
    layout: Layout
    t_min: wp.array
    t_max: wp.array


class UsualRays:
    """The rays of a usual call, with what a prepared query asks of `wrt.engine.rays.device_rays.DeviceRays`."""

    __slots__ = ("_call", "_directions", "_origins", "facts")

    def __init__(self, call: KnownCall, origins: wp.array, directions: wp.array) -> None:
        self._call, self._origins, self._directions = call, origins, directions
        self.facts = RayFacts(origins.size, origins.shape)

    def write_to(self, arguments: Any) -> None:
        """As in `DeviceRays`."""
        origins, directions, t_min, t_max = arguments.origins, arguments.directions, arguments.t_min, arguments.t_max
        count = arguments.count = self.facts.count
        origins.data, origins.shape[0] = self._origins.ptr, count
        directions.data, directions.shape[0] = self._directions.ptr, count
        t_min.data, t_min.shape[0] = self._call.t_min.ptr, 1
        t_max.data, t_max.shape[0] = self._call.t_max.ptr, 1


def given_arrays(rays: GivenRays) -> tuple[Any, Any, Any, Any]:
    """Origins, directions, t_min and t_max as the caller passed them."""
    if isinstance(rays, Rays):
        return rays.origins, rays.directions, rays.t_min, rays.t_max
    if isinstance(rays[0], Rays):
        own = rays[0]
        return (own.origins, own.directions, own.t_min, own.t_max) if rays[1] is None else (None, None, None, None)
    return rays


def is_usual(scene: SceneState, rays: tuple[Any, Any, Any, Any]) -> bool:
    """Whether rays are those of a usual call; more than one, so that their layout is `IN_PLACE`."""
    origins, directions, t_min, t_max = rays
    if not (type(origins) is type(directions) is wp.array and type(t_min) is type(t_max) is float):
        return False
    device, size = scene.device, origins.size
    return (
        origins.dtype is directions.dtype is wp.vec3f
        and origins.device is directions.device is device
        and origins.shape == directions.shape
        and origins.is_contiguous
        and directions.is_contiguous
        and 1 < size <= MAX_RAYS
        and not device.is_capturing
    )


def answer_known(scene: SceneState, rays: GivenRays, kind: str) -> tuple[DeviceHits, ResultForm, Plan] | None:
    """The answer to a query without options, its form and its plan; None if no such call was made before, or it is not
    usual."""
    given = given_arrays(rays)
    origins, directions, t_min, t_max = given
    call = scene.cache.calls.get((kind, t_min, t_max)) if type(t_min) is type(t_max) is float else None
    if call is None or not is_usual(scene, given):
        return None
    chosen, layout = call.chosen, call.layout
    prepared = chosen.prepared.take(layout) or prepare(scene, chosen.carried_out, kind, layout)
    hits = prepared.run(scene, UsualRays(call, origins, directions), 0)  # type: ignore[arg-type]
    chosen.prepared.give_back(prepared, layout)
    return hits, ResultForm(origins.shape, True, np.float32), chosen.plan


def keep_call(scene: SceneState, rays: GivenRays, kind: str, chosen: ChosenPlan, brought: DeviceRays) -> None:
    """Keeps what a call without options has found for the next ones, if it is usual, and its plan does not change."""
    given, layout = given_arrays(rays), brought.own_layout
    plan_stays = chosen.prepares and not chosen.missed_savings and chosen.carried_out.reorder == "none"
    if plan_stays and layout is not None and layout[: len(IN_PLACE)] == IN_PLACE and is_usual(scene, given):
        calls = scene.cache.calls
        if len(calls) >= MAX_CALLS:
            calls.clear()
        calls[kind, given[2], given[3]] = KnownCall(chosen, layout, brought.t_min, brought.t_max)

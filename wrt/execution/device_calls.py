"""Calls with rays in Warp arrays on the scene's CUDA device: what an earlier call of the kind has found is looked up at once.

A million rays take some 0.2 ms on a GPU, and the GPU waits for Python. A usual call has two flat or shaped arrays of vec3 with
one shape, numbers as bounds of t, and no options: then its plan, the layout of its rays and the arrays of its bounds are those
of the last such call (notebooks/records/2026-11-27-gpu-traversal.md). All other calls go the long way, which checks them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import warp as wp

from wrt.execution.prepared import prepare
from wrt.host_arrays import point_at
from wrt.rays.rays import MAX_RAYS, ResultForm

if TYPE_CHECKING:
    from wrt.planning.plan import ChosenPlan, Plan
    from wrt.rays.host_rays import Layout
    from wrt.rays.ray_buffers import RayBuffers
    from wrt.rays.rays import Rays
    from wrt.state.device_hits import DeviceHits
    from wrt.state.scene_state import SceneState

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


class DeviceRays:
    """The rays of a usual call, with what a prepared query asks of `wrt.rays.ray_arrays.RayArrays`."""

    __slots__ = ("_call", "_directions", "_origins", "count")

    def __init__(self, call: KnownCall, origins: wp.array, directions: wp.array) -> None:
        self._call, self._origins, self._directions, self.count = call, origins, directions, origins.size

    def write_to(self, arguments: Any) -> None:
        """As in `RayArrays`."""
        origins, directions, count = arguments.origins, arguments.directions, self.count
        origins.data, origins.shape[0] = self._origins.ptr, count
        directions.data, directions.shape[0] = self._directions.ptr, count
        point_at(arguments.t_min, self._call.t_min)
        point_at(arguments.t_max, self._call.t_max)
        arguments.count = count


def is_usual(scene: SceneState, rays: Rays) -> bool:
    """Whether rays are those of a usual call; more than one, so that their layout is `IN_PLACE`."""
    origins, directions = rays.origins, rays.directions
    if not (type(origins) is type(directions) is wp.array and type(rays.t_min) is type(rays.t_max) is float):
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


def answer_known(scene: SceneState, rays: Rays, kind: str) -> tuple[DeviceHits, ResultForm, Plan] | None:
    """The answer to a query without options, its form and its plan; None if no such call was made before, or it is not
    usual."""
    call = scene.cache.calls.get((kind, rays.t_min, rays.t_max)) if type(rays.t_min) is type(rays.t_max) is float else None
    if call is None or not is_usual(scene, rays):
        return None
    chosen, layout = call.chosen, call.layout
    prepared = chosen.take(layout) or prepare(scene, chosen.carried_out, kind, layout)
    prepared.fit(scene)
    hits = prepared.run(scene, DeviceRays(call, rays.origins, rays.directions), 0)
    chosen.give_back(layout, prepared)
    return hits, ResultForm(rays.origins.shape, True, np.float32), chosen.plan


def keep_call(scene: SceneState, rays: Rays, kind: str, chosen: ChosenPlan, buffers: RayBuffers) -> None:
    """Keeps what a call without options has found for the next ones, if it is usual, and its plan does not change."""
    plan_stays = chosen.prepares and not chosen.missed_savings and chosen.carried_out.reorder == "none"
    layout: Any = buffers.layout
    if plan_stays and layout is not None and layout[: len(IN_PLACE)] == IN_PLACE and is_usual(scene, rays):
        calls = scene.cache.calls
        if len(calls) >= MAX_CALLS:
            calls.clear()
        given: Any = buffers.given
        calls[kind, rays.t_min, rays.t_max] = KnownCall(chosen, layout, given.t_min, given.t_max)

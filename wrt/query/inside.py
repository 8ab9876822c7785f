"""Inside or outside: by the number of times that a ray from a point crosses the surface.

A ray from inside a closed surface to infinity crosses it an odd number of times, whichever way it goes. Every crossing is
counted once, at edges and vertices too (`wrt.kernels.triangle.watertight.woop`), and a whole line crosses a closed surface an
even number of times to the bit: one direction is enough, and it may be followed either way.

Through the holes of a surface that is not closed, rays of different directions disagree. There three directions vote: of the
first two, where they agree, and of a third where they do not.

Several meshes, or shells of one, count together: a point is inside if it is inside an odd number of them.

References:
    M. Shimrat: Algorithm 112: Position of point relative to polygon. Communications of the ACM 5(8), 1962 (parity).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.execution.device_hits import DeviceHits
from wrt.execution.executor import trace
from wrt.execution.plan import Plan
from wrt.execution.planner import make_plan
from wrt.execution.query_kinds import ANY, AUTO, COUNT
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.runtime.launch import launch, use_threads
from wrt.memory import empty
from wrt.rays.coherence import look_at
from wrt.rays.ray_buffers import to_device
from wrt.rays.rays import Rays

if TYPE_CHECKING:
    from wrt.execution.scene_state import SceneState
    from wrt.rays.ray_buffers import RayBuffers

DIRECTIONS = ((0.5163, 0.3781, 0.7684), (-0.7911, 0.4892, 0.3674), (0.2769, -0.8472, 0.4534))
"""Directions along no axis and no diagonal, far from one another."""


def contains(scene: SceneState, points: Any, traversal: str | Plan = AUTO) -> Any:
    """Which points are inside the scene's meshes; see `wrt.Scene.contains`."""
    from wrt.kernels.query.ray_order import sort_rays, unsort_hits

    with use_threads(scene.num_threads):
        buffers = to_device(Rays(points, np.array(DIRECTIONS[0], dtype=np.float32)), scene.device, scene.center)
        aim(buffers.batch, DIRECTIONS[0], scene.device)
        buffers.scattered = look_at(buffers.batch, scene.device).scattered
        plan = make_plan(scene, buffers, traversal, AUTO, COUNT)
        inside = odd_crossings(scene, plan, buffers)
        if not scene.is_closed:
            aim(buffers.batch, DIRECTIONS[1], scene.device)
            other = odd_crossings(scene, plan, buffers)
            undecided = np.flatnonzero(inside.occluded.numpy() != other.occluded.numpy()).astype(np.int32)
            if len(undecided):
                order = wp.array(undecided, dtype=int, device=scene.device)
                few = replace(buffers, given=sort_rays(buffers.batch, order, empty), shape=(len(undecided),))
                aim(few.batch, DIRECTIONS[2], scene.device)
                unsort_hits(order, odd_crossings(scene, plan, few).struct(), inside.struct(), ANY)
    return inside.result("occluded", buffers.form)


def aim(points: RayBatch, direction: tuple[float, ...], device: wp.Device) -> None:
    """Sends rays along the direction or against it, whichever is likely to be the shorter way out of the scene."""
    from wrt.kernels.query.hit_lists import aim_outwards

    points.directions, points.direction_stride = empty(points.count, wp.vec3, device), 1
    launch(aim_outwards, points.count, [points, wp.vec3(*direction), points.directions], device=device, chunk=4096)


def odd_crossings(scene: SceneState, plan: Plan, rays: RayBuffers) -> DeviceHits:
    """Whether each ray crosses the surface an odd number of times, as `occluded`."""
    from wrt.kernels.query.hit_lists import is_odd

    crossings, _ = trace(scene, plan, rays, COUNT)
    odd = DeviceHits.new(ANY, rays.count, scene.device)
    launch(is_odd, rays.count, [crossings.counts, odd.occluded], device=scene.device, chunk=4096)
    return odd

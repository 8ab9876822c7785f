"""Inside or outside: by the number of times that a ray from a point crosses the surface.

A ray from inside a closed surface to infinity crosses it an odd number of times, whichever way it goes. Every crossing is
counted once, at edges and vertices too (`wrt.kernels.triangle.woop`), and a whole line crosses a closed surface an even
number of times to the bit: one direction is enough.

Through the holes of a surface that is not closed, rays of different directions disagree. There three directions vote: of the
first two, where they agree, and of a third where they do not.

Several meshes, or shells of one, count together: a point is inside if it is inside an odd number of them.

References:
    M. Shimrat: Algorithm 112: Position of point relative to polygon. Communications of the ACM 5(8), 1962 (parity).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.hits import shaped
from wrt.kernels.launch import launch, use_threads
from wrt.memory import empty
from wrt.plan import AUTO, COUNT, Plan, make_plan
from wrt.rays import Rays, to_device
from wrt.tracing import trace

if TYPE_CHECKING:
    from wrt.rays import RayBuffers
    from wrt.scene import Scene

DIRECTIONS = ((0.5163, 0.3781, 0.7684), (-0.7911, 0.4892, 0.3674), (0.2769, -0.8472, 0.4534))
"""Directions along no axis and no diagonal, far from one another."""


def contains(scene: Scene, points: Any, traversal: str | Plan = AUTO) -> Any:
    """Which points are inside the scene's meshes; see `wrt.Scene.contains`."""
    with use_threads(scene.num_threads):
        one, rays = odd_crossings(scene, points, DIRECTIONS[0], traversal)
        if not scene.is_closed:
            two, _ = odd_crossings(scene, points, DIRECTIONS[1], traversal)
            if not np.array_equal(one.numpy(), two.numpy()):
                three, _ = odd_crossings(scene, points, DIRECTIONS[2], traversal)
                one = majority(one, two, three)
    return shaped(one, rays)


def odd_crossings(
    scene: Scene, points: Any, direction: tuple[float, ...], traversal: str | Plan
) -> tuple[wp.array, RayBuffers]:
    """(N,) bool: whether the ray from each point crosses the surface an odd number of times; and the rays."""
    from wrt.kernels.all_hits import is_odd

    buffers = to_device(Rays(points, np.array(direction, dtype=np.float32)), scene.device, scene.center)
    batch, _ = trace(scene, make_plan(scene, buffers, traversal, AUTO, COUNT), buffers, COUNT)
    odd = empty(buffers.count, wp.bool, scene.device)
    launch(is_odd, buffers.count, [batch.counts, odd], device=scene.device, chunk=4096)
    return odd, buffers


def majority(one: wp.array, two: wp.array, three: wp.array) -> wp.array:
    """What at least two of three say, point by point."""
    from wrt.kernels.all_hits import vote

    most = wp.empty_like(one)
    launch(vote, len(one), [one, two, three, most], device=one.device, chunk=4096)
    return most

"""Memory for the rays of a generation."""

from __future__ import annotations

import warp as wp

from wrt.engine.memory import empty
from wrt.kernels.shading.wavefront import ray_queue

__all__ = ["new_queue"]


def new_queue(count: int, device: wp.Device) -> ray_queue.RayQueue:
    """An uninitialised queue for this many rays."""
    queue = ray_queue.RayQueue()
    queue.origin, queue.direction, queue.weight = (empty(count, wp.vec3, device) for _ in range(3))
    queue.density, queue.slot, queue.media = (empty(count, dtype, device) for dtype in (wp.float32, wp.int32, wp.uint64))
    return queue

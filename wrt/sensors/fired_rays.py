"""Rays of sensors in the world: fired from the poses of their beams; those of a sensor at rest are kept on the device."""

from __future__ import annotations

import threading
from collections import OrderedDict
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.memory import empty
from wrt.kernels.runtime.launch import as_device, kept, launch
from wrt.sensors.time_slices import no_vectors

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence

    from wrt.kernels.sensors.lidar_beams import Beams
    from wrt.sensors.trajectory import StillPoses, Trajectory

MAX_SENSORS = 64
"""Largest number of sensors that measure together whose rays are kept: their poses are compared."""

BLOCK = 256
"""Rays of a block on the CPU."""

CHUNK = 16
"""Least number of blocks that are handed to another thread: some 50 us of work."""

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))

Fired = tuple[wp.array, wp.array]
"""Origins, (1,) if all rays share it, and (N,) directions."""


class KeptRays:
    """Rays that were fired before; safe to use from several threads.

    Rays are kept when the same ones are fired a second time in a row of `KeptRays.SEEN`, so those of a sensor that moves are
    not.

    Args:
        max_rays: largest number of rays that are kept; those unused for longest go first.
    """

    SEEN = 64
    """Number of sensors at different poses that are remembered."""

    def __init__(self, max_rays: int) -> None:
        self.max_rays, self.count = max_rays, 0
        self._rays: OrderedDict[Hashable, Fired] = OrderedDict()
        self._seen: OrderedDict[Hashable, None] = OrderedDict()
        self._lock = threading.RLock()  # the handler of a signal may scan, too

    def find(self, key: Hashable) -> Fired | None:
        """The rays of a key, if they are kept."""
        with self._lock:
            found = self._rays.get(key)
            if found is not None:
                self._rays[key] = self._rays.pop(key, found)  # the last to go
            return found

    def offer(self, key: Hashable, rays: Fired) -> None:
        """Keeps rays, if their key was offered before."""
        with self._lock:
            if key not in self._seen:
                self._seen[key] = None
                if len(self._seen) > self.SEEN:
                    self._seen.popitem(last=False)
            elif key not in self._rays and len(rays[1]) <= self.max_rays:
                self.count += len(rays[1])
                self._rays[key] = rays
                while self.count > self.max_rays:
                    self.count -= len(self._rays.popitem(last=False)[1][1])


kept_rays = KeptRays(max_rays=1 << 22)


def fire(
    beams: Beams, path: Trajectory | StillPoses, device: wp.Device, shape: tuple[int, int, bool], center: Any, key: Any
) -> Fired:
    """Rays of all beams in the world, in the order in which they are traced.

    Args:
        beams: the beams.
        path: poses of their sensors.
        device: where rays are made.
        shape: number of sensors, rays of each, and whether the rays of a sensor have one origin in its frame.
        center: (3,) to which origins are relative, in float32; None for float64 in the world.
        key: of the beams, without poses, if no other beams have it; None if rays are not to be kept.
    """
    from wrt.kernels.sensors.lidar_beams import FiredRays, fire_beams

    if not path.is_still or shape[0] > MAX_SENSORS or path.key is None or device.is_capturing:
        key = None
    if key is not None:
        key = key, device.alias, path.key, None if center is None else center.tobytes()
        if (rays := kept_rays.find(key)) is not None:
            return rays
    sensors, own, one_centre = shape
    count, shared = sensors * own, path.is_still and one_centre and sensors == 1
    origins = empty(1 if shared else count, wp.vec3d if center is None else wp.vec3, device)
    directions = empty(count, wp.vec3, device)
    fired = FiredRays()
    fired.origins = origins if center is None else no_vectors(device.alias, wp.vec3d)
    fired.relative = no_vectors(device.alias) if center is None else origins
    fired.center = wp.vec3d() if center is None else wp.vec3d(*center.tolist())
    fired.directions = directions
    launch_blocks(fire_beams, count, [beams, path.path(device), fired], device)
    if key is not None:
        kept_rays.offer(key, (origins, directions))
    return origins, directions


def launch_blocks(kernel: wp.Kernel, count: int, inputs: Sequence[Any], device: wp.Device) -> None:
    """Runs a kernel whose item is a block of neighbours and whose first arguments are the size of a block and the number of
    all: on the CPU, a block is worked on by one thread, which keeps what neighbours have in common; on CUDA, it is one ray."""
    block = BLOCK if device.is_cpu else 1
    launch(kernel, -(-count // block), [block, count, *inputs], device=device, chunk=CHUNK)


@lru_cache(maxsize=64)
def spread_on(bundle: int, divergence: float, device: str) -> wp.array:
    """(bundle,) vec2 tangents of the angles of a bundle's rays to the axis; kept (`wrt.sensors.Lidar`)."""
    number = np.arange(bundle)
    radius = 0.0 if bundle == 1 else np.tan(divergence / 2) * np.sqrt((number + 0.5) / bundle)
    spread = np.stack([radius * np.cos(GOLDEN_ANGLE * number), radius * np.sin(GOLDEN_ANGLE * number)], axis=-1)
    with kept(as_device(device)):
        return wp.array(spread.astype(np.float32), dtype=wp.vec2, device=device)

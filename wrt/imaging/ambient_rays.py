"""Ambient rays of a tile of a picture: how many of each point's rays leave the scene.

The rays of a point follow one another, and only points that were hit have any. So the rays of a stream start close together and
visit the same part of the tree, and pixels of the background cost nothing (notebooks/records/2026-11-23-warm-start.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.facts.query_kinds import ANY
from wrt.engine.launch.expected_kernels import ExpectedRays, expected_rays
from wrt.engine.memory import empty
from wrt.imaging.integrators.ray_tracer import RayTracer
from wrt.kernels.runtime.launch import launch
from wrt.kernels.shading import ambient
from wrt.kernels.shading.surface import Surface

if TYPE_CHECKING:
    from wrt.clouds.point_cloud import PointCloud
    from wrt.scene.scene import Scene

DIRECTIONS_AT_ONCE = 16
"""Most rays of a point that are traced at once; bounds the memory."""

CHUNK = 512
"""Least number of points of a chunk."""


class AmbientRays:
    """Memory for the ambient rays of a picture's tiles, one after the other.

    Args:
        scene: the scene.
        points: most camera rays of a tile.
        samples: ambient rays of a camera ray, at least 1.
        distance: length of ambient rays; inf for no limit.
        seed: of the sample pattern.
        query: traversal and triangle test, as in `Scene.intersect`.
        width: of the picture.
        radius: rows and columns within which pixels share their rays; 0 for none.

    Attributes:
        scale: what `count_open` gives for a ray.
        ray_count: number of rays traced so far.
    """

    def __init__(
        self,
        scene: Scene | PointCloud,
        points: int,
        samples: int,
        distance: float,
        seed: int,
        query: Mapping[str, str],
        width: int = 1,
        radius: int = 0,
    ) -> None:
        self._scene, self._samples, self._seed, self._query = scene, samples, seed, query
        self._width, self._radius, self.scale = width, radius, int(ambient.SHARES) if radius else 1
        self.ray_count = 0
        _, self._expected = max_rays(points, samples)
        self._origins, self._directions = (empty(self._expected.count, wp.vec3, scene.device) for _ in range(2))
        self._distance = wp.array(np.array([distance], np.float32), dtype=float, device=scene.device)

    def count_open(self, surface: Surface, primitive: wp.array, first_pixel: int, sample: int) -> wp.array:
        """(N,) int: rays of each point that leave the scene, times `scale`; 0 for a miss.

        Args:
            surface: the points of N camera rays.
            primitive: (N,) int, -1 for a miss.
            first_pixel: number of the first point's pixel.
            sample: number of the camera rays among those of their pixels.
        """
        device = self._scene.device
        open_rays = wp.zeros(len(primitive), dtype=int, device=device)
        hit = np.flatnonzero(primitive.numpy() >= 0).astype(np.int32)
        if len(hit) == 0:
            return open_rays
        points, center = wp.array(hit, dtype=int, device=device), wp.vec3d(*map(float, self._scene.center))
        tracer = RayTracer(self._scene.state, **self._query)
        end = (sample + 1) * self._samples
        for index in range(sample * self._samples, end, DIRECTIONS_AT_ONCE):
            count = min(DIRECTIONS_AT_ONCE, end - index)
            numbers = first_pixel, self._seed, index, count
            self._run(ambient.ambient_rays, hit, surface, points, center, *numbers, self._origins, self._directions)
            rays = self._origins, self._directions, len(hit) * count
            blocked = tracer.blocked_from_points(*rays, self._distance, self._expected)
            self.ray_count += len(hit) * count
            self._run(ambient.count_open, hit, points, count, blocked, open_rays)
        return self._shared(surface, first_pixel, open_rays) if self._radius else open_rays

    def _shared(self, surface: Surface, first_pixel: int, open_rays: wp.array) -> wp.array:
        """The mean of each point's neighbours."""
        shared = wp.empty_like(open_rays)
        inputs = surface, first_pixel, self._width, self._radius, open_rays, shared
        launch(ambient.share_open, len(open_rays), inputs, device=self._scene.device, chunk=CHUNK)
        return shared

    def _run(self, kernel: wp.Kernel, hit: np.ndarray, *inputs: Any) -> None:
        launch(kernel, len(hit), inputs, device=self._scene.device, chunk=CHUNK)


def max_rays(points: int, samples: int) -> ExpectedRays:
    """The most ambient rays that are traced at once, of this many points with this many rays each."""
    return expected_rays(ANY, points * min(samples, DIRECTIONS_AT_ONCE), coherent=False)

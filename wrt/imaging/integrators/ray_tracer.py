"""Traces rays that are relative to the scene's centre and lie in device memory: the rays of a wave.

They need no conversion, no check and no test for coherence, because the integrator made them and knows what they are.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from wrt.execution.executor import trace_chosen
from wrt.execution.expected_kernels import ExpectedRays
from wrt.kernels.runtime.launch import kept
from wrt.planning.planner import find_plan
from wrt.rays.ray_arrays import Layout, RayArrays
from wrt.rays.ray_buffers import RayBuffers
from wrt.state.device_hits import DeviceHits
from wrt.state.query_kinds import ANY, CLOSEST, Query
from wrt.state.scene_state import SceneState

ROUND = 1 << 12
"""Plans are made for numbers of rays rounded up to a power of two, not below this, so that few are made."""


class RayTracer:
    """Closest hits and occlusion in one state of a scene.

    Args:
        state: the scene's.
        traversal, triangle_test: as in `Scene.intersect`.
    """

    def __init__(self, state: SceneState, traversal: str, triangle_test: str) -> None:
        self._state = state
        self._queries = {kind: Query(kind, traversal, triangle_test) for kind in (CLOSEST, ANY)}
        with kept(state.device):
            self._zero, self._one, self._infinity = (
                wp.array(np.float32([value]), dtype=float, device=state.device) for value in (0.0, 1.0, np.inf)
            )

    def closest(self, origins: wp.array, directions: wp.array, count: int, *, columns: int = -1) -> DeviceHits:
        """Closest hits of the first `count` rays.

        Args:
            origins, directions: (>= count,) vec3; origins relative to the scene's centre.
            count: number of rays.
            columns: of the image whose pixels the rays are, row by row; 0 for similar rays that are no image, -1 for others.
        """
        return self._trace(CLOSEST, origins, directions, count, self._infinity, columns)

    def blocked(self, origins: wp.array, segments: wp.array, count: int, *, similar: bool = False) -> wp.array:
        """(count,) bool: whether anything is between the two ends of segments; False for segments of length 0."""
        return self._trace(ANY, origins, segments, count, self._one, 0 if similar else -1).occluded

    def blocked_from_points(
        self, origins: wp.array, directions: wp.array, count: int, distance: wp.array, expected: ExpectedRays
    ) -> wp.array:
        """(count,) bool: whether rays in all directions from points that follow one another hit anything.

        Args:
            origins, directions, count: as of `closest`.
            distance: (1,) float32, the length of all rays in units of their directions.
            expected: the most rays that there can be; the plan is made for them, so that batches of any size have the same.
        """
        rays = self._rays(origins, directions, count, distance, False, False, 0)
        chosen = find_plan(self._state, expected, self._queries[ANY])
        return trace_chosen(self._state, chosen, rays, ANY, False)[0].occluded

    def _trace(
        self, kind: str, origins: wp.array, directions: wp.array, count: int, t_max: wp.array, columns: int
    ) -> DeviceHits:
        coherent = columns >= 0
        buffers = self._rays(origins, directions, count, t_max, coherent, not coherent, max(columns, 0))
        chosen = find_plan(self._state, buffers, self._queries[kind])
        return trace_chosen(self._state, chosen, buffers, kind, False)[0]

    def _rays(
        self,
        origins: wp.array,
        directions: wp.array,
        count: int,
        t_max: wp.array,
        coherent: bool,
        scattered: bool,
        columns: int,
    ) -> RayBuffers:
        shape, kept = (max(ROUND, 1 << (count - 1).bit_length()),), (origins, directions)
        layout, center = Layout(1, 1, 0, 0, True), self._state.center
        given = RayArrays(origins, directions, self._zero, t_max, layout, count, center, shape, True, np.float32, kept)
        return RayBuffers(given, shape, True, np.float32, coherent, scattered, [], columns)

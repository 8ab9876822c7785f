"""Embree as programs use it that have rays in flat arrays, and want flat arrays back.

`wrt.bench.peers.embree` has packets that are filled before the clock starts, and leaves the answers in them: Embree's best
case, which is what wrt is held to. Users whose rays are (N, 3) arrays, as wrt's are, have no packets. Here each thread fills
a packet on its stack from flat arrays of origins and directions, traces it, and copies the answers to flat arrays: t,
triangle, u and v, or one bool a ray. All that is timed; the arrays for answers are made before. If rays share their origin,
it is one point that all packets are filled with. The loop, the thread pool, the chunks and Embree's scene are the same.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import warp as wp

from wrt.bench.core.benchmark_results import FLAT
from wrt.bench.core.workloads import Workload
from wrt.bench.peers.embree import Embree
from wrt.bench.peers.embree_packets import FlatAnswers, FlatRays, trace_arrays
from wrt.bench.peers.peer import Answer, Query
from wrt.engine.launch.traversal_launch import MIN_CHUNK
from wrt.kernels.runtime.launch import MAX_CHUNK, Chunks, PreparedLaunch, use_threads
from wrt.meshes.mesh import TriangleMesh

ANSWERS = {"t": np.float32, "primitive": np.int32, "u": np.float32, "v": np.float32, "occluded": np.bool_}
"""The arrays that `trace_arrays` writes: all but the last for closest hits, the last for occlusion."""


class EmbreeArrays(Embree):
    """Embree's C library with rays and answers in flat arrays; arguments as in `Embree`."""

    def __init__(self, threads: int = 1, version: int = 3) -> None:
        super().__init__(threads, version)
        self.name += FLAT

    def load(self, mesh: TriangleMesh) -> None:
        super().load(mesh)
        self.note += "; the time includes filling packets from flat arrays and copying answers to flat arrays"

    def closest(self, rays: Workload) -> Query:
        def read(found: dict[str, np.ndarray]) -> Answer:
            return Answer(found["t"], found["primitive"], np.stack([found["u"], found["v"]], axis=1))

        return Query(self._asking("rtcIntersect", rays), read)

    def occluded(self, rays: Workload) -> Query:
        return Query(self._asking("rtcOccluded", rays), lambda found: found["occluded"])

    def _asking(self, function: str, rays: Workload) -> Callable[[], dict[str, np.ndarray]]:  # type: ignore[override]
        """A function that calls `rtcIntersect` or `rtcOccluded` packet by packet and returns the answers by their names."""
        closest, scene, threads, count = function == "rtcIntersect", self._scene, self.threads, len(rays)
        origins = np.ascontiguousarray(rays.origins[:1] if rays.shares_origin else rays.origins)
        directions = np.ascontiguousarray(rays.directions)
        answers = {name: np.zeros(count, kind) for name, kind in ANSWERS.items() if (name != "occluded") == closest}
        given, asked = FlatRays(), FlatAnswers()
        given.origins, given.directions = wp.uint64(origins.ctypes.data), wp.uint64(directions.ctypes.data)
        given.origin_step, given.count = 0 if rays.shares_origin else 3, count
        for name, values in answers.items():
            setattr(asked, name, wp.uint64(values.ctypes.data))
        launch = PreparedLaunch(trace_arrays, [self._call(function, rays), given, asked], wp.get_device("cpu"))
        packets, chunks = -(-count // self.width), Chunks(MIN_CHUNK // self.width, MAX_CHUNK // self.width)

        def run() -> dict[str, np.ndarray]:
            with use_threads(threads):
                launch.run(packets, chunks, used=(origins, directions, answers, scene))
            return answers

        return run

"""Embree without anything around it: its C library, versions 3 and 4 (`embree_library` finds them), asked in packets of rays.

Packets have as many rays as Embree traces natively on this CPU: 16 with AVX-512, 8 with AVX, 4 elsewhere. The loop over them is
a kernel (`embree_packets`) that runs on wrt's thread pool, in chunks of as many rays as wrt's own queries. What is timed is
what a C++ program does that keeps its rays in packets: set the ends of the rays and the ids of their hits back, trace, leave
the hits in the packets; `embree_arrays` has what a program does that keeps rays and answers in flat arrays. Scenes are built
by Embree's own threads, as many as the peer has, and for speed: not with Embree's "robust" flag, which costs it 5 to 20 %.
Views and shadows are declared coherent. Where wrt is compiled for CPUs with AVX2 (`wrt.kernels.compilation.target`), Embree
runs its code for them too.
"""

from __future__ import annotations

import copy
import gc
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from wrt.bench.core.workloads import Workload
from wrt.bench.peers.embree_library import EMBREES, Device, Scene, address_of, library, thread_limit
from wrt.bench.peers.embree_packets import NO_GEOMETRY, EmbreeCall, FilledPackets, trace_packets
from wrt.bench.peers.peer import Answer, Peer, Query, spread_rays
from wrt.engine.launch.traversal_launch import MIN_CHUNK
from wrt.kernels.compilation.target import target_name
from wrt.kernels.runtime.launch import MAX_CHUNK, Chunks, PreparedLaunch, use_threads
from wrt.meshes.mesh import TriangleMesh

NATIVE_WIDTHS = {16: 34, 8: 33, 4: 32}
"""Rays of a packet, and RTC_DEVICE_PROPERTY_NATIVE_RAY16_SUPPORTED, 8 and 4: whether Embree traces that many at a time."""

COHERENT = ("far", "near", "shadow")
"""Workloads whose packets are declared coherent."""

_RAY_FIELDS = ("org_x", "org_y", "org_z", "tnear", "dir_x", "dir_y", "dir_z", "time", "tfar", "mask", "id", "flags")
_WHOLE = {"mask", "id", "flags", "primID", "geomID", "instID", "instPrimID"}

NONE = np.uint32(NO_GEOMETRY)


class Embree(Peer):
    """Embree's C library.

    Args:
        threads: that build and trace.
        version: 3 or 4.
    """

    package = "ctypes"

    def __init__(self, threads: int = 1, version: int = 3) -> None:
        super().__init__(threads)
        self.version = EMBREES[version]
        self.name = f"Embree {version}"

    def available(self) -> str | None:
        """Why it cannot run here, with the way to get it; None if it can."""
        return None if library(self.version.number) is not None else f"not installed; {self.version.remedy}"

    def load(self, mesh: TriangleMesh) -> None:
        isa = ",max_isa=avx2" if target_name() == "x86-64-v3" else ""
        self._embree_device = device = Device(self.version.number, f"threads={self.threads}{isa}", self.threads)
        self.width = next(width for width, asked in NATIVE_WIDTHS.items() if device.property(asked))
        version = device.property(0)
        self.note = f"version {version // 10000}.{version // 100 % 100}, its C library, packets of {self.width}, not robust"
        self.note += ", AVX2" if isa else ""
        padded = np.zeros((len(mesh.vertices) + 1, 3), dtype=np.float32)  # Embree reads 16 bytes a vertex
        padded[:-1] = mesh.vertices
        self._mesh = padded, np.ascontiguousarray(mesh.faces, dtype=np.uint32)

    def construct(self) -> Any:
        self.commit()
        vertices = self._mesh[0]
        return self.closest(Workload("first", "closest", vertices[:1], np.ones((1, 3), dtype=np.float32))).run()

    def commit(self) -> None:
        """Builds.

        Raises:
            RuntimeError: Embree would build with another number of threads than this peer has.
        """
        if thread_limit(self.version.number) != self.threads:
            gc.collect()  # peers that nobody needs
        if (limit := thread_limit(self.version.number)) != self.threads:
            raise RuntimeError(f"Embree's devices share threads: it would build with {limit}, not {self.threads}")
        self._scene = None  # first: its memory is the next one's
        self._scene = Scene(self._embree_device, *self._mesh)

    def asked_by(self, threads: int) -> Embree:
        """The same scene for queries with another number of threads; it cannot be built again."""
        other = copy.copy(self)
        other.threads = threads
        return other

    def closest(self, rays: Workload) -> Query:
        def read(result: np.ndarray) -> Answer:
            t, primitive, u, v = (result[name].ravel()[: len(rays)] for name in ("tfar", "primID", "u", "v"))
            hit = result["geomID"].ravel()[: len(rays)] != NONE
            return Answer(np.where(hit, t, np.inf), np.where(hit, primitive.astype(np.int32), -1), np.stack([u, v], axis=1))

        return Query(self._asking("rtcIntersect", rays), read)

    def occluded(self, rays: Workload) -> Query:
        return Query(self._asking("rtcOccluded", rays), lambda result: result["tfar"].ravel()[: len(rays)] < 0.0)

    def _call(self, function: str, rays: Workload) -> EmbreeCall:
        """A call of `rtcIntersect` or `rtcOccluded` for packets of these rays."""
        call = EmbreeCall()
        call.function = wp.uint64(address_of(self.version.number, f"{function}{self.width}"))
        call.scene = wp.uint64(self._scene.handle)
        call.version, call.width, call.t_max = self.version.number, self.width, rays.t_max
        call.flags = self.version.coherent if rays.name in COHERENT else 0
        call.closest = function == "rtcIntersect"
        return call

    def _asking(self, function: str, rays: Workload) -> Callable[[], np.ndarray]:
        """A function that calls `rtcIntersect` or `rtcOccluded` and returns the packets."""
        closest, scene, threads = function == "rtcIntersect", self._scene, self.threads
        hit_fields = self.version.hit_fields if closest else ()
        packets = ray_packets(rays, self.width, hit_fields)
        filled = FilledPackets()
        filled.address, filled.fields = wp.uint64(packets.ctypes.data), len(_RAY_FIELDS) + len(hit_fields)
        launch = PreparedLaunch(trace_packets, [self._call(function, rays), filled], wp.get_device("cpu"))
        chunks = Chunks(MIN_CHUNK // self.width, MAX_CHUNK // self.width)

        def run() -> np.ndarray:
            with use_threads(threads):
                launch.run(len(packets), chunks, used=(packets, scene))
            return packets

        return run


def ray_packets(rays: Workload, width: int, hit_fields: tuple[str, ...]) -> np.ndarray:
    """(ceil(N / width),) Embree's RTCRay of that width, or with fields of a hit its RTCRayHit, aligned as it requires.

    The rays are in order; lanes beyond the last ray repeat it.
    """
    names = (*_RAY_FIELDS, *hit_fields)
    layout = np.dtype([(name, np.uint32 if name in _WHOLE else np.float32, width) for name in names])
    count = -(-len(rays) // width)
    memory = np.zeros(count * layout.itemsize + 64, dtype=np.uint8)
    skipped = -memory.ctypes.data % 64
    packets = memory[skipped : skipped + count * layout.itemsize].view(layout)
    last = np.minimum(np.arange(count * width), len(rays) - 1).reshape(count, width)
    for kind, values in zip(("org", "dir"), spread_rays(rays), strict=True):
        for axis in range(3):
            packets[f"{kind}_{'xyz'[axis]}"] = values[last, axis]
    packets["mask"] = NONE
    return packets

"""Embree without anything around it: its C library, asked for packets of sixteen rays in their native layout.

No compiler is needed: the library (version 3; Debian and Ubuntu: libembree3-3) is called through ctypes, which lets other
threads run meanwhile, with some hundreds of packets a call. What is timed is what a C++ program would do that keeps its rays in
packets: set the ends of the rays and the ids of their hits back, trace, leave the hits in the packets. Scenes are built for
speed, not with Embree's "robust" flag, which costs it 5 to 20 %; views and shadows are declared coherent. Where wrt is
compiled for CPUs with AVX2 (`wrt.kernels.runtime.target`), Embree runs its code for them too.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import weakref
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from ctypes import POINTER, Structure, byref, c_char_p, c_int, c_size_t, c_ssize_t, c_uint, c_void_p
from functools import cache
from typing import Any

import numpy as np

from wrt.bench.contract import Answer, Peer, Query, spread_rays
from wrt.bench.workloads import Workload
from wrt.kernels.runtime.target import target_name
from wrt.meshes.mesh import TriangleMesh

WIDTH = 16
"""Rays of a packet."""

PACKETS_A_CALL = 512
"""8192 rays: some 0.3 ms, so that neither Python nor the last call counts."""

COHERENT = ("far", "near", "shadow")
"""Workloads whose packets are declared coherent."""

_RAY_FIELDS = "org_x org_y org_z tnear dir_x dir_y dir_z time tfar mask id flags"
_HIT_FIELDS = "Ng_x Ng_y Ng_z u v primID geomID instID"


def _layout(names: str) -> np.dtype:
    whole = {"mask", "id", "flags", "primID", "geomID", "instID"}
    return np.dtype([(name, np.uint32 if name in whole else np.float32, WIDTH) for name in names.split()])


RAY_PACKET = _layout(_RAY_FIELDS)
"""Embree's RTCRay16."""

RAY_HIT_PACKET = _layout(f"{_RAY_FIELDS} {_HIT_FIELDS}")
"""Embree's RTCRayHit16."""

NONE = np.uint32(0xFFFFFFFF)
"""RTC_INVALID_GEOMETRY_ID."""


class Context(Structure):
    """Embree's RTCIntersectContext: RTC_INTERSECT_CONTEXT_FLAG_COHERENT or 0, no filter, no instance."""

    _fields_ = (("flags", c_int), ("filter", c_void_p), ("instance", c_uint))


class Embree(Peer):
    """Embree's C library, version 3."""

    name = "Embree"
    package = "ctypes"

    def available(self) -> str | None:
        """Why it cannot run here; None if it can."""
        return None if _library() is not None else "not installed; install Embree 3 for your system (Debian: libembree3-3)"

    def load(self, mesh: TriangleMesh) -> None:
        lib = _library()
        self._pool = ThreadPoolExecutor(self.threads)
        most = ",max_isa=avx2" if target_name() == "x86-64-v3" else ""
        self._embree_device = Owned(lib.rtcNewDevice(f"threads={self.threads}{most}".encode()), lib.rtcReleaseDevice)
        version = lib.rtcGetDeviceProperty(self._embree_device.handle, 0)
        self.note = f"version {version // 10000}.{version // 100 % 100}, its C library, packets of {WIDTH}, not robust"
        self.note += ", AVX2" if most else ""
        padded = np.zeros((len(mesh.vertices) + 1, 3), dtype=np.float32)  # Embree reads 16 bytes a vertex
        padded[:-1] = mesh.vertices
        self._mesh = padded, np.ascontiguousarray(mesh.faces, dtype=np.uint32)

    def construct(self) -> Any:
        lib, device, (vertices, faces) = _library(), self._embree_device.handle, self._mesh
        self._scene = Owned(lib.rtcNewScene(device), lib.rtcReleaseScene)
        triangles = Owned(lib.rtcNewGeometry(device, 0), lib.rtcReleaseGeometry)
        share = lib.rtcSetSharedGeometryBuffer
        share(triangles.handle, 1, 0, 0x9003, vertices.ctypes.data, 0, 12, len(vertices) - 1)
        share(triangles.handle, 0, 0, 0x5003, faces.ctypes.data, 0, 12, len(faces))
        lib.rtcCommitGeometry(triangles.handle)
        lib.rtcAttachGeometry(self._scene.handle, triangles.handle)
        lib.rtcCommitScene(self._scene.handle)
        return self.closest(Workload("first", "closest", vertices[:1], np.ones((1, 3), dtype=np.float32))).run()

    def closest(self, rays: Workload) -> Query:
        packets = _packets(rays, RAY_HIT_PACKET)

        def reset(part: np.ndarray) -> None:
            part["tfar"] = rays.t_max
            part["geomID"] = NONE

        def read(result: np.ndarray) -> Answer:
            t, primitive, u, v = (result[name].ravel()[: len(rays)] for name in ("tfar", "primID", "u", "v"))
            hit = result["geomID"].ravel()[: len(rays)] != NONE
            return Answer(np.where(hit, t, np.inf), np.where(hit, primitive.astype(np.int32), -1), np.stack([u, v], axis=1))

        return Query(self._asking(_library().rtcIntersectNM, rays, packets, reset), read)

    def occluded(self, rays: Workload) -> Query:
        packets = _packets(rays, RAY_PACKET)

        def reset(part: np.ndarray) -> None:
            part["tfar"] = rays.t_max

        run = self._asking(_library().rtcOccludedNM, rays, packets, reset)
        return Query(run, lambda result: result["tfar"].ravel()[: len(rays)] < 0.0)

    def _asking(
        self, trace: Callable, rays: Workload, packets: np.ndarray, reset: Callable[[np.ndarray], None]
    ) -> Callable[[], np.ndarray]:
        scene, size, flags = self._scene, packets.itemsize, int(rays.name in COHERENT)
        parts = [packets[first : first + PACKETS_A_CALL] for first in range(0, len(packets), PACKETS_A_CALL)]
        pieces = [(part, part.ctypes.data, len(part)) for part in parts]

        def ask(waiting: Iterator[tuple[np.ndarray, int, int]]) -> None:
            context = Context(flags, None, NONE)
            for part, address, count in waiting:
                reset(part)
                trace(scene.handle, byref(context), address, WIDTH, count, size)

        def run() -> np.ndarray:
            waiting = iter(pieces)  # a list's, so that threads may share it
            for _ in self._pool.map(ask, [waiting] * self.threads):
                pass
            return packets

        return run


class Owned:
    """A reference to something of Embree's, given back when nothing needs it any more."""

    def __init__(self, handle: int | None, release: Callable[[int], None]) -> None:
        if not handle:
            raise RuntimeError("Embree made nothing: its device could not be used")
        self.handle = handle
        weakref.finalize(self, release, handle)


def _packets(rays: Workload, layout: np.dtype) -> np.ndarray:
    """The rays in packets, aligned as Embree asks; lanes beyond the last ray repeat it."""
    count = -(-len(rays) // WIDTH)
    memory = np.zeros(count * layout.itemsize + 64, dtype=np.uint8)
    skipped = -memory.ctypes.data % 64
    packets = memory[skipped : skipped + count * layout.itemsize].view(layout)
    last = np.minimum(np.arange(count * WIDTH), len(rays) - 1).reshape(count, WIDTH)
    for kind, values in zip(("org", "dir"), spread_rays(rays), strict=True):
        for axis in range(3):
            packets[f"{kind}_{'xyz'[axis]}"] = values[last, axis]
    packets["mask"] = NONE
    return packets


@cache
def _library() -> Any:
    """Embree's C library with the types of what is called; None if it is not there."""
    name = ctypes.util.find_library("embree3")
    if name is None:
        return None
    lib = ctypes.CDLL(name)
    handle, context = c_void_p, POINTER(Context)
    ask = (None, (handle, context, c_void_p, c_uint, c_uint, c_size_t))
    types: dict[str, tuple[Any, tuple[Any, ...]]] = {
        "rtcNewDevice": (handle, (c_char_p,)),
        "rtcGetDeviceProperty": (c_ssize_t, (handle, c_int)),
        "rtcReleaseDevice": (None, (handle,)),
        "rtcNewScene": (handle, (handle,)),
        "rtcReleaseScene": (None, (handle,)),
        "rtcNewGeometry": (handle, (handle, c_int)),
        "rtcReleaseGeometry": (None, (handle,)),
        "rtcSetSharedGeometryBuffer": (None, (handle, c_int, c_uint, c_int, c_void_p, c_size_t, c_size_t, c_size_t)),
        "rtcCommitGeometry": (None, (handle,)),
        "rtcAttachGeometry": (c_uint, (handle, handle)),
        "rtcCommitScene": (None, (handle,)),
        "rtcIntersectNM": ask,
        "rtcOccludedNM": ask,
    }
    for function, (result, arguments) in types.items():
        getattr(lib, function).restype = result
        getattr(lib, function).argtypes = arguments
    return lib

"""Embree's C library, version 3, called through ctypes: what the benchmark needs of it."""

from __future__ import annotations

import ctypes
import ctypes.util
import weakref
from collections.abc import Callable
from ctypes import c_char_p, c_int, c_size_t, c_ssize_t, c_uint, c_void_p, cast
from functools import cache
from typing import Any

import numpy as np


@cache
def library() -> Any:
    """Embree's C library with the types of what is called; None if it is not there."""
    name = ctypes.util.find_library("embree3")
    if name is None:
        return None
    lib = ctypes.CDLL(name)
    handle = c_void_p
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
    }
    for function, (result, arguments) in types.items():
        getattr(lib, function).restype = result
        getattr(lib, function).argtypes = arguments
    return lib


def address_of(function: str) -> int:
    """Address of one of its functions."""
    return cast(getattr(library(), function), c_void_p).value


class Owned:
    """A reference to something of Embree's, given back when nothing needs it any more."""

    def __init__(self, handle: int | None, release: Callable[[int], None]) -> None:
        if not handle:
            raise RuntimeError("Embree made nothing: its device could not be used")
        self.handle = handle
        weakref.finalize(self, release, handle)


class Device(Owned):
    """A device of Embree's, which lives as long as its scenes do.

    Attributes:
        threads: that it builds with.
    """

    def __init__(self, settings: str, threads: int) -> None:
        super().__init__(library().rtcNewDevice(settings.encode()), library().rtcReleaseDevice)
        self.threads = threads
        _devices.add(self)


class Scene(Owned):
    """Triangles, built for queries by the device's threads. It keeps the device and the arrays, which Embree shares.

    Args:
        device: where.
        vertices: (V + 1, 3) float32; the last one is padding, since Embree reads 16 bytes a vertex.
        faces: (F, 3) uint32.
    """

    def __init__(self, device: Device, vertices: np.ndarray, faces: np.ndarray) -> None:
        lib = library()
        super().__init__(lib.rtcNewScene(device.handle), lib.rtcReleaseScene)
        self.device, self.arrays = device, (vertices, faces)
        triangles = Owned(lib.rtcNewGeometry(device.handle, 0), lib.rtcReleaseGeometry)
        share = lib.rtcSetSharedGeometryBuffer
        share(triangles.handle, 1, 0, 0x9003, vertices.ctypes.data, 0, 12, len(vertices) - 1)
        share(triangles.handle, 0, 0, 0x5003, faces.ctypes.data, 0, 12, len(faces))
        lib.rtcCommitGeometry(triangles.handle)
        lib.rtcAttachGeometry(self.handle, triangles.handle)
        lib.rtcCommitScene(self.handle)


_devices: weakref.WeakSet[Device] = weakref.WeakSet()
"""All devices of the process."""


def thread_limit() -> int:
    """Threads with which any device builds: all of a process share them, as many as the device with the most has."""
    return max((device.threads for device in _devices), default=0)

"""Embree's C libraries, versions 3 and 4, called through ctypes: what the benchmark needs of them.

The two differ in where they are found, in the fields of a hit and in how a query is told that its rays are coherent
(`EMBREES`); `embree_packets` has the rest. Layouts are those of the public headers.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import weakref
from collections.abc import Callable
from ctypes import c_char_p, c_int, c_size_t, c_ssize_t, c_uint, c_void_p, cast
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from typing import Any

import numpy as np


@dataclass(frozen=True)
class EmbreeVersion:
    """What differs between versions of Embree.

    Attributes:
        number: of the version.
        find: where its library is: a name or path for the dynamic linker; None if it is not there.
        remedy: how to get it.
        hit_fields: fields of a hit, after those of its ray. Version 4 adds the primitive of an instance, `instPrimID`.
        coherent: the flag which says that rays are coherent.
    """

    number: int
    find: Callable[[], str | None]
    remedy: str
    hit_fields: tuple[str, ...]
    coherent: int


def library_in_embreex() -> str | None:
    """Path of the library that the wheel of embreex carries; embreex itself is not imported."""
    try:
        files = distribution("embreex").files or []
    except PackageNotFoundError:
        return None
    return next((str(file.locate()) for file in files if "embree4" in file.name), None)


HIT_FIELDS = ("Ng_x", "Ng_y", "Ng_z", "u", "v", "primID", "geomID", "instID")

EMBREES: dict[int, EmbreeVersion] = {
    found.number: found
    for found in (
        EmbreeVersion(
            3,
            lambda: ctypes.util.find_library("embree3"),
            "install Embree 3 for your system (Debian 12: libembree3-3)",
            HIT_FIELDS,
            1,
        ),
        EmbreeVersion(
            4,
            lambda: library_in_embreex() or ctypes.util.find_library("embree4"),
            "pip install embreex, whose wheel has it, or install Embree 4 for your system (Debian: libembree4-4)",
            (*HIT_FIELDS, "instPrimID"),
            1 << 16,
        ),
    )
}
"""Versions of Embree by their numbers."""


@cache
def library(version: int) -> Any:
    """Embree's C library of a version, with the types of what is called; None if it is not there or cannot be loaded."""
    name = EMBREES[version].find()
    if name is None:
        return None
    try:
        lib = ctypes.CDLL(name)
    except OSError:  # what it needs is missing
        return None
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


def address_of(version: int, function: str) -> int:
    """Address of one of a version's functions."""
    return cast(getattr(library(version), function), c_void_p).value


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
        version: number of its version.
        threads: that it builds with.
    """

    def __init__(self, version: int, settings: str, threads: int) -> None:
        self.library = library(version)
        super().__init__(self.library.rtcNewDevice(settings.encode()), self.library.rtcReleaseDevice)
        self.version, self.threads = version, threads
        _devices.add(self)

    def property(self, number: int) -> int:
        """`rtcGetDeviceProperty`."""
        return self.library.rtcGetDeviceProperty(self.handle, number)


class Scene(Owned):
    """Triangles, built for queries by the device's threads. It keeps the device and the arrays, which Embree shares.

    Args:
        device: where.
        vertices: (V + 1, 3) float32; the last one is padding, since Embree reads 16 bytes a vertex.
        faces: (F, 3) uint32.
    """

    def __init__(self, device: Device, vertices: np.ndarray, faces: np.ndarray) -> None:
        lib = device.library
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


def thread_limit(version: int) -> int:
    """Threads with which any device of a version builds: they share them, as many as the device with the most has.

    Devices that others make with the same library count too, but are not known here: embreex makes its own, for all cores.
    """
    return max((device.threads for device in _devices if device.version == version), default=0)

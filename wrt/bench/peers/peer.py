"""The face that wrt and its peers share.

**Contract.** `available` says whether a peer can run here. `load` brings a mesh into the peer's native form and
`construct` builds from it until the first ray is answered, so that lazy builds count; only `construct` is timed. `closest`
and `occluded` bring the rays into native form and return a `Query`: its `run` is timed and returns when the answer is
complete in memory, its `read` turns what `run` returned into NumPy arrays, untimed. So do `all_hits` and `inside`, of those
that have such queries.
"""

from __future__ import annotations

import importlib
import importlib.util
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wrt.bench.core.paired_timing import time_call
from wrt.bench.core.workloads import ALL, CLOSEST, INSIDE, OCCLUSION, Workload
from wrt.meshes.mesh import TriangleMesh


@dataclass(frozen=True)
class Answer:
    """Closest hits.

    Attributes:
        t: (N,) in units of the direction; inf for a miss.
        primitive: (N,) index of the triangle; -1 for a miss.
        uv: (N, 2) weights of the second and third vertex; None where the peer does not give them.
    """

    t: np.ndarray
    primitive: np.ndarray
    uv: np.ndarray | None = None


@dataclass(frozen=True)
class Lists:
    """All hits, in any order.

    Attributes:
        ray: (M,) number of the ray of each hit.
        primitive: (M,) index of the triangle.
    """

    ray: np.ndarray
    primitive: np.ndarray


@dataclass(frozen=True)
class Query:
    """Rays in a peer's native form, ready to be asked.

    Attributes:
        run: traces the rays; returns the peer's own result.
        read: that result -> `Answer`, `Lists` for all hits, or (N,) bool for occlusion and inside tests.
    """

    run: Callable[[], Any]
    read: Callable[[Any], Any]


class Peer(ABC):
    """One contender.

    Attributes:
        name: in tables.
        package: what must be importable, and the name to install it by.
        threads: CPU threads that it uses.
        device: Warp's name of the device that it runs on.
        note: what a reader of its figures should know; empty if nothing.
    """

    name: str
    package: str
    note: str = ""

    def __init__(self, threads: int = 1, device: str = "cpu") -> None:
        self.threads, self.device = threads, device

    def available(self) -> str | None:
        """Why it cannot run here, with the way to get it; None if it can."""
        if importlib.util.find_spec(self.package) is None:
            return f"needs {self.package}, which is not installed: pip install {self.package}"
        try:
            importlib.import_module(self.package)
        except ImportError as error:  # a system library is missing, for one
            return f"{self.package} is installed but cannot be imported: {error}"
        return None

    @abstractmethod
    def load(self, mesh: TriangleMesh) -> None:
        """Takes the mesh in native form; forgets what was built before."""

    @abstractmethod
    def construct(self) -> Any:
        """Builds, and answers one ray."""

    def build(self, mesh: TriangleMesh) -> float:
        """Loads and constructs; seconds of the latter."""
        self.load(mesh)
        return time_call(self.construct)

    @abstractmethod
    def closest(self, rays: Workload) -> Query:
        """Closest hits."""

    def occluded(self, rays: Workload) -> Query | None:
        """Whether anything is hit; None if the peer has no such query."""
        return None

    def all_hits(self, rays: Workload) -> Query | None:
        """All hits of each ray; None if the peer has no such query."""
        return None

    def inside(self, points: Workload) -> Query | None:
        """Whether points, the workload's origins, are inside the mesh; None if the peer has no such query."""
        return None

    def query(self, rays: Workload) -> Query | None:
        """The workload's query."""
        ask = {CLOSEST: self.closest, OCCLUSION: self.occluded, ALL: self.all_hits, INSIDE: self.inside}[rays.query]
        return ask(rays)

    def ray_limit(self, triangles: int) -> int | None:
        """Most rays that it is asked at once, where more would take minutes."""
        return None


def device_rays(rays: Workload, device: wp.Device | str) -> tuple[wp.array, wp.array]:
    """Origins and directions as arrays on a device; one origin only if all rays share it."""
    origins = rays.origins[:1] if rays.shares_origin else rays.origins
    return wp.array(origins, dtype=wp.vec3, device=device), wp.array(rays.directions, dtype=wp.vec3, device=device)


def spread_rays(rays: Workload) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions as two full (N, 3) arrays."""
    return np.ascontiguousarray(rays.origins), np.ascontiguousarray(rays.directions)

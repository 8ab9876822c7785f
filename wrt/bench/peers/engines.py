"""wrt as a contender: as users call it by default, with a plain triangle test, and once for each traversal and builder."""

from __future__ import annotations

from typing import Any

import warp as wp

from wrt.accelerators.accelerator import Accelerator, AcceleratorName
from wrt.accelerators.tree_descriptions import Bvh
from wrt.bench.core.workloads import ALL, INSIDE, Workload
from wrt.bench.peers.peer import Answer, Lists, Peer, Query, device_rays
from wrt.engine.facts.query_kinds import AUTO
from wrt.engine.rays.rays import Rays
from wrt.kernels.runtime.launch import get_num_threads
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

BRUTE_FORCE_PAIRS = 1 << 26
"""Pairs of ray and triangle that a traversal without a tree is asked to test in one call."""


class Engine(Peer):
    """wrt with a given accelerator, traversal and triangle test.

    Timed: from rays in memory to t, primitive ids and uv in memory.
    """

    name = "wrt"
    package = "wrt"

    def __init__(
        self,
        threads: int = 1,
        device: str = "cpu",
        *,
        name: str = "wrt",
        accelerator: AcceleratorName | Accelerator = AUTO,
        traversal: str = AUTO,
        triangle_test: str = AUTO,
    ) -> None:
        super().__init__(threads, device)
        self.name = name
        self.accelerator, self.traversal, self.triangle_test = accelerator, traversal, triangle_test
        self.mesh: TriangleMesh | None = None
        self.scene: Scene | None = None

    def load(self, mesh: TriangleMesh) -> None:
        self.mesh, self.scene = mesh, None

    def construct(self) -> Scene:
        threads = None if self.threads == get_num_threads() else self.threads  # as users have it who choose nothing
        self.scene = Scene(self.mesh, self.accelerator, device=self.device, num_threads=threads)
        self.scene.intersect([self.mesh.center], [[1.0, 0.0, 0.0]], **self._options)
        wp.synchronize_device(self.device)
        return self.scene

    def closest(self, rays: Workload) -> Query:
        scene, native, options, complete = self.scene, self._native(rays), self._options, self._complete

        def run() -> Any:
            hits = scene.intersect(native, **options)
            return complete((hits.t, hits.primitive_id, hits.uv))

        return Query(run, lambda result: Answer(*(as_numpy(values) for values in result)))

    def occluded(self, rays: Workload) -> Query:
        scene, native, options, complete = self.scene, self._native(rays), self._options, self._complete

        def run() -> Any:
            return complete(scene.occluded(native, **options))

        return Query(run, as_numpy)

    def all_hits(self, rays: Workload) -> Query:
        scene, native, options, complete = self.scene, self._native(rays), self._options, self._complete

        def run() -> Any:
            lists = scene.intersect_all(native, **options)
            return complete((lists.ray_id, lists.primitive_id, lists.t, lists.uv))

        return Query(run, lambda result: Lists(*(as_numpy(values) for values in result[:2])))

    def inside(self, points: Workload) -> Query:
        scene, native, complete = self.scene, self._native(points).origins, self._complete

        def run() -> Any:
            return complete(scene.contains(native, traversal=self.traversal))

        return Query(run, as_numpy)

    def query(self, rays: Workload) -> Query | None:
        return super().query(rays) if self.answers(rays) else None

    def answers(self, rays: Workload) -> bool:
        """Whether its traversal and its triangle test, if they are not on "auto", answer the workload's query."""
        test, way = TRIANGLE_TESTS.get(self.triangle_test), TRAVERSALS.get(self.traversal)
        if not rays.shares_origin and any(entry is not None and entry.needs_shared_origin for entry in (test, way)):
            return False
        if rays.query not in (ALL, INSIDE):
            return True
        tree = "none" if way is not None and way.trees == ("none",) else self.scene.accelerator.kind
        counts = way is None or way.supports("count", tree)
        return counts and (test is None or (test.crossing is not None and rays.query == ALL))

    def ray_limit(self, triangles: int) -> int | None:
        way = TRAVERSALS.get(self.traversal)
        return max(64, BRUTE_FORCE_PAIRS // triangles) if way is not None and way.trees == ("none",) else None

    @property
    def _options(self) -> dict[str, Any]:
        """What is chosen; callers who choose nothing pass nothing."""
        options = {"traversal": self.traversal, "triangle_test": self.triangle_test}
        return {name: value for name, value in options.items() if value != AUTO}

    def _complete(self, result: Any) -> Any:
        """A result, when the device has finished it; on the CPU, calls return when it is."""
        if self.device != "cpu":
            wp.synchronize_device(self.device)
        return result

    def _native(self, rays: Workload) -> Rays:
        """NumPy arrays on the CPU, arrays on the device on CUDA."""
        if self.scene.device.is_cpu:
            return rays.rays
        return Rays(*device_rays(rays, self.scene.device), 0.0, rays.t_max)


def default_engine(threads: int, device: str) -> Engine:
    """What users get who choose nothing: the reference of all ratios."""
    return Engine(threads, device)


def plain_engine(threads: int, device: str) -> Engine:
    """The default but for the triangle test, Moeller and Trumbore's: beside it stands what being watertight costs."""
    engine = Engine(threads, device, name="wrt, plain", triangle_test="moeller_trumbore")
    engine.note = "Moeller and Trumbore's triangle test, not watertight: 0.9x says that wrt's own takes a ninth longer"
    return engine


def all_engines(threads: int, device: str) -> list[Engine]:
    """One engine for each traversal of each tree; `triangle_test_comparison` has one for each triangle test."""
    engines = []
    for way in TRAVERSALS.values():
        for tree in way.trees:
            name = f"wrt, {way.name}" if tree == "none" else f"wrt, {tree}, {way.name}"
            accelerator = AUTO if tree == "none" else tree if way.width is None else Bvh(width=way.width)
            engines.append(Engine(threads, device, name=name, accelerator=accelerator, traversal=way.name))  # type: ignore[arg-type]
    return engines


def as_numpy(values: Any) -> Any:
    """A Warp array as a NumPy array; anything else as it is."""
    return values.numpy() if isinstance(values, wp.array) else values

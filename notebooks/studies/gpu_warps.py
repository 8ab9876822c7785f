"""Rays of a CUDA warp together, as packets, streams and frusta, beside threads that take the next ray when they are done."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter

import numpy as np
import warp as wp

from wrt.accelerators.tree_descriptions import Bvh
from wrt.bench.core.workloads import OCCLUSION, Workload, WorkloadMaker
from wrt.engine.device_hits import DeviceHits
from wrt.engine.executor import on_device
from wrt.engine.facts.query_kinds import ANY, CLOSEST, QUERIES
from wrt.engine.launch.persistent_launch import binary_tree
from wrt.engine.launch.traversal_launch import divide, kernel_and_inputs, no_work
from wrt.engine.plan.choices import make_plan
from wrt.engine.plan.plan import stack_levels, traversal_config, traversal_of
from wrt.kernels.answers import ANSWERS
from wrt.kernels.classics.studies.warp_packets import WAYS, make_kernel, threads_of
from wrt.kernels.runtime.launch import launch
from wrt.kernels.traversal.traversal_config import PersistentConfig
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

BASE = "persistent"
"""What the others are compared with: what "auto" chooses on CUDA."""

LEAF = 2
"""Triangles of a leaf, as "auto" has them on CUDA."""


@dataclass(frozen=True)
class WarpFigures:
    """A way to trace some rays.

    Attributes:
        rays: which; views are in tiles of 4 x 4 pixels, or "by rows".
        way: one of `wrt.kernels.classics.studies.warp_packets.WAYS`, or `BASE`.
        million_rays: a second, by the median of the launches.
        ratio: of speeds, to `BASE`.
        same: whether answers are those of `BASE`, to the bit.
    """

    rays: str
    way: str
    million_rays: float
    ratio: float
    same: bool


@dataclass
class Traced:
    """Rays on the device of a scene whose nodes have two children, and memory for their answers."""

    scene: Scene
    work: Workload

    def __post_init__(self) -> None:
        self.kind = ANY if self.work.query == OCCLUSION else CLOSEST
        self.rays = on_device(self.scene.state, self.work.rays, QUERIES[self.kind])
        self.hits = DeviceHits.new(self.kind, self.rays.count, self.scene.device)

    def launcher(self, way: str) -> Callable[[], None]:
        """A launch of a way's kernel, whose arguments are made once."""
        state, batch, from_zero = self.scene.state, self.rays.batch, True
        if way == BASE:
            plan = make_plan(state, self.rays, BASE, "auto", self.kind)
            config = traversal_config(plan, state, self.kind, False)
            config = replace(config, persistent=PersistentConfig(from_zero))
            idle = no_work(traversal_of(plan).counters, state.device.alias)
            kernel, inputs = kernel_and_inputs(state, plan, config, batch, self.hits.struct(), idle)
            _, threads, _ = divide(state, plan, config, batch.count)
        else:
            kernel = make_kernel(way, self.kind, stack_levels(state.tree.depth), from_zero)
            inputs, threads = [*binary_tree(state), batch, self.hits.struct()], threads_of(way, batch.count)
        return partial(launch, kernel, threads, inputs, device=self.scene.device)

    def answers(self) -> list[np.ndarray]:
        """What the last launch wrote."""
        return [getattr(self.hits, name).numpy().copy() for name in ANSWERS[self.kind].stored.columns]

    def seconds(self, run: Callable[[], None]) -> float:
        """Of a launch and the wait for it."""
        start = perf_counter()
        run()
        wp.synchronize_device(self.scene.device)
        return perf_counter() - start


def workloads(mesh: TriangleMesh, size: int) -> list[tuple[str, Workload]]:
    """Rays of every kind, from those of one eye to those from anywhere to anywhere."""
    tiles, rows = (WorkloadMaker(mesh, size=size, order=order) for order in ("tiles", "rows"))
    return [
        *((one.name, one) for one in tiles.make(["far", "near", "shadow", "ao", "random"])),
        *((f"{one.name} by rows", one) for one in rows.make(["near"])),
    ]


def compare_ways(scene: Scene, size: int, rounds: int) -> list[WarpFigures]:
    """All ways and all rays in a scene of one mesh, whose nodes have two children; the ways take turns."""
    figures = []
    for name, work in workloads(scene.meshes[0], size):
        traced = Traced(scene, work)
        runs = {way: traced.launcher(way) for way in (BASE, *WAYS)}
        answers = {}
        for way, run in runs.items():  # compiles its kernel
            traced.hits.clear(traced.kind)
            run()
            answers[way] = traced.answers()
        taken = {way: [] for way in runs}
        for _ in range(rounds):
            for way, run in runs.items():
                taken[way].append(traced.seconds(run))
        for way, seconds in taken.items():
            same = all(map(np.array_equal, answers[way], answers[BASE]))
            speed, base = len(work) / np.median(seconds) / 1e6, len(work) / np.median(taken[BASE]) / 1e6
            figures.append(WarpFigures(name, way, float(speed), float(speed / base), same))
    return figures


def compare_warps(mesh: TriangleMesh, *, size: int = 1024, rounds: int = 15) -> list[WarpFigures]:
    """Packets, streams and frusta of a CUDA warp beside persistent threads, on the first CUDA device.

    On a machine without one the same kernels run on the CPU, a ray at a time: their answers are compared, and times
    say nothing.
    """
    devices = wp.get_cuda_devices()
    scene = Scene(mesh, Bvh(width=2, max_leaf_triangles=LEAF), device=devices[0] if devices else "cpu")
    return compare_ways(scene, size, rounds)

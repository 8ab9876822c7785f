"""How queries and builds gain from threads on the CPU, how Embree does beside them, and how the pool's schedules compare.

For a job, contenders are the numbers of threads (or the schedules), which take turns; ratios are those of the same round. Of
some jobs, versions of Embree do the same beside wrt, with the same rays, on the same pool of threads, or builds of the same
mesh with threads of their own: with each number of threads they take their turns after wrt.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from wrt.bench.core.paired_timing import Contender, Timing, take_turns
from wrt.bench.core.workloads import Workload, WorkloadMaker
from wrt.bench.peers.embree import Embree
from wrt.bench.peers.engines import Engine
from wrt.imaging.cameras import PinholeCamera
from wrt.kernels.runtime.launch import use_schedule
from wrt.kernels.runtime.schedules import DEFAULT_SCHEDULE, SCHEDULES
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

VIEWS = (256, 1024)
"""Pixels a side."""

RANDOM = (1 << 16, 1 << 21)
"""Rays."""

BUILDS = ("kdtree", "bvh")
"""The kd-tree first: threads of Embree 4 that has built spin for as long as it lives, and take the cores from others."""

COMPARED = ("far", "near", "random")
"""Workloads that Embree traces, too."""

COMPARED_SIZE = 1024
"""Of these workloads: pixels a side; `random` has as many rays."""

SETTLE = 0.05
"""Calls shorter than this many seconds are preceded by untimed ones."""

WARM = 0.02
"""Seconds of untimed calls: after a turn with fewer threads, the others sleep."""

OnTurn = Callable[[str], None]
Prepare = Callable[[int], Callable[[], Any]]


@dataclass(frozen=True)
class Job:
    """Something to do with a number of threads.

    Attributes:
        name: what the tables call it.
        unit: "Mrays/s" or "ms".
        amount: rays; 0 for a build.
        prepare: makes what is run, for a number of threads.
        peers: by the name of each version of Embree that is asked: makes what it runs.
    """

    name: str
    unit: str
    amount: int
    prepare: Prepare
    peers: dict[str, Prepare] = field(default_factory=dict)

    def figure(self, seconds: float) -> float:
        """The time of one run in the job's unit."""
        return self.amount / seconds / 1e6 if self.amount else seconds * 1e3


@dataclass
class JobFigures:
    """What was measured of a job.

    Attributes:
        job, unit: its name and unit.
        names: of the contenders: numbers of threads, or schedules.
        figures: of each, by the median time.
        gains: of each, the first contender's time / its own, median of the rounds.
        engine: "wrt", "Embree 3" or "Embree 4".
        ratios: of a peer with each number of threads, its time / wrt's, median of the rounds: above one, wrt is faster.
        least_ratios: of wrt with each number of threads: the ratio of the fastest peer; empty if none was asked.
    """

    job: str
    unit: str
    names: list[str]
    figures: list[float]
    gains: list[float]
    engine: str = "wrt"
    ratios: list[float] = field(default_factory=list)
    least_ratios: list[float] = field(default_factory=list)


class EmbreeTurns:
    """A version of Embree with changing numbers of threads.

    One scene answers rays with any number of threads, since these are wrt's. Builds need a device with this many threads, and
    no other device beside it: that is made when the number changes, in the untimed call before the timed one.
    """

    def __init__(self, mesh: TriangleMesh, version: int) -> None:
        self._mesh, self._version = mesh, version
        self._peer: Embree | None = None

    def rays(self, workload: Workload) -> Prepare:
        """A function that traces a workload."""

        def prepare(threads: int) -> Callable[[], Any]:
            if self._peer is None:
                self._peer = Embree(1, self._version)
                self._peer.build(self._mesh)
            return self._peer.asked_by(threads).closest(workload).run

        return prepare

    def build(self, threads: int) -> Callable[[], Any]:
        """What builds."""

        def run() -> None:
            if self._peer is None or self._peer.threads != threads:
                self._peer = None  # before the next one is made
                self._peer = Embree(threads, self._version)
                self._peer.load(self._mesh)
            self._peer.commit()

        return run


def make_jobs(mesh: TriangleMesh, embrees: Sequence[int] = ()) -> list[Job]:
    """The jobs on a mesh; those on Embree's workloads only if one of its versions takes part."""
    engines: dict[int, Engine] = {}
    turns = {Embree(1, version).name: EmbreeTurns(mesh, version) for version in embrees}

    def engine_for(threads: int) -> Engine:
        if threads not in engines:
            engines[threads] = Engine(threads)
            engines[threads].build(mesh)
        return engines[threads]

    def rays_job(name: str, count: int, *rays: Any) -> Job:
        return Job(name, "Mrays/s", count, lambda threads: lambda: engine_for(threads).scene.intersect(*rays))

    def compared_job(workload: Workload) -> Job:
        def prepare(threads: int) -> Callable[[], Any]:
            return engine_for(threads).closest(workload).run

        peers = {name: embree.rays(workload) for name, embree in turns.items()}
        return Job(f"{workload.name} {len(workload):,}", "Mrays/s", len(workload), prepare, peers)

    def build_job(kind: Any) -> Job:
        def prepare(threads: int) -> Callable[[], Any]:
            return lambda: Scene(mesh, kind, device="cpu", num_threads=threads)

        peers = {name: embree.build for name, embree in turns.items()} if kind == "bvh" else {}
        return Job(f"build {kind}", "ms", 0, prepare, peers)  # type: ignore[arg-type]

    rng, (low, high) = np.random.default_rng(0), mesh.bounds
    views = {size: PinholeCamera.framing(mesh, size, size, up=(0, 0, 1)).rays() for size in VIEWS}  # the records' rays
    jobs = [rays_job(f"view {size} x {size}", size * size, rays) for size, rays in views.items()]
    for count in RANDOM:
        origins = rng.uniform(low, high, (count, 3)).astype(np.float32)
        jobs.append(rays_job(f"random {count:,}", count, origins, rng.normal(size=(count, 3)).astype(np.float32)))
    if turns:
        jobs += [compared_job(workload) for workload in WorkloadMaker(mesh, size=COMPARED_SIZE).make(COMPARED)]
    return jobs + [build_job(kind) for kind in BUILDS]


def measure_scaling(
    mesh: TriangleMesh,
    threads: Sequence[int],
    rounds: int,
    embrees: Sequence[int] = (),
    on_turn: OnTurn = lambda name: None,
) -> list[JobFigures]:
    """Times every job with each number of threads, versions of Embree after wrt."""
    figures = []
    for job in make_jobs(mesh, embrees):
        names = [f"{count} thread{'s' * (count > 1)}" for count in threads]
        contenders = []
        for name, count in zip(names, threads, strict=True):
            contenders.append(Contender(name, job.prepare(count)))
            contenders += [Contender(f"{peer}, {name}", prepare(count)) for peer, prepare in job.peers.items()]
        timings = run_turns(job, contenders, rounds, on_turn)
        figures.append(own := figures_of(job, {name: timings[name] for name in names}))
        for peer in job.peers:
            beside = {name: timings[f"{peer}, {name}"] for name in names}
            figures.append(figures_of(job, beside, peer))
            figures[-1].ratios = [beside[name].ratio_to(timings[name]) for name in names]
            own.least_ratios = [*map(min, own.least_ratios or figures[-1].ratios, figures[-1].ratios)]
    return figures


def measure_schedules(mesh: TriangleMesh, threads: int, rounds: int, on_turn: OnTurn = lambda name: None) -> list[JobFigures]:
    """Times every job with each schedule, the default first."""

    def contender(job: Job, name: str) -> Contender:
        run = job.prepare(threads)

        def scheduled() -> Any:
            with use_schedule(name):
                return run()

        return Contender(name, scheduled)

    names = [DEFAULT_SCHEDULE, *(name for name in SCHEDULES if name != DEFAULT_SCHEDULE)]
    return [
        figures_of(job, run_turns(job, [contender(job, name) for name in names], rounds, on_turn)) for job in make_jobs(mesh)
    ]


def run_turns(job: Job, contenders: Sequence[Contender], rounds: int, on_turn: OnTurn) -> dict[str, Timing]:
    """Times a job's contenders in turn. Where Embree builds, every turn begins with an untimed call (`EmbreeTurns`)."""
    settle = float("inf") if job.peers and not job.amount else SETTLE
    timings = take_turns(contenders, rounds, settle=settle, warm=WARM, on_turn=lambda name: on_turn(f"{job.name}, {name}"))
    for name, timing in timings.items():
        if timing.error is not None:
            raise RuntimeError(f"{job.name}, {name}: {timing.error}")
    return timings


def figures_of(job: Job, timings: dict[str, Timing], engine: str = "wrt") -> JobFigures:
    """Figures of a job's contenders; gains are over the first of them."""
    first = next(iter(timings.values()))
    figures = [job.figure(timing.median) for timing in timings.values()]
    gains = [first_over(timing, first) for timing in timings.values()]
    return JobFigures(job.name, job.unit, [*timings], figures, gains, engine)


def first_over(timing: Timing, first: Timing) -> float:
    """The first contender's time / another one's."""
    ratio = timing.ratio_to(first)
    return 1.0 / ratio if ratio else float("nan")


def powers_of_two(maximum: int) -> list[int]:
    """1, 2, 4 and so on; `maximum` is the last."""
    return [1 << i for i in range(maximum.bit_length()) if 1 << i < maximum] + [maximum]

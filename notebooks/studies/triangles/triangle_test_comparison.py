"""Every ray-triangle test beside Moeller and Trumbore's: speed, cost, exits, precision, leaks.

Situations, from a test on its own to the whole engine:

    soup      no tree: one ray after the other against W triangles at a time
    frusta    no tree: 4 x 4 rays of a view, W at a time, against one triangle after the other
    single    BVH, a view, one ray after the other
    packets   BVH, a view, packets with the same culling for all tests
    view      BVH, a view, as the engine chooses: tests that are `accurate` may use better culling
    stream    BVH, random rays; not for tests that need a shared origin
    prepare   what is computed beforehand, a triangle

Every figure is a ratio to the reference in the same round, tests taking turns. With one thread the clock is that of the
thread's own processor time, so that other work on the machine does not count.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from statistics import median
from time import perf_counter, thread_time
from typing import Any

import numpy as np

from studies.triangles.isolated_tests import Beams, Soup, closest, exits
from studies.triangles.triangle_precision import leaks, precision
from wrt.bench.core.benchmark_results import machine
from wrt.bench.core.paired_timing import Contender, Timing, take_turns
from wrt.bench.core.workloads import WorkloadMaker
from wrt.kernels.runtime.launch import use_threads
from wrt.kernels.simd.lanes import native_width
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.triangle_contract import TriangleTest
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene
from wrt.tables import lookup

REFERENCE = "moeller_trumbore"

SOUP_TRIANGLES = 4096
"""Of the mesh, evenly picked, for tests without a tree: more would measure memory."""

SOUP_RAYS = 2048
"""Rays without a tree, in tiles evenly picked from the view."""

PREPARED = 1 << 17
"""Triangles that records are made of."""

TILE_RAYS = 16
"""Of a frustum: 4 x 4 pixels."""

SETTLE = 0.2
"""Calls shorter than this many seconds are preceded by an untimed one."""


@dataclass(frozen=True)
class Ratio:
    """Time over the reference's, of rounds in which both had their turns.

    Attributes:
        median, least, greatest: of the rounds.
        nanoseconds: a test (without a tree), a ray (with one) or a triangle (prepare), median of the rounds.
    """

    median: float
    least: float
    greatest: float
    nanoseconds: float


@dataclass
class TestResult:
    """What was measured of a test.

    Attributes:
        name, paper, watertight, accurate, two_sided, needs_shared_origin: as the test's.
        record_bytes: held for each triangle, its vertices included.
        test_bytes: of them, what the test itself reads.
        operations: arithmetic operations of a test that goes through all its steps; None if not declared.
        operations_done: on the average, if each test leaves at the first exit that it can ("alone"), if 16 rays leave
            together at the first that all can ("together"), and with the exits that the engine compiles ("compiled").
        speed: by situation; None where the test cannot take part.
        exits: where its tests ended, for frusta of 4 x 4 rays: see `Exits.to_dict`.
        precision, leaks: see `studies.triangles.triangle_precision`; None if not asked.
    """

    name: str
    paper: str
    watertight: bool
    accurate: bool
    two_sided: bool
    needs_shared_origin: bool
    record_bytes: int
    test_bytes: int
    operations: int | None
    operations_done: dict[str, float | None]
    exits: dict[str, Any]
    speed: dict[str, Ratio | None] = field(default_factory=dict)
    precision: dict[str, Any] | None = None
    leaks: dict[str, Any] | None = None


@dataclass
class TestsReport:
    """A run.

    Attributes:
        machine: see `wrt.bench.core.benchmark_results.machine`.
        options: what was asked for.
        model, triangles: the mesh.
        results: one entry a test, in the order of the table.
    """

    machine: dict[str, Any]
    options: dict[str, Any]
    model: str
    triangles: int
    results: list[TestResult] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, for JSON."""
        return {"format": 1, **asdict(self)}


class Stage:
    """What tests are timed on: a mesh with its tree, and triangles picked from it.

    Args:
        mesh: any.
        size: views have size x size pixels, a multiple of 16; as many random rays.
        threads: of scenes and launches.
    """

    def __init__(self, mesh: TriangleMesh, size: int, threads: int) -> None:
        self.scene = Scene(mesh, "bvh", device="cpu", num_threads=threads)
        self.width = native_width(self.scene.device)
        self.view, self.random = WorkloadMaker(mesh, size=size).make(["far", "random"])
        self.mesh = mesh

    @cached_property
    def soup(self) -> Soup:
        """Triangles evenly picked from the mesh, and the eye."""
        chosen = np.linspace(0, self.mesh.triangle_count - 1, min(SOUP_TRIANGLES, self.mesh.triangle_count)).astype(int)
        corners = self.mesh.vertices[self.mesh.faces[chosen]] - self.mesh.center
        return Soup(corners, self.view.origins[0] - self.mesh.center)

    @cached_property
    def crowd(self) -> Soup:
        """The soup many times over."""
        return Soup(np.resize(self.soup.corners, (PREPARED, 3, 3)), self.soup.origin)

    @cached_property
    def beams(self) -> Beams:
        """Tiles of the view, evenly picked."""
        tiles = self.view.directions.reshape(-1, TILE_RAYS, 3)
        chosen = np.linspace(0, len(tiles) - 1, min(len(tiles), SOUP_RAYS // TILE_RAYS)).astype(int)
        return Beams(np.array([self.soup.origin]), tiles[chosen].reshape(-1, 3))

    def alone(self, test: TriangleTest, frustum: int) -> Contender:
        """Without a tree."""
        width = min(self.width, TILE_RAYS)
        run = closest(test, self.soup, self.beams, frustum=frustum, width=width)
        return Contender(test.name, run, self.beams.count * len(self.soup))

    def traced(self, test: TriangleTest, traversal: str, culling: str = "") -> Contender:
        """The view, with the tree."""
        plan = self.scene.explain(self.view.rays, traversal=traversal, triangle_test=test.name)
        if culling:
            plan = replace(plan, culling=culling)
        return Contender(test.name, lambda: self.scene.intersect(self.view.rays, traversal=plan).t, len(self.view))

    def streamed(self, test: TriangleTest) -> Contender | None:
        """Random rays, with the tree."""
        if test.needs_shared_origin:
            return None
        rays = self.random.rays
        return Contender(
            test.name, lambda: self.scene.intersect(rays, traversal="stream", triangle_test=test.name).t, len(self.random)
        )

    def prepared(self, test: TriangleTest) -> Contender:
        """The records, of triangles enough for a few milliseconds."""
        return Contender(test.name, lambda: self.crowd.pack(test.record, self.width), len(self.crowd))


SITUATIONS: dict[str, Callable[[Stage, TriangleTest], Contender | None]] = {
    "soup": lambda stage, test: stage.alone(test, 0),
    "frusta": lambda stage, test: stage.alone(test, TILE_RAYS),
    "single": lambda stage, test: stage.traced(test, "single"),
    "packets": lambda stage, test: stage.traced(test, "packet", "interval"),
    "view": lambda stage, test: stage.traced(test, "auto"),
    "stream": lambda stage, test: stage.streamed(test),
    "prepare": lambda stage, test: stage.prepared(test),
}


def run_triangle_tests(
    mesh: TriangleMesh,
    *,
    tests: Sequence[str] = tuple(TRIANGLE_TESTS),
    situations: Sequence[str] = tuple(SITUATIONS),
    size: int = 512,
    rounds: int = 9,
    threads: int = 1,
    precise: bool = True,
    on_turn: Callable[[str], None] = lambda name: None,
) -> TestsReport:
    """Measures tests side by side.

    Args:
        mesh: any.
        tests: names; the reference is measured with them, whether named or not.
        situations: keys of `SITUATIONS`.
        size: see `Stage`.
        rounds: number of rounds per test in each situation.
        threads: of scenes and launches.
        precise: whether to measure precision and leaks too.
        on_turn: told what is under way.

    Raises:
        ValueError: an unknown name, or a size that is not a multiple of 4.
    """
    chosen = [lookup(TRIANGLE_TESTS, name, "tests") for name in dict.fromkeys((REFERENCE, *tests))]
    ways = {name: lookup(SITUATIONS, name, "situations") for name in situations}
    options = {"tests": [test.name for test in chosen], "size": size, "rounds": rounds, "threads": threads}
    report = TestsReport(machine("cpu"), options, mesh.name or "mesh", mesh.triangle_count)
    with use_threads(threads):
        stage = Stage(mesh, size, threads)
        for test in chosen:
            on_turn(f"{test.name}: exits")
            report.results.append(describe(test, stage))
            if precise:
                on_turn(f"{test.name}: precision")
                report.results[-1].precision, report.results[-1].leaks = precision(test), leaks(test)
        for name, way in ways.items():
            speeds = compare(stage, chosen, way, rounds, threads, lambda turn, name=name: on_turn(f"{name}: {turn}"))
            for result in report.results:
                result.speed[name] = speeds.get(result.name)
    return report


def describe(test: TriangleTest, stage: Stage) -> TestResult:
    """What a test costs on paper, and where it ends in frusta without a tree."""
    apart = replace(test, lanes=getattr(test.lanes, "apart", None) or test.lanes)
    found, compiled = (exits(form, stage.soup, stage.beams, group_rays=TILE_RAYS) for form in (apart, test))
    steps = apart.lanes.operations
    done = {
        "alone": found.operations(steps),
        "together": found.operations(steps, of_vectors=True),
        "compiled": compiled.operations(test.lanes.operations, of_vectors=True),
    }
    return TestResult(
        name=test.name,
        paper=test.paper,
        watertight=test.watertight,
        accurate=test.accurate,
        two_sided=test.two_sided,
        needs_shared_origin=test.needs_shared_origin,
        record_bytes=4 * test.record.components,
        test_bytes=test.record.test_bytes,
        operations=sum(step.arithmetic for step in steps) if steps else None,
        operations_done=done,
        exits=found.to_dict(),
    )


def compare(
    stage: Stage,
    tests: Sequence[TriangleTest],
    way: Callable[[Stage, TriangleTest], Contender | None],
    rounds: int,
    threads: int,
    on_turn: Callable[[str], None] = lambda name: None,
) -> dict[str, Ratio]:
    """Times the tests that can take part in a situation, in turn."""
    contenders = [contender for test in tests if (contender := way(stage, test)) is not None]
    clock = thread_time if threads == 1 else perf_counter
    timings = take_turns(contenders, rounds, settle=SETTLE, clock=clock, on_turn=on_turn)
    return ratios(timings, REFERENCE)


def ratios(timings: dict[str, Timing], reference: str) -> dict[str, Ratio]:
    """Ratios to a reference, of contenders that took part.

    Raises:
        RuntimeError: one of them failed.
    """
    found = {}
    for name, timing in timings.items():
        if timing.error is not None:
            raise RuntimeError(f"{name} failed: {timing.error}")
        each = timing.ratios_to(timings[reference])
        found[name] = Ratio(median(each), min(each), max(each), timing.median / timing.items * 1e9)
    return found

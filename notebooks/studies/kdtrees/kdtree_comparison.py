"""What a kd-tree builder costs and what its tree is worth, beside the O(N log N) sweep in the same run.

Builders take turns on the same boxes, then on the same rays; times are ratios of medians over rounds. The SAH cost model is the
same for all: the default one, whatever the builder minimised. Builders that would not end are left out. Where
rays build what they need, the build is its beginning, and the tree is completed before its cost is taken. `compare_trees` does
the same for any descriptions, such as one builder with several options.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter

from wrt.accelerators.tree_descriptions import KdTree
from wrt.bench.comparisons.build_comparison import BUDGET, SETTLE
from wrt.bench.core.paired_timing import Contender, Timing, take_turns
from wrt.bench.core.workloads import Workload, WorkloadMaker
from wrt.engine.facts.query_kinds import AUTO
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

REFERENCE = "sweep"
"""The builder that all figures refer to."""

RAYS = ("near", "random")
"""Workloads that trees are traced with: a camera's rays, and rays from anywhere to anywhere."""

BY_PLANES = {"near": "packet", "random": "lockstep"}
"""The fastest of the walks that take a kd-tree's planes one by one."""


@dataclass(frozen=True)
class BuilderFigures:
    """One builder's figures; ratios are to `REFERENCE`, or to the first of the trees that are compared.

    Attributes:
        builder: key in `KDTREE_BUILDERS`, or the tree's name.
        seconds: of a build from a mesh in memory, median of the rounds.
        build_ratio: build time; above 1 is slower.
        sah_cost, sah_ratio: expected cost of a ray.
        tree_bytes, peak_bytes: memory per triangle, of the finished tree and during the build.
        trace_ratios: time of each workload; above 1 is slower.
    """

    builder: str
    seconds: float
    build_ratio: float | None
    sah_cost: float
    sah_ratio: float
    tree_bytes: float
    peak_bytes: float
    trace_ratios: dict[str, float | None]


def compare_builders(
    mesh: TriangleMesh,
    builders: Sequence[str],
    *,
    rounds: int = 5,
    threads: int = 1,
    size: int = 512,
    on_turn: Callable[[str], None] = lambda name: None,
) -> list[BuilderFigures]:
    """Builds and traces; `REFERENCE` takes part in any case.

    Args:
        mesh: what trees are built of.
        builders: keys in `KDTREE_BUILDERS`.
        rounds: number of rounds per builder.
        threads: CPU threads.
        size: each workload has size * size rays.
        on_turn: told the name of each builder before its turn.

    Raises:
        ValueError: a size that does not divide into tiles.
    """
    trees = {name: KdTree(builder=name) for name in dict.fromkeys((REFERENCE, *builders))}
    return compare_trees(mesh, trees, rounds=rounds, threads=threads, size=size, on_turn=on_turn)


def compare_trees(
    mesh: TriangleMesh,
    trees: Mapping[str, KdTree],
    *,
    rounds: int = 5,
    threads: int = 1,
    trace_rounds: int | None = None,
    size: int = 512,
    traversal: str = AUTO,
    clock: Callable[[], float] = perf_counter,
    on_turn: Callable[[str], None] = lambda name: None,
) -> list[BuilderFigures]:
    """Builds and traces.

    Args:
        mesh: what trees are built of.
        trees: by name; all figures refer to the first.
        rounds, threads, size, on_turn: as in `compare_builders`.
        trace_rounds: number of rounds per tree at tracing, which takes less time than building; None for `rounds`.
        traversal: how rays are traced, key in `TRAVERSALS`, or "auto" for the best walk by planes: in wide forms, leaves do not
            show.
        clock: seconds; `time.thread_time` with one thread on a machine that others use.

    Raises:
        ValueError: a size that does not divide into tiles.
    """
    workloads = list(WorkloadMaker(mesh, size=size).make(RAYS))
    reference = next(iter(trees))
    scenes: dict[str, Scene] = {}

    def build(name: str) -> None:
        scenes[name] = Scene(mesh, trees[name], device="cpu", num_threads=threads)

    def trace(name: str, rays: Workload) -> None:
        way = BY_PLANES[rays.name] if traversal == AUTO else traversal
        scenes[name].intersect(rays.origins, rays.directions, traversal=way)

    take = {"budget": BUDGET, "settle": SETTLE, "clock": clock, "on_turn": on_turn}
    timings = take_turns([Contender(name, lambda name=name: build(name)) for name in trees], rounds, **take)
    traced: dict[str, dict[str, Timing]] = {}
    for rays in workloads:
        tracing = [Contender(name, lambda name=name, rays=rays: trace(name, rays)) for name in trees]
        traced[rays.name] = take_turns(tracing, trace_rounds or rounds, **take)
    for scene in scenes.values():
        scene.state.complete()
    costs = {name: scene.statistics().tree.sah_cost for name, scene in scenes.items()}
    return [
        BuilderFigures(
            name,
            timings[name].median,
            timings[name].ratio_to(timings[reference]),
            costs[name],
            costs[name] / costs[reference],
            scenes[name].tree.bytes / mesh.triangle_count,
            scenes[name].tree.stats.peak_bytes / mesh.triangle_count,
            {rays: timing[name].ratio_to(timing[reference]) for rays, timing in traced.items()},
        )
        for name in trees
    ]

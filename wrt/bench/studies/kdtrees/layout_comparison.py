"""What a step through a kd-tree costs, by the order of its nodes (`wrt.builders.convert.node_layouts`).

One tree in every layout, walked by the same rays, one at a time; layouts take turns. All of a query's time is charged to its
steps, inner nodes and leaves, triangle tests included: those are the same for every layout.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING

from wrt.accelerators.tree_descriptions import KdTree
from wrt.bench.core.paired_timing import Contender, take_turns
from wrt.bench.core.workloads import WorkloadMaker
from wrt.builders.convert.node_layouts import LAYOUTS, lay_out
from wrt.execution.triangle_records import records_of
from wrt.kernels.runtime.launch import launch, use_threads
from wrt.meshes.mesh import TriangleMesh
from wrt.planning.planner import make_plan
from wrt.rays.ray_buffers import to_device
from wrt.rays.rays import Rays
from wrt.scene.scene import Scene
from wrt.state.query_kinds import CLOSEST

if TYPE_CHECKING:
    from wrt.builders import tree as common
    from wrt.rays.ray_buffers import RayBuffers
    from wrt.state.device_hits import DeviceHits

REFERENCE = "random"
"""The layout that all figures refer to."""

CLASSIC_BLOCK = 1.5
"""Cost of a block of one triangle, as usual with a traversal cost of 1."""

RAYS = ("near", "random")
"""Workloads: a camera's rays, and rays from anywhere to anywhere."""


@dataclass(frozen=True)
class LayoutFigures:
    """What a layout costs.

    Attributes:
        layout: key in `LAYOUTS`.
        node_bytes: memory of the nodes.
        step_ns: nanoseconds a step, by workload.
        ratios: how many times as fast as `REFERENCE`, by workload.
    """

    layout: str
    node_bytes: int
    step_ns: dict[str, float]
    ratios: dict[str, float | None]


def trace_pairs(scene: Scene, tree: common.KdTree, rays: RayBuffers) -> DeviceHits:
    """Closest hits of the rays, by a walk of the scene's tree with its nodes in pairs."""
    from wrt.execution.traversal_launch import counter_rows, no_work
    from wrt.kernels.traversal.leaf import Counters
    from wrt.kernels.traversal.single.single_kdtree import make_kernel
    from wrt.kernels.traversal.traversal_config import SingleConfig
    from wrt.planning.plan import traversal_config
    from wrt.state.device_hits import DeviceHits

    plan = make_plan(scene.state, rays, "single", "auto")
    config = replace(traversal_config(plan, scene.state, CLOSEST, False), single=SingleConfig(paired_nodes=True))
    hits = DeviceHits.new(CLOSEST, rays.count, scene.device)
    counters = counter_rows(no_work(Counters, scene.device.alias))
    inputs = [tree.struct(), records_of(scene.state, plan, rays.batch), rays.batch, hits.struct(), counters]
    launch(make_kernel(config), rays.count, inputs, device=scene.device, chunk=1024)
    return hits


def compare_layouts(
    mesh: TriangleMesh,
    *,
    builder: str = "in_place",
    width: int | None = None,
    rounds: int = 5,
    threads: int = 1,
    size: int = 512,
    clock: Callable[[], float] = perf_counter,
    on_turn: Callable[[str], None] = lambda name: None,
) -> list[LayoutFigures]:
    """Traces the rays through one tree in every layout.

    Args:
        mesh: what the tree is built of.
        builder: key in `KDTREE_BUILDERS`.
        width: triangles a block, as in `wrt.KdTree`; 1 makes the deep trees of the literature.
        rounds: turns of each layout.
        threads: CPU threads.
        size: each workload has size * size rays.
        clock: seconds; `time.thread_time` with one thread on a machine that others use.
        on_turn: told the name of each layout before its turn.

    Raises:
        ValueError: a size that does not divide into tiles.
    """
    cost = CLASSIC_BLOCK if width == 1 else KdTree.block_cost
    scene = Scene(mesh, KdTree(builder=builder, width=width, block_cost=cost), device="cpu", num_threads=threads)
    scene.complete()
    trees = {name: lay_out(scene.tree, name) for name in LAYOUTS}
    steps: dict[str, dict[str, float]] = {name: {} for name in LAYOUTS}
    ratios: dict[str, dict[str, float | None]] = {name: {} for name in LAYOUTS}
    with use_threads(threads):
        for made in WorkloadMaker(mesh, size=size).make(RAYS):
            work = scene.intersect(made.origins, made.directions, traversal="single", counters=True).counters
            total = int(work["nodes"].sum() + work["leaves"].sum())
            rays = to_device(Rays(made.origins, made.directions), scene.device, scene.center)
            contenders = [
                Contender(name, lambda tree=tree, rays=rays: trace_pairs(scene, tree, rays)) for name, tree in trees.items()
            ]
            timings = take_turns(contenders, rounds, clock=clock, on_turn=on_turn)
            for name, timing in timings.items():
                steps[name][made.name] = timing.median * 1e9 * threads / total
                ratio = timing.ratio_to(timings[REFERENCE])
                ratios[name][made.name] = None if ratio is None else 1.0 / ratio
    return [LayoutFigures(name, trees[name].nodes.shape[0] * 8, steps[name], ratios[name]) for name in LAYOUTS]

"""What a step through a kd-tree costs, by the order of its nodes (`wrt.builders.kdtree.LAYOUTS`) and by what they hold.

One tree in every layout, walked by the same rays, one at a time; layouts take turns. All of a query's time is charged to its
steps, inner nodes and leaves, triangle tests included: those are the same for every layout.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING, Any

from wrt.accelerators.tree_descriptions import KdTree
from wrt.bench.core.paired_timing import Contender, take_turns
from wrt.bench.core.workloads import WorkloadMaker
from wrt.builders.classics.kdtree.compact_subtrees import to_compact
from wrt.builders.classics.kdtree.node_layouts import in_records, lay_out
from wrt.builders.kdtree import LAYOUTS
from wrt.engine.facts.query_kinds import CLOSEST
from wrt.engine.launch.triangle_records import records_of
from wrt.engine.plan.choices import make_plan
from wrt.engine.rays.device_rays import to_device
from wrt.engine.rays.rays import Rays
from wrt.kernels.layout.compact_nodes import HEIGHTS
from wrt.kernels.runtime.launch import launch, use_threads
from wrt.kernels.traversal.traversal_config import SingleConfig
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

if TYPE_CHECKING:
    from wrt.builders import tree as common
    from wrt.engine.device_hits import DeviceHits
    from wrt.engine.rays.device_rays import DeviceRays

REFERENCE = "random"
"""The layout that all figures refer to."""

CLASSIC_BLOCK = 1.5
"""Cost of a block of one triangle, as usual with a traversal cost of 1."""

ALLOCATIONS = {"general": 7, "fixed size": 3, "an index": 1}
"""Words of 8 bytes for each node. With a general allocator, a node and six pointers: four of its own, and two to free it; with
one of fixed size, a node and two pointers (Havran 2001); and a node that holds an index instead."""

ALLOCATED = ("random", "depth_first")
"""Layouts in which allocations are compared."""

RAYS = ("near", "random")
"""Workloads: a camera's rays, and rays from anywhere to anywhere."""


ORDINARY = ("depth_first", "subtrees")
"""Layouts with which compact subtrees are compared; the first is the reference."""


@dataclass(frozen=True)
class Placed:
    """A form of a tree's nodes.

    Attributes:
        make: makes the form from the tree as built.
        walk: the walk that reads it.
    """

    make: Callable[[common.KdTree], common.KdTree]
    walk: SingleConfig


def in_pairs(layout: str, words: int = 1) -> Placed:
    """Nodes in pairs in an order of `LAYOUTS`, of this many words of 8 bytes each."""
    return Placed(lambda tree: in_records(lay_out(tree, layout), words), SingleConfig(pair_words=words))


def in_subtrees(height: int) -> Placed:
    """Compact subtrees of this many levels."""
    return Placed(lambda tree: to_compact(tree, height), SingleConfig(compact=height))


@dataclass(frozen=True)
class LayoutFigures:
    """What a layout costs.

    Attributes:
        layout: its name.
        node_bytes: memory of the nodes.
        nodes: their number, inner nodes and leaves.
        step_ns: nanoseconds a step, by workload.
        ratios: how many times as fast as the reference, by workload.
    """

    layout: str
    node_bytes: int
    nodes: int
    step_ns: dict[str, float]
    ratios: dict[str, float | None]


def trace_placed(scene: Scene, tree: common.KdTree, rays: DeviceRays, walk: SingleConfig, query: str = CLOSEST) -> DeviceHits:
    """Closest or any hits of the rays, by a walk of the scene's tree in another form."""
    from wrt.engine.device_hits import DeviceHits
    from wrt.engine.launch.traversal_launch import counter_rows, no_work
    from wrt.engine.plan.plan import traversal_config
    from wrt.kernels.traversal.leaf import Counters
    from wrt.kernels.traversal.single.single_kdtree import make_single_kdtree_kernel

    plan = make_plan(scene.state, rays, "single", "auto", CLOSEST)
    config = replace(traversal_config(plan, scene.state, query, False), single=walk)
    hits = DeviceHits.new(query, rays.count, scene.device)
    counters = counter_rows(no_work(Counters, scene.device.alias))
    inputs = [tree.struct(), records_of(scene.state, plan, rays.batch), rays.batch, hits.struct(), counters]
    launch(make_single_kdtree_kernel(config), rays.count, inputs, device=scene.device, chunk=1024)
    return hits


def compare_layouts(mesh: TriangleMesh, **options: Any) -> list[LayoutFigures]:
    """Traces rays through one tree in every layout; options: see `compare`."""
    return compare(mesh, {name: in_pairs(name) for name in LAYOUTS}, REFERENCE, **options)


def compare_allocations(mesh: TriangleMesh, **options: Any) -> list[LayoutFigures]:
    """Traces rays through one tree with nodes of the sizes that `ALLOCATIONS` names, in two layouts; options: see `compare`."""
    placed = {f"{layout}, {kind}": in_pairs(layout, words) for layout in ALLOCATED for kind, words in ALLOCATIONS.items()}
    return compare(mesh, placed, next(iter(placed)), **options)


def compare_compact(mesh: TriangleMesh, **options: Any) -> list[LayoutFigures]:
    """Traces rays through one tree with and without indices in its nodes; options: see `compare`."""
    placed = {name: in_pairs(name) for name in ORDINARY}
    placed |= {f"compact, {8 << height} bytes": in_subtrees(height) for height in HEIGHTS}
    return compare(mesh, placed, ORDINARY[0], **options)


def compare(
    mesh: TriangleMesh,
    placed: Mapping[str, Placed],
    reference: str,
    *,
    builder: str = "in_place",
    width: int | None = None,
    rounds: int = 5,
    threads: int = 1,
    size: int = 512,
    clock: Callable[[], float] = perf_counter,
    on_turn: Callable[[str], None] = lambda name: None,
) -> list[LayoutFigures]:
    """Traces the rays through one tree in several orders.

    Args:
        mesh: what the tree is built of.
        placed: forms of the tree, by name.
        reference: the name that all figures refer to.
        builder: key in `KDTREE_BUILDERS`.
        width: triangles a block, as in `wrt.KdTree`; 1 makes the deep trees of the literature.
        rounds: number of rounds per order.
        threads: CPU threads.
        size: each workload has size * size rays.
        clock: seconds; `time.thread_time` with one thread on a machine that others use.
        on_turn: told each name before its turn.

    Raises:
        ValueError: a size that does not divide into tiles.
    """
    cost = CLASSIC_BLOCK if width == 1 else KdTree.block_cost
    scene = Scene(mesh, KdTree(builder=builder, width=width, block_cost=cost), device="cpu", num_threads=threads)
    scene.state.complete()
    trees = {name: form.make(scene.tree) for name, form in placed.items()}
    steps: dict[str, dict[str, float]] = {name: {} for name in placed}
    ratios: dict[str, dict[str, float | None]] = {name: {} for name in placed}
    with use_threads(threads):
        for made in WorkloadMaker(mesh, size=size).make(RAYS):
            work = scene.intersect(made.origins, made.directions, traversal="single", counters=True).counters
            total = int(work["nodes"].sum() + work["leaves"].sum())
            rays = to_device(Rays(made.origins, made.directions), scene.device, scene.center)
            contenders = [
                Contender(name, lambda tree=tree, rays=rays, walk=placed[name].walk: trace_placed(scene, tree, rays, walk))
                for name, tree in trees.items()
            ]
            timings = take_turns(contenders, rounds, clock=clock, on_turn=on_turn)
            for name, timing in timings.items():
                steps[name][made.name] = timing.median * 1e9 * threads / total
                ratio = timing.ratio_to(timings[reference])
                ratios[name][made.name] = None if ratio is None else 1.0 / ratio
    count = scene.tree.nodes.shape[0]
    return [LayoutFigures(name, trees[name].nodes.shape[0] * 8, count, steps[name], ratios[name]) for name in placed]

"""Vertex culling by the size of leaves: Reshetov's claim for kd-trees with hundreds of triangles in a leaf (2007).

The claim: with vertex culling a kd-tree may have a tenth of the nodes and hundreds of triangles in a leaf, and more than 90 %
of the possible tests of a ray against a triangle are still avoided.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from wrt.accelerators.tree_descriptions import KdTree
from wrt.bench.core.paired_timing import Contender, take_turns
from wrt.bench.core.workloads import WorkloadMaker
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

LEAVES = (0, 32, 128, 512, 2048)
"""Sizes below which a node is not divided; 0: divided as long as the surface area heuristic gains."""

CULLINGS = ("vertex", "interval", "none")

PACKET = 64


@dataclass(frozen=True)
class LeafFigures:
    """What was measured of one size of leaves with one culling.

    Attributes:
        leaf_triangles: a node with at most this many triangles was not divided.
        culling: key in `wrt.kernels.traversal.packet.CULLINGS`.
        nodes: of the tree, leaves included.
        mean_leaf: triangles of the leaves that packets visited, on average.
        culled: share of the tests of a ray against a triangle of a visited leaf that culling avoided.
        megarays: millions of rays a second, median.
        same: whether the hits are those of the first size and culling.
    """

    leaf_triangles: int
    culling: str
    nodes: int
    mean_leaf: float
    culled: float
    megarays: float
    same: bool


def compare_leaf_sizes(
    mesh: TriangleMesh,
    *,
    leaves: Sequence[int] = LEAVES,
    cullings: Sequence[str] = CULLINGS,
    size: int = 512,
    rounds: int = 3,
    threads: int | None = None,
    on_turn: Callable[[str], None] = lambda name: None,
) -> list[LeafFigures]:
    """A view of a mesh in packets of 64, by the size of leaves and by culling.

    Args:
        mesh: the mesh.
        leaves: sizes of leaves, as `wrt.KdTree.leaf_triangles`.
        cullings: keys in `wrt.kernels.traversal.packet.CULLINGS` that need no boxes of leaves.
        size: pixels along an edge, a multiple of 4.
        rounds: number of rounds per size and culling.
        threads: on the CPU; None for all cores.
        on_turn: told the name of each turn.
    """
    (view,) = WorkloadMaker(mesh, size=size, order="rows").make(["far"])
    origin, directions = view.origins[0], view.directions.reshape(size, size, 3)
    ways: dict[tuple[int, str], Callable[..., Any]] = {}
    nodes = {}
    for most in leaves:
        scene = Scene(mesh, KdTree(leaf_triangles=most), num_threads=threads)
        nodes[most] = len(scene.tree.nodes)
        plan = scene.explain(origin, directions, traversal="packet", triangle_test="woop")
        for name in cullings:
            options = {"traversal": replace(plan, culling=name, packet=PACKET)}
            ways[most, name] = partial(scene.intersect, origin, directions, **options)
    contenders = [Contender(f"{most}, {name}", trace, size * size) for (most, name), trace in ways.items()]
    timings = take_turns(contenders, rounds, settle=0.2, on_turn=on_turn)
    figures, expected = [], next(iter(timings.values())).result
    for (most, name), trace in ways.items():
        hits = trace(counters=True)
        work = {key: float(np.asarray(values).sum()) for key, values in hits.counters.items()}
        met = work["culled"] + work["triangles"]
        same = np.array_equal(hits.t, expected.t) and np.array_equal(hits.primitive_id, expected.primitive_id)
        speed = size * size / timings[f"{most}, {name}"].median / 1e6
        row = (nodes[most], met / max(work["leaves"], 1.0), work["culled"] / max(met, 1.0), speed, same)
        figures.append(LeafFigures(most, name, *row))
    return figures

"""What the papers on kd-trees claim beyond time, cost and memory: first frames, mailbox-aware costs, planar triangles.

    first_frames        Hunt, Mark, Fussell 2007: a scene and its first view, built lazily and built at once
    built_part          how much of a lazy tree a view has built
    mailbox_costs       Hunt 2008: trees for rays with a mailbox, traced with one and without
    planar_references   Wald and Havran 2006: triangles that lie in a splitting plane go to one side

Times are the processor time of one thread; contenders take turns (`paired_timing`).

References: wald-havran-2006; hunt-2007; hunt-2008.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import thread_time

import numpy as np

from studies.kdtrees.layout_comparison import CLASSIC_BLOCK
from wrt.accelerators.tree_descriptions import KdTree
from wrt.bench.core.paired_timing import Contender, take_turns
from wrt.bench.core.workloads import WorkloadMaker
from wrt.builders.kdtree.kdtree_statistics import UnpackedKdTree, unpack
from wrt.engine.rays.rays import Rays
from wrt.kernels.runtime.launch import use_threads
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

MAILBOX = "hashed"
"""Of the rays that have one: it forgets little."""


@dataclass(frozen=True)
class FirstFrame:
    """What the first frame of a scene costs with a builder.

    Attributes:
        builder: key in `KDTREE_BUILDERS`.
        build: seconds until the scene is made, median.
        first: seconds of the first view; a lazy tree grows meanwhile.
        later: seconds of the same view, again.
        ratio: first build and view, to the same of the first builder.
    """

    builder: str
    build: float
    first: float
    later: float
    ratio: float


@dataclass(frozen=True)
class BuiltPart:
    """What of a lazy tree is built.

    Attributes:
        cells, built_cells: into which the planes above divide the scene, and those that rays visited.
        triangles: share of the mesh's triangles that are in any leaf.
        seen: share of the mesh's triangles that are a ray's closest hit.
    """

    cells: int
    built_cells: int
    triangles: float
    seen: float


@dataclass(frozen=True)
class MailboxCost:
    """A tree, and what rays do in it.

    Attributes:
        aware: whether its cost is that of rays with a mailbox.
        mailbox: whether the rays have one.
        references: entries of leaf lists, per triangle.
        nodes, tests: inner nodes visited and triangles tested, per ray.
        ratio: time, to that of the plain tree and the same rays.
    """

    aware: bool
    mailbox: bool
    references: float
    nodes: float
    tests: float
    ratio: float


def first_frames(mesh: TriangleMesh, rays: Rays, builders: Sequence[str], *, rounds: int = 3) -> list[FirstFrame]:
    """Makes a scene and traces a view, with each builder in turn.

    Args:
        mesh: the scene.
        rays: the view.
        builders: keys in `KDTREE_BUILDERS`; ratios refer to the first.
        rounds: how often each is measured.
    """
    parts: dict[str, list[tuple[float, ...]]] = {name: [] for name in builders}

    def show(name: str) -> None:
        times = [thread_time()]
        scene = Scene(mesh, KdTree(builder=name), device="cpu", num_threads=1)
        times.append(thread_time())
        for _ in range(2):
            scene.intersect(rays)
            times.append(thread_time())
        parts[name].append(tuple(np.diff(times)))

    take_turns([Contender(name, lambda name=name: show(name)) for name in builders], rounds, clock=thread_time)
    spent = {name: np.array(rows[1:]) for name, rows in parts.items()}  # the first warmed up
    whole = {name: rows[:, :2].sum(axis=1) for name, rows in spent.items()}
    return [
        FirstFrame(name, *map(float, np.median(spent[name], axis=0)), float(np.median(whole[name] / whole[builders[0]])))
        for name in builders
    ]


def compare_first_frames(mesh: TriangleMesh, *, size: int = 128, rounds: int = 3) -> list[FirstFrame]:
    """A scene and its first view of size x size rays with lazy, binned and exact builders (Hunt et al. 2007)."""
    (view,) = WorkloadMaker(mesh, size=size).make(["far"])
    return first_frames(mesh, view.rays, ("in_place", "binned", "lazy"), rounds=rounds)


def built_part(scene: Scene, rays: Rays) -> BuiltPart:
    """What of a scene's lazy tree is built, and what the rays see of the mesh."""
    cells = scene.state.lazy_tree.cells
    undivided = cells["clusters"] > 0
    hits = scene.intersect(rays).primitive_id
    listed = np.unique(scene.tree.primitive.numpy())
    return BuiltPart(
        cells=int(undivided.sum()),
        built_cells=int((undivided & ~cells["unbuilt"]).sum()),
        triangles=float((listed >= 0).sum() / scene.triangle_count),
        seen=float(len(np.unique(hits[hits >= 0])) / scene.triangle_count),
    )


def mailbox_costs(mesh: TriangleMesh, *, size: int = 128, rounds: int = 5) -> list[MailboxCost]:
    """Random rays, one by one, in trees with a triangle a block, which the paper has; without and with a mailbox.

    Args:
        mesh: what trees are built of.
        size: size * size rays.
        rounds: number of rounds per tree.
    """
    (workload,) = WorkloadMaker(mesh, size=size).make(("random",))
    options = {"width": 1, "block_cost": CLASSIC_BLOCK}
    scenes = {aware: Scene(mesh, KdTree(mailbox=aware, **options), device="cpu", num_threads=1) for aware in (False, True)}
    found = []
    for mailbox in ("none", MAILBOX):
        plans = {
            aware: replace(scene.explain(workload.rays, traversal="single"), mailbox=mailbox) for aware, scene in scenes.items()
        }
        contenders = [
            Contender(
                str(aware), lambda aware=aware, plans=plans: scenes[aware].intersect(workload.rays, traversal=plans[aware])
            )
            for aware in scenes
        ]
        with use_threads(1):
            timings = take_turns(contenders, rounds, clock=thread_time)
        for aware, scene in scenes.items():
            work = scene.intersect(workload.rays, traversal=plans[aware], counters=True).counters
            references = scene.statistics().tree.duplication
            per_ray = [float(work[key].sum() / len(workload)) for key in ("nodes", "triangles")]
            ratio = timings[str(aware)].ratio_to(timings["False"])
            found.append(MailboxCost(aware, mailbox != "none", references, *per_ray, ratio))
    return found


def planar_references(scene: Scene, mesh: TriangleMesh) -> tuple[int, int, int]:
    """What it spares to list a triangle that lies in a splitting plane on one side only.

    Args:
        scene: with a kd-tree of the mesh.
        mesh: its triangles.

    Returns:
        The number of triangles that are flat along an axis, of their references in the tree, and of the leaves that they
        touch with some area: as many references they would have in a tree of the same planes if they went to both sides.
    """
    flat = unpack(scene.tree)
    corners = (mesh.vertices[mesh.faces] - scene.center).astype(np.float32).astype(np.float64)
    low, high = corners.min(axis=1), corners.max(axis=1)
    planar = ((high == low).sum(axis=1) == 1).nonzero()[0]
    listed = int(np.isin(scene.tree.primitive.numpy(), planar).sum())
    normal = np.argmax(high[planar] == low[planar], axis=1)
    touched = sum(count_touched(flat, axis, low[planar[normal == axis]], high[planar[normal == axis]]) for axis in range(3))
    return len(planar), listed, touched


def count_touched(flat: UnpackedKdTree, axis: int, low: np.ndarray, high: np.ndarray) -> int:
    """Pairs of a leaf and a box without extent along `axis` that share more than an edge."""
    leaf_low, leaf_high = flat.low[flat.is_leaf], flat.high[flat.is_leaf]
    count = 0
    for value in np.unique(low[:, axis]):
        at = low[:, axis] == value
        near = (leaf_low[:, axis] <= value) & (value <= leaf_high[:, axis])
        meet = np.ones((int(at.sum()), int(near.sum())), dtype=bool)
        for other in {0, 1, 2} - {axis}:
            meet &= low[at][:, None, other] < leaf_high[near][None, :, other]
            meet &= high[at][:, None, other] > leaf_low[near][None, :, other]
        count += int(meet.sum())
    return count

"""Parallel binned SAH build of a bounding volume hierarchy (Wald 2007).

**Problem.** A sweep over sorted centroids costs O(N log N) and three sorts, and most of its planes are nearly equal.

**Algorithm.** Centroids are sorted into a few bins along each axis, and only the planes between bins are tried (`bvh_bins`).
Large nodes are split level by level, in parallel over chunks of triangles (`bvh_levels`). The others are tasks, each of which
builds a subtree depth first (`bvh_subtrees`). Reinsertion may then improve the binary tree (`reinsertion`). Finally, the tree
is collapsed to nodes of W children (`collapse`).

**Data.** References (`wrt.builders.triangle_references`), bins (`bvh_bins`) and a binary tree (`binary_tree`).

**Phases.** References: `make_references` of `bvh_subtrees`. Top levels: `build_levels` (search, partition and emit of
`bvh_levels`). Subtrees: `build_subtrees` (stop, search, partition and emit of `bvh_subtrees`). Then reinsertion and collapse.

**Complexity.** O(N) per level of the tree, with sequential memory access only. References take 64 bytes per triangle. Nodes use
as much as the tree needs of a reservation of 88 bytes per triangle.

**What we changed.** Like the paper, we parallelise over subtrees and over the triangles of large nodes. The paper keeps a list
of indices; here whole references are moved, which makes reads sequential. Leaf costs count blocks of W triangles
(`wrt.builders.cost`). Where sizes differ much, the size of triangles is a fourth axis (`bvh_bins`), and nodes with large boxes
have rules of their own (`large_boxes`). The tree is the same for any number of threads, chunks and tasks.

**Limits.** Surface areas are float32: nodes larger than 1e19 or smaller than 1e-19 are split in the middle of their list.

References: wald-2007-sah; wald-2014.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from wrt.builders.bvh.bvh_config import BvhConfig
from wrt.builders.bvh.phases import bvh_levels as level_phase
from wrt.builders.bvh.phases.bin_heuristic import SURFACE, AllDirections, Heuristic
from wrt.builders.bvh.phases.binary_build import BinaryBuild
from wrt.builders.bvh.phases.binary_tree import Frame, empty_tree
from wrt.builders.bvh.phases.bvh_bins import make_scratch
from wrt.builders.bvh.phases.bvh_levels import BinnedNode, Totals, make_search_planes
from wrt.builders.bvh.phases.bvh_subtrees import STACK, subtree_kernels, subtree_memory
from wrt.builders.bvh.phases.collapse import collapse_kernels, improved
from wrt.builders.core.late_import import classic_module
from wrt.builders.core.levels import Chunk
from wrt.builders.tree import Bvh, Phases
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.runtime.launch import get_num_threads, load
from wrt.kernels.runtime.launch_loop import Step
from wrt.kernels.runtime.workspace import Workspace, kept_workspace, read_ints, write

TASKS_PER_THREAD = 4
"""Tasks per thread that define a large node: one with more than the average share of triangles is split by all threads."""

MIN_TASKS = 16
"""Least number of tasks of a build with several threads, so that few of them end together
(notebooks/records/2026-11-23-comparison.md)."""

MIN_LARGE = 4096
"""Triangles below which a single thread builds a node: the fixed cost of the launches of a level would exceed the gain."""

CHUNKS_PER_THREAD = 4
"""Chunks per thread on a level; several, so that threads finish together."""

MIN_CHUNK = 2048
"""Least number of triangles in a chunk."""

NODES, CHUNKS = 0, 1
"""Positions of the numbers of live nodes and of their chunks in `Totals`."""

SLOTS_PER_THREAD = 32
"""Runs of subtrees per thread of a build on a subset, which has thousands of small ones."""

MAX_LEVELS = 32
"""Levels after which the remaining nodes become tasks whatever their size."""


MAX_KEPT = 1 << 18
"""Triangles up to which a build's work space is kept for the next one: some 85 bytes each, 22 MB in all."""


def build(triangles: TriangleBoxes, config: BvhConfig) -> Bvh:
    """Builds the tree on the device that holds the boxes."""
    device = triangles.boxes.low.device
    if triangles.count > MAX_KEPT or config.reinsertion or not device.is_cpu:
        return BinnedBuilder(triangles, config).build()
    with kept_workspace((build, config, get_num_threads()), device) as work:
        return BinnedBuilder(triangles, config, work=work).build()


def kernels(config: BvhConfig, triangles: int, heuristic: Heuristic = SURFACE) -> list[wp.Kernel]:
    """One kernel of each module that a build of the given number of triangles needs."""
    levels = [make_search_planes(heuristic), level_phase.bin_chunks] if triangles > largest_task(triangles) else []
    moving = [classic_module("bvh.reinsertion").find_insertion_positions] if config.reinsertion else []
    if config.subset < 1.0:
        moving += classic_module("bvh.subset_levels").KERNELS
    return [subtree_kernels(heuristic)[0], *levels, *moving, *collapse_kernels(heuristic)]


def largest_task(triangles: int) -> int:
    """Most triangles of a node that one thread makes a subtree of; larger nodes are split by all threads."""
    threads = get_num_threads()
    return max(MIN_LARGE, triangles // max(TASKS_PER_THREAD * threads, MIN_TASKS)) if threads > 1 else triangles


class BinnedBuilder:
    """The state of one build.

    Args:
        triangles: boxes of the triangles.
        config: costs, bins, leaf size.
        heuristic: the weight of boxes and the choice of planes.
        rays: the heuristic's knowledge of the rays; None if it has none.
        work: work space; None for its own.
    """

    def __init__(
        self,
        triangles: TriangleBoxes,
        config: BvhConfig,
        heuristic: Heuristic = SURFACE,
        rays: Any = None,
        work: Workspace | None = None,
    ) -> None:
        count = triangles.count
        self.triangles = triangles
        self.config = config
        self.heuristic = heuristic
        self.device = triangles.boxes.low.device
        self.work = work = Workspace(self.device) if work is None else work
        self.rays = work.make("rays", 1, lambda _: AllDirections()) if rays is None else rays
        self.search_planes = make_search_planes(heuristic)
        self.subtree_kernel, self.reference_kernel = subtree_kernels(heuristic)
        self.rules = work.make("rules", 1, lambda _: config.struct())
        self.phase = Phases(self.device)
        self.tree = work.make("tree", count, lambda size: empty_tree(size, self.device))
        threads = get_num_threads()
        self.chunk = max(MIN_CHUNK, -(-count // (CHUNKS_PER_THREAD * threads)))
        self.large = largest_task(count)
        self.references = work.empty("references", 16 * count, float)
        """Two buffers of references."""
        self.top: wp.array | None = None
        self.tasks_per_slot = 1

    def build(self) -> Bvh:
        """Builds the tree."""
        load(self.kernels(), self.device)  # compilation is not a phase of the build
        with self.phase("references"):
            self.make_references()
        if self.config.subset == 1.0 or not self.build_on_subset():
            with self.phase("top levels"):
                self.build_levels()
        with self.phase("subtrees"):
            self.build_subtrees()
        return improved(self.result(), self.triangles, self.config, self.phase)

    def kernels(self) -> list[wp.Kernel]:
        """One kernel of each module."""
        return kernels(self.config, self.triangles.count, self.heuristic)

    def run(self, kernel: wp.Kernel, count: int, *inputs: object, chunk: int = 1) -> None:
        """Launches a kernel on the build's device."""
        self.work.launch(kernel, count, inputs, chunk=chunk, chunks_per_thread=CHUNKS_PER_THREAD)

    def make_references(self) -> None:
        """Phase "references": fills the first buffer and computes the root's box."""
        count, size = self.triangles.count, self.chunk
        chunks = -(-count // size)
        self.parts = self.work.empty("parts", 16 * (chunks + count // self.large + 1), float)
        self.run(self.reference_kernel, chunks, self.triangles.boxes, count, size, self.references, self.parts)
        root = np.zeros(8, dtype=np.float32)
        root[0:3], root[4:7] = self.triangles.low, -self.triangles.high
        write(self.tree.box, root)

    def build_levels(self) -> None:
        """Phase "top levels": splits large nodes until none is left."""
        count, size, work = self.triangles.count, self.chunk, self.work
        chunks = -(-count // size)
        root = np.zeros(1, dtype=BinnedNode.numpy_dtype())
        root["frame"]["count"] = count
        if count <= self.large:
            self.tasks, self.task_count = work.empty("tasks", 1, Frame), 1
            write(self.tasks, root["frame"])
            return
        root["chunk_count"] = root["part_count"] = chunks
        max_nodes = count // self.large + 1
        max_chunks = chunks + max_nodes
        nodes = [work.empty(f"nodes {i}", max_nodes, BinnedNode) for i in range(2)]
        lists = [work.empty(f"lists {i}", max_chunks, Chunk) for i in range(2)]
        tasks = work.empty("tasks", 2 * max_nodes * MAX_LEVELS, Frame)
        top = work.empty("top", max_nodes * MAX_LEVELS, int)
        numbers = work.empty("numbers", 5, int)
        write(numbers, np.array([1, chunks, 0, 0, 0], dtype=np.int32))
        totals = work.make("totals", 1, lambda _: wp.array(ptr=numbers.ptr, dtype=Totals, shape=1, device=self.device))
        scratch = work.make("level scratch", max_chunks + max_nodes, lambda size: make_scratch(size, self.device))
        domain = work.empty("level domain", 8 * max_chunks, float)
        write(nodes[0], root)
        self.run(level_phase.cut_root, 1, nodes[0], size, lists[0])

        def level(nodes: wp.array, lists: wp.array, next_nodes: wp.array, next_lists: wp.array) -> list[Step]:
            binned = [self.rules, self.references, nodes, lists, self.parts, domain, scratch]
            searched = [self.rules, self.rays, count, nodes, lists, domain, scratch, max_chunks, self.tree]
            moved = [self.references, nodes, lists, self.parts]
            emitted = [count, self.large, size, MAX_LEVELS, nodes, next_nodes, next_lists, tasks, top, totals]
            return [
                Step(level_phase.bin_chunks, binned, number=CHUNKS),
                Step(self.search_planes, searched, number=NODES),
                Step(level_phase.partition_chunks, moved, number=CHUNKS),
                Step(level_phase.emit_children, emitted, count=1),
            ]

        even, odd = (nodes[0], lists[0]), (nodes[1], lists[1])
        work.loop("levels", [level(*even, *odd), level(*odd, *even)], numbers)
        _, _, self.task_count, pairs, _ = read_ints(numbers, 5)
        self.top = top[:pairs] if pairs else None
        made = tasks.numpy()[: self.task_count]
        write(tasks, made[np.argsort(-made["count"], kind="stable")])
        self.tasks = tasks

    def over(self, triangles: TriangleBoxes) -> "BinnedBuilder":
        """A builder of the same kind for other triangles, all of them."""
        return BinnedBuilder(triangles, replace(self.config, subset=1.0), self.heuristic)

    def build_on_subset(self) -> bool:
        """Phases "subset" and "insertion": the upper levels are those of a tree over a subset of the triangles.

        Returns whether there are enough triangles; if not, nothing is done."""
        subset_levels = classic_module("bvh.subset_levels")
        chosen = subset_levels.choose(self.triangles.count, self.config.subset)
        if not len(chosen):
            return False
        with self.phase("subset"):
            part = self.over(subset_levels.boxes_at(self.triangles, chosen))
            part.make_references()
            part.build_levels()
            part.build_subtrees()
        with self.phase("insertion"):
            count = self.triangles.count
            centers = part.triangles.boxes.low.numpy() + part.triangles.boxes.high.numpy()
            upper = subset_levels.insert(self.references, count, chosen, centers, part.tree, self.tree)
        self.tasks, self.task_count, self.top = upper.tasks, len(upper.tasks), upper.top
        self.tasks_per_slot = -(-self.task_count // (SLOTS_PER_THREAD * get_num_threads()))
        return True

    def build_subtrees(self) -> None:
        """Phase "subtrees": builds all tasks, the largest first, which balances the load; those on a subset by their place."""
        count, work, each = self.task_count, self.work, self.tasks_per_slot
        slots = -(-count // each)
        scratch = work.make("subtree scratch", slots, lambda size: make_scratch(size, self.device))
        domain = work.empty("subtree domain", 8 * STACK * slots, float)
        stack = work.make("stack", slots, lambda size: wp.empty((size, STACK), dtype=Frame, device=self.device))
        self.subtrees = work.make(f"subtrees {count}", 1, lambda _: wp.empty(count, dtype=wp.vec2i, device=self.device))
        memory = subtree_memory(self.references, self.triangles.count, scratch, domain)
        inputs = [self.rules, self.rays, memory, self.tasks, each, stack, self.tree, self.subtrees]
        work.launch(self.subtree_kernel, slots, inputs, chunk=1, chunks_per_thread=slots)

    def result(self) -> BinaryBuild:
        """The finished binary tree. The references are no longer needed."""
        return BinaryBuild(self.tree, self.subtrees, self.top, self.references, self.heuristic, self.rays, self.work)

"""Binned build for known rays with spatial splits (Stich et al. 2009; Falcone 2024, section 7.2).

**Problem.** A long triangle makes the box of its node long, whichever node it is in: the boxes of siblings overlap, and a ray
that meets one meets the other.

**Algorithm.** In each node the best division of its triangles is found as without spatial splits (`projected_binned`). If the
boxes of its sides overlap, the planes between equal slabs are tried too, on the axes that were tried before: a triangle that
straddles one is a reference in both children, each time with the box of its part there (`part_splits`). Both kinds have the
same cost, hit probability times leaf cost, and the lower one wins.

**Bounds.** The root has room for a share of additional references, and each node divides what is left among its children in
proportion to their references. A node is not cut where its room would not suffice, where a side would have as many references
as the node, where the overlap is met by fewer rays than `MIN_OVERLAP`, or where it has so few triangles that it could
become a leaf: no leaf lists a triangle twice.

The divisions of a node are compared as if its children were leaves, so single splits may pay and the tree may not. The tree is
kept if it costs less than that of the same triangles without spatial splits.

**Phases.** References; levels, in which every large node is a work item, until all nodes are tasks; tasks, each of which builds
a subtree depth first; order: the tree is copied without the unused room (`wrt.builders.bvh.phases.depth_first`), so it does not
depend on threads and tasks; weights and collapse as in `projected_binned`.

**Data.** References and pairs of nodes as in the binned build; a node owns `room` of both, from its first reference on.

**What we changed.** Costs are those of the given rays, and the overlap is measured by their hit probability in place of its
surface area. A straddler is never left whole on one side ("unsplitting"): costs count blocks of triangles, and one reference
less seldom saves a block.

**Complexity.** That of two builds without splits, and a clip for every slab that a straddler meets on the axes that are tried.

**Limits.** The nodes of a level are divided by one thread each, so the root by one. Leaves share triangles: see `Bvh.shared`.

References: stich-2009; falcone-2024.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
import warp as wp

from wrt.builders.bvh.binned_bvh import largest_task
from wrt.builders.bvh.bvh_config import BuildRules
from wrt.builders.bvh.known_rays_config import KnownRays, ProjectedConfig, known_rays
from wrt.builders.bvh.phases.binary_build import BinaryBuild
from wrt.builders.bvh.phases.binary_tree import LEAF, BinaryTree, empty_tree
from wrt.builders.bvh.phases.collapse import collapse, wide_cost
from wrt.builders.bvh.phases.depth_first import DepthFirstTree, lay_out
from wrt.builders.bvh.projected_binned import PROJECTED, ProjectedBuilder, is_cheap_leaf, weigh_nodes
from wrt.builders.bvh.projected_binned import build as build_without
from wrt.builders.bvh.spatial.part_splits import Branch, PartMemory, make_part_memory, split
from wrt.builders.core.clip import ClippedMesh, clipped_mesh
from wrt.builders.tree import Bvh, Phases
from wrt.builders.triangle_boxes import CHUNK, Boxes, TriangleBoxes
from wrt.builders.triangle_references import write_order, write_references
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.kernels.runtime.launch import launch, load
from wrt.kernels.runtime.options import exact_kernel

STACK = MAX_WIDE_DEPTH + 2

WEIGHED_PAIRS = 4096
"""Pairs of a work item that weighs nodes."""


@exact_kernel
def begin_references(first: int, boxes: Boxes, triangles: int, size: int, references: wp.array(dtype=float)):
    """Item: `size` triangles. Writes their references."""
    begin = (first + wp.tid()) * size
    write_references(boxes, begin, wp.min(triangles, begin + size), references)


@exact_kernel
def build_branches(
    first: int,
    rules: BuildRules,
    rays: KnownRays,
    memory: PartMemory,
    branches: wp.array(dtype=Branch),
    once: bool,
    stack: wp.array2d(dtype=Branch),
    tree: BinaryTree,
):
    """Item: a node, whose subtree is built depth first. If `once`, the node alone is divided, and its children are left on the
    stack; if it is a leaf, two branches of no triangles.

    stack: (nodes, STACK), or (nodes, 2) if `once`."""
    slot = first + wp.tid()
    branch = branches[slot]
    waiting = int(0)
    building = bool(True)
    left = Branch()
    right = Branch()
    while building:
        tree.range[branch.frame.node] = wp.vec2i(branch.frame.first, branch.frame.count)
        leaf = branch.frame.count <= rules.grain or is_cheap_leaf(rules, rays, tree, branch.frame)
        if leaf:
            tree.pair[branch.frame.node] = LEAF
            begin = branch.frame.buffer + branch.frame.first
            write_order(memory.references, begin, branch.frame.count, tree.order, branch.frame.first)
        else:
            split(rules, rays, memory, branch, slot, tree, left, right)
        if once:
            stack[slot, 0] = left
            stack[slot, 1] = right
            building = False
        elif leaf:
            waiting -= 1
            building = waiting >= 0
            if building:
                branch = stack[slot, waiting]
        else:
            stack[slot, waiting] = right
            waiting += 1
            branch = left


class Work(NamedTuple):
    """What all launches of `build_branches` share; memory: slots -> memory."""

    rules: BuildRules
    rays: KnownRays
    tree: BinaryTree
    memory: Callable[[int], PartMemory]


# -- the build -----------------------------------------------------------------------------------------------------------


def scene_mesh(triangles: TriangleBoxes) -> ClippedMesh:
    """The triangles to clip.

    Raises:
        ValueError: the boxes are not those of triangles.
    """
    if triangles.vertices is None or triangles.faces is None:
        raise ValueError("spatial splits clip triangles, and these boxes have none; build with spatial_splits=0")
    return clipped_mesh(triangles, triangles.scene_size)


def build(triangles: TriangleBoxes, config: ProjectedConfig) -> Bvh:
    """Builds the tree on the device that holds the boxes.

    Raises:
        ValueError: the boxes are not those of triangles.
    """
    device, count, rules = triangles.boxes.low.device, triangles.count, config.bvh.struct()
    mesh, phase = scene_mesh(triangles), Phases(device)
    if count <= config.bvh.leaf_limit:  # the root could be a leaf, and such nodes are not cut
        return build_without(triangles, config)
    plain = ProjectedBuilder(triangles, config)
    load([begin_references, lay_out, *plain.kernels()], device)
    capacity = count + int(count * config.spatial_splits)
    rays = known_rays(triangles, config, capacity)
    references = wp.empty(16 * capacity, dtype=float, device=device)
    tree = empty_tree(capacity, device)
    with phase("references"):
        inputs = [triangles.boxes, count, CHUNK, references]
        launch(begin_references, -(-count // CHUNK), inputs, device=device, chunk=1)
        root = np.concatenate([triangles.low, [0.0], -triangles.high, [0.0]]).astype(np.float32)
        wp.copy(tree.box, wp.array(root, dtype=float, device=device), count=8)
    work = Work(rules, rays, tree, partial(make_part_memory, mesh, references, capacity))
    with phase("top levels"):
        tasks = split_levels(work, count, capacity)
    with phase("subtrees"):
        run_branches(work, tasks, False)
    with phase("order"):
        binary = BinaryBuild(tree, wp.empty(0, dtype=wp.vec2i, device=device), None, references, PROJECTED, rays)
        binary = DepthFirstTree.of(binary, capacity).binary
        weigh(binary, rays)
    with phase("without splits"):
        plain.make_references()
        plain.build_levels()
        plain.build_subtrees()
        whole = plain.result()
    with phase("collapse"):
        pays = wide_cost(binary, rules) < wide_cost(whole, rules)
        made = collapse(binary if pays else whole, triangles, config.bvh, phase.stats)
    return replace(made, shared=pays and int((made.primitive.numpy() >= 0).sum()) > count)


def run_branches(work: Work, branches: np.ndarray, once: bool) -> wp.array:
    """Launches `build_branches`; returns its stack."""
    device, count = work.tree.box.device, len(branches)
    stack = wp.empty((count, 2 if once else STACK), dtype=Branch, device=device)
    listed = wp.array(branches, dtype=Branch, device=device)
    inputs = [work.rules, work.rays, work.memory(count), listed, once, stack, work.tree]
    launch(build_branches, count, inputs, device=device, chunk=1, chunks_per_thread=max(1, count))
    return stack


def split_levels(work: Work, count: int, capacity: int) -> np.ndarray:
    """Divides large nodes, level after level; returns the tasks, structured as `Branch`, the largest first."""
    large = largest_task(count)
    level = np.zeros(1, dtype=Branch.numpy_dtype())
    level["frame"]["count"], level["room"] = count, capacity
    tasks = []
    while len(level):
        is_large = level["frame"]["count"] > large
        tasks.append(level[~is_large])
        level = level[is_large]
        if len(level):
            level = run_branches(work, level, True).numpy().ravel()
            level = level[level["frame"]["count"] > 0]
    found = np.concatenate(tasks)
    return found[np.argsort(-found["frame"]["count"], kind="stable")]


def weigh(binary: BinaryBuild, rays: KnownRays) -> None:
    """Writes the weights of all nodes, as `weigh_nodes`."""
    end = int(binary.subtrees.numpy()[0][1])
    begins = np.arange(0, end, WEIGHED_PAIRS)
    ranges = np.stack([np.maximum(begins, 1), np.minimum(begins + WEIGHED_PAIRS, end)], axis=1).astype(np.int32)
    device = binary.space.device
    listed = wp.array(ranges, dtype=wp.vec2i, device=device)
    launch(weigh_nodes, len(ranges), [rays, binary.tree, listed], device=device, chunk=1)

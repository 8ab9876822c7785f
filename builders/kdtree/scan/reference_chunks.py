"""The kernels of a level of a build that scans references: what each chunk of a node's references does (`reference_levels`).

Counts and minima do not depend on the grouping. So the result does not depend on chunks or threads, and a node gets the same
split as in a task.

References: shevtsov-2007-kdtree.
"""

from functools import cache

import warp as wp

from wrt.builders.core.clip import ClippedMesh
from wrt.builders.core.levels import Chunk, LiveNode, decided
from wrt.builders.core.reference_lists import Sides, measure_sides, move_range
from wrt.builders.cost import SplitCost, no_split
from wrt.builders.kdtree.scan.kdtree_bins import best_bin_plane, bin_range, make_binning, median_bin_plane, merge_bins
from wrt.builders.tree import StopLimits
from wrt.builders.triangle_boxes import Boxes
from wrt.builders.triangle_references import copy_references, write_references
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel, specialised_kernel


@native.func_native(
    "clip.h",
    "const auto& split = node.split;\n"
    "auto left_high = node.frame.high, right_low = node.frame.low;\n"
    "left_high[split.axis] = right_low[split.axis] = split.position;\n"
    "const auto left_cell = wrt::cell_of(node.frame.low, left_high, mesh.pad);\n"
    "const auto right_cell = wrt::cell_of(right_low, node.frame.high, mesh.pad);\n"
    "const float* from = references.data + (size_t)chunk.begin * 8;\n"
    "float *left = target.data + (size_t)chunk.to_left * 8, *right = target.data + (size_t)chunk.to_right * 8;\n"
    "const wrt::SideTargets targets = {moving, left, right, {}};\n"
    "wrt::clip_sides(mesh, left_cell, right_cell, from, chunk.end - chunk.begin, split, targets, sides);",
)
def clip_chunk(
    mesh: ClippedMesh,
    references: wp.array(dtype=float),
    node: LiveNode,
    chunk: Chunk,
    moving: bool,
    target: wp.array(dtype=float),
    sides: wp.ref[Sides],
):
    """Clips a chunk's straddlers to the cells of the children of its node, which is split, counts the references of both sides,
    and computes their boxes. Writes them to the target if they are `moving`."""


@wp.func
def sample_step(triangles: int, sampled: int):
    """Step of the sample: every step-th triangle of a node is counted."""
    step = int(1)
    if sampled > 0 and triangles >= sampled:
        rest = triangles / 100
        while rest > 0:
            rest /= 10
            step += 1
    return step


@exact_kernel
def make_references(first: int, boxes: Boxes, triangles: int, size: int, references: wp.array(dtype=float)):
    """Item: a chunk of `size` triangles. Writes their references."""
    begin = (first + wp.tid()) * size
    write_references(boxes, begin, wp.min(triangles, begin + size), references)


@exact_kernel
def bin_chunks(
    first: int,
    bins: int,
    sampled: int,
    references: wp.array(dtype=float),
    nodes: wp.array(dtype=LiveNode),
    chunks: wp.array(dtype=Chunk),
    counter: wp.array2d(dtype=int),
):
    """Item: a chunk. Bins its references in its slot of counters."""
    slot = first + wp.tid()
    chunk = chunks[slot]
    node = nodes[chunk.node]
    if not node.finished:
        step = sample_step(node.frame.triangles, sampled)
        behind = (chunk.begin - node.frame.first[0]) % step
        skip = (step - behind) % step
        node_binning = make_binning(node.frame, bins)
        bin_range(references, chunk.begin + skip, chunk.end - chunk.begin - skip, step, node_binning, counter, slot)


@exact_kernel
def decide(
    first: int,
    cost: SplitCost,
    limits: StopLimits,
    bins: int,
    sampled: int,
    median_levels: int,
    nodes: wp.array(dtype=LiveNode),
    counter: wp.array2d(dtype=int),
    merged: int,
):
    """Item: a live node. Merges its bins, and stops or splits. Slots from `merged` on hold the bins of nodes.

    median_levels: levels that are split at medians."""
    index = first + wp.tid()
    node = nodes[index]
    if not node.finished:
        slot = merged + index
        merge_bins(counter, slot, node.chunk_first[0], node.chunk_first[0] + node.chunk_count[0], bins)
        step = sample_step(node.frame.triangles, sampled)
        best = no_split()
        if node.frame.depth < median_levels:
            best = median_bin_plane(cost, node.frame, counter, slot, bins, step)
        if best.cost > 0.0:
            best = best_bin_plane(cost, node.frame, counter, slot, bins, step)
        nodes[index] = decided(cost, limits, node, best)


@cache
def make_decide(memory_type: type, search: wp.Function) -> wp.Kernel:
    """The kernel whose item is a live node, and which searches it as a task does; search: as in `subtrees.Method`."""

    def decide_by_search(first: int, cost: SplitCost, limits: StopLimits, memory: memory_type, nodes: wp.array(dtype=LiveNode)):
        index = first + wp.tid()
        node = nodes[index]
        if not node.finished:
            nodes[index] = decided(cost, limits, node, search(cost, memory, index, node.frame))

    return specialised_kernel(decide_by_search)


@exact_kernel
def measure_chunks(
    first: int,
    mesh: ClippedMesh,
    references: wp.array(dtype=float),
    nodes: wp.array(dtype=LiveNode),
    chunks: wp.array(dtype=Chunk),
    measured: wp.array(dtype=Sides),
):
    """Item: a chunk. Measures the sides of its node's plane; straddlers are clipped if the mesh says so. In a finished node
    everything is on the left."""
    slot = first + wp.tid()
    chunk = chunks[slot]
    node = nodes[chunk.node]
    count = chunk.end - chunk.begin
    sides = Sides()
    if node.finished:
        sides.left = count
    elif mesh.clips:
        clip_chunk(mesh, references, node, chunk, False, references, sides)
    else:
        split = node.split
        measure_sides(references, chunk.begin, count, split.axis, split.position, split.planar_left, sides)
    measured[slot] = sides


@exact_kernel
def move_chunks(
    first: int,
    mesh: ClippedMesh,
    references: wp.array(dtype=float),
    nodes: wp.array(dtype=LiveNode),
    chunks: wp.array(dtype=Chunk),
    target: wp.array(dtype=float),
):
    """Item: a chunk. Moves its references to the next level's buffer."""
    chunk = chunks[first + wp.tid()]
    node = nodes[chunk.node]
    begin = chunk.begin
    count = chunk.end - begin
    left = chunk.to_left
    right = chunk.to_right
    sides = Sides()
    if node.finished:
        copy_references(references, begin, count, target, left)
    elif mesh.clips:
        clip_chunk(mesh, references, node, chunk, True, target, sides)
    else:
        move_range(references, begin, count, node.split, target, left, right, sides)

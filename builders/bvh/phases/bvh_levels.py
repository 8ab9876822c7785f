"""The top levels of the binned build: all large nodes of a level at once, in parallel over chunks of their triangles.

A level takes four launches:

    bin         every chunk bins its triangles. The centroid box of its node is the union of the partial boxes that the chunks
                of the previous level wrote
    search      every node merges the bins of its chunks, finds its best plane, and computes the write positions of its chunks:
                the counts in a chunk's own bins tell how many of its triangles go to the left
    partition   every chunk moves its triangles to the other buffer, in order, and writes the centroid boxes of both sides
    emit        lists the children that are still large, with their chunks; the others become tasks (`bvh_subtrees`)

Minima and counts do not depend on order and grouping. So the result does not depend on chunks or threads, and a node gets the
same split as in a task.
"""

from functools import cache

import warp as wp

from wrt.builders.bvh.bvh_config import BuildRules
from wrt.builders.bvh.phases.bin_heuristic import Heuristic
from wrt.builders.bvh.phases.binary_tree import BinaryTree, Frame, child_of, half_area, must_split_at_median
from wrt.builders.bvh.phases.bvh_bins import (
    SLOT_BINS,
    Binning,
    Plane,
    Scratch,
    bin_range,
    bins_for,
    make_binning,
    merge_bins,
    no_plane,
    partition_range,
    write_child_boxes,
)
from wrt.builders.core.levels import Chunk
from wrt.kernels.layout.struct_arrays import with_known_layout
from wrt.kernels.layout.unchecked import load_float, store_float
from wrt.kernels.runtime.options import exact_kernel, specialised_kernel
from wrt.kernels.simd.boxes import INFINITY


@with_known_layout
@wp.struct
class BinnedNode:
    """A large node of the current level."""

    frame: Frame
    chunk_first: int
    """First chunk; the chunks of a node on this level are contiguous."""
    chunk_count: int
    part_first: int
    """Its centroid box is the union of the parts part_first, part_first + 2, ... that the previous level wrote."""
    part_count: int
    binning: Binning
    plane: Plane


@wp.func
def merge_parts(node: BinnedNode, parts: wp.array(dtype=float), domain: wp.array(dtype=float), at: int):
    """Computes the centroid box of a node from its parts."""
    for lane in range(8):
        smallest = load_float(parts, node.part_first * 8 + lane)
        for part in range(1, node.part_count):
            value = load_float(parts, (node.part_first + part * 2) * 8 + lane)
            smallest = wp.where(value < smallest, value, smallest)
        store_float(domain, at * 8 + lane, smallest)


@exact_kernel
def bin_chunks(
    first: int,
    rules: BuildRules,
    references: wp.array(dtype=float),
    nodes: wp.array(dtype=BinnedNode),
    chunks: wp.array(dtype=Chunk),
    parts: wp.array(dtype=float),
    domain: wp.array(dtype=float),
    scratch: Scratch,
):
    """Item: a chunk. Bins its triangles. domain: (chunks * 8,)."""
    slot = first + wp.tid()
    chunk = chunks[slot]
    node = nodes[chunk.node]
    merge_parts(node, parts, domain, slot)
    binning = make_binning(domain, slot, bins_for(rules, node.frame.count))
    bin_range(references, chunk.begin, chunk.end - chunk.begin, binning, scratch, slot)


@cache
def make_search_planes(heuristic: Heuristic) -> wp.Kernel:
    """The kernel that finds the planes of the live nodes."""
    rays_type, search = heuristic.rays, heuristic.search

    def search_planes(
        first: int,
        rules: BuildRules,
        rays: rays_type,
        triangles: int,
        nodes: wp.array(dtype=BinnedNode),
        chunks: wp.array(dtype=Chunk),
        domain: wp.array(dtype=float),
        scratch: Scratch,
        merged_first: int,
        tree: BinaryTree,
    ):
        """Item: a live node. Slots from merged_first on hold the merged bins of the nodes."""
        index = first + wp.tid()
        node = nodes[index]
        frame = node.frame
        node.binning = make_binning(domain, node.chunk_first, bins_for(rules, frame.count))
        bins = node.binning.bins
        slot = merged_first + index
        node.plane = no_plane()
        if half_area(tree.box, frame.node) > 0.0 and not must_split_at_median(frame.depth, frame.count):
            merge_bins(scratch, slot, node.chunk_first, node.chunk_first + node.chunk_count, bins, node.binning.axes)
            node.plane = search(rules, rays, node.binning, scratch, slot, tree, frame)
        if node.plane.cost < INFINITY:
            pair = frame.first + node.plane.left
            tree.range[frame.node] = wp.vec2i(frame.first, frame.count)
            tree.pair[frame.node] = pair
            write_child_boxes(scratch, slot, bins, node.plane.axis, node.plane.bin, tree.box, pair)
            to_left = triangles - frame.buffer + frame.first
            to_right = to_left + node.plane.left
            for c in range(node.chunk_first, node.chunk_first + node.chunk_count):
                chunks[c].to_left = to_left
                chunks[c].to_right = to_right
                left = int(0)
                for b in range(node.plane.bin):
                    left += scratch.count[c * SLOT_BINS + node.plane.axis * bins + b]
                to_left += left
                to_right += chunks[c].end - chunks[c].begin - left
        nodes[index] = node

    return specialised_kernel(search_planes)


@with_known_layout
@wp.struct
class Totals:
    """Running totals of a build."""

    nodes: int
    chunks: int
    tasks: int
    pairs: int
    levels: int
    """Levels completed."""


@wp.func
def add_chunks(index: int, node: BinnedNode, size: int, chunks: wp.array(dtype=Chunk)):
    """Divides a live node into chunks of `size` triangles."""
    for i in range(node.chunk_count):
        chunk = Chunk()
        chunk.node = index
        chunk.begin = node.frame.buffer + node.frame.first + i * size
        chunk.end = chunk.begin + wp.min(size, node.frame.count - i * size)
        chunks[node.chunk_first + i] = chunk


@exact_kernel
def cut_root(first: int, nodes: wp.array(dtype=BinnedNode), size: int, chunks: wp.array(dtype=Chunk)):
    """One item. Makes the chunks of the first level."""
    add_chunks(0, nodes[0], size, chunks)


@exact_kernel
def emit_children(
    first: int,
    triangles: int,
    large: int,
    size: int,
    max_levels: int,
    nodes: wp.array(dtype=BinnedNode),
    next_nodes: wp.array(dtype=BinnedNode),
    next_chunks: wp.array(dtype=Chunk),
    tasks: wp.array(dtype=Frame),
    top: wp.array(dtype=int),
    totals: wp.array(dtype=Totals),
):
    """One item. Lists the children of more than `large` triangles as live nodes. The other children, nodes without a split, and
    all children of the last level become tasks. top: the pairs made."""
    total = totals[0]
    live = total.nodes
    total.nodes = 0
    total.chunks = 0
    total.levels += 1
    for index in range(live):
        node = nodes[index]
        if node.plane.cost < INFINITY:
            top[total.pairs] = node.frame.first + node.plane.left
            total.pairs += 1
            for side in range(2):
                child = BinnedNode()
                child.frame = child_of(node.frame, node.plane.left, node.frame.first + node.plane.left, side)
                child.frame.buffer = triangles - node.frame.buffer
                if child.frame.count > large and total.levels < max_levels:
                    child.chunk_first = total.chunks
                    child.chunk_count = (child.frame.count + size - 1) / size
                    child.part_first = 2 * node.chunk_first + side
                    child.part_count = node.chunk_count
                    add_chunks(total.nodes, child, size, next_chunks)
                    next_nodes[total.nodes] = child
                    total.nodes += 1
                    total.chunks += child.chunk_count
                else:
                    tasks[total.tasks] = child.frame
                    total.tasks += 1
        else:
            tasks[total.tasks] = node.frame
            total.tasks += 1
    totals[0] = total


@exact_kernel
def partition_chunks(
    first: int,
    references: wp.array(dtype=float),
    nodes: wp.array(dtype=BinnedNode),
    chunks: wp.array(dtype=Chunk),
    parts: wp.array(dtype=float),
):
    """Item: a chunk. Writes the centroid boxes of its left and right triangles to the parts 2 * chunk and 2 * chunk + 1."""
    slot = first + wp.tid()
    chunk = chunks[slot]
    node = nodes[chunk.node]
    if node.plane.cost < INFINITY:
        partition_range(
            references,
            chunk.begin,
            chunk.end - chunk.begin,
            node.binning,
            node.plane,
            wp.vec2i(chunk.to_left, chunk.to_right),
            parts,
            wp.vec2i(2 * slot, 2 * slot + 1),
        )

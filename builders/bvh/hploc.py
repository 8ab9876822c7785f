"""Parallel build of a bounding volume hierarchy from the triangles up, by merging neighbours (Benthin et al. 2024).

**Problem.** A build from the root down begins with one node, and passes over all triangles at each level. On CUDA, where one
thread is slow and there are 100,000 of them, that takes longer than many frames may.

**Algorithm** (H-PLOC). Triangles are sorted by the Morton codes of the middles of their boxes. Along the implicit hierarchy of
the codes, from the bottom up, lists of up to 16 clusters are merged pairwise: two clusters that are each other's nearest, by
the surface area of their joint box, among 8 neighbours on either side, become one (PLOC: Meister and Bittner 2018). All of it
is one kernel without levels (`cluster_merging`). If asked for, nodes then move to where they cost less
(`parallel_reinsertion`). Last, they are put into the order of the layout (`merged_layout`).

**Phases.** Codes: `write_codes` and a radix sort. Merging: `begin_clusters`, `merge_clusters`. Reinsertion: `reinsert`. Layout:
nodes of two children with leaves of at most two triangles, as CUDA has them, by `binary_bvh`; others by the collapse
(`collapse`), on the CPU.

**Complexity.** O(N) after the sort.

**What we changed.** Nodes are numbered without a shared counter, and pairs of equal area are ordered by where they differ in
the lowest bits of their places: 1,000 equal triangles make a tree of depth 10 in place of 111. The tree is the same for any
number of threads, and on CUDA and the CPU. Leaves are those of the surface area heuristic. A tree too deep for the layout is
made again without reinsertion, then by neighbourhood alone.

**Limits.** Codes have 10 bits for each axis: of triangles in one cell only their order in the mesh counts. Without
reinsertion, rays are slower than in trees of builders that search planes.

References: benthin-2024; meister-bittner-2018-ploc; apetrei-2014; karras-2012; morton-1966.
"""

from contextlib import nullcontext

import warp as wp

from wrt.builders.bvh.bvh_config import BvhConfig
from wrt.builders.bvh.phases.bin_heuristic import SURFACE
from wrt.builders.bvh.phases.cluster_merging import empty_merged_tree, make_merge_clusters, merge, sort_by_codes, write_codes
from wrt.builders.bvh.phases.collapse import collapse, collapse_kernels
from wrt.builders.bvh.phases.merged_layout import KERNELS, arrays_of, binary_build, binary_bvh, single_triangle
from wrt.builders.bvh.phases.parallel_reinsertion import find_moves, reinsert
from wrt.builders.tree import BuildStats, Bvh, Phases
from wrt.builders.triangle_boxes import TriangleBoxes
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH, check_blocks
from wrt.kernels.runtime.launch import load
from wrt.kernels.runtime.workspace import Workspace, kept_workspace

MAX_KEPT = 1 << 20
"""Triangles up to which a build's work space is kept for the next one: some 150 bytes each."""


MAX_TRIANGLES = 1 << 27
"""Triangles up to which kernels number the words of all boxes, 16 a triangle, by 32 bits."""


def check_count(count: int, width: int) -> None:
    """Refuses more triangles than a tree can have, before anything is made for them.

    Raises:
        ValueError: there are more.
    """
    check_blocks(-(-count // width), width)
    if count > MAX_TRIANGLES:
        raise ValueError(
            f"a mesh of {count:,} triangles, and hploc takes {MAX_TRIANGLES:,} at most; take another builder, or cut the mesh "
            "into several, and make a scene of a wrt.Instance of each"
        )


def needs_no_collapse(config: BvhConfig) -> bool:
    """Whether nodes are those of the binary tree: then they are made on the device that holds the boxes."""
    return config.cost.width == 2 and config.leaf_limit <= 2


def kernels(config: BvhConfig, triangles: int) -> list[wp.Kernel]:
    """One kernel of each module that a build of the given number of triangles needs."""
    needed = [write_codes, make_merge_clusters(), *([find_moves] if config.reinsertion else []), *KERNELS]
    return needed if triangles > 1 and needs_no_collapse(config) else [*needed, *collapse_kernels(SURFACE)]


def build(triangles: TriangleBoxes, config: BvhConfig) -> Bvh:
    """Builds the tree on the device that holds the boxes."""
    device, count = triangles.boxes.low.device, triangles.count
    check_count(count, config.cost.width)
    load(kernels(config, count), device)  # compilation is not a phase of the build
    if count == 1:
        return collapse(single_triangle(triangles), triangles, config, BuildStats())
    if count > MAX_KEPT:
        return build_in(Workspace(device), triangles, config)
    stream = device.stream.cuda_stream if device.is_cuda else None  # on another one, kernels may still use the arrays
    with kept_workspace((build, config, device.alias, stream), device) as work:
        return build_in(work, triangles, config)


def build_in(work: Workspace, triangles: TriangleBoxes, config: BvhConfig) -> Bvh:
    """Builds the tree of at least two triangles in a work space. On CUDA the build is one phase: the host does not wait."""
    phase = Phases(work.device)
    step, whole = (phase, nullcontext()) if work.device.is_cpu else (lambda _: nullcontext(), phase("build"))
    with whole:
        merged = work.make("merged", triangles.count, lambda size: empty_merged_tree(size, work.device))
        with step("codes"):
            sort_by_codes(triangles, merged)
        for by_area, rounds in dict.fromkeys([(True, config.reinsertion), (True, 0), (False, 0)]):
            with step("merging"):
                merge(triangles, merged, by_area)
            if rounds:
                with step("reinsertion"):
                    moves = reinsert(work, merged, triangles.count, rounds)
                    phase.stats.reserve(triangles.boxes.low, triangles.boxes.high, *arrays_of(merged), *arrays_of(moves))
            if needs_no_collapse(config):
                with step("layout"):
                    tree = binary_bvh(work, triangles, merged, config, phase.stats)
                if tree is not None:
                    return tree
            else:
                with step("layout"):
                    binary, depth = binary_build(triangles, merged)
                if depth <= MAX_WIDE_DEPTH:
                    with step("collapse"):
                        return collapse(binary, triangles, config, phase.stats)
    raise AssertionError("a tree of neighbours is not deep")

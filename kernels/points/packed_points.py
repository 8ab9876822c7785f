"""The nearest triangle to each point by persistent threads, through a tree of two children a node: what CUDA searches.

**Problem.** A thread that searches one point reads nodes from addresses that no other thread reads: what counts is how many
loads a node takes. And the walks of a warp's points end at different times.

**Idea.** Nodes and triangles are those of `wrt.kernels.layout.binary_nodes`, which rays go through, too: a node is four loads,
a triangle three. Threads take the next point when some of their warp are done (`wrt.kernels.traversal.persistent`). Boxes are a
filter, tested by fused operations; distances of triangles are those of all engines, so that the answers have the same bits.
Numbers were chosen by notebooks/records/2026-11-28-points-gpu.md.

On the CPU an item searches one point, by the same steps; that serves tests. The walk is in kernels/native/packed_points.h.

References: aila-laine-2009.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.binary_nodes import BinaryNodes, PackedTriangles
from wrt.kernels.points.point_batch import NearestBatch, PointBatch
from wrt.kernels.points.tree_points import GUARDS
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.traversal.persistent.next_ray import NextRay
from wrt.kernels.traversal.persistent.persistent_bvh import BLOCK

FETCH = 20
"""Threads of a warp without a point for which new ones are fetched."""

KEEP = 4
"""Threads of a warp that may wait at an inner node while the others test triangles."""

STEPS = 3
"""Nodes that a thread visits between two votes of its warp about that."""

BLOCKS = 12
"""Blocks of a multiprocessor, which bound a thread to 80 registers."""


@cache
def make_packed_points_kernel(levels: int) -> wp.Kernel:
    """The kernel for trees of up to `levels` inner nodes on a path. On CUDA it runs in as many threads as `NextRay` says."""

    @native.func_native(
        "packed_points.h",
        f"{GUARDS}const auto walks = wrt::point_walks<{levels}>(tree, triangles, points, found);\n"
        f"wrt::search_points<{FETCH}, {KEEP}, {STEPS}>(walks, next.number.data, next.threads, i);",
    )
    def search(
        tree: BinaryNodes, triangles: PackedTriangles, points: PointBatch, found: NearestBatch, next: NextRay, i: int
    ): ...

    def packed_nearest(
        first: int, tree: BinaryNodes, triangles: PackedTriangles, points: PointBatch, found: NearestBatch, next: NextRay
    ):
        search(tree, triangles, points, found, next, first + wp.tid())

    return specialised_kernel(packed_nearest, bounds=(BLOCK, BLOCKS))

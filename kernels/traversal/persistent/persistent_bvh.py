"""Single rays through a tree of two children a node, by persistent threads.

**Problem.** The rays of a warp of 32 CUDA threads end at different times. With one ray a thread, a warp works on for its
longest ray, and of incoherent rays most threads wait for it (notebooks/records/2026-11-27-gpu-traversal.md).

**Idea** (Aila and Laine 2009). Threads are persistent: a launch has as many as the device holds at a time. A thread that is
done waits until some others of its warp are, too; together they fetch the next rays from a counter. Within a warp, threads walk
inner nodes until nearly all have come to a leaf, then they test triangles. Nodes and triangles are those of
`wrt.kernels.layout.binary_nodes`.

**Boxes are a filter.** They are tested by fused operations, with twice the slack of `wrt.kernels.simd.boxes`, and t is compared
as an integer. Directions are scaled by a power of two, so that they may have any length. The triangle test and the consistency
rule are those of all engines, without fused operations, so that hits are the same to the bit. Coordinates may be up to 2^100.

**Crossings** are counted by the rule of `wrt.kernels.triangle.watertight`, in a walk that no hit shortens. Lists of all hits
are counted, the counts are summed up on the device, and a second walk writes each hit to its ray's list
(`wrt.query.all_hits`).

**Instances.** At a leaf of the tree of instances the ray is mapped to the geometry's space as in
`wrt.kernels.traversal.two_level.instance_single`, and goes on at the root of its tree. A mark on the stack says where it goes
back. Threads of a warp may be on different levels: the step of a node is the same. The ray is read and mapped again at each
hit. Going into an instance costs as much as several nodes, and so does a hit, so the threads of a warp that go in or out and
those that test triangles take turns, the more numerous ones first.

**Lists.** In an environment of few instances (`wrt.kernels.layout.instance_maps.MAX_LISTED_INSTANCES`) a ray tests the boxes
of all when it begins, as the other threads do, and goes to those that it meets in the order of their t. The upper tree is not
walked, and nothing is prepared again for it on the way back.

**Limits.** The watertight test, and trees whose leaves share no triangle. Alpha masks take `wrt.kernels.traversal.single`.

On the CPU an item traces one ray, by the same steps; that serves tests.

References: aila-laine-2009; woop-2013.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.answers import SKIPPING, all_crossings, any_hit, closest_hit, crossing_count, next_crossing, winding_number
from wrt.kernels.layout.binary_nodes import BinaryNodes, BinaryPart, PackedTriangles
from wrt.kernels.layout.instance_maps import MAX_LISTED_INSTANCES
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.traversal.leaf import CounterRows
from wrt.kernels.traversal.persistent.next_ray import NextRay
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.traversal.two_level.instance_single import InstanceTree

FETCH = 20
"""Threads of a warp without a ray for which new rays are fetched. A fetch stops the whole warp, so few threads do not repay
it. Neighbours of this number and of the next two are about as good (notebooks/records/2026-11-27-gpu-traversal.md)."""

KEEP = 4
"""Threads of a warp that may wait at an inner node while the others test triangles."""

STEPS = 3
"""Nodes that a thread visits between two votes of its warp about that."""

BLOCK, BLOCKS = 64, 16
"""Threads of a block and blocks of a multiprocessor. They bound a thread to 64 registers: with more, fewer threads hide the
latency of memory, and with fewer, registers spill."""

LISTED_PLACES = 2 * 2 * MAX_LISTED_INSTANCES + 1
"""Places of the stack below those of a mesh's tree where the instances of a list wait."""

INSTANCE_BLOCKS = 12
"""The same through instances, whose walks need more registers: 80 a thread."""


def launch_threads(device: wp.Device, count: int, blocks: int = BLOCKS) -> int:
    """Threads of a launch for this many rays or points: at most all that a CUDA device runs at a time.

    blocks: of a multiprocessor, as the kernel is bounded to.
    """
    return min(count, device.sm_count * blocks * BLOCK)


ANSWER_CLASSES = {
    closest_hit.KIND.name: "ClosestAnswer",
    any_hit.KIND.name: "AnyAnswer",
    crossing_count.KIND.name: "CountAnswer",
    all_crossings.KIND.name: "ListAnswer",
    winding_number.KIND.name: "WindingAnswer",
    next_crossing.KIND.name: "NextAnswer",
}
"""What `packed_answers.h` calls the kinds of answers."""


@cache
def make_persistent_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel for one specialisation. On CUDA it runs in `launch_threads`."""
    space = "wrt::one_tree(tree, triangles)"
    return make_walk_kernel(config, (BinaryNodes, PackedTriangles), space, config.stack.levels + 1)


@cache
def make_persistent_instance_kernel(config: TraversalConfig, levels: int) -> wp.Kernel:
    """The same for rays through instances.

    Args:
        config: the specialisation.
        levels: greatest number of inner nodes on a path of the upper tree, whose nodes have two children.
    """
    space, places = "wrt::instance_trees(tree, triangles)", config.stack.levels + upper_places(levels)
    return make_walk_kernel(config, (InstanceTree, wp.array(dtype=BinaryPart)), space, places, INSTANCE_BLOCKS)


def upper_places(levels: int) -> int:
    """Places of the stack of a walk through instances besides those of a mesh's tree.

    levels: greatest number of inner nodes on a path of the upper tree.
    """
    return max(levels + 2, LISTED_PLACES + 1)


def make_walk_kernel(
    config: TraversalConfig, types: tuple[Any, Any], space: str, places: int, blocks: int = BLOCKS
) -> wp.Kernel:
    """The kernel that walks all rays of a batch on CUDA, and ray i on the CPU.

    Args:
        config: the specialisation.
        types: of the arguments `tree` and `triangles`.
        space: what rays go through, a space of `persistent.h`.
        places: of the stack.
        blocks: of a multiprocessor.
    """
    Tree, Triangles = types
    flags = f"{int(config.cull_backfaces)}, {int(config.variant == SKIPPING)}, {int(config.counters)}"
    options = f"{places}, wrt::{ANSWER_CLASSES[config.query]}, {flags}"
    form = f"{FETCH}, {KEEP}, {STEPS}, {int(config.persistent.from_zero)}"
    walks = f"wrt::walks_of<{options}>({space}, rays, hits, counters, next.skipped)"

    @native.func_native("persistent.h", f"wrt::walk_rays<{form}>({walks}, next.number.data, next.threads, i);")
    def walk(
        tree: Tree,
        triangles: Triangles,
        rays: RayBatch,
        hits: HitBatch,
        counters: CounterRows,
        next: NextRay,
        i: int,
    ): ...

    def persistent_rays(
        first: int,
        tree: Tree,
        triangles: Triangles,
        rays: RayBatch,
        hits: HitBatch,
        counters: CounterRows,
        next: NextRay,
    ):
        walk(tree, triangles, rays, hits, counters, next, first + wp.tid())

    return specialised_kernel(persistent_rays, bounds=(BLOCK, blocks))

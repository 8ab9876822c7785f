"""The kernel that carries out a plan, its inputs, and its launch."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

import warp as wp

from wrt.engine.launch.triangle_records import record_kernel, records_of
from wrt.engine.plan.plan import (
    Plan,
    config_for_layout,
    kernel_factory,
    stack_levels,
    traversal_config,
    traversal_of,
    walked_tree,
)
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.runtime.launch import CHUNKS_PER_THREAD, MAX_CHUNK, Chunks, expect, get_num_threads, kept, launch, specialise
from wrt.kernels.traversal.capabilities import Capabilities

if TYPE_CHECKING:
    from wrt.engine.device_hits import DeviceHits
    from wrt.engine.facts.scene_state import SceneState
    from wrt.kernels.traversal.traversal_config import TraversalConfig

BRUTE_FORCE_TESTS = 10_000_000
"""Triangle tests that brute force does in one launch on the CPU: some hundredths of a second."""

MIN_CHUNK = 256
"""Rays that are worth a chunk of their own on the CPU: much longer to trace than a chunk takes to be claimed."""

LONGEST_ITEM = 16
"""Streams or runs of packets of an item at most: Warp clears the local memory of an item, which they then share."""

ITEMS_PER_THREAD = 32
"""Items that a thread has at least where one may be several streams or runs of packets: enough to balance the load."""

MIN_ITEMS_PER_THREAD = 6
"""Items that a thread has at least, if they can be cut: with fewer, threads wait for the last one."""

MIN_RAYS_PER_ITEM = 256
"""Rays down to which items are cut."""

TREE, RECORDS, RAYS, HITS, NEXT = 1, 2, 3, 4, 6
"""Which of a traversal kernel's arguments they are, the number of the first item counted; NEXT: of persistent threads."""


def run_kernel(
    scene: SceneState, plan: Plan, rays: RayBatch, hits: DeviceHits, query: str, work: wp.array, counters: bool
) -> None:
    """Traces rays through a scene's tree or, ray by ray or in packets, its two levels; `work` as in `counter_rows`."""
    config = config_for_rays(plan, scene, query, rays.origin_stride == 0, counters)
    kernel, inputs = kernel_and_inputs(scene, plan, config, rays, hits.struct(), work)
    rays.run, items, chunks = divide(scene, plan, config, rays.count)
    launch(kernel, items, inputs, device=scene.device, **asdict(chunks))


def config_for_rays(plan: Plan, scene: SceneState, query: str, shared_origin: bool, counters: bool = False) -> TraversalConfig:
    """The specialisation for rays that share their origin or not. In packets through instances, of which plans do not say so,
    those that do have one origin in each instance, too."""
    config = config_for_layout(traversal_config(plan, scene, query, counters), plan, scene)
    if scene.instances and Capabilities.PACKETS in traversal_of(plan).capabilities:
        return replace(config, packet=replace(config.packet, shared_origin=shared_origin))
    return config


def kernel_and_inputs(
    scene: SceneState, plan: Plan, config: TraversalConfig, rays: RayBatch, hits: HitBatch, work: wp.array
) -> tuple[wp.Kernel, list[Any]]:
    """The kernel that carries out a plan on the tree as it stands, and what it gets after the number of the first item.

    On two levels that is the one for rays that go one by one, or in packets.
    """
    counters, given = counter_rows(work), [] if scene.alpha_masks is None else [scene.alpha_masks]
    if Capabilities.PERSISTENT in traversal_of(plan).capabilities:
        from wrt.engine.launch.persistent_launch import kernel_and_trees, next_ray

        kernel, trees = kernel_and_trees(scene, config)
        return kernel, [*trees, rays, hits, counters, next_ray(scene.device, rays.count)]
    if scene.instances:
        levels, given = stack_levels(scene.tree.depth), [scene.upper(), scene.lower(plan, rays), rays, hits, counters, *given]
        if Capabilities.PACKETS in traversal_of(plan).capabilities:
            from wrt.kernels.traversal.two_level.instance_packets import make_instance_packet_kernel

            return specialise(partial(make_instance_packet_kernel, levels=levels), config), given[:HITS]
        from wrt.kernels.traversal.two_level.instance_single import make_instance_kernel

        return specialise(partial(make_instance_kernel, kind=plan.accelerator, levels=levels), config), given
    if plan.accelerator == "none":
        from wrt.kernels.traversal.brute_force import AllTriangles

        tree: Any = AllTriangles()
        tree.count, tree.low, tree.high = scene.triangle_count, scene.tree.low, scene.tree.high
    else:
        walked = walked_tree(plan, scene)
        tree = walked.paired_struct() if config.single.pair_words else walked.struct()
    kernel = specialise(kernel_factory(plan, scene), config)
    if not scene.facts.points:
        expect([kernel, record_kernel(plan)], scene.device)
    return kernel, [tree, records_of(scene, plan, rays), rays, hits, counters, *given]


def divide(scene: SceneState, plan: Plan, config: TraversalConfig, count: int) -> tuple[int, int, Chunks]:
    """Rays of an item of a plan's kernel, the items of this many rays, and their chunks."""
    traversal = traversal_of(plan)
    if Capabilities.PERSISTENT in traversal.capabilities and scene.device.is_cuda:
        from wrt.kernels.traversal.persistent.persistent_bvh import launch_threads

        return 1, launch_threads(scene.device, count), Chunks()
    if scene.instances and traversal.walks_single_rays:
        return 1, count, Chunks(1024)
    grain = traversal.rays_per_item(config)
    if scene.instances:
        return grain, -(-count // grain), Chunks(max(1, 1024 // grain))
    longest = max(1, BRUTE_FORCE_TESTS // scene.triangle_count) if plan.accelerator == "none" else MAX_CHUNK
    if Capabilities.LONG_ITEMS in traversal.capabilities and scene.device.is_cpu:
        grain *= groups_per_item(count, grain)
    if Capabilities.SHORT_ITEMS in traversal.capabilities and scene.device.is_cpu:
        share = count // (MIN_ITEMS_PER_THREAD * get_num_threads()) // 64 * 64  # whole groups of slots
        grain = min(grain, max(share, MIN_RAYS_PER_ITEM))
    chunks_per_thread = ITEMS_PER_THREAD if Capabilities.STREAMS in traversal.capabilities else CHUNKS_PER_THREAD
    return grain, -(-count // grain), Chunks(max(1, MIN_CHUNK // grain), max(1, longest // grain), chunks_per_thread)


def groups_per_item(count: int, group: int) -> int:
    """Streams or runs of packets, of `group` rays each, that share the local memory of an item, as far as each thread still has
    `ITEMS_PER_THREAD` items."""
    return min(max(1, count // (group * ITEMS_PER_THREAD * get_num_threads())), LONGEST_ITEM)


@lru_cache
def no_work(kind: type, device: str) -> wp.array:
    """What kernels get that count nothing: made once, as small batches feel every allocation."""
    with kept(wp.get_device(device)):
        return wp.zeros(1, dtype=kind, device=device)


def counter_rows(work: wp.array) -> Any:
    """The struct by which kernels get where to write counters: an entry a ray, or any number if nothing is counted."""
    from wrt.kernels.traversal.leaf import CounterRows, Counters
    from wrt.kernels.traversal.stream.stream_kernel import StreamCounterRows

    struct = CounterRows() if work.dtype is Counters else StreamCounterRows()
    struct.rows = work
    return struct

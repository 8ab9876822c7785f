"""Queries by entry points (MLRTA, AEPSA) with chosen tiles: sizes and numbers of parts that a plan does not carry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace

from wrt.execution.traversal_launch import divide, kernel_and_inputs, no_work
from wrt.kernels.runtime.launch import launch, use_threads
from wrt.kernels.traversal.leaf import Counters
from wrt.kernels.traversal.traversal_config import TileConfig
from wrt.planning.plan import traversal_config
from wrt.planning.planner import make_plan
from wrt.rays.ray_buffers import to_device
from wrt.rays.rays import Rays
from wrt.scene.scene import Scene
from wrt.state.device_hits import DeviceHits
from wrt.state.query_kinds import CLOSEST


def tile_query(scene: Scene, rays: Rays, traversal: str, *, packets: int, split: int) -> Callable[[], DeviceHits]:
    """Prepares a query for closest hits by entry points.

    A large tile has `split` tiles of `packets` packets: Reshetov's initial tile size is split x packets x rays of a packet, his
    minimum tile size is packets x rays of a packet, and his split factor is `split`.

    Args:
        scene: with a complete kd-tree of one level.
        rays: in an order whose runs are compact tiles of the picture.
        traversal: "mlrta" or "aepsa".
        packets: packets in the smallest tile that searches for an entry point.
        split: number of parts of a large tile.

    Returns:
        A function that traces all rays. Each call writes its hits to the same arrays.

    Raises:
        ValueError: `packets` or `split` is less than 1.
    """
    if packets < 1 or split < 1:
        raise ValueError(f"packets is {packets} and split {split}; both must be at least 1")
    state, buffers = scene.state, to_device(rays, scene.device, scene.center)
    plan = make_plan(state, buffers, traversal, "woop", CLOSEST)
    config = replace(traversal_config(plan, state, CLOSEST, False), tiles=TileConfig(packets, split))
    batch, hits = buffers.batch, DeviceHits.new(CLOSEST, buffers.count, scene.device)
    kernel, inputs = kernel_and_inputs(state, plan, config, batch, hits.struct(), no_work(Counters, scene.device.alias))

    def trace() -> DeviceHits:
        with use_threads(scene.num_threads):
            batch.run, items, chunks = divide(state, plan, config, batch.count)
            launch(kernel, items, inputs, device=scene.device, **asdict(chunks))
        return hits

    return trace

"""Queries by entry points (MLRTA, AEPSA) with chosen tiles: sizes, numbers of parts and levels that a plan does not carry.

`compare_levels` times them beside packets, for a square view in Morton's order, so that tiles are squares.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from wrt.bench.core.single_thread_timing import ratios, timed
from wrt.engine.device_hits import DeviceHits
from wrt.engine.facts.query_kinds import CLOSEST
from wrt.engine.launch.traversal_launch import divide, kernel_and_inputs, no_work
from wrt.engine.plan.choices import make_plan
from wrt.engine.plan.plan import traversal_config
from wrt.engine.rays.device_rays import to_device
from wrt.engine.rays.rays import Rays
from wrt.kernels.runtime.launch import launch, use_threads
from wrt.kernels.traversal.leaf import Counters
from wrt.kernels.traversal.traversal_config import TileConfig
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene


def tile_query(
    scene: Scene, rays: Rays, traversal: str, *, packets: int, split: int, levels: int = 2
) -> Callable[[], DeviceHits]:
    """Prepares a query for closest hits by entry points.

    With two levels a large tile has `split` tiles of `packets` packets: Reshetov's initial tile size is split x packets x rays
    of a packet, his minimum tile size is packets x rays of a packet, and his split factor is `split`. Each level more makes the
    initial tile `split` times as large; with one level, it is the minimum.

    Args:
        scene: with a complete kd-tree of one level.
        rays: in an order whose runs are compact tiles of the picture.
        traversal: "mlrta" or "aepsa"; or "packet", which has no tiles and is prepared likewise, to compare.
        packets: packets in the smallest tile that searches for an entry point.
        split: number of parts of a larger tile.
        levels: number of sizes of tiles.

    Returns:
        A function that traces all rays. Each call writes its hits to the same arrays.

    Raises:
        ValueError: `packets`, `split` or `levels` is less than 1.
    """
    if min(packets, split, levels) < 1:
        raise ValueError(f"packets is {packets}, split {split} and levels {levels}; all must be at least 1")
    state, buffers = scene.state, to_device(rays, scene.device, scene.center)
    plan = make_plan(state, buffers, traversal, "woop", CLOSEST)
    config = replace(traversal_config(plan, state, CLOSEST, False), tiles=TileConfig(packets, split, levels))
    batch, hits = buffers.batch, DeviceHits.new(CLOSEST, buffers.count, scene.device)
    kernel, inputs = kernel_and_inputs(state, plan, config, batch, hits.struct(), no_work(Counters, scene.device.alias))

    def trace() -> DeviceHits:
        with use_threads(scene.num_threads):
            batch.run, items, chunks = divide(state, plan, config, batch.count)
            launch(kernel, items, inputs, device=scene.device, **asdict(chunks))
        return hits

    return trace


TILINGS = (TileConfig(512, 1, 1), TileConfig(32, 16, 2), TileConfig(2, 16, 3), TileConfig(32, 4, 3), TileConfig(8, 16, 3))
"""Tiles to compare: with packets of 32 rays, 128 x 128 pixels; in 16 parts; in 16 x 16 parts; in 4 x 4 parts; 256 x 256 pixels
in 16 x 16 parts.
"""


def compare_levels(
    mesh: TriangleMesh, *, size: int = 512, tilings: tuple[TileConfig, ...] = TILINGS, rounds: int = 7
) -> list[dict[str, Any]]:
    """Time of a view by packets, and by AEPSA with tiles of several levels.

    Args:
        mesh: what is seen.
        size: the view has size x size pixels, a power of 2.
        tilings: the tiles.
        rounds: how often each has its turn.

    Returns:
        A row for packets and one for each tiling: packets, split, levels, rays (of the largest tile; 0 for packets), seconds,
        ratio to packets, least, greatest.
    """
    scene, rays = Scene(mesh, "kdtree", num_threads=1, device="cpu"), morton_view(mesh, size)
    runs: dict[Any, Callable[[], Any]] = {None: tile_query(scene, rays, "packet", packets=4, split=16)}
    for tiles in tilings:
        runs[tiles] = tile_query(scene, rays, "aepsa", packets=tiles.packets, split=tiles.split, levels=tiles.levels)
    timings, rows = timed(runs, rounds), []
    packet = scene.explain(rays, traversal="packet").packet
    for tiles, timing in timings.items():
        row: dict[str, Any] = {"packets": 0, "split": 0, "levels": 0, "rays": 0} if tiles is None else asdict(tiles)
        if tiles is not None:
            row["rays"] = tiles.packets * tiles.split ** (tiles.levels - 1) * packet
        rows.append({**row, **ratios(timing, timings[None])})
    return rows


def morton_view(mesh: TriangleMesh, size: int) -> Rays:
    """A view along the y axis from outside the mesh's box, pixels in Morton's order; size: a power of 2."""
    rank = np.arange(size * size)
    bits = [(rank >> bit & 1) << bit // 2 for bit in range(2 * int(size).bit_length())]
    across, up = ((sum(own) + 0.5) / size - 0.5 for own in (bits[0::2], bits[1::2]))
    low, high = mesh.bounds
    eye = 0.5 * (low + high) - [0.0, 1.5 * float((high - low).max()), 0.0]
    way = np.stack([across, np.ones(len(rank)), up], axis=1)
    return Rays(eye.astype(np.float32), way.astype(np.float32))

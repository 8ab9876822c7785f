"""A kd-tree for small packets and a BVH for wide ones, combined after Cadet and Lecussan (2007), against either tree alone.

`coupled_query` prepares a query that walks both trees (`wrt.kernels.classics.studies.variants.coupled_trees`);
`compare_coupling` times it for coherent and for scattered rays.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from studies.kdtrees.entry_point_tiles import morton_view, tile_query
from wrt.bench.core.single_thread_timing import ratios, timed
from wrt.engine.device_hits import DeviceHits
from wrt.engine.facts.query_kinds import CLOSEST
from wrt.engine.launch.traversal_launch import counter_rows, divide, no_work
from wrt.engine.launch.triangle_records import records_of
from wrt.engine.plan.choices import make_plan
from wrt.engine.plan.plan import Plan, traversal_config, walked_tree
from wrt.engine.rays.device_rays import to_device
from wrt.engine.rays.rays import Rays
from wrt.kernels.classics.studies.variants.coupled_trees import CoupledTrees, make_kernel
from wrt.kernels.runtime.launch import launch, use_threads
from wrt.kernels.traversal.leaf import Counters
from wrt.kernels.traversal.packet import CULLINGS, CullingTraits
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene


def coupled_query(
    bvh: Scene, kdtree: Scene, rays: Rays, *, small: int, kdtree_singles: bool, query: str = CLOSEST
) -> Callable[[], DeviceHits]:
    """Prepares a query through both trees.

    Args:
        bvh: a scene of one level with a BVH.
        kdtree: a scene of the same mesh with a complete kd-tree.
        rays: their neighbours share packets.
        small: greatest number of active rays of a packet, or of a part of one, that walks the kd-tree; 0 for none.
        kdtree_singles: whether rays that must go one by one walk the kd-tree; otherwise, the BVH.
        query: "closest" or "any".

    Returns:
        A function that traces all rays. Each call writes its hits to the same arrays.

    Raises:
        ValueError: `small` is negative, or the scenes are not of one mesh.
    """
    if small < 0:
        raise ValueError(f"small is {small}; it must be at least 0")
    same = np.array_equal(bvh.center, kdtree.center) and bvh.state.triangle_count == kdtree.state.triangle_count
    if not same:
        raise ValueError("bvh and kdtree must be scenes of the same mesh")
    buffers = to_device(rays, bvh.device, bvh.center)
    plans: list[Plan] = [make_plan(scene.state, buffers, "packet", "woop", query) for scene in (bvh, kdtree)]
    config = traversal_config(plans[0], bvh.state, query, False)
    within = replace(config, mailbox=plans[1].mailbox, packet=replace(config.packet, culling=plans[1].culling))
    outer, inner = (CULLINGS[plan.culling].traits for plan in plans)
    if CullingTraits.SLOPES in outer & ~inner:
        config = replace(config, packet=within.packet)
    batch, hits = buffers.batch, DeviceHits.new(query, buffers.count, bvh.device)
    trees = CoupledTrees()
    trees.bvh = walked_tree(plans[0], bvh.state).struct()
    trees.kdtree = walked_tree(plans[1], kdtree.state).struct()
    trees.triangles = records_of(kdtree.state, plans[1], batch)
    trees.low, trees.high = trees.bvh.low, trees.bvh.high
    kernel = make_kernel(config, within, min(small, config.packet.rays), kdtree_singles)
    work = counter_rows(no_work(Counters, bvh.device.alias))
    inputs = [trees, records_of(bvh.state, plans[0], batch), batch, hits.struct(), work]

    def trace() -> DeviceHits:
        with use_threads(bvh.num_threads):
            batch.run, items, chunks = divide(bvh.state, plans[0], config, batch.count)
            launch(kernel, items, inputs, device=bvh.device, **asdict(chunks))
        return hits

    return trace


def bounced(scene: Scene, view: Rays, seed: int = 3) -> Rays:
    """A diffuse ray from each point that a view sees, in the order of the view: neighbours begin close together and go all
    ways."""
    hits = scene.intersect(view)
    seen = hits.is_hit
    normal = hits.normal[seen]
    facing = (normal * view.directions[seen]).sum(axis=1, keepdims=True) < 0.0
    away = np.random.default_rng(seed).normal(size=normal.shape)
    way = np.where(facing, normal, -normal) + away / np.linalg.norm(away, axis=1, keepdims=True)
    start = hits.position[seen] + 1e-4 * np.where(facing, normal, -normal) * float(np.ptp(scene.bounds, axis=0).max())
    return Rays(start.astype(np.float32), way.astype(np.float32))


def compare_coupling(
    mesh: TriangleMesh, view: Rays | None = None, *, size: int = 256, smalls: Sequence[int] = (0, 8, 16), rounds: int = 7
) -> list[dict[str, Any]]:
    """Time of packets through a BVH, through a kd-tree, and through both.

    Args:
        mesh: what is seen.
        view: rays that bounce once, neighbours in an order for packets; by default a view of size x size pixels.
        size: a power of 2.
        smalls: greatest numbers of active rays of a packet that walks the kd-tree; rays one by one walk it in any case.
        rounds: how often each has its turn.

    Returns:
        A row for each kind of rays (view, bounce) and each way: rays, way ("bvh packet", "bvh single", likewise for the
        kd-tree, or the number of rays), seconds, ratio to packets through the BVH, least, greatest.

    Raises:
        RuntimeError: the hits of two ways differ.
    """
    bvh, kdtree = (Scene(mesh, tree, num_threads=1, device="cpu") for tree in ("bvh", "kdtree"))
    view = morton_view(mesh, size) if view is None else view
    rows = []
    for kind, rays in (("view", view), ("bounce", bounced(bvh, view))):
        runs: dict[Any, Callable[[], DeviceHits]] = {
            f"{name} {traversal}": tile_query(scene, rays, traversal, packets=1, split=1)
            for name, scene in (("bvh", bvh), ("kdtree", kdtree))
            for traversal in ("packet", "single")
        }
        for small in smalls:
            runs[small] = coupled_query(bvh, kdtree, rays, small=small, kdtree_singles=True)
        expected = runs["bvh packet"]()
        for way, run in runs.items():
            hits = run()
            for one, two in ((hits.t, expected.t), (hits.primitive, expected.primitive)):
                if not np.array_equal(one.numpy(), two.numpy()):
                    raise RuntimeError(f"hits of {kind} rays by {way} differ from those by packets through the BVH")
        timings = timed(runs, rounds)
        rows += [{"rays": kind, "way": str(way), **ratios(timing, timings["bvh packet"])} for way, timing in timings.items()]
    return rows

"""A sample of packets: how much of the tree their rays share, for the choice between packets and other traversals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from wrt.engine.facts.wide_trees import wide_tree, wide_width
from wrt.engine.memory import keep_alive
from wrt.kernels.answers import ANSWERS
from wrt.kernels.layout.instance_maps import Placement
from wrt.kernels.query.ordering.packet_overlap import (
    SAMPLED_PACKETS,
    SAMPLED_RAYS,
    SampleConfig,
    SampledScene,
    SampledTree,
    make_overlap_kernel,
)
from wrt.kernels.runtime.launch import Chunks, PreparedLaunch, specialise
from wrt.kernels.traversal.traversal_scores import Overlap

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState
    from wrt.kernels.layout.ray_batch import RayBatch

TABLE = "sample", ""
"""Key of the table of trees in `QueryCache.tables`."""


def measure_overlap(scene: SceneState, rays: RayBatch, packet: int, query: str) -> Overlap:
    """Traces a sample of packets.

    Args:
        scene: on the CPU, with complete BVHs, or a kd-tree that has a wide form or is to get it.
        rays: the rays, at least as many as a packet has; for pictures with `columns`.
        packet: rays of a packet.
        query: the rays end at any hit if it is "any", else at the closest hit.
    """
    found = np.zeros(3, dtype=np.int32)
    result = wp.array(found, dtype=int, device=scene.device, copy=False)
    any_hit = int(ANSWERS[query].rules.ends_at_first)
    inputs = [sampled_scene(scene), rays, packet, SAMPLED_PACKETS, SAMPLED_RAYS, any_hit, result]
    PreparedLaunch(sample_kernel(scene), inputs, scene.device).run(1, Chunks())
    steps, different, count = found.tolist()
    return Overlap(different / steps, steps / count) if count else Overlap(1.0, 0.0)


def sample_kernel(scene: SceneState) -> wp.Kernel:
    """The kernel for a scene's trees."""
    width = scene.tree.width if scene.facts.tree == "bvh" else wide_width(scene.width)
    return specialise(make_overlap_kernel, SampleConfig(width, bool(scene.instances)))


def sampled_scene(scene: SceneState) -> SampledScene:
    """The scene as the kernel reads it; cached."""
    tables = scene.cache.tables
    if TABLE not in tables:
        sampled = SampledScene()
        sampled.part = sampled_tree(scene)
        table = [sampled_tree(part) for part in scene.parts] if scene.instances else []
        sampled.parts = keep_alive(wp.array(table, dtype=SampledTree, device=scene.device), table)
        if scene.instances:
            sampled.placements, sampled.top = scene.device_mesh.placements, scene.upper()
        else:
            sampled.placements = wp.empty(0, dtype=Placement, device=scene.device)
        tables[TABLE] = sampled
    return tables[TABLE]


def sampled_tree(scene: SceneState) -> SampledTree:
    """The boxes of one state's tree, and its triangles if it has any itself."""
    sampled, mesh = SampledTree(), scene.device_mesh
    tree = scene.tree if scene.facts.tree == "bvh" else wide_tree(scene)
    sampled.tree, sampled.primitive = tree.struct(), tree.primitive
    if not scene.instances:
        sampled.vertices, sampled.faces = mesh.vertices, mesh.faces
    return sampled

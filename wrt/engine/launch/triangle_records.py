"""The triangle records of a scene: made by the first query that needs them, and cached."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from wrt.engine.memory import empty
from wrt.engine.plan.plan import walked_tree
from wrt.engine.rays.device_rays import shared_origin
from wrt.kernels.runtime.launch import specialise
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.block_packing import make_packing_kernel, pack_blocks
from wrt.kernels.triangle.support.record_blocks import VERTICES, TriangleBlocks

if TYPE_CHECKING:
    from wrt.builders.tree import Bvh, KdTree
    from wrt.engine.facts.query_cache import KnownRecords, Origin
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.plan.plan import Plan
    from wrt.kernels.layout.ray_batch import RayBatch
    from wrt.kernels.triangle.support.record_blocks import Record


def records_of(scene: SceneState, plan: Plan, rays: RayBatch | None) -> TriangleBlocks:
    """The triangles in the order of the tree's leaves ("none": of their ids), as the plan's triangle test stores them.

    Made once; records that depend on the rays' shared origin are made again when it has changed. Others need no rays. Those of
    a lazily built tree are extended by what is new.
    """
    walked = walked_tree(plan, scene)
    if scene.facts.points:
        return walked.blocks
    known = scene.cache.wide.records if plan.is_wide else scene.cache.records
    record = TRIANGLE_TESTS[plan.triangle_test].record
    origin = shared_origin(rays) if record.per_origin else None
    return known_blocks(scene, walked, plan.accelerator, record, origin, known)


def vertex_blocks(scene: SceneState) -> TriangleBlocks:
    """The vertices of the triangles in the order of the leaves of the scene's tree, as tests store them that need no more.

    Raises:
        ValueError: alpha masks count in the scene.
    """
    scene.require_opaque("a query of points")
    return known_blocks(scene, scene.tree, scene.accelerator.kind, VERTICES, None, scene.cache.records)


def known_blocks(
    scene: SceneState, walked: KdTree | Bvh, tree: str, record: Record, origin: Origin | None, known: KnownRecords
) -> TriangleBlocks:
    """Records of a kind in the order of a tree's leaves, made if they are not known; `tree`, `origin`: as in `KnownRecords`."""
    made_for, blocks = known.get((tree, record), (None, None))
    primitive, width = walked.primitive, walked.width
    if made_for != origin:
        blocks = None
    if blocks is None or (tree != "none" and len(blocks.primitive) < len(primitive)):
        if tree == "none":
            primitive = in_order(scene.triangle_count, width, scene.device)
        vertices, faces = scene.shown
        point = origin or (0.0, 0.0, 0.0)
        blocks = pack_blocks(record, vertices, faces, primitive, width, point, blocks, empty)
        known[tree, record] = origin, blocks
    return blocks


def record_kernel(plan: Plan) -> wp.Kernel:
    """The kernel that makes the records of a plan's triangle test."""
    return specialise(make_packing_kernel, TRIANGLE_TESTS[plan.triangle_test].record)


def in_order(count: int, width: int, device: wp.Device) -> wp.array:
    """Ids 0 .. count - 1 in blocks of `width`, with -1 in the unused lanes."""
    ids = np.full(-(-count // width) * width, -1, dtype=np.int32)
    ids[:count] = np.arange(count)
    return wp.array(ids, dtype=int, device=device)

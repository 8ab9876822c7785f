"""What traversals by persistent threads read: the nodes and triangles of scenes in their layout, and the counter of rays."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import warp as wp

from wrt.engine.memory import keep_alive
from wrt.engine.plan.plan import stack_levels
from wrt.kernels.layout.binary_nodes import BinaryNodes, BinaryPart, PackedTriangles, pack_tree, pack_triangles
from wrt.kernels.runtime.launch import kept, specialise
from wrt.kernels.traversal.persistent.next_ray import NextRay, counter_of
from wrt.kernels.traversal.persistent.persistent_bvh import (
    BLOCKS,
    launch_threads,
    make_persistent_instance_kernel,
    make_persistent_kernel,
)

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState
    from wrt.kernels.traversal.traversal_config import TraversalConfig


def binary_tree(scene: SceneState) -> tuple[BinaryNodes, PackedTriangles]:
    """The tree of a scene, of width 2, and its triangles; made by the first query that needs them, on the scene's device."""
    cache = scene.cache
    if cache.binary is None:
        nodes = pack_tree(scene.tree.struct())
        cache.binary = nodes, pack_triangles(*scene.shown, scene.tree.primitive)
    return cache.binary


def binary_parts(scene: SceneState) -> wp.array:
    """(meshes,) `BinaryPart`: the trees and triangles of the meshes that instances place; cached."""
    key, tables = ("bvh", "binary"), scene.cache.tables
    if key not in tables:
        table, used = [], []
        for mesh in scene.parts:
            part = BinaryPart()
            part.tree, part.triangles = binary_tree(mesh)
            table.append(part)
            used.append(mesh)
        with kept(scene.device):
            tables[key] = keep_alive(wp.array(table, dtype=BinaryPart, device=scene.device), used)
    return tables[key]


def kernel_and_trees(scene: SceneState, config: TraversalConfig) -> tuple[wp.Kernel, list[Any]]:
    """The kernel of a specialisation, and the first two of its arguments after the number of the first item."""
    if scene.instances:
        factory = partial(make_persistent_instance_kernel, levels=stack_levels(scene.tree.depth))
        return specialise(factory, config), [scene.upper(), binary_parts(scene)]
    return specialise(make_persistent_kernel, config), [*binary_tree(scene)]


def next_ray(device: wp.Device, count: int, skipped: wp.array | None = None, blocks: int = BLOCKS) -> NextRay:
    """The counter for the next launch on the device's current stream, for this many rays or points.

    Args:
        device: of the launch.
        count: of rays or points.
        skipped: triangles that rays ignore, as in `NextRay`.
        blocks: as in `launch_threads`.
    """
    counter = NextRay()
    counter.number = counter_of(device)
    counter.threads = launch_threads(device, count, blocks) if device.is_cuda else 0
    if skipped is not None:
        counter.skipped = skipped
    return counter

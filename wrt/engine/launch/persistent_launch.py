"""What traversals by persistent threads read: the nodes and triangles of a scene in their layout, and the counter of rays."""

from __future__ import annotations

from typing import TYPE_CHECKING

from wrt.kernels.layout.binary_nodes import BinaryNodes, PackedTriangles, pack_tree, pack_triangles
from wrt.kernels.traversal.persistent.next_ray import NextRay, counter_of
from wrt.kernels.traversal.persistent.persistent_bvh import launch_threads

if TYPE_CHECKING:
    import warp as wp

    from wrt.engine.facts.scene_state import SceneState


def binary_tree(scene: SceneState) -> tuple[BinaryNodes, PackedTriangles]:
    """The tree of a scene, of width 2, and its triangles; made by the first query that needs them, on the scene's device."""
    cache = scene.cache
    if cache.binary is None:
        nodes = pack_tree(scene.tree.struct())
        cache.binary = nodes, pack_triangles(*scene.shown, scene.tree.primitive)
    return cache.binary


def next_ray(device: wp.Device, rays: int) -> NextRay:
    """The counter for the next launch on the device's current stream, for this many rays."""
    counter = NextRay()
    counter.number = counter_of(device)
    counter.threads = launch_threads(device, rays) if device.is_cuda else 0
    return counter

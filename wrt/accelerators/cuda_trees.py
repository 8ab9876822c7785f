"""What descriptions of trees leave open, for trees that CUDA threads walk."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

from wrt.accelerators.ray_aware_bvh import RayAwareBvh
from wrt.accelerators.tree_descriptions import Bvh, KdTree

if TYPE_CHECKING:
    import warp as wp

    from wrt.accelerators.accelerator import Accelerator

LEAF_TRIANGLES = 2
"""Largest number of triangles in a leaf on CUDA, where threads of a warp wait for the one with the most triangles to test
(notebooks/records/2026-11-27-gpu-traversal.md)."""

WIDTH = 2
"""Children of a node on CUDA, unless the description says otherwise (`wrt.kernels.simd.lanes.native_width`)."""


ROUNDS = 8
"""Rounds of reinsertion with which "hploc" builds on CUDA, unless the description says otherwise: trees then cost no more than
those of the CPU's default builder, and more rounds gain little (notebooks/records/2026-11-28-gpu-graphs.md)."""


def for_device(accelerator: Accelerator, device: wp.Device, moves: bool = False) -> Accelerator:
    """The description by which a tree for a device is built: on CUDA, smaller leaves, and reinsertion, where the description
    leaves them open. moves: whether the tree is built for geometry that moves, which is not worth reinsertion."""
    if device.is_cuda and type(accelerator) is Bvh:
        return _for_cuda(accelerator, moves)
    if device.is_cuda and isinstance(accelerator, RayAwareBvh):
        return replace(accelerator, whole=_for_cuda(accelerator.whole, moves))
    return accelerator


@cache
def _for_cuda(accelerator: Bvh, moves: bool) -> Bvh:
    if accelerator.builder == "hploc" and accelerator.reinsertion is None and not moves:
        accelerator = replace(accelerator, reinsertion=ROUNDS)
    if accelerator.max_leaf_triangles is not None or accelerator.width not in (None, WIDTH):
        return accelerator
    return replace(accelerator, max_leaf_triangles=LEAF_TRIANGLES)


def is_built_on(accelerator: Accelerator, device: wp.Device, width: int) -> bool:
    """Whether the tree of a scene on a device is built there, not on the CPU and copied; width: of nodes and leaf blocks."""
    from wrt.builders.bvh import BVH_BUILDERS
    from wrt.builders.kdtree import KDTREE_BUILDERS, NATIVE

    if type(accelerator) is Bvh:
        return device.is_cpu or BVH_BUILDERS[accelerator.builder].on_cuda(accelerator.config(width))
    if type(accelerator) is KdTree:
        config = accelerator.config(width)
        is_finished = accelerator.layout == NATIVE and not (config.cuts_late or config.cell_tests == "leaves")
        return device.is_cpu or (is_finished and KDTREE_BUILDERS[accelerator.builder].on_cuda(config))
    return False

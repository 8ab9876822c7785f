"""A step of trees of rays for W simple rays at once, on the CPU.

A ray is simple if it hits a mirror or smooth glass, or if it ends: in the last generation on such a surface, and where nothing
is hit under a sky of one colour. Further, its surface has no image, no colours of corners and emits nothing, nothing is
absorbed on its way, it enters glass from air, and the scene has no lights with an area. Each simple ray gets the bits that
`wrt.kernels.shading.wavefront.tree_step` gives it. The others are left to it.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.compilation.target import lane_width
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime import native
from wrt.kernels.shading.sampling import MIX_1
from wrt.kernels.shading.wavefront.lane_code import in_lanes, same
from wrt.kernels.shading.wavefront.path_step_simd import ARRAYS, SURFACES
from wrt.kernels.shading.wavefront.pixel_samples import PixelSamples
from wrt.kernels.shading.wavefront.ray_queue import Gathered, RayQueue, Wave
from wrt.kernels.shading.wavefront.scene_light import LitScene
from wrt.kernels.shading.wavefront.tree_step import TreeStep


@cache
def make_tree_step_simd(width: int) -> Any:
    """`tree_step_simd` for the given number of lanes."""
    call = f"wrt::shade_trees<{width}>({ARRAYS}, step, first, begin, child, scratch, is_alive)"

    @native.func_native("tree_step.h", in_lanes(call, SURFACES, same(MIX_1=int(MIX_1))))
    def tree_step_simd(
        first: int,
        begin: int,
        child: int,
        step: TreeStep,
        scene: LitScene,
        source: PixelSamples,
        wave: Wave,
        queue: RayQueue,
        hits: HitBatch,
        rays: Gathered,
        scratch: RayQueue,
        is_alive: wp.array(dtype=int),
    ) -> wp.uint32:
        """Does the step of the simple ones among the rays first .. first + width - 1 of a queue that begins at `begin`, and
        returns one bit for each. The rays that follow go to the places from 2 `child` on. What it writes for the others is to
        be overwritten.
        """
        ...

    return tree_step_simd


WIDTH = wp.constant(lane_width())
tree_step_simd = make_tree_step_simd(lane_width())

"""The step of `wrt.kernels.shading.wavefront.path_step_simd` for W simple rays at once, which appends what it sends out.

The lanes of paths that go on, or of shadow rays that may bring light, are moved together by one permutation for each number of
a ray, and stored W at a time. The next rays overwrite what was stored beyond the last of them.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.compilation.target import lane_width
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime import native
from wrt.kernels.shading.wavefront.lane_code import in_lanes
from wrt.kernels.shading.wavefront.path_step_simd import ARRAYS, LIGHTS, SAMPLES, SURFACES, PathStep
from wrt.kernels.shading.wavefront.pixel_samples import PixelSamples
from wrt.kernels.shading.wavefront.ray_queue import Gathered, RayQueue, Wave
from wrt.kernels.shading.wavefront.scene_light import LitScene


@cache
def make_path_tile_step_simd(width: int) -> Any:
    """`path_tile_step_simd` for the given number of lanes."""
    writer = "wrt::Appended{following, lit_slot, rays, to, entry}"

    @native.func_native(
        "path_step.h", in_lanes(f"wrt::shade_paths<{width}>({ARRAYS}, step, first, {writer})", SURFACES, LIGHTS, SAMPLES)
    )
    def path_tile_step_simd(
        first: int,
        step: PathStep,
        scene: LitScene,
        source: PixelSamples,
        wave: Wave,
        queue: RayQueue,
        hits: HitBatch,
        rays: Gathered,
        lit_slot: wp.array(dtype=int),
        following: RayQueue,
        to: wp.ref[int],
        entry: wp.ref[int],
    ) -> wp.uint32:
        """Does the step of the simple ones among the rays first .. first + width - 1, which all exist, and returns one bit for
        each. Appends paths that go on to `following` at place `to`, and shadow rays to `rays` at place `entry`; both places are
        moved on, and up to width places from there on are written.
        """
        ...

    return path_tile_step_simd


WIDTH = wp.constant(lane_width())
path_tile_step_simd = make_path_tile_step_simd(lane_width())

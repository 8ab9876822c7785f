"""The kernels of a tile of paths, which one thread carries out one after the other.

A tile has `size` places in each of two queues, and in a list of shadow rays. The step appends the paths that go on to the
second queue. From there they are moved to the first one, in the order of the octants of their directions, so that the rays of a
stream take similar ways; in scenes of few triangles the queues take turns instead.

**W simple rays at once** (`path_tile_step_simd`): the step of `wrt.kernels.shading.wavefront.path_step_simd`, which appends
what it sends out. The lanes of paths that go on, or of shadow rays that may bring light, are moved together by one permutation
for each number of a ray, and stored W at a time. The next rays overwrite what was stored beyond the last of them.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.compilation.target import lane_width
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel, specialised_kernel
from wrt.kernels.shading.ray_trees.tile_memories import TileMemories
from wrt.kernels.shading.wavefront.lane_code import in_lanes
from wrt.kernels.shading.wavefront.path_step import UNKNOWN, follow_path
from wrt.kernels.shading.wavefront.path_step_simd import ARRAYS, LIGHTS, SAMPLES, SURFACES, PathStep
from wrt.kernels.shading.wavefront.picture import Film, develop_pixel
from wrt.kernels.shading.wavefront.pixel_samples import PixelSamples
from wrt.kernels.shading.wavefront.ray_at_hit import AHEAD, StepArrays, fetch_hits, step_arrays
from wrt.kernels.shading.wavefront.ray_queue import Gathered, RayQueue, Wave
from wrt.kernels.shading.wavefront.scene_light import LitScene


@cache
def make_path_tile_step_simd(width: int) -> Any:
    """`path_tile_step_simd` for the given number of lanes."""
    writer = "wrt::Appended{following, lit_slot, arrays.rays, to, entry}"

    @native.func_native(
        "path_step.h", in_lanes(f"wrt::shade_paths<{width}>({ARRAYS}, step, first, {writer})", SURFACES, LIGHTS, SAMPLES)
    )
    def path_tile_step_simd(
        first: int,
        step: PathStep,
        scene: LitScene,
        arrays: StepArrays,
        lit_slot: wp.array(dtype=int),
        following: RayQueue,
        to: wp.ref[int],
        entry: wp.ref[int],
    ) -> wp.uint32:
        """Does the step of the simple ones among the rays first .. first + width - 1, which all exist, and returns one bit for
        each. Appends paths that go on to `following` at place `to`, and shadow rays at place `entry`; both places are
        moved on, and up to width places from there on are written.
        """

    return path_tile_step_simd


WIDTH = wp.constant(lane_width())
path_tile_step_simd = make_path_tile_step_simd(lane_width())


@cache
def make_step_tile() -> wp.Kernel:
    """The step of a tile. It has a module of its own, because it runs on the CPU only and takes long to compile."""

    @specialised_kernel
    def step_tile(
        first: int,
        size: int,
        stop: int,
        lanes: int,
        has_shadows: bool,
        step: PathStep,
        scene: LitScene,
        source: PixelSamples,
        wave: Wave,
        queue: RayQueue,
        hits: HitBatch,
        rays: Gathered,
        lit_slot: wp.array(dtype=int),
        following: RayQueue,
        memories: TileMemories,
    ):
        """Adds the light of the rays of a tile to their samples, and appends shadow rays and the paths that go on.

        Item: a tile memory of `size` places, whose rays end before `stop`. A sample has one ray in a generation. lanes: rays
        that are done together, WIDTH or 1. lit_slot: (N,) the samples of the shadow rays.
        """
        memory = first + wp.tid()
        begin = memory * size
        to = int(begin)
        entry = int(begin)
        here = int(begin)
        arrays = step_arrays(begin, source, wave, queue, hits, rays)
        fetch_hits(scene, hits, begin, wp.min(begin + AHEAD, stop))
        while here < stop:
            last = wp.min(here + lanes, stop)
            fetch_hits(scene, hits, here + AHEAD, wp.min(last + AHEAD, stop))
            done = wp.uint32(0)
            if lanes > 1 and here + WIDTH <= stop:
                done = path_tile_step_simd(here, step, scene, arrays, lit_slot, following, to, entry)
            for i in range(here, last):
                if (done >> wp.uint32(i - here)) & wp.uint32(1) == wp.uint32(0):
                    found = follow_path(i, UNKNOWN, to, entry, step, scene, arrays, following)
                    if found >= 2:
                        lit_slot[entry] = queue.slot[i]
                        entry += 1
                    to += found & 1
            here = last
        memories.left[memory] = to - begin
        memories.shadows[memory] = entry - begin
        memories.traced[memory] += stop - begin
        if has_shadows:  # a hit that lights may light counts, whether its shadow ray is listed or not
            memories.traced[memory] += stop - begin

    return step_tile


@native.func_native("ray_queues.h", "wrt::gather_paths(begin, stop, blocked, rays, lit_slot);")
def gather_range(begin: int, stop: int, blocked: wp.array(dtype=wp.bool), rays: Gathered, lit_slot: wp.array(dtype=int)):
    """Adds the light of the shadow rays begin .. stop - 1 that nothing blocks to their samples."""


@exact_kernel
def gather_lit(
    first: int, size: int, stop: int, blocked: wp.array(dtype=wp.bool), rays: Gathered, lit_slot: wp.array(dtype=int)
):
    """Adds the light of the shadow rays of a tile that nothing blocks to their samples. Item: a tile memory, whose list ends
    before `stop`."""
    gather_range((first + wp.tid()) * size, stop, blocked, rays, lit_slot)


@native.func_native("ray_queues.h", "wrt::order_rays(begin, stop, source, target);")
def order_range(begin: int, stop: int, source: RayQueue, target: RayQueue):
    """Copies the rays begin .. stop - 1 to another queue, in the order of the octants of their directions."""


@exact_kernel
def order_tile(first: int, size: int, stop: int, source: RayQueue, target: RayQueue):
    """Copies the rays of a tile to another queue, in the order of the octants of their directions. Item: a tile memory, whose
    rays end before `stop`."""
    order_range((first + wp.tid()) * size, stop, source, target)


@exact_kernel
def develop_tile(
    first: int, size: int, stop: int, wave: Wave, radiance: wp.array(dtype=wp.vec3), film: Film, memories: TileMemories
):
    """Adds the samples of a tile to their pixels, if tiles hold all samples of their pixels. Item: a tile memory, whose samples
    end before `stop`."""
    memory = first + wp.tid()
    if size % wave.samples == 0:
        begin = memories.first_sample[memory]
        for i in range(begin / wave.samples, (begin + stop - memory * size) / wave.samples):
            develop_pixel(wave, i, radiance, film)

"""The kernels of a tile of trees, which one thread carries out one after the other.

A tile has `room` places for the rays of a generation, in each of two queues that take turns, and `room` places for shadow rays.
The step appends the rays that follow to the other queue, so none are moved afterwards, and writes only those shadow rays that
may bring light. Mirrors and smooth glass have none. The memory of a tile belongs to a thread
(`wrt.kernels.shading.ray_trees.tile_memories`).

**W simple rays at once** (`tree_step_simd`), on the CPU. A ray is simple if it hits a mirror or smooth glass, or if it ends: in
the last generation on such a surface, and where nothing is hit under a sky of one colour. Further, its surface has no image, no
colours of corners and emits nothing, nothing is absorbed on its way, it enters glass from air, and the scene has no lights with
an area. Each simple ray gets the bits that `wrt.kernels.shading.wavefront.tree_step` gives it. The others are left to it.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.compilation.target import lane_width
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.shading.ray_trees.tile_memories import TileMemories
from wrt.kernels.shading.sampling import MIX_1
from wrt.kernels.shading.wavefront.lane_code import in_lanes, same
from wrt.kernels.shading.wavefront.path_step_simd import ARRAYS, SURFACES
from wrt.kernels.shading.wavefront.pixel_samples import PixelSamples
from wrt.kernels.shading.wavefront.ray_at_hit import AHEAD, StepArrays, fetch_hits, step_arrays
from wrt.kernels.shading.wavefront.ray_queue import Gathered, RayQueue, Wave
from wrt.kernels.shading.wavefront.scene_light import LitScene, sky_light
from wrt.kernels.shading.wavefront.tree_step import SentRays, ShadowList, TreeStep, sent_rays, shade_ray


@cache
def make_tree_step_simd(width: int) -> Any:
    """`tree_step_simd` for the given number of lanes."""
    call = f"wrt::shade_trees<{width}>({ARRAYS}, step, first, arrays.begin, child, sent.queue, sent.is_alive)"

    @native.func_native("tree_step.h", in_lanes(call, SURFACES, same(MIX_1=int(MIX_1))))
    def tree_step_simd(
        first: int,
        child: int,
        step: TreeStep,
        scene: LitScene,
        arrays: StepArrays,
        sent: SentRays,
    ) -> wp.uint32:
        """Does the step of the simple ones among the rays first .. first + width - 1 of the queue, and returns one bit for
        each. The rays that follow go to the places from 2 `child` on. What it writes for the others is to be overwritten.
        """

    return tree_step_simd


WIDTH = wp.constant(lane_width())
tree_step_simd = make_tree_step_simd(lane_width())


@native.func_native("ray_queues.h", "return wrt::append_rays(begin, end, scratch, is_alive, queue, place);")
def append_rays(begin: int, end: int, scratch: RayQueue, is_alive: wp.array(dtype=int), queue: RayQueue, place: int) -> int:
    """Copies those of the rays 2 begin .. 2 end - 1 that go on to the places from `place` on; returns the first one after them.
    It may write to the place after those of the rays."""


@exact_kernel
def shade_tile(
    first: int,
    room: int,
    stop: int,
    step: TreeStep,
    light_count: int,
    scene: LitScene,
    source: PixelSamples,
    wave: Wave,
    queue: RayQueue,
    hits: HitBatch,
    rays: Gathered,
    scratch: RayQueue,
    is_alive: wp.array(dtype=int),
    following: RayQueue,
    listed: ShadowList,
    memories: TileMemories,
):
    """Writes light, shadow rays and the next generation of a tile, whose rays end at the place `stop`. Item: a tile
    memory. `light_count` is the number of lights that are sampled at a hit."""
    memory = first + wp.tid()
    begin = memory * room
    end = begin + room
    child = memory * WIDTH
    to = int(begin)
    entry = int(begin)
    here = int(begin)
    arrays = step_arrays(begin, source, wave, queue, hits, rays)
    sent = sent_rays(scratch, is_alive)
    fetch_hits(scene, hits, begin, wp.min(begin + AHEAD, stop))
    while here < stop and to + 2 * WIDTH <= end and entry + light_count * WIDTH <= end:
        fetch_hits(scene, hits, here + AHEAD, wp.min(here + AHEAD + WIDTH, stop))
        last = wp.min(here + WIDTH, stop)
        done = wp.uint32(0)
        if here + WIDTH <= stop:
            done = tree_step_simd(here, child, step, scene, arrays, sent)
        for i in range(here, last):
            if (done >> wp.uint32(i - here)) & wp.uint32(1) == wp.uint32(0):
                entry = shade_ray(i, child + i - here, entry, step, scene, arrays, sent, listed)
        if not step.is_last:
            to = append_rays(child, child + last - here, scratch, is_alive, following, to)
        here = last
    memories.shaded[memory] = stop - begin
    memories.left[memory] = to - begin
    memories.shadows[memory] = entry - begin
    memories.needed[memory] = wp.max(memories.needed[memory], wp.max(to, entry) - begin)
    memories.traced[memory] += stop - begin
    if not step.is_last:
        memories.traced[memory] += light_count * (stop - begin)
    if here < stop:
        memories.needed[memory] = room + 1
        memories.shaded[memory] = 0
        memories.left[memory] = 0
        memories.shadows[memory] = 0


@exact_kernel
def end_tile(
    first: int,
    room: int,
    stop: int,
    scene: LitScene,
    queue: RayQueue,
    blocked: wp.array(dtype=wp.bool),
    rays: Gathered,
    memories: TileMemories,
):
    """Writes the light of the last generation of a tile, whose rays end at place `stop`, where no surface sends any: only the
    sky does. Item: a tile memory."""
    memory = first + wp.tid()
    begin = memory * room
    for i in range(begin, stop):
        emitted = wp.vec3()
        if not blocked[i]:
            emitted += sky_light(scene, queue.weight[i], 0.0, queue.direction[i])
        rays.emitted[i] = emitted
    memories.shaded[memory] = stop - begin
    memories.shadows[memory] = 0
    memories.left[memory] = 0
    memories.traced[memory] += stop - begin


@native.func_native(
    "ray_queues.h", "wrt::gather_trees(begin, stop, shadows, lights[0], lights[1], slot, blocked, rays, listed);"
)
def gather_range(
    begin: int,
    stop: int,
    shadows: int,
    lights: wp.vec2i,
    slot: wp.array(dtype=int),
    blocked: wp.array(dtype=wp.bool),
    rays: Gathered,
    listed: ShadowList,
):
    """Adds the light of the rays begin .. stop - 1 to their samples, in the order of `ray_queue.gather`: light by light.
    lights: number of the first one, and how many."""


@exact_kernel
def gather_tile(
    first: int,
    room: int,
    stop: int,
    first_light: int,
    light_count: int,
    slot: wp.array(dtype=int),
    blocked: wp.array(dtype=wp.bool),
    rays: Gathered,
    listed: ShadowList,
    memories: TileMemories,
):
    """Adds the light of a generation of a tile to its samples; `light_count` lights from `first_light` on. Item: a tile
    memory."""
    memory = first + wp.tid()
    lights = wp.vec2i(first_light, light_count)
    gather_range(memory * room, stop, memories.shadows[memory], lights, slot, blocked, rays, listed)

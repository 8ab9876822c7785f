"""The last generation of paths in tiles: which of its rays need the closest hit.

A ray of the last generation sends nothing on. It brings the radiance of the lights that it crosses, of the surface that it
hits, and of the sky if it hits nothing. A ray that crosses no light and passes all emissive triangles can bring that of the sky
only: then it is enough to know whether it hits anything, and without a sky it need not be traced.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.compilation.target import lane_width
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.shading.emitters.light_table import Lights
from wrt.kernels.shading.ray_trees.tile_memories import TileMemories
from wrt.kernels.shading.wavefront.lane_code import in_lanes
from wrt.kernels.shading.wavefront.path_step_simd import LIGHTS
from wrt.kernels.shading.wavefront.ray_queue import RayQueue
from wrt.kernels.shading.wavefront.scene_light import LitScene, sky_light


@cache
def make_part_range(width: int) -> Any:
    """`part_range` for the given number of lanes."""
    call = f"wrt::part_last_rays<{width}>(begin, stop, has_sky, lights, source, is_met.data, target)"

    @native.func_native("last_rays.h", in_lanes(call, LIGHTS))
    def part_range(
        begin: int,
        stop: int,
        has_sky: bool,
        lights: Lights,
        source: RayQueue,
        is_met: wp.array(dtype=int),
        target: RayQueue,
    ) -> int:
        """Moves those of the rays begin .. stop - 1 that may meet a light before the sky to the front of their places, and
        returns their number. The others are copied to another queue, in the order of the octants of their directions, if there
        is a sky. `is_met` is written.
        """

    return part_range


part_range = make_part_range(lane_width())


@exact_kernel
def part_tile(
    first: int,
    size: int,
    stop: int,
    lights: Lights,
    source: RayQueue,
    is_met: wp.array(dtype=int),
    target: RayQueue,
    memories: TileMemories,
):
    """Parts the rays of the last generation of a tile: those that may meet a light are left, in their queue; the others go to
    `target` and count as shadow rays to the sky, if there is one. Item: a tile memory, whose rays end before `stop`."""
    memory = first + wp.tid()
    begin = memory * size
    has_sky = lights.sky_entry >= 0
    left = part_range(begin, stop, has_sky, lights, source, is_met, target)
    others = stop - begin - left
    memories.left[memory] = left
    memories.shadows[memory] = wp.where(has_sky, others, 0)
    memories.traced[memory] += others  # a ray counts, whether it need be traced or not


@exact_kernel
def gather_sky(
    first: int,
    size: int,
    stop: int,
    samples_lights: bool,
    scene: LitScene,
    blocked: wp.array(dtype=wp.bool),
    queue: RayQueue,
    radiance: wp.array(dtype=wp.vec3),
):
    """Adds the light of the sky along the rays of a tile that nothing blocks to their samples. Item: a tile memory, whose rays
    end before `stop`."""
    for i in range((first + wp.tid()) * size, stop):
        if not blocked[i]:
            slot = queue.slot[i]
            density = wp.where(samples_lights, queue.density[i], 0.0)
            radiance[slot] = radiance[slot] + sky_light(scene, queue.weight[i], density, queue.direction[i])

"""The last generation of paths in tiles: which of its rays need the closest hit.

A ray of the last generation sends nothing on. It brings the light of the lamps that it crosses, of the surface that it hits,
and of the sky if it hits nothing. A ray that crosses no lamp and passes all emissive triangles can bring that of the sky only:
then it is enough to know whether it hits anything, and without a sky it need not be traced.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.compilation.target import lane_width
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.shading.emitters.light_table import Lights
from wrt.kernels.shading.ray_trees.tile_memories import TileMemories
from wrt.kernels.shading.wavefront.lane_words import lane_words
from wrt.kernels.shading.wavefront.plain_step import CONSTANTS, CROSSED
from wrt.kernels.shading.wavefront.ray_queue import RayQueue
from wrt.kernels.shading.wavefront.scene_light import LitScene, sky_light

exact_module(__name__)

MOVE = """
    auto octant = [&](int i) {
        const int* d = (const int*)(source.direction.data + i);
        return (int)((unsigned)d[0] >> 31 | (unsigned)d[1] >> 31 << 1 | (unsigned)d[2] >> 31 << 2);
    };
    auto move_ray = [&](int i, auto& target, int place) {
        target.origin.data[place] = source.origin.data[i];
        target.direction.data[place] = source.direction.data[i];
        target.weight.data[place] = source.weight.data[i];
        target.density.data[place] = source.density.data[i];
        target.slot.data[place] = source.slot.data[i];
        target.media.data[place] = source.media.data[i];
    };
"""
"""C++: `octant(i)` of the direction of a ray of the queue `source`, and `move_ray(i, target, place)` to another place."""

_MEETS = """
    auto meets_box = [&](const V3& start, const V3& direction) {
        const V3 away = {1.0f / direction.x, 1.0f / direction.y, 1.0f / direction.z};
        const V3 a = (all3(lights.triangle_low) - start) * away, b = (all3(lights.triangle_high) - start) * away;
        const vf near = larger(larger(smaller(a.x, b.x), smaller(a.y, b.y)), smaller(a.z, b.z));
        const vf far = smaller(smaller(larger(a.x, b.x), larger(a.y, b.y)), larger(a.z, b.z));
        return (near <= far) & (far >= 0.0f);
    };
    for (int i = begin; i < stop; i += W) {  // what lies beyond the last ray is written over
        const V3 start = load3(source.origin.data + i), direction = load3(source.direction.data + i);
        vi meets = 0;
        for (int e = 0; e < lights.areas; ++e) {
            vf density;
            meets = meets | crossed(e, start, direction, all(WRT_INFINITY), density);
        }
        if (lights.triangle_entry >= 0) meets = meets | meets_box(start, direction);
        save(is_met.data + i, meets);
    }
"""

_PART = """
    int next[9] = {}, kept = begin;
    for (int i = begin; i < stop; ++i) next[octant(i) + 1] += is_met.data[i] == 0;
    next[0] = begin;
    for (int k = 0; k < 8; ++k) next[k + 1] += next[k];
    for (int i = begin; i < stop; ++i) {
        if (is_met.data[i] != 0) move_ray(i, source, kept++);
        else if (has_sky) move_ray(i, target, next[octant(i)]++);
    }
    return kept - begin;
"""


@cache
def make_part_range(width: int) -> Any:
    """`part_range` for so many lanes."""
    head = f"#if defined(__CUDA_ARCH__)\nreturn 0;\n#else\nconstexpr int W = {width};\n"
    parts = f"{CONSTANTS}const bool is_sobol = false;{lane_words(width)}{CROSSED}{_MEETS}{MOVE}{_PART}"

    @native.func_native("lanes.h", f"{head}{parts}\n#endif\n")
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
        ...

    return part_range


part_range = make_part_range(lane_width())


@wp.kernel
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


@wp.kernel
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

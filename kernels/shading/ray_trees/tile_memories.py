"""The memory of a tile of samples, which a thread uses again for its next tile, so that it stays in the caches of its core.

There are as many of these tile memories as threads; a thread takes a free one for each tile, and follows the samples of the
tile through all stages of a chain (`wrt.kernels.runtime.launch_chain`), as many at a time as find place.
"""

import warp as wp

from wrt.kernels.runtime.job_queue import on_cpu
from wrt.kernels.runtime.launch_chain import run_stages
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.shading.wavefront.camera_rays import WIDTH, CameraModel, start_lanes, start_ray
from wrt.kernels.shading.wavefront.pixel_samples import PixelSamples
from wrt.kernels.shading.wavefront.ray_queue import RayQueue, Wave


@wp.struct
class TileMemories:
    """The state of the tile memories, an entry each, and of the loop over tiles."""

    taken: wp.array(dtype=int)
    """1 while a thread works there."""
    first_sample: wp.array(dtype=int)
    """Number of the first sample in the wave."""
    fitting: wp.array(dtype=int)
    """Samples that are tried together."""
    min_fitting: wp.array(dtype=int)
    """The least number that was, in the wave."""
    left: wp.array(dtype=int)
    """Rays of the generation to be traced."""
    shaded: wp.array(dtype=int)
    """Rays of the generation whose light is to be summed."""
    shadows: wp.array(dtype=int)
    """Shadow rays to be traced."""
    needed: wp.array(dtype=int)
    """The largest generation so far; above `room` if rays found no place."""
    traced: wp.array(dtype=int)
    """Rays so far of the samples that are tried."""
    total: wp.array(dtype=int)
    """Rays of the wave so far."""
    failed: wp.array(dtype=int)
    """1 if the rays of a single sample found no place; other samples are left out then."""


@wp.func
def shifted_queue(queue: RayQueue, by: int):
    """A queue whose place i is place i + by of this one."""
    own = RayQueue()
    count = queue.slot.shape[0]
    own.origin = wp.array(ptr=queue.origin.ptr + wp.uint64(12 * by), shape=(count,), dtype=wp.vec3)
    own.direction = wp.array(ptr=queue.direction.ptr + wp.uint64(12 * by), shape=(count,), dtype=wp.vec3)
    own.weight = wp.array(ptr=queue.weight.ptr + wp.uint64(12 * by), shape=(count,), dtype=wp.vec3)
    own.density = wp.array(ptr=queue.density.ptr + wp.uint64(4 * by), shape=(count,), dtype=float)
    own.slot = wp.array(ptr=queue.slot.ptr + wp.uint64(4 * by), shape=(count,), dtype=int)
    own.media = wp.array(ptr=queue.media.ptr + wp.uint64(8 * by), shape=(count,), dtype=wp.uint64)
    return own


@exact_kernel
def start_tile(
    first: int,
    room: int,
    stop: int,
    camera: CameraModel,
    source: PixelSamples,
    wave: Wave,
    queue: RayQueue,
    radiance: wp.array(dtype=wp.vec3),
    memories: TileMemories,
    lanes: int,
):
    """Writes the camera rays of a tile, which end at place `stop`, and clears the radiance of its samples. Item: a tile
    memory. lanes: rays that are made together, WIDTH or 1."""
    memory = first + wp.tid()
    here = memories.first_sample[memory]
    end = here + stop - memory * room
    own = shifted_queue(queue, memory * room - here)
    while here < end:
        done = int(0)
        if lanes > 1 and here + WIDTH <= end:
            done = start_lanes(here, camera, source, wave, own, radiance)
        if done == 0:
            start_ray(here, camera, source, wave, own, radiance)
            done = 1
        here += done


@wp.func_native(
    on_cpu("""
    for (int memory = 0;; memory = memory + 1 < (int)taken.shape[0] ? memory + 1 : 0) {
        int is_free = 0;
        if (__atomic_load_n(taken.data + memory, __ATOMIC_RELAXED) == 0
            && __atomic_compare_exchange_n(taken.data + memory, &is_free, 1, false, __ATOMIC_ACQUIRE, __ATOMIC_RELAXED))
            return memory;
    }
""")
)
def take_memory(taken: wp.array(dtype=int)) -> int:
    """A free tile memory, which is taken; waits for one if there are more threads."""


@wp.func_native(on_cpu("__atomic_store_n(taken.data + memory, 0, __ATOMIC_RELEASE);"))
def leave_memory(taken: wp.array(dtype=int), memory: int) -> int:
    """Makes a tile memory free; returns 0."""


@exact_kernel
def follow_tiles(
    first: int,
    stages: wp.array(dtype=wp.int64),
    stage_count: int,
    last_count: int,
    room: int,
    size: int,
    count: int,
    memories: TileMemories,
):
    """Follows the samples of a tile through all stages, as many at a time as find place. The last stages, `last_count` of them,
    are for all samples that found place, even if no rays are left. Item: a tile of `size` of the `count` samples."""
    here = (first + wp.tid()) * size
    end = wp.min(here + size, count)
    memory = take_memory(memories.taken)
    fitting = memories.fitting[memory]
    while here < end and memories.failed[memory] == 0:
        samples = wp.min(fitting, end - here)
        memories.first_sample[memory] = here
        memories.left[memory] = samples
        memories.needed[memory] = samples
        memories.traced[memory] = 0
        run_stages(stages, 0, stage_count - last_count, memories.left, room, memory)
        needed = memories.needed[memory]
        if needed <= room or samples == 1:
            memories.left[memory] = samples
            run_stages(stages, stage_count - last_count, stage_count, memories.left, room, memory)
            memories.total[memory] += memories.traced[memory]
            here += samples
            if 4 * needed <= room and samples == fitting:
                fitting = wp.min(2 * fitting, size)
            if needed > room:
                memories.failed[memory] = 1
        else:
            fitting = samples / 2
            memories.min_fitting[memory] = wp.min(memories.min_fitting[memory], fitting)
    memories.fitting[memory] = fitting
    leave_memory(memories.taken, memory)

"""A ray of a generation where it ends: what a step reads first."""

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime import native
from wrt.kernels.shading.bsdf.material_table import MaterialAtHit
from wrt.kernels.shading.shading_point import ShadingPoint
from wrt.kernels.shading.wavefront.pixel_samples import PixelSamples, pixel_hash
from wrt.kernels.shading.wavefront.ray_queue import Gathered, RayQueue, Wave, pixel_of
from wrt.kernels.shading.wavefront.scene_light import Boundary, LitScene, absorbed


@wp.struct
class RayAtHit:
    """A ray of the queue, with what it hit."""

    origin: wp.vec3
    direction: wp.vec3
    weight: wp.vec3
    """At the hit: what the medium absorbs is taken off."""
    density: float
    media: wp.uint64
    slot: int
    primitive: int
    """-1 for a miss."""
    t: float
    uv: wp.vec2


@wp.struct
class ShadedHit:
    """A hit, with all that decides about its light and the rays that follow."""

    ray: RayAtHit
    point: ShadingPoint
    material: MaterialAtHit
    boundary: Boundary


@wp.struct
class StepArrays:
    """What a step reads, and where its light goes."""

    begin: int
    """Place of the generation's first ray in the queue."""
    source: PixelSamples
    wave: Wave
    queue: RayQueue
    hits: HitBatch
    rays: Gathered


@wp.func(inline=True)
def step_arrays(begin: int, source: PixelSamples, wave: Wave, queue: RayQueue, hits: HitBatch, rays: Gathered):
    """The arrays of a step, from the arguments of a kernel."""
    arrays = StepArrays()
    arrays.begin = begin
    arrays.source = source
    arrays.wave = wave
    arrays.queue = queue
    arrays.hits = hits
    arrays.rays = rays
    return arrays


@wp.func(inline=True)
def ray_at_hit(scene: LitScene, queue: RayQueue, hits: HitBatch, i: int):
    """Ray number i of a generation, where it ends."""
    ray = RayAtHit()
    ray.origin = queue.origin[i]
    ray.direction = queue.direction[i]
    ray.weight = queue.weight[i]
    ray.density = queue.density[i]
    ray.media = queue.media[i]
    ray.slot = queue.slot[i]
    ray.primitive = hits.primitive[i]
    ray.t = hits.t[i]
    ray.uv = hits.uv[i]
    if ray.media != wp.uint64(0) and ray.primitive >= 0:
        ray.weight = absorbed(scene, ray.weight, ray.media, ray.t)
    return ray


AHEAD = wp.constant(16)
"""Rays by which a step is ahead of itself when it fetches what it will read."""


@native.func_native("ray_queues.h", "wrt::fetch_hits(scene, hits, begin, end);")
def fetch_hits(scene: LitScene, hits: HitBatch, begin: int, end: int):
    """Fetches the triangles of the hits begin .. end - 1 into the caches of a core: records, numbers of materials, normals.

    Reflected and refracted rays hit triangles in no order, and a step would wait for each (a third of Whitted's time).
    """


@wp.struct
class SampleKey:
    """What the random numbers of a sample follow from."""

    pixel: wp.uint32
    """`pixel_hash` of its pixel."""
    sample: int


@wp.func(inline=True)
def sample_key(source: PixelSamples, wave: Wave, slot: int):
    """The key of a sample of a wave."""
    key = SampleKey()
    key.pixel = pixel_hash(source, pixel_of(wave, slot))
    key.sample = wave.first_sample + slot % wave.samples
    return key

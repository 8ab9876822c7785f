"""One step of path tracing: from the hits of a generation to the light that they give and the rays that follow.

Kajiya's path tracing. At each point a light is chosen by power and sampled (next-event estimation), and one direction is
followed. Light that both ways can find is weighted by the power heuristic (Veach and Guibas 1995). From generation `roulette`
on, a path goes on with the probability of its weight, at most 0.95, and is weighted up by its inverse (Arvo and Kirk 1990).

References: kajiya-1986; arvo-kirk-1990; veach-guibas-1995.
"""

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch, is_finite
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.shading.bsdf.scattering import is_single, largest, sample_scattering
from wrt.kernels.shading.emitters.environment import find_interval
from wrt.kernels.shading.emitters.light_table import entry_probability
from wrt.kernels.shading.shading_point import leaving_origin, shading_point
from wrt.kernels.shading.wavefront.path_step_simd import WIDTH, PathStep, path_step_simd
from wrt.kernels.shading.wavefront.pixel_samples import FIRST_BOUNCE, PER_BOUNCE, PixelSamples, pixel_point, single_number
from wrt.kernels.shading.wavefront.ray_at_hit import (
    AHEAD,
    SampleKey,
    ShadedHit,
    StepArrays,
    fetch_hits,
    ray_at_hit,
    sample_key,
    step_arrays,
)
from wrt.kernels.shading.wavefront.ray_queue import Gathered, RayQueue, Wave
from wrt.kernels.shading.wavefront.scene_light import (
    Arrival,
    LitScene,
    arriving_light,
    boundary_of,
    crossed_lights,
    material_at_point,
    may_emit,
    sky_light,
    surface_light,
)

UNKNOWN = wp.constant(-1)
"""What `follow_path` knows of a ray beforehand: nothing."""

MISSED = wp.constant(-2)
"""The ray hit nothing. Kinds of material stand for themselves."""


@wp.func
def kept_above(direction: wp.vec3, face_normal: wp.vec3, is_transmitted: bool):
    """A single direction that a smooth normal sent through the triangle, or back from it, mirrored at its plane."""
    rise = wp.dot(direction, face_normal)
    wrong = (rise < 0.0) != is_transmitted
    return wp.where(wrong, direction - 2.0 * rise * face_normal, direction)


@wp.func(inline=True)
def sampled_light(
    step: PathStep,
    scene: LitScene,
    source: PixelSamples,
    key: SampleKey,
    hit: ShadedHit,
):
    """Radiance of one light, chosen by power, that may be scattered along a ray."""
    entry = int(0)
    probability = float(1.0)
    if scene.lights.count > 1:
        entry = find_interval(
            scene.lights.sums, 0, scene.lights.count, single_number(key.pixel, key.sample, 3 * step.generation)
        )
        probability = entry_probability(scene.lights, entry)
    place = pixel_point(source, key.pixel, key.sample, FIRST_BOUNCE + PER_BOUNCE * step.generation)
    return arriving_light(scene, hit.point, hit.material, -hit.ray.direction, entry, place, probability, True)


@wp.func(inline=True)
def pass_through(hit: ShadedHit, to: int, following: RayQueue):
    """Lets a ray go on through a boundary that is none to it."""
    following.direction[to] = hit.ray.direction
    following.weight[to] = hit.ray.weight
    following.density[to] = hit.ray.density
    following.media[to] = hit.boundary.media_beyond
    following.origin[to] = leaving_origin(hit.point, True)
    return 1


@wp.func(inline=True)
def scatter(
    step: PathStep,
    source: PixelSamples,
    key: SampleKey,
    hit: ShadedHit,
    to: int,
    following: RayQueue,
):
    """Sends a path on in a sampled direction; 1 unless it ends here."""
    ray = hit.ray
    point = hit.point
    lobe = single_number(key.pixel, key.sample, 3 * step.generation + 1)
    spot = pixel_point(source, key.pixel, key.sample, FIRST_BOUNCE + PER_BOUNCE * step.generation + 1)
    scattered = sample_scattering(hit.material, point.normal, -ray.direction, spot, lobe)
    toward = scattered.direction
    if scattered.density == 0.0:
        toward = kept_above(toward, point.face_normal, scattered.is_transmitted)
    share = wp.cw_mul(ray.weight, scattered.weight)
    max_share = largest(share)
    is_right = (wp.dot(toward, point.face_normal) < 0.0) == scattered.is_transmitted
    alive = int(0)
    if max_share > 0.0 and is_right and is_finite(share):
        alive = 1
        if step.generation >= step.roulette:
            survival = wp.min(max_share, 0.95)
            if single_number(key.pixel, key.sample, 3 * step.generation + 2) < survival:
                share = share / survival
            else:
                alive = 0
        following.direction[to] = toward
        following.weight[to] = share
        following.density[to] = scattered.density
        following.media[to] = wp.where(scattered.is_transmitted, hit.boundary.media_beyond, ray.media)
        following.origin[to] = leaving_origin(point, scattered.is_transmitted)
    return alive


@wp.func(inline=True)
def follow_path(
    i: int,
    known: int,
    to: int,
    entry: int,
    step: PathStep,
    scene: LitScene,
    arrays: StepArrays,
    following: RayQueue,
):
    """Does the step of ray i. A constant `known` other than `UNKNOWN` leaves the code for such rays only.

    The ray that follows is written to place `to`, and the shadow ray to place `entry`. Returns 1 if the path goes on, plus 2 if
    the shadow ray may bring light.
    """
    rays = arrays.rays
    ray = ray_at_hit(scene, arrays.queue, arrays.hits, i)
    density = wp.where(step.samples_lights, ray.density, 0.0)
    found = wp.vec3()
    arrival = Arrival()
    alive = int(0)
    if scene.lights.areas > 0:
        found += crossed_lights(scene, ray.weight, density, ray.origin, ray.direction, ray.t)
    missed = known == MISSED
    if known == UNKNOWN:
        missed = ray.primitive < 0
    if missed:
        found += sky_light(scene, ray.weight, density, ray.direction)
    elif not step.is_last or may_emit(scene, ray.primitive):
        point = shading_point(scene.shaded, ray.primitive, ray.uv, ray.direction)
        material = material_at_point(scene, point)
        if known >= 0:
            material.kind = known
        cosine = wp.abs(wp.dot(point.face_normal, ray.direction))
        found += surface_light(scene, material.number, ray.weight, density, point, cosine, ray.t)
        if not step.is_last:
            boundary = boundary_of(scene, material, ray.media, point.is_front)
            material.ratio = boundary.ratio
            hit = ShadedHit()
            hit.ray = ray
            hit.point = point
            hit.material = material
            hit.boundary = boundary
            if not boundary.is_real:
                alive = pass_through(hit, to, following)
            else:
                key = sample_key(arrays.source, arrays.wave, ray.slot)
                if step.samples_lights and scene.lights.count > 0 and not is_single(material):
                    arrival = sampled_light(step, scene, arrays.source, key, hit)
                alive = scatter(step, arrays.source, key, hit, to, following)
    rays.radiance[ray.slot] = rays.radiance[ray.slot] + found
    if not step.is_last:
        following.slot[to] = ray.slot
        lit = wp.cw_mul(ray.weight, arrival.radiance)
        rays.lit[entry] = lit
        rays.shadow_origin[entry] = arrival.origin
        rays.shadow_direction[entry] = arrival.segment
        if lit[0] != 0.0 or lit[1] != 0.0 or lit[2] != 0.0:
            alive += 2
    return alive


@exact_kernel
def path_step(
    first: int,
    start: int,
    stop: int,
    group: int,
    step: PathStep,
    scene: LitScene,
    source: PixelSamples,
    wave: Wave,
    queue: RayQueue,
    hits: HitBatch,
    rays: Gathered,
    following: RayQueue,
    is_alive: wp.array(dtype=int),
):
    """Adds the light of rays to their samples, and writes shadow rays and the rays that follow.

    Item: a group of the rays start .. stop - 1. A sample has one ray in a generation. Groups of one ray have no simple rays.
    """
    begin = start + (first + wp.tid()) * group
    end = wp.min(begin + group, stop)
    size = wp.where(group > 1, WIDTH, 1)
    arrays = step_arrays(0, source, wave, queue, hits, rays)
    fetch_hits(scene, hits, begin, wp.min(begin + AHEAD, end))
    here = int(begin)
    while here < end:
        fetch_hits(scene, hits, here + AHEAD, wp.min(here + AHEAD + size, end))
        done = wp.uint32(0)
        if size > 1 and here + size <= end:
            done = path_step_simd(here, step, scene, arrays, following, is_alive)
        for i in range(here, wp.min(here + size, end)):
            if (done >> wp.uint32(i - here)) & wp.uint32(1) == wp.uint32(0):
                found = follow_path(i, UNKNOWN, i, i, step, scene, arrays, following)
                if not step.is_last:
                    is_alive[i] = found & 1
        here += size

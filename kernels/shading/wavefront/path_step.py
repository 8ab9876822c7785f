"""One step of path tracing: from the hits of a generation to the light that they give and the rays that follow.

Kajiya's path tracing. At each point a lamp is chosen by power and sampled (next-event estimation), and one direction is
followed. Light that both ways can find is weighted by the power heuristic (Veach and Guibas 1995). From generation `roulette`
on, a path goes on with the probability of its weight, at most 0.95, and is weighted up by its inverse (Arvo and Kirk 1990).

References:
    J. T. Kajiya: The rendering equation. SIGGRAPH 1986.
    J. Arvo, D. Kirk: Particle transport and image synthesis. SIGGRAPH 1990.
    E. Veach, L. J. Guibas: Optimally combining sampling techniques for Monte Carlo rendering. SIGGRAPH 1995.
"""

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch, is_finite
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.shading.bsdf.scattering import is_single, largest, sample_scattering
from wrt.kernels.shading.emitters.environment import find_interval
from wrt.kernels.shading.emitters.light_table import entry_probability
from wrt.kernels.shading.shading_point import leaving_origin, shading_point
from wrt.kernels.shading.wavefront.pixel_samples import (
    FIRST_BOUNCE,
    PER_BOUNCE,
    PixelSamples,
    pixel_hash,
    pixel_point,
    single_number,
)
from wrt.kernels.shading.wavefront.ray_queue import Gathered, RayQueue, Wave
from wrt.kernels.shading.wavefront.scene_light import (
    LitScene,
    absorbed,
    arriving_light,
    boundary_of,
    crossed_lights,
    point_look,
    sky_light,
    surface_light,
)

exact_module(__name__)


@wp.struct
class PathStep:
    """The step of a generation."""

    generation: int
    """0 for camera rays."""
    is_last: bool
    """Whether paths end here, and only collect what the surface emits."""
    roulette: int
    """First generation whose rays may end by Russian roulette."""
    samples_lights: bool
    """whether lamps are sampled; without, light is found by scattering only."""


@wp.func
def kept_above(direction: wp.vec3, face_normal: wp.vec3, is_transmitted: bool):
    """A single direction that a smooth normal sent through the triangle, or back from it, mirrored at its plane."""
    rise = wp.dot(direction, face_normal)
    wrong = (rise < 0.0) != is_transmitted
    return wp.where(wrong, direction - 2.0 * rise * face_normal, direction)


@wp.kernel
def path_step(
    first: int,
    count: int,
    group: int,
    step: PathStep,
    scene: LitScene,
    source: PixelSamples,
    wave: Wave,
    queue: RayQueue,
    hits: HitBatch,
    rays: Gathered,
    following: RayQueue,
    goes_on: wp.array(dtype=int),
):
    """Writes the light of rays, their shadow rays, and the rays that follow. Item: a group of rays, of `count` in all."""
    begin = (first + wp.tid()) * group
    for i in range(begin, wp.min(begin + group, count)):
        origin = queue.origin[i]
        direction = queue.direction[i]
        weight = queue.weight[i]
        density = queue.density[i]
        media = queue.media[i]
        slot = queue.slot[i]
        primitive = hits.primitive[i]
        t = hits.t[i]
        if media != wp.uint64(0) and primitive >= 0:
            weight = absorbed(scene, weight, media, t)
        if not step.samples_lights:
            density = 0.0
        emitted = wp.vec3()
        lit = wp.vec3()
        shadow_origin = wp.vec3()
        shadow_direction = wp.vec3()
        alive = int(0)
        if scene.lights.areas > 0:
            emitted += crossed_lights(scene, weight, density, origin, direction, t)
        if primitive < 0:
            emitted += sky_light(scene, weight, density, direction)
        else:
            point = shading_point(scene.shaded, primitive, hits.uv[i], direction)
            look = point_look(scene, point)
            cosine = wp.abs(wp.dot(point.face_normal, direction))
            emitted += surface_light(scene, look.number, weight, density, point, cosine, t)
            if not step.is_last:
                pixel = pixel_hash(source, wave.first_pixel + slot % wave.pixels)
                sample = wave.first_sample + slot / wave.pixels
                dimension = FIRST_BOUNCE + PER_BOUNCE * step.generation
                boundary = boundary_of(scene, look, media, point.is_front)
                look.ratio = boundary.ratio
                if not boundary.is_real:
                    following.direction[i] = direction
                    following.weight[i] = weight
                    following.density[i] = queue.density[i]
                    following.media[i] = boundary.media_beyond
                    following.origin[i] = leaving_origin(point, True)
                    alive = 1
                else:
                    if step.samples_lights and scene.lights.count > 0 and not is_single(look):
                        entry = int(0)
                        probability = float(1.0)
                        if scene.lights.count > 1:
                            choice = single_number(pixel, sample, 3 * step.generation)
                            entry = find_interval(scene.lights.sums, 0, scene.lights.count, choice)
                            probability = entry_probability(scene.lights, entry)
                        place = pixel_point(source, pixel, sample, dimension)
                        found = arriving_light(scene, point, look, -direction, entry, place, probability, True)
                        lit = wp.cw_mul(weight, found.radiance)
                        shadow_origin = found.origin
                        shadow_direction = found.segment
                    lobe = single_number(pixel, sample, 3 * step.generation + 1)
                    spot = pixel_point(source, pixel, sample, dimension + 1)
                    scattered = sample_scattering(look, point.normal, -direction, spot, lobe)
                    toward = scattered.direction
                    if scattered.density == 0.0:
                        toward = kept_above(toward, point.face_normal, scattered.is_transmitted)
                    share = wp.cw_mul(weight, scattered.weight)
                    most = largest(share)
                    is_right = (wp.dot(toward, point.face_normal) < 0.0) == scattered.is_transmitted
                    if most > 0.0 and is_right and is_finite(share):
                        alive = 1
                        if step.generation >= step.roulette:
                            survival = wp.min(most, 0.95)
                            if single_number(pixel, sample, 3 * step.generation + 2) < survival:
                                share = share / survival
                            else:
                                alive = 0
                        following.direction[i] = toward
                        following.weight[i] = share
                        following.density[i] = scattered.density
                        following.media[i] = wp.where(scattered.is_transmitted, boundary.media_beyond, media)
                        following.origin[i] = leaving_origin(point, scattered.is_transmitted)
        following.slot[i] = slot
        goes_on[i] = alive
        rays.emitted[i] = emitted
        rays.lit[i] = lit
        rays.shadow_origin[i] = shadow_origin
        rays.shadow_direction[i] = shadow_direction

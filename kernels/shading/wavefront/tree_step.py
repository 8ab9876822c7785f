"""One step of Whitted's ray tracing, and of distribution ray tracing: each hit is lit by all lights, and sends out a reflected
and a refracted ray.

**Whitted (1980).** Mirrors and boundaries of dielectrics send rays on, weighted by Fresnel's equations; all other surfaces are
lit by the lights and by a constant ambient light. Lights with an area are sampled at their middle, so shadows are hard. Glossy
surfaces reflect to the mirror direction.

**Distribution (Cook, Porter and Carpenter 1984).** The same tree, but each sample of a pixel has its own place on each light
(penumbrae) and its own direction in the lobe of a glossy or rough surface (gloss, translucency), as it has its own place in
the pixel, on the lens and in time. Light that is scattered diffusely twice is not followed, which path tracing does.

**Adaptive depth.** A ray ends when its weight falls below a threshold (Hall and Greenberg 1983). With Russian roulette, such a
ray goes on with the probability weight / threshold and then has the weight of the threshold, which keeps the mean.

References: whitted-1980; hall-greenberg-1983; cook-1984.
"""

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch, is_finite
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.shading.bsdf.fresnel import dielectric_share, mirrored, refracted, schlick_color
from wrt.kernels.shading.bsdf.ggx import masking, masking_and_shadowing, visible_facet
from wrt.kernels.shading.bsdf.material_table import DIELECTRIC, GLOSSY, MIRROR, MaterialAtHit
from wrt.kernels.shading.bsdf.scattering import facet_color, is_single, largest
from wrt.kernels.shading.emitters.light_table import TRIANGLES
from wrt.kernels.shading.sampling import MIX_1
from wrt.kernels.shading.shading_point import ShadingPoint, leaving_origin, shading_point
from wrt.kernels.shading.wavefront.path_step import kept_above
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
    LitScene,
    arriving_light,
    boundary_of,
    crossed_lights,
    material_at_point,
    sky_light,
    surface_light,
)

LIGHT_DIMENSIONS = wp.constant(0x4000)
"""First dimension of the places on the second and further lights."""


@wp.struct
class TreeStep:
    """The step of a generation."""

    generation: int
    """0 for camera rays."""
    is_last: bool
    """Whether no further rays are sent."""
    distributed: bool
    """Whether samples have their own places on lights and directions in lobes."""
    threshold: float
    """Weight below which rays end."""
    roulette: bool
    ambient: wp.vec3
    """Radiance of the constant ambient light."""
    first_light: int
    """The first light that this step samples."""
    light_end: int
    """The first one after them: `first_light` for none. `shade_by_light` samples the others."""
    unlit: int
    """A light that is not sampled; -1 for none."""


@wp.struct
class Child:
    """A ray that a hit sends out."""

    direction: wp.vec3
    weight: wp.vec3
    is_transmitted: bool


@wp.struct
class ShadowList:
    """Which light the shadow rays of a list may bring."""

    ray: wp.array(dtype=int)
    """(S,) the place of the lit ray in its queue."""
    light: wp.array(dtype=int)
    """(S,) the light."""


@wp.struct
class SentRays:
    """The rays that follow."""

    queue: RayQueue
    is_alive: wp.array(dtype=int)
    """Whether each place has a ray that goes on."""


@wp.func(inline=True)
def sent_rays(queue: RayQueue, is_alive: wp.array(dtype=int)):
    """The rays that follow, from the arguments of a kernel."""
    sent = SentRays()
    sent.queue = queue
    sent.is_alive = is_alive
    return sent


@wp.func
def queue_branch(slot: wp.array(dtype=int), begin: int, i: int):
    """Number of a ray among those of its sample in a queue that begins at `begin`."""
    branch = int(0)
    own = slot[i]
    is_same = bool(i > begin)
    while is_same:
        is_same = slot[i - branch - 1] == own
        if is_same:
            branch += 1
            if i - branch == begin:
                is_same = False
    return branch


@wp.func(inline=True)
def branch_key(arrays: StepArrays, i: int):
    """The key of ray i of the queue: rays of one sample and generation differ."""
    key = sample_key(arrays.source, arrays.wave, arrays.queue.slot[i])
    key.pixel += wp.uint32(queue_branch(arrays.queue.slot, arrays.begin, i)) * MIX_1
    return key


@wp.func(inline=True)
def light_place(step: TreeStep, scene: LitScene, source: PixelSamples, key: SampleKey, entry: int):
    """The point in [0, 1)^2 at which a light is sampled: its middle, if samples do not have their own."""
    place = wp.vec2(0.5, 0.5)
    if step.distributed or scene.lights.kind[entry] >= TRIANGLES:
        dimension = FIRST_BOUNCE + PER_BOUNCE * step.generation
        if entry > 0:
            dimension = LIGHT_DIMENSIONS + 64 * step.generation + entry
        place = pixel_point(source, key.pixel, key.sample, dimension)
    return place


@wp.func(inline=True)
def reflected_child(step: TreeStep, material: MaterialAtHit, point: ShadingPoint, out: wp.vec3, place: wp.vec2):
    """The reflected ray of a mirror, a boundary or a glossy surface; its weight is 0 for others."""
    child = Child()
    facet = point.normal
    is_rough = step.distributed and material.alpha > 0.0 and material.kind != MIRROR
    if is_rough:
        facet = visible_facet(out, point.normal, material.alpha, place)
    cosine = wp.abs(wp.dot(out, facet))
    child.direction = mirrored(out, facet)
    if material.kind == MIRROR:
        child.weight = material.color
    if material.kind == DIELECTRIC:
        child.weight = dielectric_share(cosine, material.ratio, material.schlick) * material.color
    if material.kind == GLOSSY:
        child.weight = schlick_color(facet_color(material), cosine)
    if is_rough:
        rise = wp.dot(child.direction, point.normal)
        shadowed = masking_and_shadowing(rise, wp.dot(out, point.normal), material.alpha)
        share = shadowed / masking(wp.dot(out, point.normal), material.alpha)
        child.weight = wp.where(rise > 0.0, share, 0.0) * child.weight
    return child


@wp.func(inline=True)
def refracted_child(step: TreeStep, material: MaterialAtHit, point: ShadingPoint, out: wp.vec3, place: wp.vec2):
    """The refracted ray of a dielectric."""
    child = Child()
    child.is_transmitted = True
    facet = point.normal
    is_rough = step.distributed and material.alpha > 0.0
    if is_rough:
        facet = visible_facet(out, point.normal, material.alpha, place)
    share = 1.0 - dielectric_share(wp.abs(wp.dot(out, facet)), material.ratio, material.schlick)
    child.direction = refracted(out, facet, material.ratio)
    child.weight = share * material.ratio * material.ratio * material.color
    if is_rough:
        rise = wp.dot(child.direction, point.normal)
        shadowed = masking_and_shadowing(rise, wp.dot(out, point.normal), material.alpha)
        facing = shadowed / masking(wp.dot(out, point.normal), material.alpha)
        child.weight = wp.where(rise < 0.0, facing, 0.0) * child.weight
    return child


@wp.func(inline=True)
def send(
    step: TreeStep,
    key: SampleKey,
    child: Child,
    hit: ShadedHit,
    at: int,
    following: RayQueue,
):
    """Writes a ray to its place; 1 if it goes on. Roulette takes a random number of the place's own."""
    point = hit.point
    share = wp.cw_mul(hit.ray.weight, child.weight)
    max_share = largest(share)
    alive = int(0)
    if max_share > 0.0 and is_finite(share) and wp.length_sq(child.direction) > 0.5:
        alive = 1
        if max_share < step.threshold:
            alive = 0
            if step.roulette:
                chance = single_number(key.pixel, key.sample, 3 * step.generation + at % 2)
                if chance * step.threshold < max_share:
                    alive = 1
                    share = share * (step.threshold / max_share)
        following.direction[at] = kept_above(child.direction, point.face_normal, child.is_transmitted)
        following.weight[at] = share
        following.density[at] = 0.0
        following.media[at] = wp.where(child.is_transmitted, hit.boundary.media_beyond, hit.ray.media)
        following.origin[at] = leaving_origin(point, child.is_transmitted)
        following.slot[at] = hit.ray.slot
    return alive


@wp.func(inline=True)
def send_children(
    step: TreeStep,
    source: PixelSamples,
    key: SampleKey,
    hit: ShadedHit,
    i: int,
    sent: SentRays,
):
    """Writes the reflected and the refracted ray of a hit to the places 2 i and 2 i + 1, and whether they go on."""
    material = hit.material
    out = -hit.ray.direction
    place = wp.vec2()
    if step.distributed and material.alpha > 0.0:
        place = pixel_point(source, key.pixel, key.sample, FIRST_BOUNCE + PER_BOUNCE * step.generation + 1)
    if not hit.boundary.is_real:
        passing = Child()
        passing.direction = hit.ray.direction
        passing.weight = wp.vec3(1.0, 1.0, 1.0)
        passing.is_transmitted = True
        sent.is_alive[2 * i + 1] = send(step, key, passing, hit, 2 * i + 1, sent.queue)
    else:
        if material.kind == MIRROR or material.kind == GLOSSY or material.kind == DIELECTRIC:
            child = reflected_child(step, material, hit.point, out, place)
            sent.is_alive[2 * i] = send(step, key, child, hit, 2 * i, sent.queue)
        if material.kind == DIELECTRIC:
            child = refracted_child(step, material, hit.point, out, place)
            sent.is_alive[2 * i + 1] = send(step, key, child, hit, 2 * i + 1, sent.queue)


@wp.func(inline=True)
def write_light(
    step: TreeStep,
    entry: int,
    scene: LitScene,
    source: PixelSamples,
    key: SampleKey,
    hit: ShadedHit,
    i: int,
    rays: Gathered,
):
    """Writes the radiance that a light may give at a hit, and its shadow ray, to place i."""
    place = light_place(step, scene, source, key, entry)
    found = arriving_light(scene, hit.point, hit.material, -hit.ray.direction, entry, place, 1.0, False)
    rays.lit[i] = wp.cw_mul(hit.ray.weight, found.radiance)
    rays.shadow_origin[i] = found.origin
    rays.shadow_direction[i] = found.segment


@wp.func(inline=True)
def shade_ray(
    i: int,
    child: int,
    entry: int,
    step: TreeStep,
    scene: LitScene,
    arrays: StepArrays,
    sent: SentRays,
    listed: ShadowList,
):
    """Does the step of ray i of the queue.

    Writes the light that needs no shadow ray to place i, and the rays that follow to the places 2 `child` and 2 `child` + 1.
    Light and shadow rays of lights go to place `entry`; or, if the list has room, those that may bring light to the places
    from `entry` on. Returns the place after them.
    """
    rays = arrays.rays
    ray = ray_at_hit(scene, arrays.queue, arrays.hits, i)
    emitted = crossed_lights(scene, ray.weight, 0.0, ray.origin, ray.direction, ray.t)
    place = int(entry)
    if not step.is_last:
        sent.is_alive[2 * child] = 0
        sent.is_alive[2 * child + 1] = 0
    if ray.primitive < 0:
        emitted += sky_light(scene, ray.weight, 0.0, ray.direction)
    else:
        point = shading_point(scene.shaded, ray.primitive, ray.uv, ray.direction)
        material = material_at_point(scene, point)
        cosine = wp.abs(wp.dot(point.face_normal, ray.direction))
        emitted += surface_light(scene, material.number, ray.weight, 0.0, point, cosine, ray.t)
        boundary = boundary_of(scene, material, ray.media, point.is_front)
        material.ratio = boundary.ratio
        if not is_single(material) and material.kind != DIELECTRIC:
            emitted += wp.cw_mul(wp.cw_mul(ray.weight, (1.0 - material.metallic) * material.color), step.ambient)
        if not step.is_last:
            hit = ShadedHit()
            hit.ray = ray
            hit.point = point
            hit.material = material
            hit.boundary = boundary
            key = branch_key(arrays, i)
            if boundary.is_real and not is_single(material):
                for light in range(step.first_light, step.light_end):
                    if light != step.unlit:
                        write_light(step, light, scene, arrays.source, key, hit, place, rays)
                        lit = rays.lit[place]
                        if listed.ray.shape[0] > 0 and (lit[0] != 0.0 or lit[1] != 0.0 or lit[2] != 0.0):
                            listed.ray[place] = i
                            listed.light[place] = light
                            place += 1
            send_children(step, arrays.source, key, hit, child, sent)
    rays.emitted[i] = emitted
    return place


@exact_kernel
def tree_step(
    first: int,
    start: int,
    stop: int,
    group: int,
    step: TreeStep,
    scene: LitScene,
    source: PixelSamples,
    wave: Wave,
    queue: RayQueue,
    hits: HitBatch,
    rays: Gathered,
    following: RayQueue,
    is_alive: wp.array(dtype=int),
    listed: ShadowList,
):
    """Writes the light of rays that needs no shadow ray, that of the light `step.first_light`, and the rays that follow. Item:
    a group of the rays start .. stop - 1. `listed` is empty."""
    begin = start + (first + wp.tid()) * group
    end = wp.min(begin + group, stop)
    arrays = step_arrays(0, source, wave, queue, hits, rays)
    sent = sent_rays(following, is_alive)
    fetch_hits(scene, hits, begin, wp.min(begin + AHEAD, end))
    for i in range(begin, end):
        fetch_hits(scene, hits, i + AHEAD, wp.min(i + AHEAD + 1, end))
        if not step.is_last:
            rays.lit[i] = wp.vec3()
            rays.shadow_direction[i] = wp.vec3()
        shade_ray(i, i, i, step, scene, arrays, sent, listed)


@exact_kernel
def shade_by_light(
    first: int,
    start: int,
    stop: int,
    group: int,
    step: TreeStep,
    entry: int,
    scene: LitScene,
    source: PixelSamples,
    wave: Wave,
    queue: RayQueue,
    hits: HitBatch,
    rays: Gathered,
):
    """Writes the radiance that a further light gives at hits, and the shadow rays. Item: a group of the rays start .. stop -
    1."""
    begin = start + (first + wp.tid()) * group
    end = wp.min(begin + group, stop)
    arrays = step_arrays(0, source, wave, queue, hits, rays)
    fetch_hits(scene, hits, begin, wp.min(begin + AHEAD, end))
    for i in range(begin, end):
        fetch_hits(scene, hits, i + AHEAD, wp.min(i + AHEAD + 1, end))
        ray = ray_at_hit(scene, queue, hits, i)
        rays.lit[i] = wp.vec3()
        rays.shadow_direction[i] = wp.vec3()
        if ray.primitive >= 0:
            point = shading_point(scene.shaded, ray.primitive, ray.uv, ray.direction)
            material = material_at_point(scene, point)
            if not is_single(material):
                boundary = boundary_of(scene, material, ray.media, point.is_front)
                material.ratio = boundary.ratio
                if boundary.is_real:
                    hit = ShadedHit()
                    hit.ray = ray
                    hit.point = point
                    hit.material = material
                    write_light(step, entry, scene, source, branch_key(arrays, i), hit, i, rays)

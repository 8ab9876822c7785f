"""What a step of path tracing and one of Whitted's ray tracing have in common: the scene, what a ray collects on its way, light
that may arrive from a light, and the passage through a boundary."""

import warp as wp

from wrt.kernels.shading.bsdf.interior import leading_medium, with_medium, without_medium
from wrt.kernels.shading.bsdf.material_table import DIELECTRIC, MaterialAtHit, Materials, material_at
from wrt.kernels.shading.bsdf.scattering import base_value, is_single, scattering_value
from wrt.kernels.shading.emitters.environment import sky_density, sky_radiance
from wrt.kernels.shading.emitters.light_sampling import (
    crossed_light,
    power_weight,
    sample_light,
    triangle_light_density,
)
from wrt.kernels.shading.emitters.light_table import Lights, entry_probability
from wrt.kernels.shading.shading_point import ShadedMesh, ShadingPoint

AIR_INDEX = wp.constant(1.0)


@wp.struct
class LitScene:
    """A scene with materials and lights."""

    shaded: ShadedMesh
    materials: Materials
    lights: Lights
    schlick: bool
    """Whether Schlick's approximation replaces Fresnel's equations."""


@wp.struct
class Boundary:
    """What a dielectric surface is to a ray."""

    is_real: bool
    """False where a medium of higher priority is on both sides: the ray passes."""
    ratio: float
    """Index of refraction on the side of the ray, divided by that beyond."""
    media_beyond: wp.uint64
    """The media that contain the ray once it has passed."""


@wp.func
def absorbed(scene: LitScene, weight: wp.vec3, media: wp.uint64, distance: float):
    """The weight of a ray after a distance in its medium (Beer's law)."""
    result = weight
    medium = leading_medium(media, scene.materials.priority)
    if medium >= 0:
        a = scene.materials.absorption[medium]
        result = wp.cw_mul(weight, wp.vec3(wp.exp(-a[0] * distance), wp.exp(-a[1] * distance), wp.exp(-a[2] * distance)))
    return result


@wp.func
def crossed_lights(scene: LitScene, weight: wp.vec3, density: float, origin: wp.vec3, direction: wp.vec3, t: float):
    """Radiance of the lights that a ray crosses before it ends at t."""
    total = wp.vec3()
    for entry in range(scene.lights.areas):
        found = crossed_light(scene.lights, entry, origin, direction, t)
        share = float(1.0)
        if density > 0.0:
            share = power_weight(density, found[3] * entry_probability(scene.lights, entry))
        total += share * wp.cw_mul(weight, wp.vec3(found[0], found[1], found[2]))
    return total


@wp.func
def sky_light(scene: LitScene, weight: wp.vec3, density: float, direction: wp.vec3):
    """Light of the sky along a ray that leaves the scene."""
    result = wp.vec3()
    if scene.lights.sky_entry >= 0:
        share = float(1.0)
        if density > 0.0:
            other = sky_density(scene.lights.sky, direction) * entry_probability(scene.lights, scene.lights.sky_entry)
            share = power_weight(density, other)
        result = share * wp.cw_mul(weight, sky_radiance(scene.lights.sky, direction))
    return result


@wp.func
def surface_light(scene: LitScene, number: int, weight: wp.vec3, density: float, point: ShadingPoint, cosine: float, t: float):
    """Light that a surface emits along a ray.

    Args:
        number: its material.
        cosine: between the ray and the triangle's normal, positive.
    """
    result = wp.vec3()
    radiance = scene.materials.emission[number]
    if radiance[0] + radiance[1] + radiance[2] > 0.0 and (point.is_front or scene.materials.two_sided[number] != 0):
        share = float(1.0)
        if density > 0.0:
            other = triangle_light_density(scene.lights, radiance, t, cosine)
            share = power_weight(density, other * entry_probability(scene.lights, scene.lights.triangle_entry))
        result = share * wp.cw_mul(weight, radiance)
    return result


@wp.func
def may_emit(scene: LitScene, primitive: int):
    """Whether a triangle may emit light: False only if its material does not."""
    result = scene.lights.triangle_entry >= 0
    if result and scene.shaded.records.shape[0] > 0:
        radiance = scene.materials.emission[scene.materials.of_face[primitive * scene.materials.of_face_stride]]
        result = radiance[0] + radiance[1] + radiance[2] > 0.0
    return result


@wp.func
def boundary_of(scene: LitScene, material: MaterialAtHit, media: wp.uint64, is_front: bool):
    """What a dielectric surface is to a ray that meets its front from outside, or its back from inside."""
    result = Boundary()
    result.is_real = True
    result.ratio = 1.0
    result.media_beyond = media
    if material.kind == DIELECTRIC:
        priority = scene.materials.priority
        # what else is there: of two bodies of one material that overlap, the other one
        others = wp.uint64(media)
        if is_front:
            result.media_beyond = with_medium(media, material.number)
        else:
            others = without_medium(media, material.number)
            result.media_beyond = others
        other = leading_medium(others, priority)
        index = float(AIR_INDEX)
        if other >= 0:
            index = scene.materials.shape[other][2]
            result.is_real = priority[material.number] >= priority[other]
        result.ratio = wp.where(is_front, index / material.index, material.index / index)
    return result


@wp.func
def material_at_point(scene: LitScene, point: ShadingPoint):
    """The material at a point."""
    material = material_at(scene.materials, point.face, point.weights)
    material.schlick = scene.schlick
    return material


@wp.struct
class Arrival:
    """Light that may arrive at a point."""

    origin: wp.vec3
    segment: wp.vec3
    """From the origin to the light; 0 for none."""
    radiance: wp.vec3
    """What is gathered at the other end of the ray, per weight, if nothing is in between."""


@wp.func
def arriving_light(
    scene: LitScene,
    point: ShadingPoint,
    material: MaterialAtHit,
    out: wp.vec3,
    entry: int,
    place: wp.vec2,
    probability: float,
    is_combined: bool,
):
    """Radiance of a light that is scattered towards `out`.

    Args:
        entry: the light, and `place` the point on it, in [0, 1)^2.
        probability: with which this light was chosen.
        is_combined: whether rays find lights by scattering, too, so that both share the light by weights. If not, reflected and
            refracted rays alone find the lights that they can find, and the diffuse part of the surface is lit for here.
    """
    result = Arrival()
    if not is_single(material):
        origin = point.position + point.rise
        light = sample_light(scene.lights, scene.shaded, scene.materials, entry, origin, place)
        cosine_face = wp.dot(light.direction, point.face_normal)
        if light.density > 0.0 and (cosine_face > 0.0) == (wp.dot(light.direction, point.normal) > 0.0):
            found = wp.vec4()
            if is_combined or light.is_single:
                found = scattering_value(material, point.normal, out, light.direction)
            else:
                found = base_value(material, point.normal, out, light.direction)
            if found[3] > 0.0:
                side = wp.where(cosine_face > 0.0, point.offset, -point.offset)
                if cosine_face < 0.0:
                    origin = point.position
                share = 1.0 / (light.density * probability)
                if is_combined and not light.is_single:
                    share = share * power_weight(light.density * probability, found[3])
                shift = side * point.face_normal
                result.origin = origin + shift
                result.segment = light.segment - (result.origin - (point.position + point.rise))
                result.radiance = share * wp.cw_mul(wp.vec3(found[0], found[1], found[2]), light.radiance)
    return result

"""A point or direction on a light, as seen from a surface, with its density; and the density of what a ray found by itself.

The last two let paths combine both ways to find light, each with the weight of the power heuristic (Veach and Guibas 1995).

References: shirley-1996; veach-guibas-1995; turk-1990.
"""

import warp as wp

from wrt.kernels.query.hit_attributes import triangle_of
from wrt.kernels.shading.bsdf.ggx import tangent_of
from wrt.kernels.shading.bsdf.material_table import Materials
from wrt.kernels.shading.bsdf.scattering import luminance
from wrt.kernels.shading.emitters.environment import find_interval, sample_sky, sky_density, sky_radiance, within
from wrt.kernels.shading.emitters.light_table import (
    DIRECTIONAL,
    PARALLELOGRAM,
    POINT,
    SKY,
    SPHERE,
    SPOT,
    TRIANGLE,
    TRIANGLES,
    Lights,
)
from wrt.kernels.shading.sampling import TWO_PI, direction_of
from wrt.kernels.shading.shading_point import FaceRecord, ShadedMesh, record_of
from wrt.kernels.shading.surface import OFFSET
from wrt.kernels.simd.boxes import reach


@wp.struct
class LightSample:
    """Light that may reach a point."""

    segment: wp.vec3
    """From the point to the light, or as far as leaves the scene; 0 if there is no light."""
    direction: wp.vec3
    """Unit vector."""
    radiance: wp.vec3
    """Of points: intensity over squared distance; of directional lights: irradiance. Not yet divided by `density`."""
    density: float
    """Per solid angle; 1 for lights at single points or directions."""
    is_single: bool
    """Whether only this way finds the light."""


@wp.func
def power_weight(own: float, other: float):
    """Weight of a sample that one density gave, where another one could have, too."""
    square = own * own
    return square / wp.max(square + other * other, 1e-30)


@wp.func
def on_flat(
    target: wp.vec3, position: wp.vec3, normal: wp.vec3, area: float, radiance: wp.vec3, two_sided: bool, offset: float
):
    """A sample at a point of a flat light of this area; `offset` moves the end of the ray off it."""
    found = LightSample()
    toward = target - position
    distance = wp.length(toward)
    if distance > 0.0:
        found.direction = toward / distance
        cosine = -wp.dot(found.direction, normal)
        if two_sided:
            cosine = wp.abs(cosine)
        if cosine > 1e-6:
            side = wp.where(wp.dot(found.direction, normal) < 0.0, offset, -offset)
            found.segment = toward + side * normal
            found.radiance = radiance
            found.density = distance * distance / (cosine * area)
    return found


@wp.func
def folded(point: wp.vec2):
    """Maps [0, 1)^2 to the weights of a triangle's second and third corner, uniformly (Turk 1990)."""
    root = wp.sqrt(point[0])
    return wp.vec2(root * (1.0 - point[1]), root * point[1])


@wp.func
def sample_sphere(lights: Lights, entry: int, position: wp.vec3, point: wp.vec2):
    """A direction within the cone in which a sphere is seen; none from inside it."""
    found = LightSample()
    axis = lights.position[entry] - position
    distance = wp.length(axis)
    radius = lights.shape[entry][2]
    if distance > radius * 1.000001:
        sine = radius / distance
        cosine = wp.sqrt(wp.max(0.0, 1.0 - sine * sine))
        cap = sine * sine / (1.0 + cosine)  # 1 - cosine, without cancellation
        rest = point[0] * cap
        height = 1.0 - rest
        across = wp.sqrt(wp.max(0.0, rest * (1.0 + height)))
        forward = axis / distance
        tangent = tangent_of(forward)
        turn = direction_of(point[1])
        found.direction = wp.normalize(height * forward + across * (turn[0] * tangent + turn[1] * wp.cross(forward, tangent)))
        to_middle = height * distance
        found.segment = (to_middle - wp.sqrt(wp.max(0.0, radius * radius - distance * distance * across * across))) * (
            found.direction
        )
        found.radiance = lights.radiance[entry]
        found.density = 1.0 / (TWO_PI * cap)
    return found


@wp.func
def sample_triangles(lights: Lights, shaded: ShadedMesh, materials: Materials, position: wp.vec3, point: wp.vec2):
    """A point on the emissive triangles of the scene."""
    count = lights.triangle.shape[0]
    number = find_interval(lights.triangle_sums, 0, count, point[0])
    inner = wp.vec2(within(lights.triangle_sums, number, point[0]), point[1])
    primitive = lights.triangle[number]
    record = FaceRecord()
    face = int(primitive)
    if shaded.records.shape[0] > 0:
        record = shaded.records[primitive]
    else:
        triangle = triangle_of(shaded.mesh, primitive)
        face = triangle.face
        record = record_of(shaded.mesh, triangle)
    weights = folded(inner)
    target = record.corner + weights[0] * record.edge1 + weights[1] * record.edge2
    material = materials.of_face[face * materials.of_face_stride]
    radiance = materials.emission[material]
    offset = OFFSET * reach(target, shaded.mesh.low, shaded.mesh.high)
    area = lights.triangle_power / wp.max(luminance(radiance), 1e-30)  # 1 / probability per area
    return on_flat(target, position, record.normal, area, radiance, materials.two_sided[material] != 0, offset)


@wp.func
def sample_light(lights: Lights, shaded: ShadedMesh, materials: Materials, entry: int, position: wp.vec3, point: wp.vec2):
    """Light from an entry of the table.

    Args:
        lights, shaded, materials: the scene.
        entry: of the table.
        position: of the lit point, relative to the scene's centre.
        point: in [0, 1)^2.
    """
    found = LightSample()
    kind = lights.kind[entry]
    shape = lights.shape[entry]
    if kind == POINT or kind == SPOT:  # noqa: SIM109 - kernels have no `in`
        found.segment = lights.position[entry] - position
        square = wp.length_sq(found.segment)
        found.direction = wp.normalize(found.segment)
        found.radiance = lights.radiance[entry] / wp.max(square, 1e-30)
        if kind == SPOT:
            fade = (wp.dot(-found.direction, lights.axis[entry]) - shape[1]) / wp.max(shape[0] - shape[1], 1e-6)
            fade = wp.clamp(fade, 0.0, 1.0)
            found.radiance = found.radiance * (fade * fade * (3.0 - 2.0 * fade))
        found.density = 1.0
        found.is_single = True
    if kind == DIRECTIONAL:
        found.direction = -lights.axis[entry]
        found.segment = lights.far * found.direction
        found.radiance = lights.radiance[entry]
        found.density = 1.0
        found.is_single = True
    if kind == PARALLELOGRAM or kind == TRIANGLE:  # noqa: SIM109
        weights = point
        if kind == TRIANGLE:
            weights = folded(point)
        target = lights.position[entry] + weights[0] * lights.edge1[entry] + weights[1] * lights.edge2[entry]
        found = on_flat(target, position, lights.axis[entry], shape[2], lights.radiance[entry], shape[3] != 0.0, 0.0)
    if kind == SPHERE:
        found = sample_sphere(lights, entry, position, point)
    if kind == TRIANGLES:
        found = sample_triangles(lights, shaded, materials, position, point)
    if kind == SKY:
        found.direction = sample_sky(lights.sky, point)
        found.segment = lights.far * found.direction
        found.radiance = sky_radiance(lights.sky, found.direction)
        found.density = sky_density(lights.sky, found.direction)
    return found


@wp.func
def crossed_light(lights: Lights, entry: int, origin: wp.vec3, direction: wp.vec3, t_max: float):
    """A flat or round light that a ray crosses before t_max: its radiance, and in the last component the density with which
    `sample_light` finds the direction; 0 if it is not crossed or faces away."""
    result = wp.vec4()
    kind = lights.kind[entry]
    shape = lights.shape[entry]
    radiance = lights.radiance[entry]
    if kind == SPHERE:
        middle = lights.position[entry] - origin
        along = wp.dot(middle, direction)
        square = wp.length_sq(middle)
        radius = shape[2]
        miss = middle - along * direction
        rest = radius * radius - wp.length_sq(miss)
        if rest > 0.0 and square > radius * radius:
            t = along - wp.sqrt(rest)
            if t > 0.0 and t < t_max:
                sine = radius * radius / square
                density = (1.0 + wp.sqrt(1.0 - sine)) / (TWO_PI * sine)
                result = wp.vec4(radiance[0], radiance[1], radiance[2], density)
    else:
        normal = lights.axis[entry]
        slope = wp.dot(normal, direction)
        if (slope < 0.0 or shape[3] != 0.0) and wp.abs(slope) > 1e-6:
            corner = lights.position[entry] - origin
            t = wp.dot(corner, normal) / slope
            if t > 0.0 and t < t_max:
                at = t * direction - corner
                e1 = lights.edge1[entry]
                e2 = lights.edge2[entry]
                across = wp.cross(e1, e2)
                scale = 1.0 / wp.length_sq(across)
                u = wp.dot(wp.cross(at, e2), across) * scale
                v = wp.dot(wp.cross(e1, at), across) * scale
                limit = wp.where(kind == TRIANGLE, u + v, wp.max(u, v))
                if u >= 0.0 and v >= 0.0 and limit <= 1.0:
                    density = t * t / (wp.abs(slope) * shape[2])
                    result = wp.vec4(radiance[0], radiance[1], radiance[2], density)
    return result


@wp.func
def triangle_light_density(lights: Lights, radiance: wp.vec3, t: float, cosine: float):
    """Density per solid angle with which `sample_light` finds the point of an emissive triangle that a ray hit at distance
    t."""
    return t * t * luminance(radiance) / (wp.max(cosine, 1e-6) * lights.triangle_power)

"""Scattering at a point: its value for two directions, the density of its samples, and the samples.

Directions are unit vectors away from the surface; `normal` is on the side of `out`, from where the light is gathered. Values
include the cosine to the normal. Mirrors and smooth dielectrics scatter to single directions: their samples have the density
0, which stands for "no other way to find this direction".

* **Diffuse**: Lambert. The share `translucency` leaves on the other side, as diffusely.
* **Glossy**: facets (GGX) that reflect by Schlick's approximation, over a diffuse base: the metallic-roughness material of
  glTF. The base gets what a smooth surface lets in and out, at the angles to its normal (Ashikhmin and Shirley 2000). glTF
  takes the angle to the facet, and then a white base under grazing light sends back up to 3 % more than it receives.
* **Dielectric**: smooth, or of facets that reflect and refract (Walter et al. 2007). Refraction into a medium compresses
  radiance by the square of the ratio of indices; leaving it undoes that (Veach 1997).

References: ashikhmin-shirley-2000; lambert-1760; walter-2007; khronos-gltf-2021.
"""

import warp as wp

from wrt.kernels.shading.bsdf.fresnel import dielectric_share, mirrored, refracted, schlick_color
from wrt.kernels.shading.bsdf.ggx import PI, facet_density, masking, masking_and_shadowing, visible_facet
from wrt.kernels.shading.bsdf.material_table import DIELECTRIC, DIFFUSE, GLOSSY, MIRROR, MaterialAtHit
from wrt.kernels.shading.sampling import cosine_direction


@wp.struct
class Scattering:
    """A sampled direction."""

    direction: wp.vec3
    weight: wp.vec3
    """Value over density; 0 if the sample failed."""
    density: float
    """Per solid angle; 0 for single directions."""
    is_transmitted: bool


@wp.func
def largest(color: wp.vec3):
    """The largest of three components."""
    return wp.max(color[0], wp.max(color[1], color[2]))


@wp.func
def luminance(color: wp.vec3):
    """Brightness of linear colours (Rec. 709)."""
    return 0.2126 * color[0] + 0.7152 * color[1] + 0.0722 * color[2]


@wp.func
def facet_color(material: MaterialAtHit):
    """What the facets of a glossy surface reflect at normal incidence."""
    at_normal = (material.index - 1.0) / (material.index + 1.0)
    return (1.0 - material.metallic) * at_normal * at_normal * wp.vec3(1.0, 1.0, 1.0) + material.metallic * material.color


@wp.func
def facet_probability(material: MaterialAtHit, cosine: float):
    """Share of the samples of a glossy surface that are reflected by facets."""
    base = (1.0 - material.metallic) * luminance(material.color)
    facets = luminance(schlick_color(facet_color(material), cosine))
    share = wp.clamp(facets / wp.max(facets + base * (1.0 - facets), 1e-6), 0.1, 0.9)
    return wp.where(base > 0.0, share, 1.0)


@wp.func
def is_single(material: MaterialAtHit):
    """Whether light is scattered to single directions only."""
    return material.kind == MIRROR or (material.kind == DIELECTRIC and material.alpha == 0.0)


@wp.func
def diffuse_value(material: MaterialAtHit, cosine: float):
    """Value and density (in the last component) of a diffuse surface; a negative cosine is on the other side."""
    share = wp.where(cosine > 0.0, 1.0 - material.translucency, material.translucency)
    density = share * wp.abs(cosine) / PI
    return wp.vec4(material.color[0] * density, material.color[1] * density, material.color[2] * density, density)


@wp.func
def glossy_base(material: MaterialAtHit, cosine: float, cosine_out: float):
    """Value of the diffuse base of a glossy surface, for the cosines to its normal."""
    white = wp.vec3(1.0, 1.0, 1.0)
    color = facet_color(material)
    enters = wp.cw_mul(white - schlick_color(color, cosine), white - schlick_color(color, cosine_out))
    return (1.0 - material.metallic) * cosine / PI * wp.cw_mul(enters, material.color)


@wp.func
def glossy_value(material: MaterialAtHit, normal: wp.vec3, out: wp.vec3, toward: wp.vec3):
    """Value and density of a glossy surface."""
    result = wp.vec4()
    cosine = wp.dot(normal, toward)
    cosine_out = wp.dot(normal, out)
    if cosine > 0.0 and cosine_out > 0.0:
        facet = wp.normalize(out + toward)
        fresnel = schlick_color(facet_color(material), wp.dot(out, facet))
        facets = facet_density(wp.dot(normal, facet), material.alpha) / (4.0 * cosine_out)
        value = facets * masking_and_shadowing(cosine, cosine_out, material.alpha) * fresnel
        value += glossy_base(material, cosine, cosine_out)
        share = facet_probability(material, cosine_out)
        density = share * facets * masking(cosine_out, material.alpha) + (1.0 - share) * cosine / PI
        result = wp.vec4(value[0], value[1], value[2], density)
    return result


@wp.func
def base_value(material: MaterialAtHit, normal: wp.vec3, out: wp.vec3, toward: wp.vec3):
    """Value of the diffuse part of a surface alone, with a density above 0 if there is one."""
    result = wp.vec4()
    cosine = wp.dot(normal, toward)
    if material.kind == DIFFUSE:
        result = diffuse_value(material, cosine)
    if material.kind == GLOSSY and cosine > 0.0 and material.metallic < 1.0:
        value = glossy_base(material, cosine, wp.max(0.0, wp.dot(normal, out)))
        result = wp.vec4(value[0], value[1], value[2], cosine / PI)
    return result


@wp.func
def rough_dielectric_value(material: MaterialAtHit, normal: wp.vec3, out: wp.vec3, toward: wp.vec3):
    """Value and density of a rough boundary, for directions on either side."""
    result = wp.vec4()
    cosine = wp.dot(normal, toward)
    cosine_out = wp.dot(normal, out)
    if cosine_out > 0.0 and cosine != 0.0:
        reflects = cosine > 0.0
        facet = wp.normalize(wp.where(reflects, out + toward, material.ratio * out + toward))
        if wp.dot(facet, normal) < 0.0:
            facet = -facet
        to_out = wp.dot(out, facet)
        beyond = wp.dot(toward, facet)
        if to_out > 0.0 and ((beyond > 0.0) == reflects):
            share = dielectric_share(to_out, material.ratio, material.schlick)
            jacobian = 0.25 / cosine_out
            compression = float(1.0)
            if not reflects:
                share = 1.0 - share
                path = material.ratio * to_out + beyond
                jacobian = to_out * wp.abs(beyond) / (wp.max(path * path, 1e-12) * cosine_out)
                compression = material.ratio * material.ratio
            facets = share * facet_density(wp.dot(normal, facet), material.alpha) * jacobian
            value = facets * compression * masking_and_shadowing(cosine, cosine_out, material.alpha)
            density = facets * masking(cosine_out, material.alpha)
            result = wp.vec4(material.color[0] * value, material.color[1] * value, material.color[2] * value, density)
    return result


@wp.func
def scattering_value(material: MaterialAtHit, normal: wp.vec3, out: wp.vec3, toward: wp.vec3):
    """Value (three components) and density (the fourth) for two directions; 0 for what scatters to single directions."""
    result = wp.vec4()
    if material.kind == DIFFUSE:
        result = diffuse_value(material, wp.dot(normal, toward))
    if material.kind == GLOSSY:
        result = glossy_value(material, normal, out, toward)
    if material.kind == DIELECTRIC and material.alpha > 0.0:
        result = rough_dielectric_value(material, normal, out, toward)
    return result


@wp.func
def sample_boundary(material: MaterialAtHit, facet: wp.vec3, out: wp.vec3, choice: float):
    """Reflection or refraction at a smooth boundary, or at one facet of a rough one, chosen by its share."""
    result = Scattering()
    share = dielectric_share(wp.abs(wp.dot(out, facet)), material.ratio, material.schlick)
    if choice < share:
        result.direction = mirrored(out, facet)
        result.weight = material.color
    else:
        result.direction = refracted(out, facet, material.ratio)
        result.weight = material.ratio * material.ratio * material.color
        result.is_transmitted = True
    return result


@wp.func
def sample_rough(material: MaterialAtHit, normal: wp.vec3, out: wp.vec3, point: wp.vec2, choice: float):
    """A sample of a rough dielectric."""
    facet = visible_facet(out, normal, material.alpha, point)
    result = sample_boundary(material, facet, out, choice)
    cosine = wp.dot(result.direction, normal)
    found = rough_dielectric_value(material, normal, out, result.direction)
    if (cosine < 0.0) == result.is_transmitted and found[3] > 0.0:
        result.weight = wp.vec3(found[0], found[1], found[2]) / found[3]
        result.density = found[3]
    else:
        result.weight = wp.vec3()
    return result


@wp.func
def sample_glossy(material: MaterialAtHit, normal: wp.vec3, out: wp.vec3, point: wp.vec2, choice: float):
    """A sample of a glossy surface: of its facets or of its diffuse base."""
    result = Scattering()
    direction = wp.vec3()
    if choice < facet_probability(material, wp.dot(out, normal)):
        direction = mirrored(out, visible_facet(out, normal, material.alpha, point))
    else:
        direction = cosine_direction(normal, point)
    found = glossy_value(material, normal, out, direction)
    result.direction = direction
    if found[3] > 0.0:
        result.weight = wp.vec3(found[0], found[1], found[2]) / found[3]
        result.density = found[3]
    return result


@wp.func
def sample_scattering(material: MaterialAtHit, normal: wp.vec3, out: wp.vec3, point: wp.vec2, choice: float):
    """A direction with a density that follows the value.

    Args:
        material: of the point.
        normal: unit vector on the side of `out`.
        out: unit vector towards where the light is gathered.
        point: in [0, 1)^2, the direction within a lobe.
        choice: in [0, 1), the lobe.
    """
    result = Scattering()
    if material.kind == DIFFUSE:
        result.is_transmitted = choice < material.translucency
        result.direction = cosine_direction(wp.where(result.is_transmitted, -normal, normal), point)
        result.weight = material.color
        share = wp.where(result.is_transmitted, material.translucency, 1.0 - material.translucency)
        result.density = share * wp.abs(wp.dot(result.direction, normal)) / PI
    if material.kind == MIRROR:
        result.direction = mirrored(out, normal)
        result.weight = material.color
    if material.kind == GLOSSY:
        result = sample_glossy(material, normal, out, point, choice)
    if material.kind == DIELECTRIC:
        if material.alpha > 0.0:
            result = sample_rough(material, normal, out, point, choice)
        else:
            result = sample_boundary(material, normal, out, choice)
    return result

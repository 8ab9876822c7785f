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

References:
    M. Ashikhmin, P. Shirley: An anisotropic Phong BRDF model. Journal of Graphics Tools 5(2), 2000.
    J. H. Lambert: Photometria. 1760.
    B. Walter, S. Marschner, H. Li, K. Torrance: Microfacet models for refraction through rough surfaces. EGSR 2007.
    Khronos Group: glTF 2.0 specification, appendix B, BRDF implementation. 2021.
"""

import warp as wp

from wrt.kernels.runtime.options import exact_module
from wrt.kernels.shading.bsdf.fresnel import dielectric_share, mirrored, refracted, schlick_color
from wrt.kernels.shading.bsdf.ggx import PI, facet_density, masking, masking_and_shadowing, visible_facet
from wrt.kernels.shading.bsdf.material_table import DIELECTRIC, DIFFUSE, GLOSSY, MIRROR, Look
from wrt.kernels.shading.sampling import cosine_direction

exact_module(__name__)


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
def facet_color(look: Look):
    """What the facets of a glossy surface reflect at normal incidence."""
    least = (look.index - 1.0) / (look.index + 1.0)
    return (1.0 - look.metallic) * least * least * wp.vec3(1.0, 1.0, 1.0) + look.metallic * look.color


@wp.func
def facet_probability(look: Look, cosine: float):
    """Share of the samples of a glossy surface that are reflected by facets."""
    base = (1.0 - look.metallic) * luminance(look.color)
    facets = luminance(schlick_color(facet_color(look), cosine))
    share = wp.clamp(facets / wp.max(facets + base * (1.0 - facets), 1e-6), 0.1, 0.9)
    return wp.where(base > 0.0, share, 1.0)


@wp.func
def is_single(look: Look):
    """Whether light is scattered to single directions only."""
    return look.kind == MIRROR or (look.kind == DIELECTRIC and look.alpha == 0.0)


@wp.func
def diffuse_value(look: Look, cosine: float):
    """Value and density (in the last component) of a diffuse surface; a negative cosine is on the other side."""
    share = wp.where(cosine > 0.0, 1.0 - look.translucency, look.translucency)
    density = share * wp.abs(cosine) / PI
    return wp.vec4(look.color[0] * density, look.color[1] * density, look.color[2] * density, density)


@wp.func
def glossy_base(look: Look, cosine: float, cosine_out: float):
    """Value of the diffuse base of a glossy surface, for the cosines to its normal."""
    white = wp.vec3(1.0, 1.0, 1.0)
    color = facet_color(look)
    enters = wp.cw_mul(white - schlick_color(color, cosine), white - schlick_color(color, cosine_out))
    return (1.0 - look.metallic) * cosine / PI * wp.cw_mul(enters, look.color)


@wp.func
def glossy_value(look: Look, normal: wp.vec3, out: wp.vec3, toward: wp.vec3):
    """Value and density of a glossy surface."""
    result = wp.vec4()
    cosine = wp.dot(normal, toward)
    cosine_out = wp.dot(normal, out)
    if cosine > 0.0 and cosine_out > 0.0:
        facet = wp.normalize(out + toward)
        fresnel = schlick_color(facet_color(look), wp.dot(out, facet))
        facets = facet_density(wp.dot(normal, facet), look.alpha) / (4.0 * cosine_out)
        value = facets * masking_and_shadowing(cosine, cosine_out, look.alpha) * fresnel
        value += glossy_base(look, cosine, cosine_out)
        share = facet_probability(look, cosine_out)
        density = share * facets * masking(cosine_out, look.alpha) + (1.0 - share) * cosine / PI
        result = wp.vec4(value[0], value[1], value[2], density)
    return result


@wp.func
def base_value(look: Look, normal: wp.vec3, out: wp.vec3, toward: wp.vec3):
    """Value of the diffuse part of a surface alone, with a density above 0 if there is one."""
    result = wp.vec4()
    cosine = wp.dot(normal, toward)
    if look.kind == DIFFUSE:
        result = diffuse_value(look, cosine)
    if look.kind == GLOSSY and cosine > 0.0 and look.metallic < 1.0:
        value = glossy_base(look, cosine, wp.max(0.0, wp.dot(normal, out)))
        result = wp.vec4(value[0], value[1], value[2], cosine / PI)
    return result


@wp.func
def rough_dielectric_value(look: Look, normal: wp.vec3, out: wp.vec3, toward: wp.vec3):
    """Value and density of a rough boundary, for directions on either side."""
    result = wp.vec4()
    cosine = wp.dot(normal, toward)
    cosine_out = wp.dot(normal, out)
    if cosine_out > 0.0 and cosine != 0.0:
        reflects = cosine > 0.0
        facet = wp.normalize(wp.where(reflects, out + toward, look.ratio * out + toward))
        if wp.dot(facet, normal) < 0.0:
            facet = -facet
        to_out = wp.dot(out, facet)
        beyond = wp.dot(toward, facet)
        if to_out > 0.0 and ((beyond > 0.0) == reflects):
            share = dielectric_share(to_out, look.ratio, look.schlick)
            jacobian = 0.25 / cosine_out
            compression = float(1.0)
            if not reflects:
                share = 1.0 - share
                path = look.ratio * to_out + beyond
                jacobian = to_out * wp.abs(beyond) / (wp.max(path * path, 1e-12) * cosine_out)
                compression = look.ratio * look.ratio
            facets = share * facet_density(wp.dot(normal, facet), look.alpha) * jacobian
            value = facets * compression * masking_and_shadowing(cosine, cosine_out, look.alpha)
            density = facets * masking(cosine_out, look.alpha)
            result = wp.vec4(look.color[0] * value, look.color[1] * value, look.color[2] * value, density)
    return result


@wp.func
def scattering_value(look: Look, normal: wp.vec3, out: wp.vec3, toward: wp.vec3):
    """Value (three components) and density (the fourth) for two directions; 0 for what scatters to single directions."""
    result = wp.vec4()
    if look.kind == DIFFUSE:
        result = diffuse_value(look, wp.dot(normal, toward))
    if look.kind == GLOSSY:
        result = glossy_value(look, normal, out, toward)
    if look.kind == DIELECTRIC and look.alpha > 0.0:
        result = rough_dielectric_value(look, normal, out, toward)
    return result


@wp.func
def sample_boundary(look: Look, facet: wp.vec3, out: wp.vec3, choice: float):
    """Reflection or refraction at a smooth boundary, or at one facet of a rough one, chosen by its share."""
    result = Scattering()
    share = dielectric_share(wp.abs(wp.dot(out, facet)), look.ratio, look.schlick)
    if choice < share:
        result.direction = mirrored(out, facet)
        result.weight = look.color
    else:
        result.direction = refracted(out, facet, look.ratio)
        result.weight = look.ratio * look.ratio * look.color
        result.is_transmitted = True
    return result


@wp.func
def sample_rough(look: Look, normal: wp.vec3, out: wp.vec3, point: wp.vec2, choice: float):
    """A sample of a rough dielectric."""
    facet = visible_facet(out, normal, look.alpha, point)
    result = sample_boundary(look, facet, out, choice)
    cosine = wp.dot(result.direction, normal)
    found = rough_dielectric_value(look, normal, out, result.direction)
    if (cosine < 0.0) == result.is_transmitted and found[3] > 0.0:
        result.weight = wp.vec3(found[0], found[1], found[2]) / found[3]
        result.density = found[3]
    else:
        result.weight = wp.vec3()
    return result


@wp.func
def sample_glossy(look: Look, normal: wp.vec3, out: wp.vec3, point: wp.vec2, choice: float):
    """A sample of a glossy surface: of its facets or of its diffuse base."""
    result = Scattering()
    direction = wp.vec3()
    if choice < facet_probability(look, wp.dot(out, normal)):
        direction = mirrored(out, visible_facet(out, normal, look.alpha, point))
    else:
        direction = cosine_direction(normal, point)
    found = glossy_value(look, normal, out, direction)
    result.direction = direction
    if found[3] > 0.0:
        result.weight = wp.vec3(found[0], found[1], found[2]) / found[3]
        result.density = found[3]
    return result


@wp.func
def sample_scattering(look: Look, normal: wp.vec3, out: wp.vec3, point: wp.vec2, choice: float):
    """A direction with a density that follows the value.

    Args:
        look: of the point.
        normal: unit vector on the side of `out`.
        out: unit vector towards where the light is gathered.
        point: in [0, 1)^2, the direction within a lobe.
        choice: in [0, 1), the lobe.
    """
    result = Scattering()
    if look.kind == DIFFUSE:
        result.is_transmitted = choice < look.translucency
        result.direction = cosine_direction(wp.where(result.is_transmitted, -normal, normal), point)
        result.weight = look.color
        share = wp.where(result.is_transmitted, look.translucency, 1.0 - look.translucency)
        result.density = share * wp.abs(wp.dot(result.direction, normal)) / PI
    if look.kind == MIRROR:
        result.direction = mirrored(out, normal)
        result.weight = look.color
    if look.kind == GLOSSY:
        result = sample_glossy(look, normal, out, point, choice)
    if look.kind == DIELECTRIC:
        if look.alpha > 0.0:
            result = sample_rough(look, normal, out, point, choice)
        else:
            result = sample_boundary(look, normal, out, choice)
    return result

"""Reflection and refraction at smooth boundaries: directions, and the share of light that is reflected.

`mirrored`, `refracted` and `fresnel_exact` stand in `kernels/native/scattering.h` for W rays in lanes: the same operations in
the same order.

References: fresnel-1823; schlick-1994; veach-1997 (section 5.2, radiance across boundaries).
"""

import warp as wp


@wp.func
def mirrored(out: wp.vec3, normal: wp.vec3):
    """The mirror image of `out` about a unit normal; both point away from the surface."""
    return 2.0 * wp.dot(out, normal) * normal - out


@wp.func
def refracted(out: wp.vec3, normal: wp.vec3, ratio: float):
    """Snell's law: the direction beyond the boundary; 0 at total internal reflection.

    Args:
        out: unit vector away from the surface, on the side of `normal`.
        ratio: index of refraction on the side of `out`, divided by that beyond.
    """
    cosine = wp.dot(out, normal)
    beyond = 1.0 - ratio * ratio * wp.max(0.0, 1.0 - cosine * cosine)
    result = wp.vec3()
    if beyond > 0.0:
        result = (ratio * cosine - wp.sqrt(beyond)) * normal - ratio * out
    return result


@wp.func
def fresnel_exact(cosine: float, ratio: float):
    """Share of unpolarised light that a dielectric reflects; 1 at total internal reflection.

    Args:
        cosine: of the angle to the normal, on the side of the ray, in [0, 1].
        ratio: index of refraction on that side, divided by that beyond.
    """
    beyond = 1.0 - ratio * ratio * (1.0 - cosine * cosine)
    share = float(1.0)
    if beyond > 0.0:
        other = wp.sqrt(beyond)
        parallel = (cosine - ratio * other) / (cosine + ratio * other)
        perpendicular = (ratio * cosine - other) / (ratio * cosine + other)
        share = 0.5 * (parallel * parallel + perpendicular * perpendicular)
    return share


@wp.func
def fifth_power(cosine: float):
    """(1 - cosine)^5, the weight of white in Schlick's approximation."""
    rest = wp.clamp(1.0 - cosine, 0.0, 1.0)
    square = rest * rest
    return square * square * rest


@wp.func
def fresnel_schlick(cosine: float, ratio: float):
    """Schlick's approximation of `fresnel_exact`. In the denser medium it takes the cosine beyond the boundary."""
    beyond = 1.0 - ratio * ratio * (1.0 - cosine * cosine)
    share = float(1.0)
    if beyond > 0.0:
        at_normal = (ratio - 1.0) / (ratio + 1.0)
        at_normal = at_normal * at_normal
        share = at_normal + (1.0 - at_normal) * fifth_power(wp.where(ratio > 1.0, wp.sqrt(beyond), cosine))
    return share


@wp.func
def dielectric_share(cosine: float, ratio: float, schlick: bool):
    """Share of light that is reflected, by Fresnel's equations or by Schlick's approximation."""
    share = fresnel_exact(cosine, ratio)
    if schlick:
        share = fresnel_schlick(cosine, ratio)
    return share


@wp.func
def schlick_color(color: wp.vec3, cosine: float):
    """Schlick's approximation for a surface that reflects `color` at normal incidence."""
    return color + fifth_power(cosine) * (wp.vec3(1.0, 1.0, 1.0) - color)

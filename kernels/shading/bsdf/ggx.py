"""Rough surfaces of microscopic facets: the GGX distribution with Smith's shadowing and masking.

`alpha` is the width of the distribution. Materials give a roughness, of which alpha is the square. Facets are sampled among
those that are seen from a direction, by spherical caps; the weight of a sample is then the share that is not shadowed.

References: smith-1967; trowbridge-reitz-1975; walter-2007; heitz-2014; dupuy-benyoub-2023.
"""

import warp as wp

from wrt.kernels.shading.sampling import direction_of

PI = wp.constant(3.141592653589793)

MIN_ALPHA = wp.constant(1e-3)
"""Smoother surfaces count as mirrors and smooth boundaries: float32 does not resolve their highlights."""


@wp.func
def facet_density(cosine: float, alpha: float):
    """Density of facet normals at an angle to the surface's normal, per projected area of the surface."""
    square = alpha * alpha
    # (cosine^2 (alpha^2 - 1) + 1) loses its digits near cosine 1; this form does not
    rest = wp.max(0.0, 1.0 - cosine * cosine) + square * cosine * cosine
    return square / (PI * rest * rest)


@wp.func
def smith_lambda(cosine: float, alpha: float):
    """Smith's ratio of hidden to visible facets for a direction at this angle to the normal."""
    square = cosine * cosine
    tangent = alpha * alpha * wp.max(0.0, 1.0 - square) / wp.max(square, 1e-12)
    return 0.5 * (wp.sqrt(1.0 + tangent) - 1.0)


@wp.func
def masking(cosine: float, alpha: float):
    """Share of facets that are visible from a direction."""
    return 1.0 / (1.0 + smith_lambda(cosine, alpha))


@wp.func
def masking_and_shadowing(cosine_a: float, cosine_b: float, alpha: float):
    """Share of facets that are visible from two directions, correlated by height."""
    return 1.0 / (1.0 + smith_lambda(wp.abs(cosine_a), alpha) + smith_lambda(wp.abs(cosine_b), alpha))


@wp.func
def tangent_of(normal: wp.vec3):
    """A unit vector orthogonal to a unit normal (Duff et al. 2017)."""
    sign = wp.where(normal[2] < 0.0, -1.0, 1.0)
    a = -1.0 / (sign + normal[2])
    return wp.vec3(1.0 + sign * normal[0] * normal[0] * a, sign * normal[0] * normal[1] * a, -sign * normal[0])


@wp.func
def visible_facet(out: wp.vec3, normal: wp.vec3, alpha: float, point: wp.vec2):
    """Maps [0, 1)^2 to the unit normal of a facet that is visible from `out`, with the density `masking * facet_density *
    dot(out, facet) / dot(out, normal)`."""
    tangent = tangent_of(normal)
    bitangent = wp.cross(normal, tangent)
    x = alpha * wp.dot(out, tangent)
    y = alpha * wp.dot(out, bitangent)
    stretched = wp.normalize(wp.vec3(x, y, wp.dot(out, normal)))
    turn = direction_of(point[0])
    z = (1.0 - point[1]) * (1.0 + stretched[2]) - stretched[2]
    radius = wp.sqrt(wp.clamp(1.0 - z * z, 0.0, 1.0))
    cap = wp.vec3(radius * turn[0], radius * turn[1], z) + stretched
    return wp.normalize(alpha * cap[0] * tangent + alpha * cap[1] * bitangent + wp.max(cap[2], 1e-7) * normal)

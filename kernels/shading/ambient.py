"""Ambient occlusion: the share of the light of a uniform sky that reaches a point.

The share is the integral of visibility times cosine over the hemisphere. Rays are drawn with a density proportional to the
cosine, so the estimate is the share of rays that leave the scene (or travel farther than a given distance).

References:
    S. Zhukov, A. Iones, G. Kronin: An ambient light illumination model. Eurographics Workshop on Rendering, 1998.
    H. Landis: Production-ready global illumination. SIGGRAPH course 16, 2002.
"""

import warp as wp

from wrt.kernels.runtime.options import exact_module
from wrt.kernels.shading.sampling import cosine_direction, mix, spread_point
from wrt.kernels.shading.surface import Surface

exact_module(__name__)


@wp.kernel
def ambient_directions(
    first: int,
    surface: Surface,
    first_pixel: int,
    seed: wp.uint32,
    index: int,
    directions: wp.array(dtype=wp.vec3),
):
    """Item: a point. Writes direction number `index` of its pixel's sequence; 0 for a miss.

    Directions about a smooth normal that point into the triangle are mirrored at its plane.
    """
    i = first + wp.tid()
    face_normal = surface.face_normal[i]
    direction = wp.vec3()
    if wp.length_sq(face_normal) > 0.0:
        point = spread_point(index, mix(wp.uint32(first_pixel + i), seed))
        direction = cosine_direction(surface.normal[i], point)
        direction -= 2.0 * wp.min(0.0, wp.dot(direction, face_normal)) * face_normal
    directions[i] = direction


@wp.kernel
def count_open(first: int, occluded: wp.array(dtype=wp.bool), open_rays: wp.array(dtype=int)):
    """Item: a point. Counts the ray if it is not occluded."""
    i = first + wp.tid()
    if not occluded[i]:
        open_rays[i] += 1

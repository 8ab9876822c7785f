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
def ambient_rays(
    first: int,
    surface: Surface,
    points: wp.array(dtype=int),
    center: wp.vec3d,
    first_pixel: int,
    seed: wp.uint32,
    index: int,
    count: int,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
):
    """Item: one of the points that were hit. Writes `count` of its ambient rays, from direction number `index` of its pixel's
    sequence on; origins are relative to the scene's centre.

    Directions about a smooth normal that point into the triangle are mirrored at its plane.
    """
    item = first + wp.tid()
    i = points[item]
    face_normal = surface.face_normal[i]
    normal = surface.normal[i]
    origin = wp.vec3(surface.origin[i] - center)
    pixel = mix(wp.uint32(first_pixel + i), seed)
    for k in range(count):
        direction = cosine_direction(normal, spread_point(index + k, pixel))
        direction -= 2.0 * wp.min(0.0, wp.dot(direction, face_normal)) * face_normal
        origins[item * count + k] = origin
        directions[item * count + k] = direction


@wp.kernel
def count_open(
    first: int, points: wp.array(dtype=int), count: int, occluded: wp.array(dtype=wp.bool), open_rays: wp.array(dtype=int)
):
    """Item: one of the points that were hit. Adds the number of its `count` rays that are not occluded."""
    item = first + wp.tid()
    found = int(0)
    for k in range(count):
        if not occluded[item * count + k]:
            found += 1
    open_rays[points[item]] += found

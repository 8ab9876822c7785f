"""Ambient occlusion: the share of the light of a uniform sky that reaches a point.

The share is the integral of visibility times cosine over the hemisphere. Rays are drawn with a density proportional to the
cosine, so the estimate is the share of rays that leave the scene (or travel farther than a given distance).

References: zhukov-1998; landis-2002.
"""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.shading.sampling import cosine_direction, mix, spread_point
from wrt.kernels.shading.surface import Surface


@exact_kernel
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


@exact_kernel
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


SHARES = wp.constant(256)
"""Parts of an ambient ray that `share_open` counts in."""

MIN_COSINE, MAX_SLOPE = wp.constant(0.9), wp.constant(0.2)
"""Of the normals of two points that see the sky alike, and of the line between them above the plane of one of them."""


MIN_ALIKE = wp.constant(8)
"""Points that are alike; where there are fewer, all in the window are asked."""


@exact_kernel
def share_open(
    first: int,
    surface: Surface,
    first_pixel: int,
    width: int,
    radius: int,
    open_rays: wp.array(dtype=int),
    shared: wp.array(dtype=int),
):
    """Item: a point. Writes the mean number of open rays, in parts of 1 / `SHARES`, of the points within `radius` rows and
    columns of its pixel that lie on the same smooth surface: their normals are alike, and they lie near its plane. Of a
    surface as thin as a few pixels, there are too few; then all points in the window count.

    Few rays a point leave it black or bright by chance; neighbours know better together. Points beyond the ends of the tile
    are left out.
    """
    item = first + wp.tid()
    normal = surface.normal[item]
    found = int(0)
    count = int(0)
    found_alike = int(0)
    alike = int(0)
    if wp.length_sq(surface.face_normal[item]) > 0.0:
        origin = surface.origin[item]
        pixel = first_pixel + item
        row = pixel / width
        column = pixel % width
        for below in range(-radius, radius + 1):
            for beside in range(-radius, radius + 1):
                other = (row + below) * width + column + beside - first_pixel
                inside = column + beside >= 0 and column + beside < width and row + below >= 0
                if inside and other >= 0 and other < open_rays.shape[0]:  # noqa: SIM102 - in a kernel, `and` evaluates both sides
                    if wp.length_sq(surface.face_normal[other]) > 0.0:
                        found += open_rays[other]
                        count += 1
                        between = wp.vec3(surface.origin[other] - origin)
                        slope = wp.abs(wp.dot(normal, between)) - MAX_SLOPE * wp.length(between)
                        if wp.dot(normal, surface.normal[other]) >= MIN_COSINE and slope <= 0.0:
                            found_alike += open_rays[other]
                            alike += 1
    if alike >= MIN_ALIKE:
        found = found_alike
        count = alike
    if count > 0:
        shared[item] = (SHARES * found + count / 2) / count
    else:
        shared[item] = 0

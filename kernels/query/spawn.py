"""Where a ray starts that leaves a surface: near it, and on the right side of it, whatever the rounding.

**Problem.** A ray that starts in a surface must neither meet that surface again (black speckles) nor start behind another one
(light leaks). A fixed distance is wrong at some scale.

**Bound.** A hit's point follows from its weights in float64, so that it is off its triangle's plane only by the rounding of the
origin to float32. What matters more is the triangle test of the next ray: it is exact for vertices that are moved by a few
units in the last place of the largest coordinate they have as seen from the origin, and so moves the surface by as much at
most, at grazing angles too. The reach of the point in the scene bounds that coordinate for every triangle there is (so it does
the rounding of the origin), and a share of it is the distance along the geometric normal at which the ray starts: Waechter and
Binder bound in units in the last place too, but of the coordinates of the point alone.

Slivers need more. Rounding shifts an edge of length L by some units in the last place of L; in a triangle of height h that
moves the weights by L / h of such units, and the hit along the triangle's length by L of that again: `SLIVER L^2 / h`. More
than a quarter of h is not taken: beyond, at L / h of a thousand, no offset is right.

That is not enough in a corner of two walls: a point in one wall, a hair from the other, may be moved or rounded to
beyond the other. So a point keeps `INSET` offsets away from the edges of its triangle, as far as the triangle has room.

References:
    C. Waechter, N. Binder: A fast and robust method for avoiding self-intersection. Ray Tracing Gems, 2019.
    M. Pharr, W. Jakob, G. Humphreys: Physically based rendering: from theory to implementation, 3rd edition. Morgan Kaufmann,
        2016 (section 3.9, bounds of rounding errors).
"""

import warp as wp

from wrt.kernels.layout.ray_batch import TINY
from wrt.kernels.query.hit_attributes import SceneMesh, triangle_of
from wrt.kernels.simd.boxes import reach

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

OFFSET = wp.constant(2.0**-21)
"""Distance of origins from the surface, as a share of the point's reach: eight roundings of half a unit in the last place."""

SLIVER = wp.constant(2.0**-22)
"""Units in the last place, times a few."""

INSET = wp.constant(4.0)
"""Distance of origins from the edges of their triangle, in offsets."""


@wp.func
def origin_offset(share: float, at: wp.vec3, low: wp.vec3, high: wp.vec3, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """Distance from a triangle at which rays from the point `at` on it start: a share of its reach, more for slivers."""
    longest = float(wp.max(wp.length(c - b), wp.max(wp.length(a - c), wp.length(b - a))))
    height = float(wp.length(wp.cross(b - a, c - a))) / wp.max(longest, TINY)
    return wp.max(share * reach(at, low, high), wp.min(SLIVER * longest * (longest / wp.max(height, TINY)), 0.25 * height))


@wp.func
def keep_from_edges(weights: wp.vec3, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, distance: float):
    """Barycentric weights of the point, moved so that it is `distance` from each edge, or in the middle if that is less."""
    area = wp.length(wp.cross(b - a, c - a))
    edges = wp.vec3d(wp.length(c - b), wp.length(a - c), wp.length(b - a))
    result = wp.vec3d()
    for corner in range(3):
        # the height over an edge is area / edge; a weight is the distance from the edge by that height
        least = wp.float64(distance) * edges[corner]
        least = wp.where(wp.float64(3.0) * least < area, least / area, wp.float64(1.0) / wp.float64(3.0))
        result[corner] = wp.max(wp.float64(weights[corner]), least)
    return result / (result[0] + result[1] + result[2])


@wp.func
def spawn_origin(mesh: SceneMesh, primitive: int, uv: wp.vec2, direction: wp.vec3):
    """Origin, in the caller's coordinates, of a ray that leaves a hit; NaN for a miss."""
    nan = wp.float64(wp.nan)
    origin = wp.vec3d(nan, nan, nan)
    if primitive >= 0:
        corners = triangle_of(mesh, primitive)
        a = corners.a
        b = corners.b
        c = corners.c
        weights = wp.vec3(1.0 - uv[0] - uv[1], uv[0], uv[1])
        near = wp.float64(weights[0]) * a + wp.float64(weights[1]) * b + wp.float64(weights[2]) * c
        offset = origin_offset(OFFSET, wp.vec3(near), mesh.low, mesh.high, a, b, c)
        at = keep_from_edges(weights, a, b, c, INSET * offset)
        toward = wp.vec3d(direction)
        normal = wp.normalize(wp.cross(b - a, c - a))
        if wp.length_sq(normal) == wp.float64(0.0):
            normal = wp.normalize(toward)
        side = wp.where(wp.dot(normal, toward) < wp.float64(0.0), wp.float64(-1.0), wp.float64(1.0))
        origin = mesh.center + (at[0] * a + at[1] * b + at[2] * c + (side * wp.float64(offset)) * normal)
    return origin


@wp.kernel
def spawn_origins(
    first: int,
    mesh: SceneMesh,
    primitive: wp.array(dtype=int),
    uv: wp.array(dtype=wp.vec2),
    directions: wp.array(dtype=wp.vec3),
    direction_stride: int,
    origins: wp.array(dtype=wp.vec3d),
):
    """Item: a ray that leaves hit number item modulo their number. Its origin in the caller's coordinates; NaN for a miss."""
    i = first + wp.tid()
    hit = i % primitive.shape[0]
    origins[i] = spawn_origin(mesh, primitive[hit], uv[hit], directions[i * direction_stride])

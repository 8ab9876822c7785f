"""Origins of rays that leave a surface: close to it, and on its correct side despite rounding.

**Problem.** A ray that starts on a surface must neither hit that surface again (black speckles) nor start behind another
surface (light leaks). A fixed offset is wrong at some scale.

**Bound.** The point of a hit is computed from its weights in float64, so its distance from the plane of the triangle is only
the rounding of the origin to float32. The triangle test of the next ray contributes more: it is exact for vertices that are
moved by a few units in the last place of their largest coordinate relative to the origin. It therefore moves the surface by at
most that much, even at grazing angles. The reach of the point in the scene bounds that coordinate for every triangle, and
bounds the rounding of the origin too. The ray starts at a distance along the geometric normal that is a fixed fraction of the
reach. Waechter and Binder also bound in units in the last place, but of the coordinates of the point alone.

**Slivers** need more. Rounding moves an edge of length L by some units in the last place of L. In a triangle of height h this
changes the weights by L / h units, and moves the hit along the triangle by L times as much: `SLIVER L^2 / h`. The offset is
limited to a quarter of h; for L / h above about a thousand no offset is correct.

**Corners.** In a corner of two walls, a point on one wall very close to the other may be moved or rounded beyond the other. A
point is therefore kept `INSET` offsets away from the edges of its triangle, as far as the size of the triangle allows.

References:
    C. Waechter, N. Binder: A fast and robust method for avoiding self-intersection. Ray Tracing Gems, 2019.
    M. Pharr, W. Jakob, G. Humphreys: Physically based rendering: from theory to implementation, 3rd edition. Morgan Kaufmann,
        2016 (section 3.9, bounds of rounding errors).
"""

import warp as wp

from wrt.kernels.layout.ray_batch import TINY
from wrt.kernels.query.hit_attributes import SceneMesh, triangle_of
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import reach

exact_module(__name__)

OFFSET = wp.constant(2.0**-21)
"""Distance of origins from the surface as a fraction of the point's reach: eight roundings of half a unit in the last place."""

SLIVER = wp.constant(2.0**-22)
"""Factor of the extra offset of slivers: a few units in the last place."""

INSET = wp.constant(4.0)
"""Least distance of origins from the edges of their triangle, in offsets."""


@wp.func
def origin_offset(share: float, at: wp.vec3, low: wp.vec3, high: wp.vec3, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """Offset from a triangle for rays that start at the point `at` on it: `share` of the reach, more for slivers."""
    longest = float(wp.max(wp.length(c - b), wp.max(wp.length(a - c), wp.length(b - a))))
    height = float(wp.length(wp.cross(b - a, c - a))) / wp.max(longest, TINY)
    return wp.max(share * reach(at, low, high), wp.min(SLIVER * longest * (longest / wp.max(height, TINY)), 0.25 * height))


@wp.func
def keep_from_edges(weights: wp.vec3, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, distance: float):
    """Barycentric weights of the point, moved to be at least `distance` from each edge.

    If the triangle is too small for that, the point moves towards the centroid.
    """
    area = wp.length(wp.cross(b - a, c - a))
    edges = wp.vec3d(wp.length(c - b), wp.length(a - c), wp.length(b - a))
    result = wp.vec3d()
    for corner in range(3):
        # height over an edge = area / edge; weight = distance from the edge / height
        least = wp.float64(distance) * edges[corner]
        least = wp.where(wp.float64(3.0) * least < area, least / area, wp.float64(1.0) / wp.float64(3.0))
        result[corner] = wp.max(wp.float64(weights[corner]), least)
    return result / (result[0] + result[1] + result[2])


@wp.func
def spawn_origin(mesh: SceneMesh, primitive: int, uv: wp.vec2, direction: wp.vec3):
    """Origin of a ray that leaves a hit, in the caller's coordinates; NaN for a miss."""
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
    """Writes the origin of a ray that leaves a hit, in the caller's coordinates; NaN for a miss. Item: a ray.

    Ray i leaves hit i modulo the number of hits.
    """
    i = first + wp.tid()
    hit = i % primitive.shape[0]
    origins[i] = spawn_origin(mesh, primitive[hit], uv[hit], directions[i * direction_stride])

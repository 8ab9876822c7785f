"""From hits to the points that light falls on, and the rays from there to the light.

**Where a secondary ray starts.** A ray that starts in a surface must neither meet that surface again (black speckles)
nor start behind another one (light leaks). The hit's point follows from its weights in float64, so it is off its triangle's
plane only by the rounding to float32 on the way to the device; what matters is the triangle test of the next ray,
which moves surfaces by a few units in the last place of the distance to a triangle's farthest vertex. So the bound is taken
from the size of the coordinates, as is the widening of boxes in `wrt.kernels.boxes`: `OFFSET` times the reach of the point
in the scene. The origin is moved by that much along the geometric normal, to the side where the ray came from.

Slivers need more. Rounding shifts an edge of length L by some units in the last place of L; in a triangle of height h that
moves the weights by L / h of such units, and the hit along the triangle's length by L of that again: `SLIVER L^2 / h`. More
than a quarter of h is not taken: beyond, at L / h of a thousand, no offset is right.

That is not enough in a corner of two walls: a point in one wall, a hair from the other, may be moved or rounded to
beyond the other. So a point keeps `INSET` offsets away from the edges of its triangle, as far as the triangle has room.

**Smooth normals and the terminator.** Where a smooth normal still faces the light, the flat triangle may face away from it
and lie in its own shadow, whose edge then shows the triangles. Hanika moves the origin of the shadow ray off the triangle to
the curved surface that the normals describe: up where the surface is convex, nowhere else. Flat normals: no shift.

References:
    C. Waechter, N. Binder: A fast and robust method for avoiding self-intersection. Ray Tracing Gems, 2019.
    J. Hanika: Hacking the shadow terminator. Ray Tracing Gems II, 2021.
"""

import warp as wp

from wrt.kernels.boxes import reach
from wrt.kernels.hits import SceneMesh
from wrt.kernels.rays import TINY
from wrt.kernels.shading.normals import face_normal

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

OFFSET = wp.constant(2.0**-18)
"""Distance of secondary origins from the surface, as a share of the point's reach: four times the slack of boxes."""

SLIVER = wp.constant(2.0**-22)
"""Units in the last place, times a few."""

INSET = wp.constant(4.0)
"""Distance of secondary origins from the edges of their triangle, in offsets."""


@wp.struct
class Appearance:
    """Triangles and what is needed to shade them."""

    mesh: SceneMesh
    low: wp.vec3
    """Lowest corner of the scene, relative to its centre."""
    high: wp.vec3
    smooth: bool
    corner_normals: wp.array(dtype=wp.vec3)
    """(3 F,) if `smooth`."""
    albedo: wp.array(dtype=wp.vec3)
    """(F,) or (1,), linear."""
    albedo_stride: int


@wp.struct
class Surface:
    """What N camera rays have met."""

    origin: wp.array(dtype=wp.vec3d)
    """Where ambient rays start, in the caller's coordinates."""
    face_normal: wp.array(dtype=wp.vec3)
    """Unit, on the side of the ray; 0 for a miss."""
    normal: wp.array(dtype=wp.vec3)
    """Unit, for shading: smooth or the same."""
    albedo: wp.array(dtype=wp.vec3)
    cosine: wp.array(dtype=float)
    """Between the normal and the direction to the light; 0 where the surface faces away."""
    shadow_origin: wp.array(dtype=wp.vec3d)
    shadow_direction: wp.array(dtype=wp.vec3)
    """To the light: t = 1 is there. 0 where no ray is needed."""


@wp.func
def origin_offset(at: wp.vec3, low: wp.vec3, high: wp.vec3, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """Distance from a triangle at which rays from the point `at` on it start."""
    longest = float(wp.max(wp.length(c - b), wp.max(wp.length(a - c), wp.length(b - a))))
    height = float(wp.length(wp.cross(b - a, c - a))) / wp.max(longest, TINY)
    return wp.max(OFFSET * reach(at, low, high), wp.min(SLIVER * longest * (longest / wp.max(height, TINY)), 0.25 * height))


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
def lifted(point: wp.vec3d, corner: wp.vec3d, normal: wp.vec3d):
    """How far the point is below the plane through a corner and across its normal, as a vector up to it; 0 above."""
    return -wp.min(wp.float64(0.0), wp.dot(point - corner, normal)) * normal


@wp.kernel
def find_surface(
    first: int,
    scene: Appearance,
    light: wp.vec3d,
    directions: wp.array(dtype=wp.vec3),
    direction_stride: int,
    primitive: wp.array(dtype=int),
    uv: wp.array(dtype=wp.vec2),
    surface: Surface,
):
    """Item: a camera ray and its hit, if any."""
    i = first + wp.tid()
    side_normal = wp.vec3d()
    normal = wp.vec3d()
    origin = wp.vec3d()
    shadow_origin = wp.vec3d()
    to_light = wp.vec3d()
    cosine = float(0.0)
    triangle = primitive[i]
    if triangle >= 0:
        face = scene.mesh.faces[triangle]
        a = wp.vec3d(scene.mesh.vertices[face[0]])
        b = wp.vec3d(scene.mesh.vertices[face[1]])
        c = wp.vec3d(scene.mesh.vertices[face[2]])
        toward = wp.vec3d(directions[i * direction_stride])
        winding = face_normal(scene.mesh.vertices, face)
        side = wp.where(wp.dot(winding, toward) > wp.float64(0.0), wp.float64(-1.0), wp.float64(1.0))
        side_normal = side * winding
        if wp.length_sq(winding) == wp.float64(0.0):
            side_normal = -wp.normalize(toward)
        weights = wp.vec3(1.0 - uv[i][0] - uv[i][1], uv[i][0], uv[i][1])
        near = wp.vec3(wp.float64(weights[0]) * a + wp.float64(weights[1]) * b + wp.float64(weights[2]) * c)
        offset = origin_offset(near, scene.low, scene.high, a, b, c)
        at = keep_from_edges(weights, a, b, c, INSET * offset)
        point = at[0] * a + at[1] * b + at[2] * c
        step = wp.float64(offset) * side_normal
        origin = scene.mesh.center + (point + step)
        shadow_origin = origin
        normal = side_normal
        if scene.smooth:
            na = side * wp.vec3d(scene.corner_normals[3 * triangle])
            nb = side * wp.vec3d(scene.corner_normals[3 * triangle + 1])
            nc = side * wp.vec3d(scene.corner_normals[3 * triangle + 2])
            blend = at[0] * na + at[1] * nb + at[2] * nc
            if wp.dot(blend, side_normal) > wp.float64(0.0):
                normal = wp.normalize(blend)
                rise = at[0] * lifted(point, a, na) + at[1] * lifted(point, b, nb) + at[2] * lifted(point, c, nc)
                shadow_origin = origin + rise
        to_light = light - shadow_origin
        cosine = wp.max(0.0, float(wp.dot(normal, wp.normalize(to_light))))
        if not cosine > 0.0:
            to_light = wp.vec3d()
        surface.albedo[i] = scene.albedo[triangle * scene.albedo_stride]
    surface.origin[i] = origin
    surface.face_normal[i] = wp.vec3(side_normal)
    surface.normal[i] = wp.vec3(normal)
    surface.cosine[i] = cosine
    surface.shadow_origin[i] = shadow_origin
    surface.shadow_direction[i] = wp.vec3(to_light)

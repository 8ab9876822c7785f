"""From hits to shading points, and the rays from there to the light.

**Origins of secondary rays.** They lie off the triangle and away from its edges, on the side from which the ray came, as
`wrt.kernels.query.spawn` explains, at a distance of `OFFSET` times the reach of the point in the scene.

**Smooth normals and the terminator.** Where a smooth normal still faces the light, the flat triangle may face away from it and
shadow itself, and the edge of that shadow shows the triangles. Hanika moves the origin of the shadow ray off the triangle to
the curved surface that the normals describe: upwards where the surface is convex, nowhere else. Flat normals give no shift.

References: hanika-2021.
"""

import warp as wp

from wrt.kernels.layout.instance_maps import scene_normal
from wrt.kernels.query.hit_attributes import SceneMesh, Triangle, triangle_of, winding
from wrt.kernels.query.spawn import keep_from_edges
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.shading.normals import unit_or_zero
from wrt.kernels.simd.boxes import reach

OFFSET = wp.constant(2.0**-18)
"""Distance of secondary origins from the surface, relative to the point's reach: eight times that of `wrt.kernels.query.spawn`,
four times the slack of boxes."""


@wp.struct
class Appearance:
    """Triangles and their shading attributes."""

    mesh: SceneMesh
    smooth: bool
    corner_normals: wp.array(dtype=wp.vec3)
    """(3 F,) if `smooth`. Geometry shared by instances counts once in F."""
    albedo: wp.array(dtype=wp.vec3)
    """(F,), or (N,) of points, or (1,); linear."""
    albedo_stride: int
    point: wp.array(dtype=int)
    """(N,) numbers of the points that the camera rays have met, on which `mesh` has a triangle each; empty if it has all
    triangles of a scene."""


@wp.struct
class Surface:
    """Shading points of N camera rays."""

    origin: wp.array(dtype=wp.vec3d)
    """(N,) origins of ambient rays, in the caller's coordinates."""
    face_normal: wp.array(dtype=wp.vec3)
    """(N,) unit vectors on the side of the ray; 0 for a miss."""
    normal: wp.array(dtype=wp.vec3)
    """(N,) unit vectors for shading: smooth, or equal to `face_normal`."""
    albedo: wp.array(dtype=wp.vec3)
    cosine: wp.array(dtype=float)
    """(N,) cosine between the normal and the direction to the light; 0 where the surface faces away."""
    shadow_origin: wp.array(dtype=wp.vec3d)
    shadow_direction: wp.array(dtype=wp.vec3)
    """(N,) vectors to the light, which is at t = 1; 0 where no ray is needed."""


@wp.func
def corner_normal(scene: Appearance, triangle: Triangle, corner: int):
    """Smooth unit normal at a corner of a triangle, in the scene."""
    normal = scene.corner_normals[3 * triangle.face + corner]
    result = wp.vec3d(normal)
    if triangle.instance >= 0:
        result = unit_or_zero(scene_normal(scene.mesh.placements[triangle.instance], normal))
    return result


@wp.func
def raised_exact(point: wp.vec3d, corner: wp.vec3d, normal: wp.vec3d):
    """Vector from the point up to the plane through a corner and perpendicular to its normal; 0 if the point is above it."""
    return -wp.min(wp.float64(0.0), wp.dot(point - corner, normal)) * normal


@exact_kernel
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
    """Item: a camera ray and its hit, if any. Writes its shading point."""
    i = first + wp.tid()
    side_normal = wp.vec3d()
    normal = wp.vec3d()
    origin = wp.vec3d()
    shadow_origin = wp.vec3d()
    to_light = wp.vec3d()
    cosine = float(0.0)
    if primitive[i] >= 0:
        triangle = triangle_of(scene.mesh, primitive[i])
        a = triangle.a
        b = triangle.b
        c = triangle.c
        toward = wp.vec3d(directions[i * direction_stride])
        front = unit_or_zero(winding(scene.mesh, triangle) * wp.cross(b - a, c - a))
        side = wp.where(wp.dot(front, toward) > wp.float64(0.0), wp.float64(-1.0), wp.float64(1.0))
        side_normal = side * front
        if wp.length_sq(front) == wp.float64(0.0):
            side_normal = -wp.normalize(toward)
        weights = wp.vec3(1.0 - uv[i][0] - uv[i][1], uv[i][0], uv[i][1])
        near = wp.vec3(wp.float64(weights[0]) * a + wp.float64(weights[1]) * b + wp.float64(weights[2]) * c)
        offset = OFFSET * reach(near, scene.mesh.low, scene.mesh.high)
        at = keep_from_edges(weights, a, b, c, offset)
        point = at[0] * a + at[1] * b + at[2] * c
        step = wp.float64(offset) * side_normal
        origin = scene.mesh.center + (point + step)
        shadow_origin = origin
        normal = side_normal
        if scene.smooth:
            na = side * corner_normal(scene, triangle, 0)
            nb = side * corner_normal(scene, triangle, 1)
            nc = side * corner_normal(scene, triangle, 2)
            blend = at[0] * na + at[1] * nb + at[2] * nc
            if wp.dot(blend, side_normal) > wp.float64(0.0):
                normal = wp.normalize(blend)
                rise = (
                    at[0] * raised_exact(point, a, na) + at[1] * raised_exact(point, b, nb) + at[2] * raised_exact(point, c, nc)
                )
                shadow_origin = origin + rise
        to_light = light - shadow_origin
        cosine = wp.max(0.0, float(wp.dot(normal, wp.normalize(to_light))))
        if not cosine > 0.0:
            to_light = wp.vec3d()
        painted = triangle.face
        if scene.point.shape[0] > 0:
            painted = scene.point[i]
        surface.albedo[i] = scene.albedo[painted * scene.albedo_stride]
    surface.origin[i] = origin
    surface.face_normal[i] = wp.vec3(side_normal)
    surface.normal[i] = wp.vec3(normal)
    surface.cosine[i] = cosine
    surface.shadow_origin[i] = shadow_origin
    surface.shadow_direction[i] = wp.vec3(to_light)

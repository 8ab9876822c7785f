"""Origins of rays that leave a surface: close to it, and on its correct side despite rounding.

**Problem.** A ray that starts on a surface must neither hit that surface again (black speckles) nor start behind another
surface (light leaks). A fixed offset is wrong at some scale.

**Bound.** The watertight test (`wrt.kernels.triangle.watertight.woop`) is exact for vertices that are displaced a little.

    u      2^-24, the greatest relative error of a rounding
    R      reach of the origin in the scene: the largest distance along an axis to its bounds
    n      unit normal of the triangle
    e      displacement of a vertex, along the ray's largest axis, z, and along the others, x and y
    d      distance of the origin from the plane, on the side to which the ray goes

    |e_z| <= u R                                           `wrt.kernels.triangle.watertight.woop_areas`, the vertices
    |e_x|, |e_y| <= 4.5 u R                                the same
    |n e| <= sqrt(1 + 2 4.5^2) u R <= 6.45 u R             for any n
    |n (fl(o) - o)| <= sqrt(3) u R / 2 <= 0.87 u R         the origin is at most R / 2 from the scene's centre
    d > 7.32 u R                                           is enough

A point of the displaced triangle is a convex combination of its vertices. So it is at most |n e| away from the plane of the
triangle, whatever the triangle's shape: a long or thin one needs no more than others. A ray that starts at d can thus meet the
displaced triangle at a negative t only. The distance is `OFFSET` R, 8 u R: 0.68 u R are left. Searched by `spawn` of
tests/bounds.

**Steep rays.** The sign of t is that of the sum of three products of areas and depths, which is rounded, too. That matters
where t is small, which it is for steep rays. If all roundings reached their limits with the same sign, steep rays would need 25
u R. No search came close to this: needles and other triangles in random positions need at most 4 u R, and those that a climbing
search found 8.8 u R. So nobody pays for it: the origin is tested with the triangle itself, and the distance is doubled while
the ray meets it. The test is the one that all engines agree with to the bit. In an instance that is stretched by different
factors along different axes, where rounding happens in another space than that of R, the same loop finds the distance.

**Corners.** In a corner of two walls at an angle T, a point at a distance s from their edge is offset from one wall by d and is
then in front of the other one by

    s sin T - d cos T.

A point is therefore kept `INSET` offsets away from the edges of its triangle. With 7 offsets that is positive for

    T > 8.2 degrees.

The point is moved perpendicularly to the edges, by the sum of what is missing to each of them, twice. In a corner of the
triangle of angle A, its distance from both edges is then at least

    7 offsets for A >= 90 degrees, 7 sin^2 A for smaller angles,

so 3.5 for 45 degrees, where two walls may meet at 16 degrees. In a sharp corner it hardly moves. In a triangle whose inscribed
circle has a smaller radius than 14 offsets, half of this radius takes the place of 7 offsets. The point never leaves its
triangle, and it moves by 14 offsets at most, in corners of nearly 180 degrees. An origin is thus at most

    sqrt(14^2 + 1) OFFSET R < 112.4 u R < 6.7e-6 R

from the point of the hit, if the distance was not doubled. Waechter and Binder also bound in units in the last place, but of
the coordinates of the point alone.

**Sides.** A ray may be made to start on a given side, although it points to the other one. It then starts so that it passes
through the point, and meets the triangle.

References: waechter-binder-2019; pharr-2016 (section 3.9, bounds of rounding errors).
"""

import warp as wp

from wrt.kernels.layout.instance_maps import object_ray
from wrt.kernels.layout.ray_batch import FARTHEST, checked_ray
from wrt.kernels.query.hit_attributes import SceneMesh, Triangle, geometry_of, triangle_of, winding
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.simd.boxes import reach
from wrt.kernels.triangle.support.record_blocks import Corners
from wrt.kernels.triangle.watertight.woop import intersect, prepare

OFFSET = wp.constant(2.0**-21)
"""Distance of origins from the surface as a fraction of the point's reach: eight roundings of half a unit in the last place."""

INSET = wp.constant(7.0)
"""Distance of origins from the edges of their triangle, in offsets."""

DOUBLINGS = wp.constant(16)
"""How often the offset may be doubled."""

GRAZING = wp.constant(wp.float64(2.0**-10))
"""A ray that points away from the side on which it has to start, at a smaller sine of the angle to its triangle, does not pass
through its point, but near it."""


@wp.func
def keep_from_edges(weights: wp.vec3, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, offset: float):
    """Barycentric weights of the point, moved `INSET` offsets away from the edges of its triangle; see the module docstring."""
    result = wp.vec3d(weights) / (wp.float64(weights[0]) + wp.float64(weights[1]) + wp.float64(weights[2]))
    area = wp.length(wp.cross(b - a, c - a))
    edges = wp.vec3d(wp.length(c - b), wp.length(a - c), wp.length(b - a))
    if area > wp.float64(0.0):
        # height over an edge = area / edge; weight = distance from the edge / height; 1 / radius = sum of 1 / height
        radius = area / (edges[0] + edges[1] + edges[2])
        inset = (wp.min(wp.float64(INSET * offset), wp.float64(0.5) * radius) / area) * edges
        for _ in range(2):
            missing = wp.max(inset - result, wp.vec3d())
            # a distance m is missing to each edge e: the step is their sum along the normals, here turned by a right angle
            m = area * wp.vec3d(missing[0] / edges[0], missing[1] / edges[1], missing[2] / edges[2])
            step = (m[0] / edges[0]) * (c - b) + (m[1] / edges[1]) * (a - c) + (m[2] / edges[2]) * (b - a)
            result += wp.vec3d(wp.dot(c - b, step), wp.dot(a - c, step), wp.dot(b - a, step)) / area
    return result


@wp.func
def front_normal(mesh: SceneMesh, triangle: Triangle):
    """Unit normal on the side of the winding; 0 for a triangle without area."""
    return winding(mesh, triangle) * wp.normalize(wp.cross(triangle.b - triangle.a, triangle.c - triangle.a))


@wp.func
def meets_own(mesh: SceneMesh, primitive: int, origin: wp.vec3, direction: wp.vec3):
    """Whether a ray, relative to the scene's centre, meets a triangle by the watertight test."""
    ray = checked_ray(origin, direction, 0.0, FARTHEST)
    corners = Corners()
    if mesh.placements.shape[0] == 0:
        face = mesh.faces[primitive]
        corners.a = mesh.vertices[face[0]]
        corners.b = mesh.vertices[face[1]]
        corners.c = mesh.vertices[face[2]]
    else:
        placement = mesh.placements[geometry_of(mesh, primitive)]
        geometry = mesh.geometries[placement.geometry]
        local = geometry.faces[primitive - placement.first]
        corners.a = geometry.vertices[local[0]]
        corners.b = geometry.vertices[local[1]]
        corners.c = geometry.vertices[local[2]]
        ray = object_ray(placement, wp.vec3d(origin), ray, FARTHEST)
    found = intersect(prepare(ray.origin, ray.direction), corners)
    return ray.valid and found[0] >= 0.0


@wp.struct
class Footing:
    """Where rays leave a triangle."""

    point: wp.vec3d
    """Of the triangle, away from its edges, in the caller's coordinates."""
    offset: float
    """How far from the triangle rays start."""


@wp.func
def footing(mesh: SceneMesh, corners: Triangle, uv: wp.vec2):
    """The footing of rays that leave a point of a triangle; uv: weights of its second and third corner."""
    found = Footing()
    weights = wp.vec3(1.0 - uv[0] - uv[1], uv[0], uv[1])
    edge1 = corners.b - corners.a
    edge2 = corners.c - corners.a
    near = corners.a + wp.float64(uv[0]) * edge1 + wp.float64(uv[1]) * edge2
    found.offset = OFFSET * reach(wp.vec3(near), mesh.low, mesh.high)
    at = keep_from_edges(weights, corners.a, corners.b, corners.c, found.offset)
    found.point = mesh.center + (corners.a + at[1] * edge1 + at[2] * edge2)
    return found


@wp.func
def spawn_origin(mesh: SceneMesh, primitive: int, uv: wp.vec2, direction: wp.vec3, sided: int):
    """Origin of a ray that leaves a hit, in the caller's coordinates; NaN for a miss.

    Args:
        mesh: the triangles.
        primitive: number of the triangle in the scene; -1 for a miss.
        uv: weights of its second and third corner.
        direction: of the ray.
        sided: 0 for the side to which the direction points, 1 for the front, -1 for the back.
    """
    nan = wp.float64(wp.nan)
    origin = wp.vec3d(nan, nan, nan)
    if primitive >= 0:
        corners = triangle_of(mesh, primitive)
        start = footing(mesh, corners, uv)
        point = start.point
        offset = start.offset
        toward = wp.normalize(wp.vec3d(direction))
        normal = front_normal(mesh, corners)
        if wp.length_sq(normal) == wp.float64(0.0):
            normal = toward
        slope = wp.dot(normal, toward)
        side = wp.where(slope < wp.float64(0.0), wp.float64(-1.0), wp.float64(1.0))
        if sided != 0 and wp.float64(sided) != side:
            back = (toward - slope * normal) / wp.max(wp.abs(slope), GRAZING)
            origin = point - wp.float64(offset) * (side * normal + back)
        else:
            origin = point + (side * wp.float64(offset)) * normal
            doublings = int(0)
            while doublings < DOUBLINGS and meets_own(mesh, primitive, wp.vec3(origin - mesh.center), direction):
                offset *= 2.0
                origin = point + (side * wp.float64(offset)) * normal
                doublings += 1
    return origin


@wp.func
def faces_front(mesh: SceneMesh, primitive: int, direction: wp.vec3):
    """Whether a direction points to the front of a triangle. No for one in its plane, and without a triangle."""
    result = bool(False)
    if primitive >= 0:
        result = wp.dot(front_normal(mesh, triangle_of(mesh, primitive)), wp.vec3d(direction)) > wp.float64(0.0)
    return result


@exact_kernel
def spawn_origins(
    first: int,
    mesh: SceneMesh,
    primitive: wp.array(dtype=int),
    uv: wp.array(dtype=wp.vec2),
    directions: wp.array(dtype=wp.vec3),
    direction_stride: int,
    sided: int,
    origins: wp.array(dtype=wp.vec3d),
):
    """Writes the origin of a ray that leaves a hit, in the caller's coordinates; NaN for a miss. Item: a ray.

    Ray i leaves hit i modulo the number of hits.
    """
    i = first + wp.tid()
    hit = i % primitive.shape[0]
    origins[i] = spawn_origin(mesh, primitive[hit], uv[hit], directions[i * direction_stride], sided)


@exact_kernel
def mark_facing(
    first: int,
    mesh: SceneMesh,
    primitive: wp.array(dtype=int),
    directions: wp.array(dtype=wp.vec3),
    direction_stride: int,
    faces: wp.array(dtype=wp.bool),
):
    """Writes whether a direction points to the front of a hit; hits repeat as in `spawn_origins`. Item: a direction."""
    i = first + wp.tid()
    faces[i] = faces_front(mesh, primitive[i % primitive.shape[0]], directions[i * direction_stride])

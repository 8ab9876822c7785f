"""Attributes derived from the primitive and the weights of a hit: point, normal, geometry and instance."""

import warp as wp

from wrt.kernels.layout.instance_maps import Geometry, Placement, scene_point
from wrt.kernels.runtime.options import exact_kernel


@wp.struct
class SceneMesh:
    """All triangles of a scene, stored directly or through its instances."""

    vertices: wp.array(dtype=wp.vec3)
    """Relative to `center`; (0,) in a scene of instances."""
    faces: wp.array(dtype=wp.vec3i)
    center: wp.vec3d
    low: wp.vec3
    """Lowest corner of all triangles, relative to `center`."""
    high: wp.vec3
    geometry_first: wp.array(dtype=int)
    """(geometries + 1,) or (instances + 1,) number of the first triangle of each."""
    placements: wp.array(dtype=Placement)
    """(instances,); (0,) in a scene without instances."""
    geometries: wp.array(dtype=Geometry)
    """The geometries that the placements refer to."""


@wp.struct
class Triangle:
    """A triangle of a scene, relative to its centre, in float64."""

    a: wp.vec3d
    b: wp.vec3d
    c: wp.vec3d
    face: int
    """Number of the triangle when each shared geometry is counted once."""
    instance: int
    """-1 in a scene without instances."""


@wp.func
def geometry_of(mesh: SceneMesh, primitive: int):
    """Number of the geometry or instance that contains a triangle of the scene."""
    low = int(0)
    count = mesh.geometry_first.shape[0] - 1
    while count > 1:  # without a branch that depends on the ray
        half = count / 2
        low = wp.where(mesh.geometry_first[low + half] <= primitive, low + half, low)
        count = count - half
    return low


@wp.func
def triangle_of(mesh: SceneMesh, primitive: int):
    """Triangle number `primitive` of the scene, with the winding of its geometry, whether mirrored or not."""
    triangle = Triangle()
    if mesh.placements.shape[0] == 0:
        face = mesh.faces[primitive]
        triangle.a = wp.vec3d(mesh.vertices[face[0]])
        triangle.b = wp.vec3d(mesh.vertices[face[1]])
        triangle.c = wp.vec3d(mesh.vertices[face[2]])
        triangle.face = primitive
        triangle.instance = -1
    else:
        triangle.instance = geometry_of(mesh, primitive)
        placement = mesh.placements[triangle.instance]
        geometry = mesh.geometries[placement.geometry]
        local = primitive - placement.first
        face = geometry.faces[local]
        triangle.a = scene_point(placement, geometry.vertices[face[0]])
        triangle.b = scene_point(placement, geometry.vertices[face[1]])
        triangle.c = scene_point(placement, geometry.vertices[face[2]])
        triangle.face = geometry.first_face + local
    return triangle


@wp.func
def winding(mesh: SceneMesh, triangle: Triangle):
    """1, or -1 for a triangle that its instance mirrors: the cross product of its edges then points to its back."""
    sign = wp.float64(1.0)
    if triangle.instance >= 0 and wp.determinant(mesh.placements[triangle.instance].to_scene) < wp.float64(0.0):
        sign = wp.float64(-1.0)
    return sign


@wp.func
def triangle_normal(mesh: SceneMesh, triangle: Triangle):
    """Unit normal of a triangle by its winding; 0 for a degenerate one."""
    across = wp.cross(triangle.b - triangle.a, triangle.c - triangle.a)
    return wp.vec3(winding(mesh, triangle) * wp.normalize(across))


@wp.func
def hit_position(mesh: SceneMesh, primitive: int, uv: wp.vec2):
    """The point (1 - u - v) a + u b + v c in float64, in the caller's coordinates; NaN for a miss."""
    nan = wp.float64(wp.nan)
    point = wp.vec3d(nan, nan, nan)
    if primitive >= 0:
        at = triangle_of(mesh, primitive)
        point = mesh.center + (at.a + wp.float64(uv[0]) * (at.b - at.a) + wp.float64(uv[1]) * (at.c - at.a))
    return point


@wp.func
def hit_normal(mesh: SceneMesh, primitive: int):
    """Unit normal of a triangle by its winding; 0 for a miss and for a degenerate triangle."""
    normal = wp.vec3()
    if primitive >= 0:
        normal = triangle_normal(mesh, triangle_of(mesh, primitive))
    return normal


@exact_kernel
def hit_positions(
    first: int,
    mesh: SceneMesh,
    primitive: wp.array(dtype=int),
    uv: wp.array(dtype=wp.vec2),
    positions: wp.array(dtype=wp.vec3d),
):
    """Writes the point of a hit. Item: a ray."""
    i = first + wp.tid()
    positions[i] = hit_position(mesh, primitive[i], uv[i])


GRAZING = wp.constant(wp.float64(1e-4))
"""If the sine of the angle between ray and triangle is below this, the point is computed from the weights, not from the
plane."""


@exact_kernel
def intersect_planes(
    first: int,
    vertices: wp.array(dtype=wp.vec3d),
    faces: wp.array(dtype=wp.vec3i),
    origins: wp.array(dtype=wp.vec3d),
    directions: wp.array(dtype=wp.vec3d),
    ray: wp.array(dtype=int),
    primitive: wp.array(dtype=int),
    uv: wp.array(dtype=wp.vec2),
    positions: wp.array(dtype=wp.vec3d),
):
    """Intersects a ray with the plane of its triangle in float64. Item: a hit.

    If the angle between the two is too small (`GRAZING`), or the triangle is degenerate, the result is the point of the
    triangle with the weights `uv`.
    """
    i = first + wp.tid()
    face = faces[primitive[i]]
    a = vertices[face[0]]
    edge1 = vertices[face[1]] - a
    edge2 = vertices[face[2]] - a
    normal = wp.cross(edge1, edge2)
    origin = origins[ray[i]]
    direction = directions[ray[i]]
    slope = wp.dot(normal, direction)
    point = a + wp.float64(uv[i][0]) * edge1 + wp.float64(uv[i][1]) * edge2
    if wp.abs(slope) > GRAZING * wp.length(normal) * wp.length(direction):
        point = origin + (wp.dot(normal, a - origin) / slope) * direction
    positions[i] = point


@exact_kernel
def hit_normals(first: int, mesh: SceneMesh, primitive: wp.array(dtype=int), normals: wp.array(dtype=wp.vec3)):
    """Writes the normal of the triangle that a ray hits. Item: a ray."""
    i = first + wp.tid()
    normals[i] = hit_normal(mesh, primitive[i])


@exact_kernel
def locate_geometry(
    first: int,
    mesh: SceneMesh,
    primitive: wp.array(dtype=int),
    instance: wp.array(dtype=int),
    geometry: wp.array(dtype=int),
    local: wp.array(dtype=int),
):
    """Splits the scene's triangle number into instance, geometry and triangle of the geometry; all -1 for a miss. Item: a ray.

    In a scene without instances the instance equals the geometry.
    """
    i = first + wp.tid()
    found = int(-1)
    shared = int(-1)
    inside = int(-1)
    if primitive[i] >= 0:
        found = geometry_of(mesh, primitive[i])
        shared = found
        if mesh.placements.shape[0] > 0:
            shared = mesh.placements[found].geometry
        inside = primitive[i] - mesh.geometry_first[found]
    instance[i] = found
    geometry[i] = shared
    local[i] = inside


@exact_kernel
def mark_hits(first: int, primitive: wp.array(dtype=int), is_hit: wp.array(dtype=wp.bool)):
    """Writes whether a ray hit anything. Item: a ray."""
    i = first + wp.tid()
    is_hit[i] = primitive[i] >= 0


@exact_kernel
def round_vectors(first: int, values: wp.array(dtype=wp.vec3d), rounded: wp.array(dtype=wp.vec3)):
    """Rounds vectors to float32. Item: a ray."""
    i = first + wp.tid()
    rounded[i] = wp.vec3(values[i])


@exact_kernel
def widen_vectors(first: int, values: wp.array(dtype=wp.vec3), widened: wp.array(dtype=wp.vec3d)):
    """Converts vectors to float64. Item: a ray."""
    i = first + wp.tid()
    widened[i] = wp.vec3d(values[i])


@exact_kernel
def number_faces(
    first: int,
    geometry: wp.array(dtype=int),
    local: wp.array(dtype=int),
    first_face: wp.array(dtype=int),
    face_of: wp.array(dtype=int),
):
    """Writes the number of a hit triangle among those of all meshes, each counted once; -1 for a miss. Item: a ray."""
    i = first + wp.tid()
    face = int(-1)
    if geometry[i] >= 0:
        face = first_face[geometry[i]] + local[i]
    face_of[i] = face

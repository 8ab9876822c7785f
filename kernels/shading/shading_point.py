"""Hits -> points to shade.

A point is found from a record of its triangle: a corner, two edges, the normal, and what keeps the origins of secondary rays
off the surface (`wrt.kernels.query.spawn`). The records are made once for a scene without instances. With instances, the record
is made from the transformed triangle at each hit.

Points are float32 relative to the scene's centre. Their error, a few units in the last place, is small against the offset of
`OFFSET` times the reach.

References: hanika-2021.
"""

import warp as wp

from wrt.kernels.layout.instance_maps import scene_normal
from wrt.kernels.query.hit_attributes import SceneMesh, Triangle, triangle_of, winding
from wrt.kernels.query.spawn import INSET
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.shading.normals import unit_or_zero
from wrt.kernels.shading.surface import OFFSET
from wrt.kernels.simd.boxes import reach


@wp.struct
class FaceRecord:
    """A triangle as shading reads it: 64 bytes."""

    corner: wp.vec3
    edge1: wp.vec3
    edge2: wp.vec3
    normal: wp.vec3
    """Unit vector by the winding; 0 for a triangle without area."""
    inverse_heights: wp.vec3
    """Over the edges opposite to the three corners."""
    curved: float
    """1, or 0 if the smooth normals of the corners are equal to `normal`."""


@wp.struct
class ShadedMesh:
    """Triangles with the normals to shade by."""

    mesh: SceneMesh
    records: wp.array(dtype=FaceRecord)
    """(F,); (0,) in a scene of instances."""
    is_smooth: bool
    corner_normals: wp.array(dtype=wp.vec3)
    """(3 F,) if `is_smooth`. Geometry shared by instances counts once."""


@wp.struct
class ShadingPoint:
    """A point on a surface, seen along a ray."""

    position: wp.vec3
    """On the triangle, away from its edges; relative to the scene's centre."""
    offset: float
    """Distance from the surface at which secondary rays begin."""
    face_normal: wp.vec3
    """Unit vector on the side of the ray."""
    normal: wp.vec3
    """The same, or the smooth normal."""
    rise: wp.vec3
    """Shift of shadow rays from the flat triangle to the curved surface."""
    weights: wp.vec3
    """Of the three corners at the hit."""
    face: int
    """Number of the triangle when each shared geometry is counted once."""
    is_front: bool
    """Whether the ray met the side that the winding calls the front."""


@wp.func
def record_of(mesh: SceneMesh, triangle: Triangle):
    """The record of a triangle, computed in float64."""
    across = winding(mesh, triangle) * wp.cross(triangle.b - triangle.a, triangle.c - triangle.a)
    area = wp.length(across)
    sizes = wp.vec3d(wp.length(triangle.c - triangle.b), wp.length(triangle.a - triangle.c), wp.length(triangle.b - triangle.a))
    record = FaceRecord()
    record.corner = wp.vec3(triangle.a)
    record.edge1 = wp.vec3(triangle.b - triangle.a)
    record.edge2 = wp.vec3(triangle.c - triangle.a)
    record.normal = wp.vec3(unit_or_zero(across))
    record.inverse_heights = wp.vec3(sizes / wp.max(area, wp.float64(1e-30)))
    record.curved = 1.0
    return record


@exact_kernel
def make_face_records(
    first: int,
    mesh: SceneMesh,
    is_smooth: bool,
    corner_normals: wp.array(dtype=wp.vec3),
    records: wp.array(dtype=FaceRecord),
):
    """Writes the record of a triangle. Item: a triangle."""
    i = first + wp.tid()
    record = record_of(mesh, triangle_of(mesh, i))
    is_flat = not is_smooth
    if is_smooth:
        lower = wp.min(wp.dot(corner_normals[3 * i], record.normal), wp.dot(corner_normals[3 * i + 1], record.normal))
        is_flat = wp.min(lower, wp.dot(corner_normals[3 * i + 2], record.normal)) > 0.999999
    if is_flat:
        record.curved = 0.0
    records[i] = record


@wp.func
def corner_normal_at(shaded: ShadedMesh, face: int, instance: int, corner: int):
    """Smooth unit normal at a corner of a triangle, in the scene."""
    normal = shaded.corner_normals[3 * face + corner]
    if instance >= 0:
        normal = wp.vec3(unit_or_zero(scene_normal(shaded.mesh.placements[instance], normal)))
    return normal


@wp.func
def raised(point: wp.vec3, corner: wp.vec3, normal: wp.vec3):
    """Vector from the point up to the plane through a corner and perpendicular to its normal; 0 if the point is above it."""
    return -wp.min(0.0, wp.dot(point - corner, normal)) * normal


@wp.func
def inset_weights(weights: wp.vec3, record: FaceRecord, offset: float):
    """Weights of the point, moved away from the edges: `wrt.kernels.query.spawn.keep_from_edges` in float32."""
    inverse = record.inverse_heights
    room = wp.min(INSET * offset, 0.5 / (inverse[0] + inverse[1] + inverse[2]))
    lower = room * inverse
    area = float(0.0)
    if weights[0] < lower[0] or weights[1] < lower[1] or weights[2] < lower[2]:
        area = wp.length(wp.cross(record.edge1, record.edge2))
    result = weights / (weights[0] + weights[1] + weights[2])
    if area > 0.0:
        edge0 = record.edge2 - record.edge1
        edge1 = -record.edge2
        edge2 = record.edge1
        for _ in range(2):
            step0 = wp.max(0.0, lower[0] - result[0]) / inverse[0] / (inverse[0] * area)
            step1 = wp.max(0.0, lower[1] - result[1]) / inverse[1] / (inverse[1] * area)
            step2 = wp.max(0.0, lower[2] - result[2]) / inverse[2] / (inverse[2] * area)
            step = step0 * edge0 + step1 * edge1 + step2 * edge2
            result += wp.vec3(wp.dot(edge0, step), wp.dot(edge1, step), wp.dot(edge2, step)) / area
    return result


@wp.func
def shading_point(shaded: ShadedMesh, primitive: int, uv: wp.vec2, direction: wp.vec3):
    """The point that a ray hits.

    Args:
        shaded: the scene.
        primitive: number of the triangle in the scene.
        uv: weights of its second and third corner.
        direction: unit vector along the ray.
    """
    point = ShadingPoint()
    record = FaceRecord()
    instance = int(-1)
    if shaded.records.shape[0] > 0:
        record = shaded.records[primitive]
        point.face = primitive
    else:
        triangle = triangle_of(shaded.mesh, primitive)
        record = record_of(shaded.mesh, triangle)
        point.face = triangle.face
        instance = triangle.instance
    point.is_front = wp.dot(record.normal, direction) <= 0.0
    side = wp.where(point.is_front, 1.0, -1.0)
    point.face_normal = side * record.normal
    if wp.length_sq(record.normal) == 0.0:
        point.face_normal = -direction
    point.weights = wp.vec3(1.0 - uv[0] - uv[1], uv[0], uv[1])
    near = record.corner + uv[0] * record.edge1 + uv[1] * record.edge2
    point.offset = OFFSET * reach(near, shaded.mesh.low, shaded.mesh.high)
    at = inset_weights(point.weights, record, point.offset)
    point.position = record.corner + at[1] * record.edge1 + at[2] * record.edge2
    point.normal = point.face_normal
    if shaded.is_smooth and record.curved != 0.0:
        na = side * corner_normal_at(shaded, point.face, instance, 0)
        nb = side * corner_normal_at(shaded, point.face, instance, 1)
        nc = side * corner_normal_at(shaded, point.face, instance, 2)
        blend = at[0] * na + at[1] * nb + at[2] * nc
        if wp.dot(blend, point.face_normal) > 0.0 and wp.dot(blend, direction) < 0.0:
            point.normal = wp.normalize(blend)
            point.rise = (
                at[0] * raised(point.position, record.corner, na)
                + at[1] * raised(point.position, record.corner + record.edge1, nb)
                + at[2] * raised(point.position, record.corner + record.edge2, nc)
            )
    return point


@wp.func
def leaving_origin(point: ShadingPoint, is_transmitted: bool):
    """Origin of a secondary ray, off the surface on the side where it goes."""
    return point.position + wp.where(is_transmitted, -point.offset, point.offset) * point.face_normal

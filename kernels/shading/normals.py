"""Smooth normals at the corners of triangles, with creases kept.

A corner's normal is the sum of the normals of the triangles around its vertex, each weighted by its angle there, so that the
result does not depend on how a surface is triangulated (Thuermer and Wuethrich 1998). Only triangles whose planes differ from
the corner's own by less than the crease angle count, so a cube keeps its edges. Both sides of a triangle are shaded, so a
neighbour of opposite winding counts with its normal reversed.

References: thuermer-wuethrich-1998.
"""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel

MAX_VALENCE = wp.constant(256)
"""Vertices of more triangles are shaded flat, because each of their corners reads all the others."""


@wp.func
def unit_or_zero(v: wp.vec3d):
    """Unit vector, or 0 if there is none. The vector is scaled first, so that no square under- or overflows."""
    size = wp.max(wp.abs(v[0]), wp.max(wp.abs(v[1]), wp.abs(v[2])))
    result = wp.vec3d()
    if size > wp.float64(0.0):
        result = wp.normalize(v / size)
    return result


@wp.func
def face_normal(vertices: wp.array(dtype=wp.vec3), face: wp.vec3i):
    """Unit normal by the winding; 0 for a triangle without area."""
    a = wp.vec3d(vertices[face[0]])
    return unit_or_zero(wp.cross(wp.vec3d(vertices[face[1]]) - a, wp.vec3d(vertices[face[2]]) - a))


@exact_kernel
def face_normals_and_angles(
    first: int,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    normals: wp.array(dtype=wp.vec3),
    angles: wp.array(dtype=float),
):
    """Item: a triangle. Writes its unit normal and its three angles, in radians."""
    i = first + wp.tid()
    face = faces[i]
    normals[i] = wp.vec3(face_normal(vertices, face))
    for corner in range(3):
        here = wp.vec3d(vertices[face[corner]])
        one = unit_or_zero(wp.vec3d(vertices[face[(corner + 1) % 3]]) - here)
        other = unit_or_zero(wp.vec3d(vertices[face[(corner + 2) % 3]]) - here)
        angles[3 * i + corner] = float(wp.acos(wp.clamp(wp.dot(one, other), wp.float64(-1.0), wp.float64(1.0))))


@wp.struct
class VertexCorners:
    """The corners that meet at each vertex. Corner c of triangle f has the number 3 f + c."""

    vertex: wp.array(dtype=int)
    """(3 F,) vertex of each corner; coinciding points count as one vertex."""
    start: wp.array(dtype=int)
    """(V + 1,) start of each vertex's list."""
    corner: wp.array(dtype=int)
    """(3 F,) the concatenated lists."""


@exact_kernel
def smooth_corner_normals(
    first: int,
    around: VertexCorners,
    normals: wp.array(dtype=wp.vec3),
    angles: wp.array(dtype=float),
    crease_cosine: float,
    out: wp.array(dtype=wp.vec3),
):
    """Item: a corner. Writes its smooth unit normal, on the side of its triangle's normal; at a crease, the triangle's
    normal."""
    i = first + wp.tid()
    own = normals[i / 3]
    start = around.start[around.vertex[i]]
    end = around.start[around.vertex[i] + 1]
    total = wp.vec3()
    if end - start <= MAX_VALENCE:
        for k in range(start, end):
            corner = around.corner[k]
            normal = normals[corner / 3]
            cosine = wp.dot(own, normal)
            if wp.abs(cosine) >= crease_cosine:
                total += wp.where(cosine < 0.0, -angles[corner], angles[corner]) * normal
    length = wp.length(total)
    out[i] = wp.where(length > 0.0, total / length, own)

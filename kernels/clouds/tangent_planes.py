"""Hits on points as triangles: each hit gets one whose first vertex is the place of the hit, in the plane that touches the
surface there. What is computed of triangles that were hit, such as normals, and origins of rays that leave them, is then that
of points.

The triangles are as large as the cloud, so that float32 gives their normals to some 1e-7.
"""

import warp as wp

from wrt.kernels.clouds.cloud_test import CloudPoints
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel


@native.func_native(
    "spheres.h",
    """const int one = points.radius.shape[0] == 1 ? 0 : id;
    const float* const across = points.normal.shape[0] > 0 ? (const float*)(points.normal.data + id) : nullptr;
    float* const to = (float*)(vertices.data + 3 * (size_t)i);
    wrt::tangent_triangle(
        (const float*)(points.centre.data + id), points.radius.data[one], across, points.components == wrt::BOX, uv.c[0],
        uv.c[1], size, to);""",
)
def tangent_triangle(points: CloudPoints, id: int, uv: wp.vec2, size: float, i: int, vertices: wp.array(dtype=wp.vec3)):
    """Writes the three vertices of the triangle of hit i."""


@exact_kernel
def make_tangents(
    first: int,
    points: CloudPoints,
    primitive: wp.array(dtype=int),
    uv: wp.array(dtype=wp.vec2),
    size: float,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    number: wp.array(dtype=int),
):
    """Writes the triangle of a hit, and its number, which is the hit's; -1 for a miss. Item: a hit."""
    i = first + wp.tid()
    faces[i] = wp.vec3i(3 * i, 3 * i + 1, 3 * i + 2)
    number[i] = int(-1)
    if primitive[i] >= 0:
        tangent_triangle(points, primitive[i], uv[i], size, i, vertices)
        number[i] = i
    else:
        for corner in range(3):
            vertices[3 * i + corner] = wp.vec3()

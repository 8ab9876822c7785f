"""The nearest triangle of each point by a test of all triangles: what every tree is compared with."""

import warp as wp

from wrt.kernels.layout.ray_batch import is_finite
from wrt.kernels.points.point_batch import NearestBatch, PointBatch
from wrt.kernels.points.point_triangle import OnTriangle, nearest_on_triangle
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import INFINITY

exact_module(__name__)


@wp.kernel
def nearest_of_all(
    first: int,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    points: PointBatch,
    found: NearestBatch,
):
    """Writes what is nearest. Item: a point."""
    i = first + wp.tid()
    point = points.position[i]
    most = points.most[i * points.most_stride]
    best = OnTriangle()
    best.square = INFINITY
    primitive = int(-1)
    if is_finite(point) and most >= 0.0:
        for k in range(faces.shape[0]):
            face = faces[k]
            on = nearest_on_triangle(vertices[face[0]] - point, vertices[face[1]] - point, vertices[face[2]] - point)
            if wp.sqrt(on.square) < wp.sqrt(best.square):
                best = on
                primitive = k
    distance = wp.sqrt(best.square)
    if primitive < 0 or distance > most:
        distance = INFINITY
        primitive = -1
        best.u = 0.0
        best.v = 0.0
        best.feature = -1
    found.distance[i] = distance
    found.primitive[i] = primitive
    found.uv[i] = wp.vec2(best.u, best.v)
    found.feature[i] = wp.int8(best.feature)

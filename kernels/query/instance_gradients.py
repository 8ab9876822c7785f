"""`wrt.kernels.query.hit_gradients` through instances: hits as smooth functions of rays, vertices and transforms.

A vertex of a mesh is mapped by the transform of the instance that a ray hits; the rest is as for one level. All arithmetic is
float64. A transform is a (4, 4) matrix, or a position with a quaternion, which is taken as it is, without normalisation: a
quaternion of another length scales, and its gradient says how.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.query.hit_gradients import Edges, result_types, store_hit
from wrt.kernels.runtime.options import specialised_kernel


@wp.func
def placed(transform: Any, row: int, point: wp.vec3d):
    """A coordinate of a mapped point; transform: a (4, 4) matrix."""
    first = wp.float64(transform[row, 0]) * point[0] + wp.float64(transform[row, 1]) * point[1]
    return first + wp.float64(transform[row, 2]) * point[2] + wp.float64(transform[row, 3])


@wp.func
def place(transform: Any, point: wp.vec3d):
    """The point of a mesh in the scene."""
    return wp.vec3d(placed(transform, 0, point), placed(transform, 1, point), placed(transform, 2, point))


@wp.func
def turn(x: wp.float64, y: wp.float64, z: wp.float64, w: wp.float64, point: wp.vec3d):
    """The vector q p q* of a quaternion."""
    axis = wp.vec3d(x, y, z)
    two = wp.float64(2.0)
    return two * wp.dot(axis, point) * axis + (w * w - wp.dot(axis, axis)) * point + two * w * wp.cross(axis, point)


@wp.func
def place_pose(transform: Any, point: wp.vec3d):
    """The same of a position with a quaternion x, y, z, w."""
    shift = wp.vec3d(wp.float64(transform[0]), wp.float64(transform[1]), wp.float64(transform[2]))
    x = wp.float64(transform[3])
    y = wp.float64(transform[4])
    return shift + turn(x, y, wp.float64(transform[5]), wp.float64(transform[6]), point)


@cache
def make_instance_gradient_kernel(Origin: type, Direction: type, Vertex: type, Transform: type, double: bool) -> wp.Kernel:
    """The kernel for arrays of these types; Transform: mat44, mat44d, transform or transformd; otherwise as on one level."""
    Scalar, Pair, Vector = result_types(double)
    store = store_hit(double)
    to_scene = place_pose if Transform in (wp.transformf, wp.transformd) else place

    def intersect_placed_triangles(
        origins: wp.array(dtype=Origin),
        origin_stride: int,
        directions: wp.array(dtype=Direction),
        direction_stride: int,
        vertices: wp.array(dtype=Vertex),
        transforms: wp.array(dtype=Transform),
        faces: wp.array(dtype=wp.vec3i),
        face_of: wp.array(dtype=int),
        instance: wp.array(dtype=int),
        winding: wp.array(dtype=wp.float64),
        t: wp.array(dtype=Scalar),
        uv: wp.array(dtype=Pair),
        positions: wp.array(dtype=Vector),
        normals: wp.array(dtype=Vector),
    ):
        i = wp.tid()
        if face_of[i] >= 0:
            face = faces[face_of[i]]
            own = instance[i]
            triangle = Edges()
            triangle.a = to_scene(transforms[own], wp.vec3d(vertices[face[0]]))
            triangle.edge1 = to_scene(transforms[own], wp.vec3d(vertices[face[1]])) - triangle.a
            triangle.edge2 = to_scene(transforms[own], wp.vec3d(vertices[face[2]])) - triangle.a
            triangle.winding = winding[own]
            origin = wp.vec3d(origins[i * origin_stride])
            direction = wp.vec3d(directions[i * direction_stride])
            store(i, origin, direction, triangle, t, uv, positions, normals)

    return specialised_kernel(intersect_placed_triangles, gradients=True)

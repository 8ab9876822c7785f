"""Bounding boxes of instances: of the points that cover a mesh, mapped to the scene."""

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel

LANES = 8
"""Points that are mapped at a time: those of a mesh begin at a multiple of it, and repeat the last one up to the next."""


@wp.struct
class CoverPoints:
    """Points that cover M meshes, P in all with those that fill lanes."""

    centers: wp.array(dtype=wp.vec3d)
    """(M,) what the points of each mesh are relative to."""
    begins: wp.array(dtype=int)
    """(M + 1,) first point of each mesh, and the number of points; multiples of `LANES`."""
    points: wp.array(dtype=wp.float64)
    """(3 P,) all x, then all y, then all z."""


@wp.struct
class BoundedInstances:
    """Where N instances are."""

    origin: wp.array(dtype=wp.vec3d)
    """(N,) scene position of the centre of each instance's mesh."""
    corners: wp.array(dtype=wp.float64)
    """(6 N,) lowest x of all boxes, then lowest y and z, then highest x, y and z."""
    norms: wp.array(dtype=wp.float64)
    """(N,) product of the norms of the map and of its inverse, each the greatest row sum of absolute values."""


@native.func_native(
    "instances.h",
    f"""wrt::bound_points<{LANES}>(
        points.data, points.shape[0] / 3, begin, end, map, origin, corners.data, corners.shape[0] / 6, i);""",
)
def bound_points(
    points: wp.array(dtype=wp.float64),
    begin: int,
    end: int,
    map: wp.mat33d,
    origin: wp.vec3d,
    corners: wp.array(dtype=wp.float64),
    i: int,
):
    """Writes the box of the points begin .. end - 1, mapped, as that of instance i."""


@wp.func
def norm(m: wp.mat33d):
    """The greatest row sum of absolute values."""
    largest = wp.float64(0.0)
    for row in range(3):
        largest = wp.max(largest, (wp.abs(m[row, 0]) + wp.abs(m[row, 1])) + wp.abs(m[row, 2]))
    return largest


@wp.func
def linear_part(transform: wp.mat44d):
    """The map without its translation."""
    return wp.mat33d(
        transform[0, 0],
        transform[0, 1],
        transform[0, 2],
        transform[1, 0],
        transform[1, 1],
        transform[1, 2],
        transform[2, 0],
        transform[2, 1],
        transform[2, 2],
    )


@wp.func
def inverse_map(m: wp.mat33d):
    """The inverse by elimination with row pivots: the same bits on every device, as no library is asked."""
    left = m
    right = wp.identity(n=3, dtype=wp.float64)
    for column in range(3):
        for row in range(column + 1, 3):
            if wp.abs(left[row, column]) > wp.abs(left[column, column]):
                for k in range(3):
                    kept = left[row, k]
                    left[row, k] = left[column, k]
                    left[column, k] = kept
                    kept = right[row, k]
                    right[row, k] = right[column, k]
                    right[column, k] = kept
        for row in range(column + 1, 3):
            factor = left[row, column] / left[column, column]
            for k in range(3):
                left[row, k] = left[row, k] - factor * left[column, k]
                right[row, k] = right[row, k] - factor * right[column, k]
    for k in range(3):
        right[2, k] = right[2, k] / left[2, 2]
        right[1, k] = (right[1, k] - left[1, 2] * right[2, k]) / left[1, 1]
        right[0, k] = ((right[0, k] - left[0, 1] * right[1, k]) - left[0, 2] * right[2, k]) / left[0, 0]
    return right


@wp.func
def scene_origin(transform: wp.mat44d, center: wp.vec3d):
    """Where a transform puts the centre of a mesh."""
    return linear_part(transform) * center + wp.vec3d(transform[0, 3], transform[1, 3], transform[2, 3])


@wp.func
def bound_instance(
    transform: wp.mat44d, to_object: wp.mat33d, mesh: int, cover: CoverPoints, i: int, bounded: BoundedInstances
):
    """Writes where instance i is, by its transform and the inverse of its linear part."""
    to_scene = linear_part(transform)
    origin = scene_origin(transform, cover.centers[mesh])
    bounded.origin[i] = origin
    bounded.norms[i] = norm(to_scene) * norm(to_object)
    bound_points(cover.points, cover.begins[mesh], cover.begins[mesh + 1], to_scene, origin, bounded.corners, i)


@exact_kernel
def bound_instances(
    first: int,
    transforms: wp.array(dtype=wp.mat44d),
    mesh: wp.array(dtype=int),
    cover: CoverPoints,
    bounded: BoundedInstances,
    to_object: wp.array(dtype=wp.mat33d),
):
    """Writes where an instance is, and the inverse of its map. Item: an instance."""
    i = first + wp.tid()
    to_object[i] = inverse_map(linear_part(transforms[i]))
    bound_instance(transforms[i], to_object[i], mesh[i], cover, i, bounded)

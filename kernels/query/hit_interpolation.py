"""Values of vertices and corners, interpolated at hits; smooth normals."""

import warp as wp

from wrt.kernels.layout.instance_maps import scene_normal
from wrt.kernels.query.hit_attributes import SceneMesh, triangle_of, winding
from wrt.kernels.runtime.options import exact_kernel


@exact_kernel
def interpolate_at_hits(
    first: int,
    mesh: SceneMesh,
    primitive: wp.array(dtype=int),
    uv: wp.array(dtype=wp.vec2),
    corners: wp.array(dtype=wp.vec3i),
    values: wp.array2d(dtype=float),
    out: wp.array2d(dtype=float),
):
    """Writes the weighted sum of the values of a triangle's corners; NaN for a miss. Item: a ray.

    `corners` holds, for each triangle, the rows of `values` of its corners; geometry shared by instances counts once.
    """
    i = first + wp.tid()
    if primitive[i] >= 0:
        rows = corners[triangle_of(mesh, primitive[i]).face]
        u = uv[i][0]
        v = uv[i][1]
        for k in range(values.shape[1]):
            out[i, k] = (1.0 - u - v) * values[rows[0], k] + u * values[rows[1], k] + v * values[rows[2], k]
    else:
        for k in range(values.shape[1]):
            out[i, k] = wp.nan


@exact_kernel
def smooth_normals_at_hits(
    first: int,
    mesh: SceneMesh,
    primitive: wp.array(dtype=int),
    uv: wp.array(dtype=wp.vec2),
    corner_normals: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
):
    """Writes the interpolated normal, on the side of the triangle's own; 0 for a miss. Item: a ray."""
    i = first + wp.tid()
    normal = wp.vec3d()
    if primitive[i] >= 0:
        at = triangle_of(mesh, primitive[i])
        own = winding(mesh, at) * wp.cross(at.b - at.a, at.c - at.a)
        for corner in range(3):
            given = corner_normals[3 * at.face + corner]
            one = wp.vec3d(given)
            if at.instance >= 0:
                one = wp.normalize(scene_normal(mesh.placements[at.instance], given))
            weight = 1.0 - uv[i][0] - uv[i][1]
            if corner > 0:
                weight = uv[i][corner - 1]
            normal += wp.float64(weight) * one
        normal = wp.normalize(wp.where(wp.length_sq(normal) > wp.float64(0.0), normal, own))
    normals[i] = wp.vec3(normal)

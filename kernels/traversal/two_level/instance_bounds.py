"""Bounding boxes of instances: of the points that cover a mesh, mapped to the scene."""

import warp as wp

from wrt.kernels.runtime.options import exact_module

exact_module(__name__)


@wp.kernel
def bound_instances(
    first: int,
    to_scene: wp.array(dtype=wp.mat33d),
    origin: wp.array(dtype=wp.vec3d),
    mesh: wp.array(dtype=int),
    begins: wp.array(dtype=int),
    points: wp.array(dtype=wp.vec3d),
    corners: wp.array2d(dtype=wp.float64),
):
    """Writes the box of an instance. Item: an instance.

    begins: (meshes + 1,) first of each mesh's `points`, which are relative to its centre. corners: (6, instances), lowest x, y
    and z, then highest.
    """
    i = first + wp.tid()
    m = to_scene[i]
    begin = begins[mesh[i]]
    low = m * points[begin]
    high = low
    for k in range(begin + 1, begins[mesh[i] + 1]):
        p = m * points[k]
        low = wp.min(low, p)
        high = wp.max(high, p)
    for axis in range(3):
        corners[axis, i] = low[axis] + origin[i][axis]
        corners[axis + 3, i] = high[axis] + origin[i][axis]

"""Points in the spaces of instances: brought there, and what was found there brought back.

**Problem.** An instance is a mesh in its own space, and so is its tree.

**Idea.** A map that keeps angles scales all distances alike. So the point is mapped in float64 by the inverse, the nearest
triangle is searched in the mesh's space, as near as what earlier instances have given, and its distance is multiplied by the
scale. Of instances at the same distance, the first is kept.
"""

from functools import cache

import warp as wp

from wrt.kernels.points.point_batch import NearestBatch, PointBatch
from wrt.kernels.runtime.options import exact_module, specialised_kernel

exact_module(__name__)

WIDENED = wp.constant(1.000001)
"""Factor of a limit that is divided by a scale, so that rounding loses nothing that is as near."""


@wp.struct
class PointMap:
    """From the scene to the space of a mesh, relative to its centre: linear p + shift."""

    linear: wp.mat33d
    shift: wp.vec3d
    scale: float
    """A distance in the scene over that in the mesh's space."""
    first: int
    """Number of the instance's first triangle in the scene."""


@cache
def make_enter(dtype: type) -> wp.Kernel:
    """The kernel for points of a type, vec3 or vec3d, that brings them and their limits to an instance. Item: a point."""

    def enter_instance(
        first: int, given: wp.array(dtype=dtype), to_mesh: PointMap, most: PointBatch, so_far: NearestBatch, own: PointBatch
    ):
        i = first + wp.tid()
        own.position[i] = wp.vec3(to_mesh.linear * wp.vec3d(given[i]) + to_mesh.shift)
        limit = wp.min(most.most[i * most.most_stride], so_far.distance[i])
        own.most[i] = limit / to_mesh.scale * WIDENED

    return specialised_kernel(enter_instance)


@wp.kernel
def leave_instance(first: int, found: NearestBatch, to_mesh: PointMap, points: PointBatch, so_far: NearestBatch):
    """Keeps what was found in an instance if it is nearer than what earlier ones have given. Item: a point."""
    i = first + wp.tid()
    distance = found.distance[i] * to_mesh.scale
    if found.primitive[i] >= 0 and distance < so_far.distance[i] and distance <= points.most[i * points.most_stride]:
        so_far.distance[i] = distance
        so_far.primitive[i] = to_mesh.first + found.primitive[i]
        so_far.uv[i] = found.uv[i]
        so_far.feature[i] = found.feature[i]

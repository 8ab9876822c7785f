"""The kernels that find the nearest triangle in float64. The search is in kernels/native/exact_points.h.

**Problem.** Trees hold float32, relative to the scene's centre, and round vertices and points.

**Idea.** The walk is that of `wrt.kernels.points.tree_points`. What is as near as the best so far, up to the greatest error of
a distance in float32, is measured again in float64, from the vertices and points as they were given, and compared by that. So
the triangle is that of brute force in float64.

**Bound.** In the notation of `wrt.kernels.points`, the computed distance of a triangle is at most the true one + 256 u R: the
weights of a foot may be wrong, and the foot moves in the plane by no more than that, as flat triangles have theirs computed in
float64. Candidates are all whose computed distance exceeds the best by less than 512 u R.
"""

from functools import cache

import warp as wp

from wrt.kernels.points.point_batch import NearestBatch, PointBatch
from wrt.kernels.points.tree_points import GUARDS, PointConfig, space_code, space_type
from wrt.kernels.query.exact_closest import ExactMesh
from wrt.kernels.query.instance_exact import ExactGeometry
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel


@wp.struct
class ExactPoints:
    """N points, and what is nearest to them, in float64."""

    point: wp.array(dtype=wp.vec3d)
    """(N,) in the scene's coordinates."""
    max_distance: wp.array(dtype=wp.float64)
    """(N,) or (1,) greatest distance at which a triangle is found, with the stride of `PointBatch.max_distance`."""
    t: wp.array(dtype=wp.float64)
    """(N,) distances; inf if nothing was found. Of lists, `room` for each point, as in `NearestBatch`."""
    uv: wp.array(dtype=wp.vec2d)
    """(N,) weights of the triangle's second and third vertex; 0 if nothing was found. Of lists as `t`."""
    room: int
    """Triangles of a list."""


TASKS = {"nearest": "exact_nearest_of_group", "some": "exact_lists_of_group"}
"""C++ of what is searched: the nearest triangle of each point, or the `room` nearest."""


@cache
def make_exact_points_kernel(config: PointConfig) -> wp.Kernel:
    """The kernel for one specialisation, of a task of `TASKS`. Item: a group of points."""
    group, Space = config.group, space_type(config.tree, config.instances)
    Triangles = wp.array(dtype=ExactGeometry) if config.instances else ExactMesh
    space = space_code(config.tree, config.width, config.instances)

    @native.func_native(
        "exact_points.h",
        f"{GUARDS}wrt::{TASKS[config.task]}<{group}>({space}, points, triangles, exact, found, begin);",
    )
    def search_exactly(
        scene: Space, points: PointBatch, triangles: Triangles, exact: ExactPoints, found: NearestBatch, begin: int
    ): ...

    def nearest_in_float64(
        first: int, scene: Space, points: PointBatch, triangles: Triangles, exact: ExactPoints, found: NearestBatch
    ):
        search_exactly(scene, points, triangles, exact, found, (first + wp.tid()) * wp.static(group))

    return specialised_kernel(nearest_in_float64)

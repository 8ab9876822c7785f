"""Closest points inside user kernels: a function that a `@wp.kernel` calls point by point.

As for rays (`wrt.kernels.query.device_functions`), each type of handle adds an overload of the search. The triangle records of
handles are those of their triangle test, whose first rows are the vertices.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.answers.answer_kind import start
from wrt.kernels.points.tree_points import GUARDS, space_code
from wrt.kernels.query.device_functions import TRIANGLE_TEST, NoScene, QueryFunction, centered, hit_of
from wrt.kernels.runtime import native
from wrt.kernels.triangle import TRIANGLE_TESTS

ENTER_TREE = "space.enter((float)point.c[0], (float)point.c[1], (float)point.c[2])"
ENTER_INSTANCES = "space.enter(point.c[0], point.c[1], point.c[2], scene.mask, scene.environment)"


@wp.func
def search_point(scene: NoScene, point: wp.vec3d, max_distance: float):
    """Distance, weights and number (its bits) of the nearest triangle to a point relative to the scene's centre."""
    return wp.vec4(max_distance, 0.0, 0.0, 0.0)


@cache
def add_point_search(handle: type, kind: str, width: int, instances: bool) -> None:
    """Adds the overload of `search_point` for a type of handle, whose trees are as in `PointConfig`."""
    space = space_code(kind, width, instances, TRIANGLE_TESTS[TRIANGLE_TEST].record.components)
    enter = ENTER_INSTANCES if instances else ENTER_TREE
    search = "return wrt::nearest_in<wp::vec_t<4, float>>(space, has_entered, max_distance);"

    @native.func_native("point_spaces.h", f"{GUARDS}auto space = {space};\nconst bool has_entered = {enter};\n{search}")
    def search_handle(scene: handle, point: wp.vec3d, max_distance: float) -> wp.vec4: ...

    search_point.add_overload(search_handle)


@wp.func
def checked_point(point: wp.vec3d):
    """The point. The one function that all searches of points call, so that kernels with other options are refused."""
    return point


checked_point.__class__ = QueryFunction


@wp.func
def closest_point(scene: Any, point: Any, max_distance: float):
    """The `Hit` of the closest point on the scene, whose t is the distance, the same as `Scene.closest_point` finds.

    Args:
        scene: `Scene.handle()`. Instances must be moved, turned, mirrored or scaled alike along all axes: with others,
            distances are wrong.
        point: vec3 or vec3d, in the scene's coordinates. One with a NaN or an infinity misses.
        max_distance: a triangle is found if its distance is at most this (closed interval); a negative one or a NaN misses.
    """
    found = search_point(scene, checked_point(centered(scene, point)), max_distance)
    best = start(found[0])
    best.primitive = wp.cast(found[3], wp.int32)
    best.u = found[1]
    best.v = found[2]
    return hit_of(scene, best)

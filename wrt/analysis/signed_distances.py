"""Distances with signs: by crossings, by pseudonormals or by winding numbers.

References: baerentzen-aanaes-2005; jacobson-2013.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, overload
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp

from wrt.analysis.analysis_arguments import state_of
from wrt.analysis.winding_numbers import ACCURACY, winding_numbers_of
from wrt.engine.rays.rays import as_vectors
from wrt.kernels.fields.distance_signs import apply_signs, find_sides, sides_of_numbers, sides_of_rule
from wrt.kernels.runtime.launch import launch, refuse_capture, use_threads
from wrt.meshes.mesh_measures import first_of_equal_points
from wrt.query.inside import contains
from wrt.query.points.closest_point import closest_point, flat_points, relative_points
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike, Numbers, NumpyLike, WarpLike
    from wrt.engine.facts.scene_state import SceneState
    from wrt.meshes.mesh import TriangleMesh
    from wrt.query.points.closest_points import ClosestPoints
    from wrt.scene.scene import Scene

SignRule: TypeAlias = Literal["auto", "parity", "pseudonormal", "winding"]

INF = float("inf")
AUTO = "auto"


@overload
def signed_distance(scene: Scene, points: NumpyLike, *, sign: SignRule = "auto", max_distance: Numbers = INF) -> np.ndarray: ...
@overload
def signed_distance(scene: Scene, points: WarpLike, *, sign: SignRule = "auto", max_distance: Numbers = INF) -> wp.array: ...
def signed_distance(
    scene: Scene, points: ArrayLike, *, sign: SignRule = "auto", max_distance: Numbers = INF
) -> np.ndarray | wp.array:
    """Distances to the surface, negative inside: (...) float32, a NumPy array if the points were, else a Warp array.

        field = wrt.analysis.signed_distance(scene, points)
        near = wrt.analysis.signed_distance(scene, points, max_distance=0.1)    # inf and -inf farther away

    The distance is that of `wrt.Scene.closest_point`, to any triangle, also to one inside a body; where bodies overlap it is
    not the distance to the surface of their union. The sign is one of these; a page (docs/guides/distances.md) measures which
    of them is right on meshes with faults of all kinds:

    ================ ======================================== ============================================================
    `sign`           inside where                             right for
    ================ ======================================== ============================================================
    `"parity"`       a ray crosses the surface an odd number  closed meshes, whichever way their triangles face; wrong
                     of times                                 where bodies overlap
    `"winding"`      the winding number is above 1/2, or      closed meshes that overlap or meet themselves; holes, which
                     below -1/2                               it closes smoothly; triangles must mostly face the same way
    `"pseudonormal"` the nearest point shows its back         closed meshes that do not meet themselves, and sheets, of
                                                              which it tells the side, up to some 10^6 times the size of
                                                              the scene away; the fastest
    `"auto"`         see `sign_rule`                          what "winding" is right for, and closed meshes whose
                                                              triangles face any way; not sheets, wide cracks, cavities
                                                              whose shells face outwards, and bodies one of which is
                                                              inside out where they overlap
    ================ ======================================== ============================================================

    Args:
        scene: a `wrt.Scene` whose `closest_point` works.
        points: (..., 3).
        sign: "auto", "parity", "pseudonormal" or "winding".
        max_distance: greatest distance that is searched, a number or (...), in units of the vertices; included.

    Returns:
        The distances; inf or -inf where nothing is within `max_distance`, but NaN with `sign="pseudonormal"`, which knows no
        side there; NaN for a point with a NaN or an infinity. On the surface, 0.

    Raises:
        TypeError: scene is not a scene, points are not an array of real numbers, or sign is no name.
        ValueError: wrong shapes, an unknown sign, a negative `max_distance`, an array on another device, or a scene that
            does not answer `closest_point`.
        RuntimeError: a graph is being captured.
    """
    state = state_of(scene)
    state.require_whole("a signed distance")
    rule = lookup(SIGNS, sign, "sign")
    refuse_capture("signed_distance", state.device)
    given = as_vectors(points, "points", state.device)
    found = closest_point(state, given, max_distance)
    distance = with_signs(state, given, found, SIGNS[sign_rule(scene)] if sign == AUTO else rule)
    return distance.reshape(found.shape) if isinstance(given, wp.array) else distance.numpy().reshape(found.shape)


def signed(state: SceneState, points: wp.array, sign: str | None, max_distance: float = INF) -> wp.array:
    """(N,) distances of (N,) vec3d points that follow each other in space, with signs by a rule; None for no signs."""
    found = closest_point(state, points, max_distance, in_order=True)
    return found.batch.t if sign is None else with_signs(state, points, found, SIGNS[sign])


def with_signs(
    state: SceneState, points: np.ndarray | wp.array, found: ClosestPoints, rule: Callable[..., wp.array]
) -> wp.array:
    """(N,) distances of what was found for points, with signs by a rule, a value of `SIGNS`."""
    with use_threads(state.num_threads):
        relative = relative_points(state, flat_points(state, points, points.dtype in (wp.vec3d, np.dtype(np.float64))))
        sides = rule(state, points, relative, found)
        distance = wp.empty(len(relative), dtype=float, device=state.device)
        launch(apply_signs, len(relative), [relative, found.batch.t, sides, distance], device=state.device, chunk=4096)
    return distance


def sign_rule(scene: Scene) -> SignRule:
    """The sign that `sign="auto"` means for a scene: "winding" or "parity".

    Winding numbers, unless every mesh is closed and has neighbouring triangles that face opposite ways: then no sum of signs
    means anything, and the parity of crossings, which needs no front, is right. In a scene whose meshes are closed and face one
    way, winding numbers are whole numbers, and are found exactly by the crossings of a ray, as `wrt.Scene.contains` does;
    otherwise they are sums of solid angles (`winding_number`).
    """
    state = state_of(scene)
    state.require_whole("a signed distance")
    return "parity" if state.is_closed and not is_oriented(state) else "winding"


def is_oriented(state: SceneState) -> bool:
    """Whether triangles face the same way as their neighbours in every mesh: each edge has as many one way as the other."""
    for mesh in set(state.meshes):
        if mesh not in _one_way:
            _one_way[mesh] = faces_one_way(mesh)
    return all(_one_way[mesh] for mesh in state.meshes)


_one_way: WeakKeyDictionary[TriangleMesh, bool] = WeakKeyDictionary()
"""Whether triangles face the same way as their neighbours, of meshes that were asked for."""


def faces_one_way(mesh: TriangleMesh) -> bool:
    """Whether the edges of a mesh are used as often in one direction as in the other, comparing positions."""
    ends = first_of_equal_points(mesh.vertices)[mesh.faces].astype(np.int64)
    starts, stops = ends.ravel(), np.roll(ends, -1, axis=1).ravel()
    low, high = np.minimum(starts, stops), np.maximum(starts, stops)
    _, edge = np.unique(low * mesh.vertex_count + high, return_inverse=True)
    return not np.bincount(edge, np.sign(stops - starts)).any()


def by_parity(state: SceneState, points: Any, relative: wp.array, found: ClosestPoints) -> wp.array:
    """(N,) int8: -1 where `contains` says inside by parity."""
    return sides_by_rule(state, relative, contains(state, points))


def by_winding(state: SceneState, points: Any, relative: wp.array, found: ClosestPoints) -> wp.array:
    """(N,) int8: -1 where the winding number is above 1/2 or below -1/2."""
    if state.is_closed and is_oriented(state):
        return sides_by_rule(state, relative, contains(state, points, rule="winding"))
    sides = wp.empty(len(relative), dtype=wp.int8, device=state.device)
    numbers = winding_numbers_of(state, points, ACCURACY)
    launch(sides_of_numbers, len(relative), [numbers, sides], device=state.device, chunk=4096)
    return sides


def sides_by_rule(state: SceneState, relative: wp.array, inside: Any) -> wp.array:
    """(N,) int8: -1 where points are inside."""
    sides = wp.empty(len(relative), dtype=wp.int8, device=state.device)
    if not isinstance(inside, wp.array):
        inside = wp.array(np.ascontiguousarray(inside).reshape(-1), dtype=wp.bool, device=state.device)
    launch(sides_of_rule, len(relative), [inside.flatten(), sides], device=state.device, chunk=4096)
    return sides


def by_pseudonormal(state: SceneState, points: Any, relative: wp.array, found: ClosestPoints) -> wp.array:
    """(N,) int8: the side of what is nearest; 0 where nothing was found."""
    from wrt.analysis.pseudonormal_table import pseudonormals_of

    sides, feature = wp.empty(len(relative), dtype=wp.int8, device=state.device), found.feature
    if not isinstance(feature, wp.array):
        feature = wp.array(np.ascontiguousarray(feature).reshape(-1), dtype=wp.int8, device=state.device)
    nearest = [found.batch.primitive, found.batch.uv, feature.flatten()]
    launch(find_sides, len(relative), [pseudonormals_of(state), relative, *nearest, sides], device=state.device, chunk=1024)
    return sides


SIGNS = {AUTO: by_winding, "parity": by_parity, "pseudonormal": by_pseudonormal, "winding": by_winding}
"""Signs by name; "auto" chooses one of the others (`sign_rule`)."""

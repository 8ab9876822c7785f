"""Generalised winding numbers of points, exact or by clusters of triangles; see `wrt.kernels.fields`.

References: jacobson-2013; barill-2018.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, overload

import numpy as np
import warp as wp

from wrt.analysis.analysis_arguments import state_of
from wrt.analysis.winding_clusters import clusters_of, visible_mesh, winding_tree
from wrt.engine.launch.triangle_records import vertex_blocks
from wrt.engine.rays.rays import MAX_RAYS, as_vectors
from wrt.kernels.fields.winding_walk import make_winding_kernel
from wrt.kernels.points.point_order import morton_order
from wrt.kernels.runtime.launch import launch, refuse_capture, specialise, use_threads
from wrt.kernels.validation import as_float
from wrt.query.points.closest_point import flat_points, relative_points

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike, NumpyLike, WarpLike
    from wrt.engine.facts.scene_state import SceneState
    from wrt.scene.scene import Scene

ACCURACY = 0.5
"""The default: clusters are at least 2.8 of their radii away."""

MIN_SORTED = 1024
"""Fewest points that are sorted."""


@overload
def winding_number(scene: Scene, points: NumpyLike, *, accuracy: float = ACCURACY) -> np.ndarray: ...
@overload
def winding_number(scene: Scene, points: WarpLike, *, accuracy: float = ACCURACY) -> wp.array: ...
def winding_number(scene: Scene, points: ArrayLike, *, accuracy: float = ACCURACY) -> np.ndarray | wp.array:
    """Generalised winding numbers: how often the surface, with its front outside, surrounds each point.

        inside = wrt.analysis.winding_number(scan, points) > 0.5    # also where the scan has holes

    The number is the sum of the solid angles of all triangles, seen from the point, over 4 pi. Of a closed surface it is a
    whole number: 1 inside a body, 0 outside, -1 in a body that is inside out, 2 where two bodies overlap. Near holes it falls
    smoothly from one to the other. A triangle that occurs twice counts twice. Every scene of triangles has winding numbers;
    instances with mask 0 are left out, and for instances and kd-trees, a BVH of all triangles is built by the first call, and
    kept as long as the scene does not change.

    Triangles that are far away are taken together (Barill et al. 2018, to the third order). The error is at most `accuracy`
    times the sum of A / (4 pi R^2) over the triangles, A being an area and R the distance from the point, within a rounding of
    1e-5; what was measured is some thousandth of that bound (docs/guides/distances.md). On a triangle itself the number is that
    of one of its sides, or between them.

    Args:
        scene: a `wrt.Scene`.
        points: (..., 3).
        accuracy: the factor of the bound, greater for faster answers; 0 sums the solid angles of all triangles in float64.

    Returns:
        (...) float32, or float64 if `accuracy` is 0; NaN for a point with a NaN or an infinity, or beyond float32 if
        `accuracy` is not 0. A NumPy array if the points were, else a Warp array.

    Raises:
        TypeError: scene is not a scene, points are not an array of real numbers, or accuracy is no number.
        ValueError: wrong shapes, an array on another device, or accuracy is negative or not finite.
        RuntimeError: a graph is being captured.
    """
    state, accuracy = state_of(scene), as_float("accuracy", accuracy, finite=True)
    state.require_whole("a winding number")
    if accuracy < 0.0:
        raise ValueError(f"accuracy must be 0 for exact sums, or more, not {accuracy}")
    refuse_capture("winding_number", state.device)
    given = as_vectors(points, "points", state.device)
    is_warp = isinstance(given, wp.array)
    shape = given.shape if is_warp else given.shape[:-1]
    if math.prod(shape) > MAX_RAYS:
        raise ValueError(f"{math.prod(shape):,} points are more than the {MAX_RAYS:,} of one call; pass parts of them")
    found = winding_numbers_of(state, given, accuracy)
    return found.reshape(shape) if is_warp else found.numpy().reshape(shape)


def winding_numbers_of(state: SceneState, points: np.ndarray | wp.array, accuracy: float) -> wp.array:
    """(N,) numbers on the device; arguments as in `winding_number`."""
    with use_threads(state.num_threads):
        return sum_of_all(state, points) if accuracy == 0.0 else sum_of_clusters(state, points, accuracy)


def sum_of_all(state: SceneState, points: np.ndarray | wp.array) -> wp.array:
    """(N,) float64, by every triangle."""
    from wrt.kernels.query.nearest64 import vertex_rows, winding_numbers

    mesh = visible_mesh(state)
    places = (points.numpy() if isinstance(points, wp.array) else points).reshape(-1, 3).astype(np.float64) - state.center
    finite = np.isfinite(places).all(axis=1)
    found = np.full(len(places), np.nan)
    rows = vertex_rows(mesh.vertices.astype(np.float64) - state.center, mesh.faces)
    found[finite] = winding_numbers(rows, places[finite])
    return wp.array(found, dtype=wp.float64, device=state.device)


def sum_of_clusters(state: SceneState, points: np.ndarray | wp.array, accuracy: float) -> wp.array:
    """(N,) float32, by the walk of a tree."""
    tree = winding_tree(state)
    own, device = tree.other or state, state.device
    relative = relative_points(own, flat_points(own, points, points.dtype in (wp.vec3d, np.dtype(np.float64))))
    count = len(relative)
    order = wp.empty(0, dtype=int, device=device)
    if count >= MIN_SORTED:
        order = morton_order(relative, own.device_mesh.low, own.device_mesh.high)
    found = wp.empty(count, dtype=float, device=device)
    inputs = [own.tree.struct(), vertex_blocks(own), clusters_of(tree, own, accuracy), relative, order, found]
    launch(specialise(make_winding_kernel, own.width), count, inputs, device=device, chunk=64, longest=4096)
    return found

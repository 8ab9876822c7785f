"""Closest points with gradients with respect to points and vertices, for a `wp.Tape`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from wrt.kernels.runtime.launch import load
from wrt.query.gradients import on_device

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike
    from wrt.query.api import Queries
    from wrt.query.points.closest_points import ClosestPoints


@dataclass(frozen=True)
class DifferentiablePoints:
    """Closest points as Warp arrays with gradients on the scene's device, in the leading shape (...) of what was found.

    Scalars and vectors are float64 if the points or the vertices are, else float32.

    Attributes:
        distance: (...), from the point to `position`; inf if nothing was found.
        position: (...) vec3, in the coordinates of the vertices; NaN if nothing was found.
    """

    distance: wp.array
    position: wp.array


def differentiable_points(
    scene: Queries, found: ClosestPoints, points: ArrayLike, vertices: ArrayLike | None = None
) -> DifferentiablePoints:
    """Recomputes closest points as smooth functions of points and vertices; triangle and feature of each are fixed.

        found = scene.closest_point(points)  # not on the tape
        with wp.Tape() as tape:
            near = wrt.device.differentiable_points(scene, found, points, vertices)
            wp.launch(loss_of, dim=near.distance.shape, inputs=[near.distance, loss])
        tape.backward(loss)
        points.grad, vertices.grad

    Arguments that are Warp arrays with `requires_grad=True` receive gradients; the others are constants. Points that found
    nothing contribute none. The derivative of a distance of 0 is given as 0. This is one launch; on the CPU it uses one thread,
    because gradients are summed.

    Args:
        scene: the scene that was queried, without instances.
        found: its result, of `closest_point`, with or without `k`. Points and vertices may have changed since, as long as the
            same triangles and features are nearest.
        points: (..., 3) as in `closest_point`, with the leading shape of `found`, without the axis of `k`.
        vertices: (V, 3) of all meshes, concatenated, in the scene's coordinates; None for the scene's own.

    Raises:
        TypeError: an argument is not an array of real numbers.
        ValueError: a wrong shape, results of another scene or from a pickle, a scene of instances, an array on another device.
    """
    from wrt.kernels.points.point_gradients import make_point_gradient_kernel
    from wrt.kernels.query.hit_gradients import result_types

    device, count, shape = scene.device, found.batch.count, found.shape or (1,)
    if scene.instances:
        raise ValueError("differentiable_points needs a scene without instances; use wrt.Scene(scene.flattened())")
    if not hasattr(found, "features") or not found.is_of(scene.state):
        raise ValueError("found belongs to another scene, or to a pickle; pass what this scene's closest_point returned")
    corners = scene.state.exact_vertices if vertices is None else on_device(vertices, "vertices", device)
    if corners.shape != scene.state.exact_vertices.shape:
        raise ValueError(
            f"vertices have the shape {corners.shape}, those of the scene {scene.state.exact_vertices.shape}; pass all vertices"
        )
    given = on_device(points, "points", device)
    if given.shape not in (found.shape, found.shape[:-1]) and not (given.size == count == 1):
        raise ValueError(
            f"points have the leading shape {given.shape}, what was found {found.shape}; pass those that were asked"
        )
    flat = given.flatten() if given.ndim else given.reshape(1)
    double = flat.dtype is wp.vec3d or (vertices is not None and corners.dtype is wp.vec3d)
    Scalar, _, Vector = result_types(double)
    outputs = [
        wp.full(count, value, dtype=dtype, device=device, requires_grad=True)
        for value, dtype in ((np.inf, Scalar), (np.nan, Vector))
    ]
    kernel = make_point_gradient_kernel(flat.dtype, corners.dtype, double)
    load([kernel], device)
    inputs = [flat, max(count // max(flat.size, 1), 1), corners, scene.state.device_mesh.faces, *found.features]
    wp.launch(kernel, dim=count, inputs=inputs, outputs=outputs, device=device)
    return DifferentiablePoints(*(values.reshape(shape) for values in outputs))

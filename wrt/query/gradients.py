"""Hits with gradients with respect to rays and vertices, for a `wp.Tape`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.kernels.runtime.launch import load
from wrt.rays.rays import as_vectors

if TYPE_CHECKING:
    from wrt.query.api import Queries
    from wrt.query.hits import Hits


@dataclass(frozen=True)
class DifferentiableHits:
    """Closest hits as Warp arrays with gradients on the scene's device, in the leading shape (...) of the hits.

    Scalars and vectors are float64 if the rays or the vertices are, else float32.

    Attributes:
        t: (...), in units of the direction's length; inf for a miss.
        uv: (...) vec2, weights of the triangle's second and third vertex; 0 for a miss.
        position: (...) vec3, in the coordinates of the vertices; NaN for a miss.
        normal: (...) vec3, unit vectors from the triangle's winding; 0 for a miss.
    """

    t: wp.array
    uv: wp.array
    position: wp.array
    normal: wp.array


def differentiable_hits(scene: Queries, hits: Hits, origins: Any, directions: Any, vertices: Any = None) -> DifferentiableHits:
    """Recomputes hits as smooth functions of rays and vertices; the triangle that each ray hits is fixed.

        hits = scene.intersect(origins, directions)  # not on the tape
        with wp.Tape() as tape:
            found = wrt.differentiable_hits(scene, hits, origins, directions, vertices)
            wp.launch(loss_of, dim=found.t.shape, inputs=[found.t, measured, loss])
        tape.backward(loss)
        origins.grad, directions.grad, vertices.grad

    Arguments that are Warp arrays with `requires_grad=True` receive gradients; the others are constants. Misses contribute
    no gradient, whatever the loss does with them. This is one launch; on the CPU it uses one thread, because gradients are
    summed.

    Args:
        scene: the scene that was queried.
        hits: its result. Rays and vertices may have changed since, as long as the rays still hit the same triangles.
        origins, directions: (..., 3) as in `intersect`, with the hits' leading shape, or one vector for all rays.
        vertices: (V, 3) of all meshes, concatenated, in the scene's coordinates; None for the scene's own.

    Returns:
        The hits as arrays with gradients.

    Raises:
        TypeError: an argument is not an array of real numbers.
        ValueError: a wrong shape, hits of another scene, a scene of instances, or an array on another device.
    """
    from wrt.kernels.query.hit_gradients import make_kernel

    if scene.instances:
        raise ValueError(
            "gradients need a scene without instances; use wrt.Scene(scene.flattened()), which numbers the triangles of all "
            "instances, for hits and gradients"
        )
    device, count, shape = scene.device, len(hits.batch.t), hits.shape or (1,)
    if hits.batch.t.device != device:
        raise ValueError(f"hits are on {hits.batch.t.device}, the scene on {device}; pass hits of this scene")
    if not hits.is_of(scene.state):
        raise ValueError("hits belong to another scene; pass hits of this scene")
    points = scene.exact_vertices if vertices is None else _on_device(vertices, "vertices", device)
    if points.shape != scene.exact_vertices.shape:
        raise ValueError(
            f"vertices have the shape {points.shape}, those of the scene {scene.exact_vertices.shape}; pass all vertices"
        )
    start, origin_stride = _ray_vectors(origins, "origins", shape, device)
    toward, direction_stride = _ray_vectors(directions, "directions", shape, device)
    double = any(values.dtype is wp.vec3d for values in (start, toward, *(() if vertices is None else (points,))))
    Scalar, Pair, Vector = (wp.float64, wp.vec2d, wp.vec3d) if double else (wp.float32, wp.vec2, wp.vec3)
    outputs = [
        wp.full(count, value, dtype=dtype, device=device, requires_grad=True)
        for value, dtype in ((np.inf, Scalar), (0.0, Pair), (np.nan, Vector), (0.0, Vector))
    ]
    kernel = make_kernel(start.dtype, toward.dtype, points.dtype, double)
    inputs = [start, origin_stride, toward, direction_stride, points, scene.device_mesh.faces, hits.batch.primitive]
    load([kernel], device)
    wp.launch(kernel, dim=count, inputs=inputs, outputs=outputs, device=device)
    return DifferentiableHits(*(values.reshape(shape) for values in outputs))


def _on_device(values: Any, name: str, device: wp.Device) -> wp.array:
    """(...) vec3 or vec3d; a Warp array keeps its gradient."""
    values = as_vectors(values, name, device)
    if isinstance(values, wp.array):
        return values
    return wp.array(values, dtype=wp.vec3 if values.dtype == np.float32 else wp.vec3d, device=device)


def _ray_vectors(values: Any, name: str, shape: tuple[int, ...], device: wp.Device) -> tuple[wp.array, int]:
    """((N,) array, 1), or ((1,) array, 0) if all rays share it."""
    array = _on_device(values, name, device)
    if array.size != 1 and array.shape != shape:
        raise ValueError(f"{name} have the leading shape {array.shape}, the hits {shape}; pass the rays that were traced")
    return array.flatten() if array.ndim else array.reshape(1), int(array.size != 1)

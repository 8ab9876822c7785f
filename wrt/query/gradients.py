"""Hits with gradients with respect to rays, vertices and transforms of instances, for a `wp.Tape`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.engine.rays.rays import as_vectors
from wrt.kernels.runtime.launch import kept, launch, load
from wrt.kernels.validation import as_real_array

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike
    from wrt.query.api import Queries
    from wrt.query.hits import Hits


TRANSFORMS = (wp.mat44, wp.mat44d, wp.transformf, wp.transformd)


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


def differentiable_hits(
    scene: Queries,
    hits: Hits,
    origins: ArrayLike,
    directions: ArrayLike,
    vertices: ArrayLike | None = None,
    transforms: ArrayLike | None = None,
) -> DifferentiableHits:
    """Recomputes hits as smooth functions of rays, vertices and transforms; the triangle that each ray hits is fixed.

        hits = scene.intersect(origins, directions)  # not on the tape
        with wp.Tape() as tape:
            found = wrt.device.differentiable_hits(scene, hits, origins, directions, vertices)
            wp.launch(loss_of, dim=found.t.shape, inputs=[found.t, measured, loss])
        tape.backward(loss)
        origins.grad, directions.grad, vertices.grad

    Arguments that are Warp arrays with `requires_grad=True` receive gradients; the others are constants. Misses contribute
    no gradient, whatever the loss does with them. This is one launch; on the CPU it uses one thread, because gradients are
    summed.

    Args:
        scene: the scene that was queried.
        hits: its result. Rays, vertices and transforms may have changed since, as long as the rays hit the same triangles.
        origins, directions: (..., 3) as in `intersect`, with the hits' leading shape, or one vector for all rays.
        vertices: (V, 3) of all meshes, concatenated: in the scene's coordinates, or, in a scene of instances, each mesh once
            (`Scene.meshes`) in its own space. None for the scene's own.
        transforms: in a scene of instances, (I, 4, 4) of all of them, or a Warp array (I,) of mat44, mat44d or `wp.transform`
            (whose quaternions are not normalised); None for the scene's own.

    Returns:
        The hits as arrays with gradients.

    Raises:
        TypeError: an argument is not an array of real numbers.
        ValueError: a wrong shape, hits of another scene, transforms in a scene without instances, an array on another device.
    """
    from wrt.kernels.query import hit_gradients, instance_gradients

    device, count, shape = scene.device, len(hits.batch.t), hits.shape or (1,)
    if hits.batch.t.device != device:
        raise ValueError(f"hits are on {hits.batch.t.device}, the scene on {device}; pass hits of this scene")
    if not hits.is_of(scene.state):
        raise ValueError("hits belong to another scene; pass hits of this scene")
    points = scene.state.exact_vertices if vertices is None else on_device(vertices, "vertices", device)
    if points.shape != scene.state.exact_vertices.shape:
        raise ValueError(
            f"vertices have the shape {points.shape}, those of the scene {scene.state.exact_vertices.shape}; pass all vertices"
        )
    start, origin_stride = _ray_vectors(origins, "origins", shape, device)
    toward, direction_stride = _ray_vectors(directions, "directions", shape, device)
    if transforms is not None:
        scene.state.require_instances("transforms")
    places = _transforms(scene, transforms, device) if scene.instances else None
    given = (start, toward, *(() if vertices is None else (points,)), *(() if transforms is None else (places,)))
    double = any(values.dtype in (wp.vec3d, wp.mat44d, wp.transformd) for values in given)
    Scalar, Pair, Vector = hit_gradients.result_types(double)
    outputs = [
        wp.full(count, value, dtype=dtype, device=device, requires_grad=True)
        for value, dtype in ((np.inf, Scalar), (0.0, Pair), (np.nan, Vector), (0.0, Vector))
    ]
    inputs = [start, origin_stride, toward, direction_stride, points]
    if scene.instances:
        kernel = instance_gradients.make_instance_gradient_kernel(start.dtype, toward.dtype, points.dtype, places.dtype, double)
        inputs += [places, *_placed_triangles(scene, hits)]
    else:
        kernel = hit_gradients.make_gradient_kernel(start.dtype, toward.dtype, points.dtype, double)
        inputs += [scene.state.device_mesh.faces, hits.batch.primitive]
    load([kernel], device)
    wp.launch(kernel, dim=count, inputs=inputs, outputs=outputs, device=device)
    return DifferentiableHits(*(values.reshape(shape) for values in outputs))


def _transforms(scene: Queries, transforms: Any, device: wp.Device) -> wp.array:
    """(I,) matrices or poses of all instances; a Warp array keeps its gradient.

    Raises:
        TypeError: an array of another type.
        ValueError: another number of transforms, or an array on another device.
    """
    count = len(scene.instances)
    if isinstance(transforms, wp.array):
        if transforms.dtype not in TRANSFORMS or transforms.shape != (count,):
            raise TypeError(
                f"transforms must be a Warp array ({count},) of mat44, mat44d, transform or transformd, not "
                f"{transforms.shape} of {transforms.dtype.__name__}"
            )
        if transforms.device != device:
            raise ValueError(f"transforms are on {transforms.device}, the scene on {device}; copy them there")
        return transforms
    values = scene.state.instances.transforms if transforms is None else transforms
    matrices = as_real_array("transforms", values)
    if matrices.shape != (count, 4, 4):
        raise ValueError(f"transforms have the shape {matrices.shape}; pass ({count}, 4, 4), one for each instance")
    kind = wp.mat44 if matrices.dtype == np.float32 else wp.mat44d
    return wp.array(np.ascontiguousarray(matrices, dtype=wp.dtype_to_numpy(kind._wp_scalar_type_)), dtype=kind, device=device)


def _placed_triangles(scene: Queries, hits: Hits) -> list[wp.array]:
    """Faces of all meshes, the face and the instance that each ray hits, and 1 or -1, for mirrored ones, for each instance."""
    from wrt.kernels.query.hit_attributes import number_faces

    device, tables = scene.device, scene.state.cache.tables
    key = ("faces", "")
    if key not in tables:
        faces, first_vertex, first_face = [], 0, [0]
        for mesh in scene.meshes:
            faces.append(mesh.faces + first_vertex)
            first_vertex, first_face = first_vertex + mesh.vertex_count, [*first_face, first_face[-1] + mesh.triangle_count]
        with kept(device):
            tables[key] = (
                wp.array(np.concatenate(faces).astype(np.int32), dtype=wp.vec3i, device=device),
                wp.array(np.array(first_face), dtype=int, device=device),
            )
    faces, first_face = tables[key]
    instance, geometry, local = hits.located
    face_of = wp.empty_like(local)
    launch(number_faces, len(local), [geometry, local, first_face, face_of], device=device)
    signs = np.sign(np.linalg.det(scene.state.instances.transforms[:, :3, :3]))
    return [faces, face_of, instance, wp.array(signs, dtype=wp.float64, device=device)]


def on_device(values: Any, name: str, device: wp.Device) -> wp.array:
    """(...) vec3 or vec3d; a Warp array keeps its gradient."""
    values = as_vectors(values, name, device)
    if isinstance(values, wp.array):
        return values
    return wp.array(values, dtype=wp.vec3 if values.dtype == np.float32 else wp.vec3d, device=device)


def _ray_vectors(values: Any, name: str, shape: tuple[int, ...], device: wp.Device) -> tuple[wp.array, int]:
    """((N,) array, 1), or ((1,) array, 0) if all rays share it."""
    array = on_device(values, name, device)
    if array.size != 1 and array.shape != shape:
        raise ValueError(f"{name} have the leading shape {array.shape}, the hits {shape}; pass the rays that were traced")
    return array.flatten() if array.ndim else array.reshape(1), int(array.size != 1)

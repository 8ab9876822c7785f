"""What closest points are compared with: brute force in float32 with the bits of trees, and distances in float64."""

from __future__ import annotations

import numpy as np
import warp as wp

import wrt
from wrt.kernels.layout.ray_batch import is_finite
from wrt.kernels.points.point_batch import NearestBatch, PointBatch
from wrt.kernels.points.point_triangle import OnTriangle, nearest_on_triangle
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.simd.boxes import INFINITY
from wrt.query.points.closest_point import flat_points, relative_points


@exact_kernel
def nearest_of_all(
    first: int,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    points: PointBatch,
    found: NearestBatch,
):
    """Writes the nearest of all triangles, which trees are compared with. Item: a point."""
    i = first + wp.tid()
    point = points.position[i]
    most = points.max_distance[i * points.distance_stride]
    best = OnTriangle()
    best.square = INFINITY
    primitive = int(-1)
    if is_finite(point) and most >= 0.0:
        for k in range(faces.shape[0]):
            face = faces[k]
            on = nearest_on_triangle(vertices[face[0]] - point, vertices[face[1]] - point, vertices[face[2]] - point)
            if wp.sqrt(on.square) < wp.sqrt(best.square):
                best = on
                primitive = k
    distance = wp.sqrt(best.square)
    if primitive < 0 or distance > most:
        distance = INFINITY
        primitive = -1
        best.u = 0.0
        best.v = 0.0
        best.feature = -1
    found.distance[i] = distance
    found.primitive[i] = primitive
    found.uv[i] = wp.vec2(best.u, best.v)
    found.feature[i] = wp.int8(best.feature)


def answers(found: wrt.results.ClosestPoints) -> dict[str, np.ndarray]:
    """What a search stores."""
    return {name: getattr(found, name) for name in ("distance", "uv", "feature", "primitive_id")}


def brute_force(scene: wrt.Scene, points: np.ndarray, max_distance: float | np.ndarray = np.inf) -> dict[str, np.ndarray]:
    """The same by a test of every triangle, of a scene of one mesh."""
    batch, found, device, count = PointBatch(), NearestBatch(), scene.device, len(points)
    most = np.atleast_1d(np.asarray(max_distance, dtype=np.float32))
    batch.count, batch.position = (
        count,
        relative_points(scene.state, flat_points(scene.state, points, points.dtype == np.float64)),
    )
    batch.max_distance, batch.distance_stride = wp.array(most, dtype=float, device=device), int(len(most) > 1)
    found.distance, found.primitive = wp.empty(count, dtype=float, device=device), wp.empty(count, dtype=int, device=device)
    found.uv, found.feature = wp.empty(count, dtype=wp.vec2, device=device), wp.empty(count, dtype=wp.int8, device=device)
    mesh = scene.state.device_mesh
    launch(nearest_of_all, count, [mesh.vertices, mesh.faces, batch, found], device=device, chunk=64)
    values = (found.distance, found.uv, found.feature, found.primitive)
    return dict(zip(("distance", "uv", "feature", "primitive_id"), (each.numpy() for each in values), strict=True))


def points_around(mesh: wrt.TriangleMesh, count: int) -> np.ndarray:
    """(count, 3) float32 points in and around the box, near triangles, on vertices and on the middles of faces."""
    rng = np.random.default_rng(count)
    low, high = np.asarray(mesh.bounds, dtype=np.float64)
    size = max(np.ptp([low, high], axis=0).max(), np.finfo(np.float32).tiny)
    faces = mesh.vertices[mesh.faces[rng.integers(0, mesh.triangle_count, count)]].astype(np.float64)
    on = np.einsum("nij,ni->nj", faces, rng.dirichlet([1, 1, 1], count))
    kinds = [
        rng.uniform(low - 0.4 * size, high + 0.4 * size, (count, 3)),
        on + rng.normal(size=(count, 3)) * 0.01 * size,
        faces[:, 0],
        faces.mean(axis=1),
        rng.normal(size=(count, 3)) * 30.0 * size,
    ]
    chosen = rng.choice(5, count, p=[0.4, 0.3, 0.1, 0.1, 0.1])
    return np.stack(kinds)[chosen, np.arange(count)].astype(np.float32)


def true_distances(mesh: wrt.TriangleMesh, points: np.ndarray) -> np.ndarray:
    """(N,) float64 distances from all triangles, by edges and by the foot on the plane, in units of the mesh's size."""
    size = max(float(np.abs(mesh.bounds).max()), 1e-300)
    corners = mesh.vertices[mesh.faces].astype(np.float64) / size
    found = np.empty(len(points))
    for i, point in enumerate(np.asarray(points, dtype=np.float64) / size):
        at = corners - point
        found[i] = np.sqrt(squares(at).min())
    return found * size


def squares(at: np.ndarray) -> np.ndarray:
    """(F,) squared distances of triangles (F, 3, 3) from 0."""
    least = np.full(len(at), np.inf)
    for k in range(3):
        start, edge = at[:, k], at[:, (k + 1) % 3] - at[:, k]
        length = (edge * edge).sum(axis=1)
        t = np.clip(-(start * edge).sum(axis=1) / np.where(length > 0, length, 1.0), 0.0, 1.0)
        least = np.minimum(least, ((start + t[:, None] * edge) ** 2).sum(axis=1))
    b, c = at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]
    normal = np.cross(b, c)
    area = (normal * normal).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = ((normal * np.cross(c, at[:, 0])).sum(1) / area, (normal * np.cross(at[:, 0], b)).sum(1) / area)
        height = (normal * at[:, 0]).sum(axis=1) ** 2 / area
    within = (area > 0) & (u >= 0) & (v >= 0) & (u + v <= 1)
    return np.where(within, np.minimum(height, least), least)

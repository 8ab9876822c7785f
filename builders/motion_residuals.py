"""How far triangles stray in the spaces of clusters: what motion decomposition assigns them by (`motion_clusters`)."""

import numpy as np
import warp as wp

from wrt.kernels.runtime.launch import as_device, launch
from wrt.kernels.runtime.options import exact_kernel

CHUNK = 1024
"""Vertices or triangles that are worth a chunk of their own."""


@exact_kernel
def measure_vertices(
    first: int,
    cluster: int,
    frames: wp.array2d(dtype=wp.vec3d),
    inverse: wp.array2d(dtype=wp.mat33d),
    origins: wp.array2d(dtype=wp.vec3d),
    sizes: wp.array2d(dtype=wp.float64),
):
    """Item: a vertex. frames: (F, V); inverse, origins: (F, C).

    sizes: (C, V) the sum of the sides of the box that each vertex needs over all frames."""
    vertex = first + wp.tid()
    low = inverse[0, cluster] * (frames[0, vertex] - origins[0, cluster])
    high = low
    for frame in range(1, frames.shape[0]):
        own = inverse[frame, cluster] * (frames[frame, vertex] - origins[frame, cluster])
        low = wp.min(low, own)
        high = wp.max(high, own)
    size = high - low
    sizes[cluster, vertex] = size[0] + size[1] + size[2]


@exact_kernel
def choose_clusters(
    first: int,
    faces: wp.array(dtype=wp.vec3i),
    sizes: wp.array2d(dtype=wp.float64),
    labels: wp.array(dtype=int),
    residual: wp.array(dtype=wp.float64),
):
    """Item: a triangle. labels: the cluster in which the largest box of its corners is smallest, the first of equals; residual:
    that box's size."""
    triangle = first + wp.tid()
    face = faces[triangle]
    best = int(0)
    min_size = wp.float64(0.0)
    for cluster in range(sizes.shape[0]):
        size = wp.max(sizes[cluster, face[0]], wp.max(sizes[cluster, face[1]], sizes[cluster, face[2]]))
        if cluster == 0 or size < min_size:
            min_size = size
            best = cluster
    labels[triangle] = best
    residual[triangle] = min_size


def nearest_clusters(
    frames: np.ndarray, faces: np.ndarray, matrices: np.ndarray, origins: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Of each triangle the cluster where it needs the smallest boxes, (T,) int, and how large they are, (T,) float64.

    Args:
        frames: (F, V, 3).
        faces: (T, 3).
        matrices, origins: (F, C, 3, 3), (F, C, 3).
    """
    device, clusters, vertices = as_device("cpu"), matrices.shape[1], frames.shape[1]

    def array(values: np.ndarray, dtype: type) -> wp.array:
        return wp.array(np.ascontiguousarray(values, dtype=np.float64), dtype=dtype, device=device, copy=False)

    maps = [array(frames, wp.vec3d), array(np.linalg.inv(matrices), wp.mat33d), array(origins, wp.vec3d)]
    sizes = wp.empty((clusters, vertices), dtype=wp.float64, device=device)
    for cluster in range(clusters):
        launch(measure_vertices, vertices, [cluster, *maps, sizes], device=device, chunk=CHUNK)
    corners = wp.array(np.ascontiguousarray(faces, dtype=np.int32), dtype=wp.vec3i, device=device, copy=False)
    labels = wp.empty(len(faces), dtype=int, device=device)
    residual = wp.empty(len(faces), dtype=wp.float64, device=device)
    launch(choose_clusters, len(faces), [corners, sizes, labels, residual], device=device, chunk=CHUNK)
    return labels.numpy(), residual.numpy()

"""Clusters that need no sort: the meshes of a scene, or the clusters of the previous frame (Hunt, Mark and Fussell 2007).

**Meshes.** The triangles of a mesh have consecutive ids, and its box is known, so the scene itself is a list of clusters. The
top of the tree is built over the meshes' boxes in O(meshes), without reading a triangle. A mesh that a ray reaches is sorted
then, unless it is small. The meshes may be in groups, which are then nodes of their own (`scene_groups`).

**Previous frame.** Triangles that move keep most of their neighbours. The order of the last frame's clusters is kept, and one
pass over the triangles computes their new boxes. When the clusters have grown too much, they are sorted anew
(`MAX_GROWN_AREA`).

References: hunt-2007.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wrt.builders.kdtree.lazy.triangle_clusters import Clusters
from wrt.builders.triangle_boxes import Boxes, TriangleBoxes
from wrt.kernels.runtime import native
from wrt.kernels.runtime.launch import launch
from wrt.kernels.runtime.options import exact_kernel

MAX_GROWN_AREA = 1.5
"""Area of the boxes of all clusters, relative to that after the last sort, from which on they are sorted anew. Both are
measured in areas of the scene's box."""


@dataclass(frozen=True)
class MeshBoxes:
    """The meshes of a scene.

    Attributes:
        first: (meshes + 1,) the first triangle of each mesh, and the number of all triangles.
        low, high: (meshes, 3) float32, the box of each mesh's triangles, relative to the same point as they are.
        hierarchy: how they are nested: the number of a mesh, or a tuple of hierarchies, in the order of the meshes; None if
            they are not, or if it does not matter.
    """

    first: np.ndarray
    low: np.ndarray
    high: np.ndarray
    hierarchy: Any = None


def widened(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The next larger boxes in float32, which contain what is in the faces of the others."""
    return np.nextafter(low, -np.float32(np.inf)), np.nextafter(high, np.float32(np.inf))


def mesh_clusters(meshes: MeshBoxes, device: wp.Device) -> Clusters | None:
    """A cluster for each mesh; None if there is only one."""
    sizes = np.diff(meshes.first)
    used = np.flatnonzero(sizes)
    if len(used) < 2:
        return None
    low, high = widened(meshes.low[used], meshes.high[used])
    count = int(meshes.first[-1])
    order = wp.array(np.arange(count, dtype=np.int32), dtype=int, device=device)
    first = np.append(np.asarray(meshes.first, dtype=np.int64)[used], count)
    return Clusters(order, first, low, high, low, high, are_meshes=True)


@native.func_native("clusters.h", "wrt::box_of_range(boxes, order.data, begin, end, corners.data + (size_t)cluster * 12);")
def box_of_range(
    boxes: Boxes, order: wp.array(dtype=int), begin: int, end: int, cluster: int, corners: wp.array2d(dtype=float)
):
    """The box of the triangles order[begin .. end - 1], and that of their centres: (low, -high) of both."""


@exact_kernel
def measure_clusters(
    first: int, boxes: Boxes, order: wp.array(dtype=int), starts: wp.array(dtype=int), corners: wp.array2d(dtype=float)
):
    """Item: a cluster. starts: (clusters + 1,). corners: (clusters, 12)."""
    cluster = first + wp.tid()
    box_of_range(boxes, order, starts[cluster], starts[cluster + 1], cluster, corners)


def moved_clusters(old: Clusters, triangles: TriangleBoxes) -> Clusters | None:
    """The clusters of the previous frame around the same triangles elsewhere; None if they have grown too much, or if there
    are other triangles than before.

    Cores are the boxes of the triangles' centres, which do not overlap as long as no triangle moves."""
    if len(old.order) != triangles.count:
        return None
    device = old.order.device
    corners = wp.empty((len(old.low), 12), dtype=float, device=device)
    starts = wp.array(old.first, dtype=int, device=device)
    launch(measure_clusters, len(old.low), [triangles.boxes, old.order, starts, corners], device=device, chunk=16)
    low, high, core_low, core_high = corners.numpy().reshape(-1, 4, 3).transpose(1, 0, 2)
    low, high = widened(low, -high)
    sorted_area = old.sorted_area or relative_area(old.low, old.high)
    if not relative_area(low, high) <= MAX_GROWN_AREA * sorted_area:
        return None
    core_low, core_high = np.clip(core_low, low, high), np.clip(-core_high, low, high)
    return Clusters(old.order, old.first, low, high, core_low, core_high, sorted_area=sorted_area)


def relative_area(low: np.ndarray, high: np.ndarray) -> float:
    """Area of boxes, relative to that of the box around them; NaN if that has none."""

    def area(size: np.ndarray) -> np.ndarray:
        return size[..., 0] * size[..., 1] + size[..., 1] * size[..., 2] + size[..., 2] * size[..., 0]

    with np.errstate(all="ignore"):
        whole = area(high.max(axis=0).astype(np.float64) - low.min(axis=0))
        return float(area(high.astype(np.float64) - low).sum() / whole)

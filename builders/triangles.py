"""Bounding boxes of triangles: what every builder starts from."""

from dataclasses import dataclass, field

import numpy as np
import warp as wp

from wrt.kernels.launch import launch

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.struct
class Boxes:
    """Bounding boxes of triangles, component by component."""

    low: wp.array2d(dtype=float)
    """(3, triangles)"""
    high: wp.array2d(dtype=float)


@wp.kernel
def compute_boxes(first: int, vertices: wp.array(dtype=wp.vec3), faces: wp.array(dtype=wp.vec3i), boxes: Boxes):
    """Item: a triangle. Adding 0 turns -0 into +0, so that equal positions have equal bits."""
    i = first + wp.tid()
    face = faces[i]
    a = vertices[face[0]]
    b = vertices[face[1]]
    c = vertices[face[2]]
    for axis in range(3):
        boxes.low[axis, i] = wp.min(a[axis], wp.min(b[axis], c[axis])) + 0.0
        boxes.high[axis, i] = wp.max(a[axis], wp.max(b[axis], c[axis])) + 0.0


@dataclass
class TriangleBoxes:
    """Boxes of all triangles, the box of them all, and the point (3,) that positions are relative to."""

    boxes: Boxes
    count: int
    low: np.ndarray
    high: np.ndarray
    center: np.ndarray = field(default_factory=lambda: np.zeros(3))


def triangle_boxes(vertices: wp.array, faces: wp.array, center: np.ndarray | None = None) -> TriangleBoxes:
    """Bounding boxes of the triangles.

    Args:
        vertices: (V,) vec3.
        faces: (F,) vec3i.
        center: (3,) the point that vertices are relative to; None for the origin.
    """
    device, count = vertices.device, len(faces)
    boxes = Boxes()
    boxes.low = wp.empty((3, count), dtype=float, device=device)
    boxes.high = wp.empty((3, count), dtype=float, device=device)
    launch(compute_boxes, count, [vertices, faces, boxes], device=device, chunk=4096)
    low, high = boxes.low.numpy().min(axis=1), boxes.high.numpy().max(axis=1)
    return TriangleBoxes(boxes, count, low, high, np.zeros(3) if center is None else center)

"""Random triangles in the unit box: a scene of any size without structure that an accelerator could use."""

from __future__ import annotations

import numpy as np

from wrt.meshes.mesh import TriangleMesh
from wrt.scenes.shapes import check_count, check_positive

__all__ = ["random_triangles"]


def random_triangles(count: int = 1000, size: float = 0.1, seed: int = 0) -> TriangleMesh:
    """Independent random triangles inside [0, 1]^3.

    Every triangle has a cube of side `size` whose centre is uniform in [size/2, 1 - size/2]^3; its three corners are
    independent and uniform in that cube. So no triangle leaves the unit box, and the density falls off linearly
    within `size` of its faces. No two triangles share a vertex.

    Args:
        count: number of triangles, >= 1.
        size: side of the cubes, in (0, 1].
        seed: the same seed gives the same triangles; a larger count does not keep the smaller one's triangles.

    Raises:
        TypeError: an argument is no number.
        ValueError: count < 1, seed < 0 or size outside (0, 1].
    """
    count = check_count("count", count)
    size = check_positive("size", size, maximum=1.0)
    random = np.random.default_rng(check_count("seed", seed, 0))
    corner = random.random((count, 1, 3)) * (1.0 - size)
    vertices = np.clip(corner + random.random((count, 3, 3)) * size, 0.0, 1.0)
    return TriangleMesh(vertices.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), name="random_triangles")

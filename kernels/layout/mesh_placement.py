"""Vertices relative to a point, subtracted in float64 and rounded to float32 once."""

from collections.abc import Callable
from functools import cache

import numpy as np
import warp as wp

from wrt.kernels.runtime.launch import as_device, launch, specialise
from wrt.kernels.runtime.options import specialised_kernel

CHUNK = 4096
"""Vertices that are worth a chunk of their own."""


@cache
def make_shift(dtype: type) -> wp.Kernel:
    """The kernel for vertices of a type, vec3 or vec3d."""

    def shift_vertices(
        first: int,
        center: wp.vec3d,
        vertices: wp.array(dtype=dtype),
        relative: wp.array(dtype=wp.vec3),
    ):
        """Item: a vertex."""
        i = first + wp.tid()
        relative[i] = wp.vec3(wp.vec3d(vertices[i]) - center)

    return specialised_kernel(shift_vertices)


def shifted(center: np.ndarray, vertices: np.ndarray, allocate: Callable[..., wp.array] = wp.empty) -> wp.array:
    """(V,) vec3 on the CPU: vertices relative to a point. Those that no triangle uses may come to be infinite.

    Args:
        center: (3,) float64.
        vertices: (V, 3) float32 or float64.
        allocate: allocates the result; same signature as `wp.empty`.
    """
    device, dtype = as_device("cpu"), wp.vec3 if vertices.dtype == np.float32 else wp.vec3d
    given = wp.array(vertices, dtype=dtype, device=device, copy=False)
    relative = allocate(len(vertices), dtype=wp.vec3, device=device)
    inputs = [wp.vec3d(*map(float, center)), given, relative]
    launch(specialise(make_shift, dtype), len(vertices), inputs, device=device, chunk=CHUNK)
    return relative


def relative_to(center: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """(V, 3) float32: as in `shifted`."""
    return shifted(center, vertices).numpy()

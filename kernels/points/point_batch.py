"""Points and what is nearest to them, on the device."""

import warp as wp

from wrt.kernels.runtime.options import exact_module

exact_module(__name__)


@wp.struct
class PointBatch:
    """N points."""

    count: int
    position: wp.array(dtype=wp.vec3)
    """(N,) relative to the scene's centre."""
    order: wp.array(dtype=int)
    """(N,) the order in which they are searched; (0,) for that in which they are given."""
    most: wp.array(dtype=float)
    """(N,) or (1,) greatest distance at which a triangle is found; 0 or more."""
    most_stride: int
    """1, or 0 if all points have the same."""


@wp.struct
class NearestBatch:
    """What is nearest to each of N points."""

    distance: wp.array(dtype=float)
    """inf if nothing was found."""
    primitive: wp.array(dtype=int)
    """-1 if nothing was found."""
    uv: wp.array(dtype=wp.vec2)
    """Weights of the triangle's second and third vertex; 0 if nothing was found."""
    feature: wp.array(dtype=wp.int8)
    """0 on a vertex, 1 on an edge, 2 on the face; -1 if nothing was found."""

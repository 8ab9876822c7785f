"""An influence area as kernels see it, the direction of its rays at a box, and which rays belong to it.

References: falcone-2024.
"""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.simd.boxes import INFINITY


@wp.struct
class AreaView:
    """Start points and directions of the rays of an influence area.

    A point p has the coordinates x = right . (p - eye), y = up . (p - eye) and depth = forward . (p - eye). x and y are divided
    by the depth if the rays are radial.
    """

    eye: wp.vec3
    """The point through which radial rays pass; for parallel rays, the centre of the rectangle that they leave."""
    right: wp.vec3
    up: wp.vec3
    forward: wp.vec3
    """Orthogonal unit vectors."""
    near: float
    """Depth at which rays start: > 0 for radial rays, 0 for parallel ones."""
    far: float
    """Depth at which the area ends."""
    half: wp.vec2
    """The window: |x| <= half x, |y| <= half y."""
    radial: bool


@wp.func
def to_view_space(view: AreaView, point: wp.vec3):
    """(x, y, depth) of a point, x and y before the division."""
    ray = point - view.eye
    return wp.vec3(wp.dot(view.right, ray), wp.dot(view.up, ray), wp.dot(view.forward, ray))


@wp.func
def project(view: AreaView, seen: wp.vec3):
    """(x, y) of the projection of a result of `to_view_space`."""
    scale = wp.where(view.radial, 1.0 / seen[2], 1.0)
    return wp.vec2(seen[0] * scale, seen[1] * scale)


@wp.func
def contains_view_point(view: AreaView, point: wp.vec3):
    """Whether a point lies in the area, which is closed on all sides. False for NaN and infinity."""
    seen = to_view_space(view, point)
    reach = wp.where(view.radial, seen[2], 1.0)
    return (
        seen[2] >= view.near
        and seen[2] <= view.far
        and wp.abs(seen[0]) <= view.half[0] * reach
        and wp.abs(seen[1]) <= view.half[1] * reach
    )


@wp.func
def direction_at(view: AreaView, point: wp.vec3):
    """Direction of the area's ray through a point, not normalised. For a box, the ray through its centre represents all."""
    return wp.where(view.radial, point - view.eye, view.forward)


@wp.func
def is_aligned(view: AreaView, origin: wp.vec3, direction: wp.vec3, sine: float):
    """Whether a ray deviates by at most an angle from the area's ray through its origin, in the same or the opposite direction.

    Both directions count, because a shadow ray runs towards the light on the line of a ray from the light. `sine`: of the
    greatest angle, which is at most 90 degrees. False for directions that are zero, NaN or infinite, or whose square is.
    """
    along = direction_at(view, origin)
    off = wp.cross(along, direction)
    lengths = wp.dot(along, along) * wp.dot(direction, direction)
    return lengths > 0.0 and lengths < INFINITY and wp.dot(off, off) <= sine * sine * lengths


@wp.func
def belongs_to_area(view: AreaView, origin: wp.vec3, direction: wp.vec3, sine: float):
    """Whether a ray belongs to the area: it starts in it and is aligned with its rays (Falcone 2024, section 3.1)."""
    return contains_view_point(view, origin) and is_aligned(view, origin, direction, sine)


@exact_kernel
def mark_rays_of_area(
    first: int,
    view: AreaView,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    sine: float,
    belongs: wp.array(dtype=wp.bool),
):
    """Item: a ray, relative to the view's centre. Writes whether it belongs to the area."""
    i = first + wp.tid()
    belongs[i] = belongs_to_area(view, origins[i], directions[i], sine)

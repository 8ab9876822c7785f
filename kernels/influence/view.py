"""An influence area as kernels see it, the direction of its rays at a box, and which rays belong to it.

References:
    L. Falcone: Ray distribution aware heuristics for BVHs construction in ray tracing. MSc thesis, Politecnico di Milano,
        2024.
"""

import warp as wp

from wrt.kernels.simd.boxes import INFINITY

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.struct
class AreaView:
    """Where the rays of an influence area start, and where they go.

    A point p is seen at x = right . (p - eye), y = up . (p - eye), at depth = forward . (p - eye); x and y are divided by the
    depth if the rays are radial.
    """

    eye: wp.vec3
    """The point that radial rays go through; of parallel ones, the middle of the rectangle that they leave."""
    right: wp.vec3
    up: wp.vec3
    forward: wp.vec3
    """Orthogonal unit vectors."""
    near: float
    """Depth at which rays start, > 0 if they are radial, 0 if not."""
    far: float
    """Depth at which the area ends."""
    half: wp.vec2
    """The window: |x| <= half x, |y| <= half y."""
    radial: bool


@wp.func
def seen_from(view: AreaView, point: wp.vec3):
    """(x, y, depth) of a point, x and y before the division."""
    ray = point - view.eye
    return wp.vec3(wp.dot(view.right, ray), wp.dot(view.up, ray), wp.dot(view.forward, ray))


@wp.func
def picture_of(view: AreaView, seen: wp.vec3):
    """(x, y) in the picture of what `seen_from` gave."""
    scale = wp.where(view.radial, 1.0 / seen[2], 1.0)
    return wp.vec2(seen[0] * scale, seen[1] * scale)


@wp.func
def holds_point(view: AreaView, point: wp.vec3):
    """Whether a point lies in the area, which is closed on all sides; never if it is NaN or infinite."""
    seen = seen_from(view, point)
    reach = wp.where(view.radial, seen[2], 1.0)
    return (
        seen[2] >= view.near
        and seen[2] <= view.far
        and wp.abs(seen[0]) <= view.half[0] * reach
        and wp.abs(seen[1]) <= view.half[1] * reach
    )


@wp.func
def direction_at(view: AreaView, point: wp.vec3):
    """Direction of the area's ray through a point, of any length; for a box, that at its centre stands for all."""
    return wp.where(view.radial, point - view.eye, view.forward)


@wp.func
def is_aligned(view: AreaView, origin: wp.vec3, direction: wp.vec3, sine: float):
    """Whether a ray runs along the area's ray through its origin, or straight against it, but for an angle.

    Both senses count: a shadow ray runs to the light on the line of a ray that comes from it. sine: of the greatest angle,
    which is at most a right one. Rays with a direction that is 0, NaN, infinite, or whose square is, are not aligned.
    """
    along = direction_at(view, origin)
    off = wp.cross(along, direction)
    lengths = wp.dot(along, along) * wp.dot(direction, direction)
    return lengths > 0.0 and lengths < INFINITY and wp.dot(off, off) <= sine * sine * lengths


@wp.func
def is_affine(view: AreaView, origin: wp.vec3, direction: wp.vec3, sine: float):
    """Whether a ray belongs to the area: it starts in it and is aligned with its rays (Falcone 2024, section 3.1)."""
    return holds_point(view, origin) and is_aligned(view, origin, direction, sine)


@wp.kernel
def tell_affine(
    first: int,
    view: AreaView,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    sine: float,
    affine: wp.array(dtype=wp.bool),
):
    """Item: a ray, relative to the view's centre."""
    i = first + wp.tid()
    affine[i] = is_affine(view, origins[i], directions[i], sine)

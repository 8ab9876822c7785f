"""Rays and hits as structures of arrays: what every traversal reads and writes."""

import warp as wp

from wrt.kernels.boxes import INFINITY

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

TINY = wp.constant(1.1754944e-38)
"""Smallest normal float32. A direction with no component as large is treated as zero: its ray misses."""


@wp.struct
class RayBatch:
    """N rays origin + t direction, t_min <= t <= t_max. A stride of 0 shares element 0 among all rays, 1 gives each its own."""

    count: int
    """N."""
    origins: wp.array(dtype=wp.vec3)
    """(N,) or (1,), in the caller's coordinates."""
    directions: wp.array(dtype=wp.vec3)
    """(N,) or (1,), of any length."""
    t_min: wp.array(dtype=float)
    """(N,) or (1,), at least 0."""
    t_max: wp.array(dtype=float)
    """(N,) or (1,)."""
    origin_stride: int
    direction_stride: int
    t_min_stride: int
    t_max_stride: int
    columns: int
    """Of the picture whose pixels the rays are, row by row; 0 if they are to be taken as they come. For packets only."""
    mask: wp.array(dtype=wp.uint32)
    """(N,), (1,) or, for rays that see everything, (0,): see `wrt.kernels.instances`."""
    mask_stride: int
    run: int
    """Rays that an item traces, a multiple of the stream's length. For streams only."""
    center: wp.vec3d
    """Subtracted from the origins in float64: the scene's geometry is stored relative to this point."""


@wp.struct
class Ray:
    """One ray relative to the scene's centre."""

    origin: wp.vec3
    direction: wp.vec3
    t_min: float
    t_max: float
    valid: bool
    """False for a NaN or infinity in origin, direction or range, and for a zero direction: such a ray misses."""


@wp.struct
class HitBatch:
    """Results of N rays. A closest-hit query writes the first three, an any-hit query only `occluded`, a count only `counts`.

    A query for all hits writes the first three, for many hits a ray, and `counts`: hits of ray i, in no order, go to the
    elements from i * room on, at most `room` of them; with a room of 0 to those from begins[i] on, all of them.
    """

    t: wp.array(dtype=float)
    """inf for a miss."""
    primitive: wp.array(dtype=int)
    """-1 for a miss."""
    uv: wp.array(dtype=wp.vec2)
    """Weights of the triangle's second and third vertex; 0 for a miss."""
    occluded: wp.array(dtype=wp.bool)
    counts: wp.array(dtype=int)
    """Hits of each ray, those for which there was no room included."""
    room: int
    begins: wp.array(dtype=int)


@wp.func
def is_finite(v: wp.vec3):
    """True if no component is NaN or infinite (x - x is 0 for all other numbers; the C library's test is a call)."""
    rest = v - v
    return rest[0] == 0.0 and rest[1] == 0.0 and rest[2] == 0.0


@wp.func
def load_ray(rays: RayBatch, i: int):
    """Ray number `i`, checked and relative to the scene's centre."""
    return checked_ray(
        wp.vec3(wp.vec3d(rays.origins[i * rays.origin_stride]) - rays.center),
        rays.directions[i * rays.direction_stride],
        rays.t_min[i * rays.t_min_stride],
        rays.t_max[i * rays.t_max_stride],
    )


@wp.func
def checked_ray(origin: wp.vec3, direction: wp.vec3, t_min: float, t_max: float):
    """A ray whose origin is relative to the scene's centre."""
    ray = Ray()
    ray.origin = origin
    ray.direction = direction
    ray.t_min = t_min
    ray.t_max = t_max
    size = wp.abs(ray.direction)
    ray.valid = (
        is_finite(ray.origin)
        and is_finite(ray.direction)
        and wp.max(size[0], wp.max(size[1], size[2])) >= TINY
        and ray.t_min >= 0.0
        and ray.t_min <= ray.t_max
    )
    return ray


@wp.func
def store_hit(hits: HitBatch, i: int, t: float, primitive: int, u: float, v: float):
    """Writes hit number `i`; `primitive` < 0 is a miss."""
    hits.t[i] = wp.where(primitive < 0, INFINITY, t)
    hits.primitive[i] = primitive
    hits.uv[i] = wp.vec2(u, v)


@wp.kernel
def center_float64_points(first: int, points: wp.array(dtype=wp.vec3d), center: wp.vec3d, out: wp.array(dtype=wp.vec3)):
    """Item: a point. Float64 to float32, relative to the centre: what is lost is lost there, not far from the origin."""
    i = first + wp.tid()
    out[i] = wp.vec3(points[i] - center)

"""Rays and hits as structures of arrays: what every traversal reads and writes.

**Short directions.** 1 / direction overflows for components below 2^-128, and box tests then take the ray to be parallel to
the axis; numbers below 2^-126, the smallest normal one, have fewer digits, and cost a CPU a hundred times as much wherever
they come up. So rays are loaded by one rule. Components below 2^-126, or below 2^-100 of the largest one, count as 0, as on
hardware that flushes such numbers to zero, and a direction without any other is no direction: its ray misses. That keeps
slopes and inverses normal and finite. It turns a ray by less than 2^-26, a quarter of a rounding, if the largest component
is 2^-100 or more; shorter directions have fewer digits.

**Far hits.** t counts in units of the direction, and may be beyond float32 where that is short. No hit has a t of inf: every
ray ends at `FARTHEST`, the largest float32."""

import warp as wp

from wrt.kernels.simd.boxes import INFINITY

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

TINY = wp.constant(2.0**-126)
"""Smallest normal float32."""

SHORTEST = TINY
"""A direction with no component as large is treated as zero: its ray misses."""

FARTHEST = wp.constant(3.4028234663852886e38)
"""Largest float32: no hit has a larger t."""

NEGLIGIBLE = wp.constant(2.0**-100)
"""Share of a direction's largest component below which another one counts as 0."""

_LEAST_SIZE = wp.constant(2.0**-26)
"""`TINY` / `NEGLIGIBLE`."""

DIRECTION_LANES = f"""
    auto wrt_direction = [](float& x, float& y, float& z) {{
        const float size_x = WRT_ABS(x), size_y = WRT_ABS(y), size_z = WRT_ABS(z);
        float size = size_x > size_y ? size_x : size_y; size = size > size_z ? size : size_z;
        const float least = (size > {_LEAST_SIZE!r}f ? size : {_LEAST_SIZE!r}f) * {NEGLIGIBLE!r}f;
        x = size_x < least ? 0.0f : x; y = size_y < least ? 0.0f : y; z = size_z < least ? 0.0f : z;
    }};
    constexpr float SHORTEST = {SHORTEST!r}f, FARTHEST = {FARTHEST!r}f;
"""
"""C++ of `usable_direction`, for lanes: wrt_direction; and the two bounds."""


@wp.struct
class RayBatch:
    """N rays origin + t direction, t_min <= t <= t_max. A stride of 0 shares element 0 among all rays, 1 gives each its own."""

    count: int
    """N."""
    origins: wp.array(dtype=wp.vec3)
    """(N,) or (1,), in the caller's coordinates."""
    directions: wp.array(dtype=wp.vec3)
    """(N,) or (1,), of any length from `SHORTEST` on."""
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
    """(N,), (1,) or, for rays that see everything, (0,): see `wrt.kernels.layout.instance_maps`."""
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
    """False for a NaN or infinity in origin, direction or range, and for a direction that is too short: such a ray misses."""


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
def usable_direction(direction: wp.vec3):
    """The direction without components that are negligible; NaN stays."""
    size = wp.abs(direction)
    largest = wp.where(size[0] > size[1], size[0], size[1])
    largest = wp.where(largest > size[2], largest, size[2])
    least = wp.where(largest > _LEAST_SIZE, largest, _LEAST_SIZE) * NEGLIGIBLE
    return wp.vec3(
        wp.where(size[0] < least, 0.0, direction[0]),
        wp.where(size[1] < least, 0.0, direction[1]),
        wp.where(size[2] < least, 0.0, direction[2]),
    )


@wp.func
def is_direction(direction: wp.vec3):
    """Whether a direction is finite and long enough."""
    size = wp.abs(direction)
    return is_finite(direction) and wp.max(size[0], wp.max(size[1], size[2])) >= SHORTEST


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
    ray.direction = usable_direction(direction)
    ray.t_min = t_min
    ray.t_max = wp.where(t_max > FARTHEST, FARTHEST, t_max)
    ray.valid = is_finite(ray.origin) and is_direction(ray.direction) and ray.t_min >= 0.0 and ray.t_min <= ray.t_max
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

"""Rays and hits as structures of arrays: the input and output of every traversal.

**Short directions.** 1 / direction overflows for components below 2^-128, and box tests then treat the ray as parallel to the
axis. Numbers below 2^-126 (subnormals) have fewer digits, and arithmetic on them is very slow on CPUs. Rays are therefore
loaded by one rule: components below 2^-126, or below 2^-100 of the largest one, count as 0, as on hardware that flushes
subnormals to zero. A direction without any other component is invalid, and its ray misses. All slopes and inverses are then
normal and finite. The rule rotates a ray by less than 2^-26, a quarter of a rounding, if its largest component is at least
2^-100; shorter directions have fewer digits.

**Far hits.** t counts in units of the direction and may exceed the range of float32 if the direction is short. No hit has t =
inf: every ray ends at `FARTHEST`, the largest float32.
"""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.simd.boxes import INFINITY

TINY = wp.constant(2.0**-126)
"""Smallest normal float32."""

SHORTEST = TINY
"""A direction whose components are all smaller is treated as zero: its ray misses."""

FARTHEST = wp.constant(3.4028234663852886e38)
"""Largest float32: no hit has a larger t."""

NEGLIGIBLE = wp.constant(2.0**-100)
"""Fraction of a direction's largest component below which another component counts as 0."""

_MIN_SIZE = wp.constant(2.0**-26)
"""`TINY` / `NEGLIGIBLE`."""


@wp.struct
class RayBatch:
    """N rays origin + t direction, t_min <= t <= t_max.

    A stride of 0 shares element 0 among all rays, a stride of 1 gives each ray its own element.
    """

    count: int
    """N."""
    origins: wp.array(dtype=wp.vec3)
    """(N,) or (1,), in the caller's coordinates."""
    directions: wp.array(dtype=wp.vec3)
    """(N,) or (1,), not normalised; at least `SHORTEST` in some component."""
    t_min: wp.array(dtype=float)
    """(N,) or (1,), at least 0."""
    t_max: wp.array(dtype=float)
    """(N,) or (1,)."""
    origin_stride: int
    direction_stride: int
    t_min_stride: int
    t_max_stride: int
    columns: int
    """Columns of the picture whose pixels the rays are, row by row; 0 if they are not a picture. Used by packets only."""
    mask: wp.array(dtype=wp.uint32)
    """(N,), (1,), or (0,) for rays without masks: see `wrt.kernels.layout.instance_maps`."""
    mask_stride: int
    environment: wp.array(dtype=int)
    """(N,), (1,), or (0,) for rays that see the instances of all environments, as those of environment -1 do."""
    environment_stride: int
    run: int
    """Rays per item, a multiple of those of a stream or a run of packets. Used by kernels whose items vary in length only
    (`Capabilities.LONG_ITEMS`)."""
    center: wp.vec3d
    """Subtracted from the origins in float64; the geometry of the scene is stored relative to this point."""


@wp.struct
class Ray:
    """One ray relative to the scene's centre."""

    origin: wp.vec3
    direction: wp.vec3
    t_min: float
    t_max: float
    valid: bool
    """False for a NaN or an infinity in origin, direction or range, and for a direction that is too short: the ray misses."""


@wp.struct
class HitBatch:
    """Results of N rays.

    A closest-hit query writes the first three arrays, an any-hit query only `occluded`, a count only `counts`. A query for all
    hits writes the first three, with several elements per ray, and `counts`. The hits of ray i, unordered, are the elements
    from i * room on, at most `room` of them. If room is 0 they are the elements from begins[i] on, without a limit.
    """

    t: wp.array(dtype=float)
    """inf for a miss."""
    primitive: wp.array(dtype=int)
    """-1 for a miss."""
    uv: wp.array(dtype=wp.vec2)
    """Weights of the triangle's second and third vertex; 0 for a miss."""
    occluded: wp.array(dtype=wp.bool)
    counts: wp.array(dtype=int)
    """Number of hits of each ray, including those that did not fit."""
    room: int
    begins: wp.array(dtype=int)


@wp.func
def is_finite(v: wp.vec3):
    """True if no component is NaN or infinite. Tests x - x == 0, because the C library's test is a function call."""
    rest = v - v
    return rest[0] == 0.0 and rest[1] == 0.0 and rest[2] == 0.0


@wp.func
def usable_direction(direction: wp.vec3):
    """The direction with its negligible components set to 0; NaN is kept."""
    size = wp.abs(direction)
    largest = wp.where(size[0] > size[1], size[0], size[1])
    largest = wp.where(largest > size[2], largest, size[2])
    negligible = wp.where(largest > _MIN_SIZE, largest, _MIN_SIZE) * NEGLIGIBLE
    return wp.vec3(
        wp.where(size[0] < negligible, 0.0, direction[0]),
        wp.where(size[1] < negligible, 0.0, direction[1]),
        wp.where(size[2] < negligible, 0.0, direction[2]),
    )


@wp.func
def is_direction(direction: wp.vec3):
    """Whether a direction is finite and long enough."""
    size = wp.abs(direction)
    return is_finite(direction) and wp.max(size[0], wp.max(size[1], size[2])) >= SHORTEST


@wp.func
def load_ray(rays: RayBatch, i: int):
    """Ray number `i`, validated and relative to the scene's centre."""
    return checked_ray(
        wp.vec3(wp.vec3d(rays.origins[i * rays.origin_stride]) - rays.center),
        rays.directions[i * rays.direction_stride],
        rays.t_min[i * rays.t_min_stride],
        rays.t_max[i * rays.t_max_stride],
    )


@wp.func
def checked_ray(origin: wp.vec3, direction: wp.vec3, t_min: float, t_max: float):
    """A validated ray; `origin` is relative to the scene's centre."""
    ray = Ray()
    ray.origin = origin
    ray.direction = usable_direction(direction)
    ray.t_min = t_min
    ray.t_max = wp.where(t_max > FARTHEST, FARTHEST, t_max)
    ray.valid = is_finite(ray.origin) and is_direction(ray.direction) and ray.t_min >= 0.0 and ray.t_min <= ray.t_max
    return ray


@wp.func
def store_hit(hits: HitBatch, i: int, t: float, primitive: int, u: float, v: float):
    """Writes hit number `i`; `primitive` < 0 means a miss."""
    hits.t[i] = wp.where(primitive < 0, INFINITY, t)
    hits.primitive[i] = primitive
    hits.uv[i] = wp.vec2(u, v)


@exact_kernel
def center_float64_points(first: int, points: wp.array(dtype=wp.vec3d), center: wp.vec3d, out: wp.array(dtype=wp.vec3)):
    """Converts a float64 point to float32 relative to the centre. Item: a point.

    Points far from the origin keep their precision, because the centre is subtracted first.
    """
    i = first + wp.tid()
    out[i] = wp.vec3(points[i] - center)


@wp.func_native("""
    const float* const from = (const float*)&points.data[place];
    float* const to = (float*)&out.data[i];
    const float x = from[0], y = from[1], z = from[2];
    if (step) for (int k = 0; k < 3 * run; ++k) to[k] = from[k];
    else for (int k = 0; k < run; ++k) to[3 * k] = x, to[3 * k + 1] = y, to[3 * k + 2] = z;
""")
def write_run(points: wp.array(dtype=wp.vec3), place: int, step: int, run: int, i: int, out: wp.array(dtype=wp.vec3)):
    """Writes `run` points from number `i` on, those from `place` on or, with a step of 0, the one there."""


@exact_kernel
def repeat_points(
    first: int, points: wp.array(dtype=wp.vec3), lengths: wp.vec4i, strides: wp.vec4i, run: int, out: wp.array(dtype=wp.vec3)
):
    """Broadcasts points along the axes whose stride is 0, to the shape `lengths`. Item: `run` neighbours along the last axis,
    one or all."""
    i = (first + wp.tid()) * run
    rest = int(i)
    place = int(0)
    for k in range(4):
        axis = 3 - k
        place += rest % lengths[axis] * strides[axis]
        rest = rest // lengths[axis]
    write_run(points, place, strides[3], run, i, out)

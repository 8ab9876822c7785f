"""A ray and a point: the filter of W points, the decision about one, and the records and boxes of points.

A record has the centre and the radius, and for discs the unit normal: 4 or 7 floats, in blocks as those of triangles
(`wrt.kernels.triangle.support.record_blocks`).
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import Ray
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import RaySlabs, ray_slabs, reach
from wrt.kernels.triangle.support.vectors import dot

exact_module(__name__)

SPHERE, DISC = 4, 7
"""Components of a record."""

MARGIN = wp.constant(2.0**-18)
"""By which the filter enlarges points, as a fraction of the ray's reach; `wrt.kernels.clouds` has the proof."""


@wp.struct
class CloudPoints:
    """Points by their numbers, relative to the cloud's centre."""

    centre: wp.array(dtype=wp.vec3)
    radius: wp.array(dtype=float)
    """(N,), or (1,) for all."""
    normal: wp.array(dtype=wp.vec3)
    """(N,) unit vectors of discs; (0,) for spheres."""


@wp.struct
class PointLine:
    """A ray as the tests of points need it."""

    origin: wp.vec3
    direction: wp.vec3
    unit: wp.vec3
    """The direction, of length 1 up to rounding."""
    margin: float
    t_min: float
    slabs: RaySlabs


@wp.func
def line_of(ray: Ray, low: wp.vec3, high: wp.vec3):
    """A ray for points in a box."""
    line = PointLine()
    distance = reach(ray.origin, low, high)
    size = wp.abs(ray.direction)
    scaled = ray.direction / wp.max(size[0], wp.max(size[1], size[2]))
    line.origin = ray.origin
    line.direction = ray.direction
    line.unit = scaled * (1.0 / wp.sqrt(dot(scaled, scaled)))
    line.margin = MARGIN * distance
    line.t_min = ray.t_min
    line.slabs = ray_slabs(ray.origin, ray.direction, distance)
    return line


@cache
def points_near(width: int, components: int) -> wp.Function:
    """`wp.func(records, block, line) -> mask`: the lanes of a block whose points a ray may meet; the others it does not."""

    @native.func_native("spheres.h", f"return wrt::points_near<{width}, {components}>(records.data, block, line);")
    def points_near_native(records: wp.array(dtype=float), block: int, line: wp.ref[PointLine]) -> wp.uint32: ...

    return points_near_native


@cache
def meet_point(width: int, components: int) -> wp.Function:
    """`wp.func(records, slot, line, u, v) -> t`: where a ray meets a point first, from t_min on; NaN for nowhere."""

    @native.func_native("spheres.h", f"return wrt::meet_point<{width}, {components}>(records.data, slot, line, u, v);")
    def meet_point_native(
        records: wp.array(dtype=float), slot: int, line: wp.ref[PointLine], u: wp.ref[float], v: wp.ref[float]
    ) -> float: ...

    return meet_point_native


@native.func_native(
    "spheres.h",
    f"""static_assert(wrt::SPHERE == {SPHERE} && wrt::DISC == {DISC});
    const float *const at = (const float*)points.centre.data, *const across = (const float*)points.normal.data;
    float* const to = records.data + (size_t)(slot / width) * components * width + slot % width;
    const int id = primitive.data[slot];
    wrt::copy_point(at, points.radius.data, points.radius.shape[0] == 1, across, components, id, width, to);""",
)
def copy_point(
    points: CloudPoints,
    primitive: wp.array(dtype=int),
    slot: int,
    width: int,
    components: int,
    records: wp.array(dtype=float),
):
    """Writes the record of a slot; NaN for an unused lane."""
    ...


@native.func_native("spheres.h", "wrt::point_box(records.data + i * components, components, 1, low.c, high.c);")
def point_box(records: wp.array(dtype=float), components: int, i: int, low: wp.ref[wp.vec3], high: wp.ref[wp.vec3]):
    """The box of the record i, in blocks of one."""
    ...


@wp.kernel
def pack_points(
    first: int,
    points: CloudPoints,
    primitive: wp.array(dtype=int),
    width: int,
    components: int,
    records: wp.array(dtype=float),
):
    """Writes the record of a slot. Item: a slot; `primitive` has its point, -1 for an unused lane."""
    copy_point(points, primitive, first + wp.tid(), width, components, records)


@wp.kernel
def box_points(
    first: int,
    records: wp.array(dtype=float),
    components: int,
    low: wp.array2d(dtype=float),
    high: wp.array2d(dtype=float),
):
    """Writes the box of a record. Item: a record, in blocks of one. low, high: (3, records)."""
    i = first + wp.tid()
    lower = wp.vec3()
    upper = wp.vec3()
    point_box(records, components, i, lower, upper)
    for axis in range(3):
        low[axis, i] = lower[axis]
        high[axis, i] = upper[axis]

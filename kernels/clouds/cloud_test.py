"""A ray and a point: the filter of W points, the decision about one, and the records and boxes of points.

A record has the centre and the radius, for discs also the unit normal, and for boxes half the edges in place of the radius: 4,
7 or 6 floats, in blocks as those of triangles (`wrt.kernels.triangle.support.record_blocks`).

To traversals, points are a triangle test with records, a state of the ray and a filter of their own (`TESTS`). It is not among
those that a caller may name: a scene has triangles or points.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.simd.boxes import RaySlabs
from wrt.kernels.simd.lanes import lanes
from wrt.kernels.triangle.support.lane_form import HandWritten
from wrt.kernels.triangle.support.record_blocks import Record
from wrt.kernels.triangle.support.triangle_contract import CrossingForms, TriangleTest
from wrt.kernels.triangle.support.vectors import dot

SPHERE, BOX, DISC = 4, 6, 7
"""Components of a record."""


@wp.struct
class CloudPoints:
    """Points by their numbers, relative to the cloud's centre."""

    centre: wp.array(dtype=wp.vec3)
    radius: wp.array(dtype=float)
    """(N,), or (1,) for all; not of boxes."""
    normal: wp.array(dtype=wp.vec3)
    """(N,) unit vectors of discs, or half the edges of boxes; (0,) for spheres."""
    components: int
    """`SPHERE`, `DISC` or `BOX`."""


@wp.struct
class PointRay:
    """A ray as the tests of points need it."""

    origin: wp.vec3
    direction: wp.vec3
    unit: wp.vec3
    """The direction, of length 1 up to rounding."""


@wp.func
def prepare(origin: wp.vec3, direction: wp.vec3):
    """A ray for the tests of points."""
    ray = PointRay()
    size = wp.abs(direction)
    scaled = direction / wp.max(size[0], wp.max(size[1], size[2]))
    ray.origin = origin
    ray.direction = direction
    ray.unit = scaled * (1.0 / wp.sqrt(dot(scaled, scaled)))
    return ray


@cache
def points_near(components: int, width: int) -> wp.Function:
    """`wp.func(records, block, ray, t, u, v) -> mask`: the lanes of a block whose points a ray may meet; it misses the
    others. t, u and v are not written."""
    Lanes = lanes(width)

    @native.func_native("spheres.h", f"return wrt::points_near<{width}, {components}>(records.data, block, ray);")
    def points_near_native(
        records: wp.array(dtype=float), block: int, ray: PointRay, t: wp.ref[Lanes], u: wp.ref[Lanes], v: wp.ref[Lanes]
    ) -> wp.uint32: ...

    return points_near_native


@cache
def meet_point(width: int, components: int) -> wp.Function:
    """`wp.func(records, slot, ray, slabs, t_min, u, v) -> t`: where a ray meets a point first, from t_min on; NaN for
    nowhere."""

    @native.func_native(
        "spheres.h", f"return wrt::meet_point<{width}, {components}>(records.data, slot, ray, slabs, t_min, u, v);"
    )
    def meet_point_native(
        records: wp.array(dtype=float),
        slot: int,
        ray: wp.ref[PointRay],
        slabs: wp.ref[RaySlabs],
        t_min: float,
        u: wp.ref[float],
        v: wp.ref[float],
    ) -> float: ...

    return meet_point_native


@cache
def candidate_point(components: int, width: int) -> wp.Function:
    """`wp.func(records, slot, ray, slabs, t_min) -> vec3 (t, u, v)`: the same, for streams."""
    meet = meet_point(width, components)

    @wp.func
    def candidate(records: wp.array(dtype=float), slot: int, ray: wp.ref[PointRay], slabs: wp.ref[RaySlabs], t_min: float):
        u = float(0.0)
        v = float(0.0)
        t = meet(records, slot, ray, slabs, t_min, u, v)
        return wp.vec3(t, u, v)

    return candidate


@dataclass(frozen=True)
class PointRecord(Record):
    """The record of a point.

    Attributes:
        size: `SPHERE`, `DISC` or `BOX`.
    """

    size: int = SPHERE

    @property
    def components(self) -> int:
        """Floats per point in a block."""
        return self.size


def point_test(name: str, components: int) -> TriangleTest:
    """Points as a test."""
    near: Callable[[int], wp.Function] = partial(points_near, components)
    return TriangleTest(
        name=name,
        paper="Haines, Günther, Akenine-Möller: Precision improvements for ray/sphere intersection (2019)",
        record=PointRecord(size=components),
        ray_state=PointRay,
        prepare=prepare,
        intersect=meet_point(1, components),
        lanes=HandWritten(near, None),  # type: ignore[arg-type]  (no packets)
        line_test=near,
        crossing=CrossingForms(meet_point(1, components), near, near),
        own_candidate=partial(candidate_point, components),
    )


TESTS = {name: point_test(name, components) for name, components in (("spheres", SPHERE), ("discs", DISC), ("boxes", BOX))}
"""By name."""


@native.func_native(
    "spheres.h",
    f"""static_assert(wrt::SPHERE == {SPHERE} && wrt::DISC == {DISC} && wrt::BOX == {BOX});
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


@native.func_native("spheres.h", "wrt::point_box(records.data + i * components, components, 1, low.c, high.c);")
def point_box(records: wp.array(dtype=float), components: int, i: int, low: wp.ref[wp.vec3], high: wp.ref[wp.vec3]):
    """The box of the record i, in blocks of one."""


@exact_kernel
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


@exact_kernel
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

"""Woop, Benthin and Wald 2013: the watertight test.

**Problem.** A test with rounded edges or barycentric coordinates may miss both triangles that share an edge.

**Idea.** Move the origin to 0 and shear space so that the ray becomes the unit vector along its largest axis, z. A vertex is
mapped to the same point in every triangle that contains it. Projected along the ray, the test asks on which side of each edge
the point 0 lies. The signed area of an edge (U, V or W) in one of its triangles is the exact negative of that in the other,
because multiplication commutes and a - b = -(b - a) in floating point (as long as no multiply-add is fused). An area of zero
means that the ray passes through the edge exactly, or that the products underflowed. All three areas are then recomputed in
float64, where products of float32 numbers are exact. The sign of each area is therefore that of the exact area of the sheared
vertices. No ray passes between neighbours at an edge or a vertex; a ray on an edge hits both.

**Weights.** The areas of a hit also weigh the vertices. Those of a thin triangle are recomputed for this purpose
(`wrt.kernels.triangle.watertight.woop_areas`), so that every hit is near its triangle.

**Crossings.** Counting crossings needs a rule by which a ray on an edge belongs to one side of it. Rasterisers assign a pixel
on an edge to the triangle whose top or left edge it is. Here the point 0 is moved symbolically by (e, e^2) for an infinitely
small e > 0 (simulation of simplicity). To first order this adds e (p.y - q.y) + e^2 (q.x - p.x) to the area p x q: where the
exact area is 0, the edge's own direction decides the side, with opposite results in its two triangles. The moved point lies on
no edge and no line through two vertices. So the count is the number of projected triangles around a point in general position,
which is even for every closed surface, whichever edges and vertices the ray meets. A triangle that is seen edge-on, or whose
projected vertices coincide, contains no such point. `CROSSING` holds this rule in the same forms as the inclusive one,
and `ORIENTED` also the sign of a crossing, which is that of the areas.

**Data.** Per triangle: the three vertices. Per ray: the axis order and the shear (`ShearedRay`).

**Departures.** The axes are not swapped to keep the winding: the test is two-sided, so it only checks that the three signs
agree. The caller compares the distance (see `wrt.kernels.simd.boxes`, the consistency rule).

References: woop-2013; edelsbrunner-muecke-1990.
"""

from functools import cache, partial

import warp as wp

from wrt.kernels.triangle.support.lane_form import HandWritten, PacketForm
from wrt.kernels.triangle.support.operation_counts import Operations
from wrt.kernels.triangle.support.record_blocks import Corners, native_block_test
from wrt.kernels.triangle.support.triangle_contract import CrossingForms, TriangleTest
from wrt.kernels.triangle.watertight.woop_areas import THIN, area64, exact_area, precise_areas

_RAYS = "const wrt::WoopRays rays_of = {{origin_x, origin_y, origin_z}, origin0, slope_x, slope_y, shear_z, main_axis};"

PACKET = PacketForm(
    state=("shear_z",),
    passes=3,
    prepare="shear_z[k] = wrt::along_main_axis(main_x, main_y, ix, iy, iz);",
    triangle=f"{_RAYS} wrt::WoopPacket<W, SHARED> woop(rays_of); woop.begin(corner, pass);",
    inside="alignas(4 * W) int inside[W]; if (!woop.meet(f, inside)) continue;",
    hit="const auto own_hit = woop.hit(i, k); at = own_hit.t; hit_u = own_hit.u; hit_v = own_hit.v;",
    ray=f"{_RAYS} wrt::woop_ray<SHARED>(rays_of, k, ray);",
    rays=_RAYS,
    pairs="wrt::WoopPairs<W, SHARED>(rays_of)",
    headers="woop_packets.h",
    certain=True,
)
"""W rays x one triangle: the same arithmetic, with one pass for each main axis that occurs among the rays."""


SMALL = wp.constant(1.1754944e-38)
"""Smallest normal float32. An area below it may have lost some or all of its digits."""

AREA_SCALE = wp.constant(wp.float64(2.0**200))
"""Factor that brings the areas of triangles too small for float32 into its range. It cancels in the weights."""


@wp.struct
class ShearedRay:
    """Origin, axis order and shear of a ray."""

    origin: wp.vec3
    """The origin's components in the order x, y, z below."""
    x: int
    """Axes: z is that of the direction's largest component; x and y are the next two, in cyclic order."""
    y: int
    z: int
    shear: wp.vec3
    """direction[x] / direction[z], direction[y] / direction[z], 1 / direction[z]."""


@wp.func
def permuted(v: wp.vec3, z: int):
    """The components along the axes x, y, z of a ray whose main axis is z. Selected, because an index would go through
    memory."""
    return wp.vec3(
        wp.where(z == 2, v[0], wp.where(z == 0, v[1], v[2])),
        wp.where(z == 2, v[1], wp.where(z == 0, v[2], v[0])),
        wp.where(z == 2, v[2], wp.where(z == 0, v[0], v[1])),
    )


@wp.func
def prepare(origin: wp.vec3, direction: wp.vec3):
    """Axis order and shear of a ray. `direction` must be finite and not zero."""
    size = wp.abs(direction)
    ray = ShearedRay()
    ray.z = wp.where(size[0] >= size[1], wp.where(size[0] >= size[2], 0, 2), wp.where(size[1] >= size[2], 1, 2))
    ray.x = wp.where(ray.z == 2, 0, ray.z + 1)
    ray.y = wp.where(ray.x == 2, 0, ray.x + 1)
    ray.origin = permuted(origin, ray.z)
    along = permuted(direction, ray.z)
    ray.shear = wp.vec3(along[0] / along[2], along[1] / along[2], 1.0 / along[2])
    return ray


@wp.func
def sheared(ray: ShearedRay, vertex: wp.vec3):
    """The sheared vertex: its two coordinates across the main axis, and its distance along that axis."""
    z = vertex[ray.z] - ray.origin[2]
    x = (vertex[ray.x] - ray.origin[0]) - ray.shear[0] * z
    y = (vertex[ray.y] - ray.origin[1]) - ray.shear[1] * z
    return wp.vec3(x, y, z)


@wp.func_native("return (a == 0.0f) | (b == 0.0f) | (c == 0.0f);")
def some_zero(a: float, b: float, c: float) -> bool:
    """Whether one of three numbers is 0: one branch, where `or` would take three."""


@wp.func_native("return ((a >= 0.0f) & (b >= 0.0f) & (c >= 0.0f)) | ((a <= 0.0f) & (b <= 0.0f) & (c <= 0.0f));")
def on_one_side(a: float, b: float, c: float) -> bool:
    """Whether no two of three areas have opposite signs. With `and` and `or`, the first sign would select a branch that the
    processor cannot predict, because rays come from either side."""


@wp.func
def intersect(ray: ShearedRay, corners: Corners):
    """One ray, one triangle: (t, u, v); t is NaN if the ray's line misses. u and v weigh the vertices b and c."""
    a = sheared(ray, corners.a)
    b = sheared(ray, corners.b)
    c = sheared(ray, corners.c)
    area_a = c[0] * b[1] - c[1] * b[0]
    area_b = a[0] * c[1] - a[1] * c[0]
    area_c = b[0] * a[1] - b[1] * a[0]
    if some_zero(area_a, area_b, area_c):
        area_a = exact_area(c, b)
        area_b = exact_area(a, c)
        area_c = exact_area(b, a)
    if not on_one_side(area_a, area_b, area_c) or (area_a + area_b) + area_c == 0.0:
        return wp.vec3(wp.nan, 0.0, 0.0)
    return interpolate(ray, wp.vec3(a[2], b[2], c[2]), precise_areas(a, b, c, wp.vec3(area_a, area_b, area_c)))


@wp.func
def interpolate(ray: ShearedRay, depth: wp.vec3, areas: wp.vec3):
    """(t, u, v) from the distances of the vertices along the main axis and the signed areas opposite them.

    Distances and areas are multiplied before 1 / direction: the product of all three may overflow float32 where t does not."""
    scale = 1.0 / ((areas[0] + areas[1]) + areas[2])
    distance = ((areas[0] * depth[0] + areas[1] * depth[1]) + areas[2] * depth[2]) * scale
    return wp.vec3(ray.shear[2] * distance, areas[1] * scale, areas[2] * scale)


@wp.func
def side(area: wp.float64, p: wp.vec3, q: wp.vec3):
    """Side of the edge p q on which the symbolically moved point lies, 1 or -1; 0 if p and q coincide."""
    tie = wp.where(p[1] > q[1], 1, wp.where(p[1] < q[1], -1, wp.where(q[0] > p[0], 1, wp.where(q[0] < p[0], -1, 0))))
    return wp.where(area > wp.float64(0.0), 1, wp.where(area < wp.float64(0.0), -1, tie))


@wp.func
def crossing_areas(a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """The areas of a triangle that is crossed, by which its vertices are weighed; NaN for one that is not."""
    area_a = c[0] * b[1] - c[1] * b[0]
    area_b = a[0] * c[1] - a[1] * c[0]
    area_c = b[0] * a[1] - b[1] * a[0]
    inside = on_one_side(area_a, area_b, area_c)
    areas = wp.vec3(area_a, area_b, area_c)
    if wp.abs(area_a) < SMALL or wp.abs(area_b) < SMALL or wp.abs(area_c) < SMALL:
        exact_a = area64(c, b)
        exact_b = area64(a, c)
        exact_c = area64(b, a)
        side_a = side(exact_a, c, b)
        inside = side_a != 0 and side_a == side(exact_b, a, c) and side_a == side(exact_c, b, a)
        small = wp.abs((exact_a + exact_b) + exact_c) < wp.float64(SMALL)
        scale = wp.where(small, AREA_SCALE, wp.float64(1.0))
        areas = wp.vec3(float(exact_a * scale), float(exact_b * scale), float(exact_c * scale))
    elif inside:
        areas = precise_areas(a, b, c, areas)
    if not inside:
        areas = wp.vec3(wp.nan, 0.0, 0.0)
    return areas


@wp.func
def intersect_crossing(ray: ShearedRay, corners: Corners):
    """`intersect` for counting crossings: a ray on an edge hits exactly one of its triangles."""
    a = sheared(ray, corners.a)
    b = sheared(ray, corners.b)
    c = sheared(ray, corners.c)
    areas = crossing_areas(a, b, c)
    if areas[0] != areas[0]:
        return areas
    return interpolate(ray, wp.vec3(a[2], b[2], c[2]), areas)


@wp.func
def intersect_oriented(ray: ShearedRay, corners: Corners):
    """`intersect_crossing` with the sign of the crossing in place of u.

    The summed areas of a triangle whose normal has a positive component along the main axis are negative.
    """
    a = sheared(ray, corners.a)
    b = sheared(ray, corners.b)
    c = sheared(ray, corners.c)
    areas = crossing_areas(a, b, c)
    if areas[0] != areas[0]:
        return areas
    hit = interpolate(ray, wp.vec3(a[2], b[2], c[2]), areas)
    leaves = ((areas[0] + areas[1]) + areas[2] < 0.0) == (ray.shear[2] > 0.0)
    return wp.vec3(hit[0], wp.where(leaves, 1.0, -1.0), hit[2])


GUARDS = f"""
    static_assert(wrt::THIN == {float(THIN)!r}f && wrt::SMALL_AREA == {float(SMALL)!r}f);
    static_assert(wrt::AREA_SCALE == {float(AREA_SCALE)!r});
"""
"""C++: constants that kernels/native has too."""


@cache
def make_block_test(width: int, rule: str, weights: bool = True) -> wp.Function:
    """One ray, W triangles: the bit mask of the lanes whose triangle the ray's line meets. t, u, v are valid in those lanes.

    Args:
        width: W.
        rule: that of kernels/native/triangle.h for a ray on an edge.
        weights: whether to compute t, u and v.
    """
    call = f"wrt::woop_block<{width}, wrt::{rule}, {int(weights)}>(records.data, block, ray, t.c, u.c, v.c)"
    return native_block_test(ShearedRay, width, f"{GUARDS}return {call};")


@cache
def line_test(width: int) -> wp.Function:
    """A block test without t, u and v; some of the lanes whose triangle the ray's line just misses are returned, too."""
    return native_block_test(ShearedRay, width, f"return wrt::woop_lines<{width}>(records.data, block, ray);")


block_test = partial(make_block_test, rule="Inclusive")
"""The test of W triangles."""

crossing_line_test = partial(make_block_test, rule="Crossing", weights=False)
"""`line_test` for counting crossings."""

CROSSING = CrossingForms(intersect_crossing, partial(make_block_test, rule="Crossing"), crossing_line_test)
"""The forms by which a line crosses a closed surface an even number of times."""

ORIENTED = CrossingForms(intersect_oriented, partial(make_block_test, rule="Oriented"), crossing_line_test)
"""The same, with the sign of the crossing in place of u."""

OPERATIONS = (Operations(add=18, multiply=12, compare=9), Operations(add=4, multiply=9, divide=1))
"""Operations of a miss, and those that a hit adds, without recomputation."""

TEST = TriangleTest(
    name="woop",
    paper="Woop, Benthin, Wald: Watertight ray/triangle intersection (2013)",
    watertight=True,
    accurate=True,
    ray_state=ShearedRay,
    prepare=prepare,
    native="wrt::Woop",
    intersect=intersect,
    lanes=HandWritten(block_test, PACKET, OPERATIONS),
    line_test=line_test,
    crossing=CROSSING,
    oriented=ORIENTED,
)

"""Rays from one point: Komatsu, Kaeriyama, Suzuki, Takizawa, Kobayashi 2008.

**Problem.** Moeller and Trumbore's products depend on ray and triangle. Of the rays of a camera, or of a point light, the
origin is always the same: most of the work is done again and again.

**Idea.** Write Cramer's rule as triple products with the direction D on its own. With S from the triangle to the origin,
u and v are D . (-S x E2) and D . (S x E1) over -D . N, and t is N . S over that: what D is multiplied with depends on triangle
and origin only and is computed once. A test takes three dot products, and most tests end after the first or the second:
each comparison is an exit, four in all.

**Data.** A triangle and an origin make a record: the three vertices (for the triangle's box, and for packet cullings), the
normals of the planes through the origin and the three edges, the triangle's normal N, and N . S: 88 bytes. They are made for
a batch's origin and again when the next batch has another (`wrt.Scene` keeps the last ones), in 55-80 ns a triangle on one
thread. (Measured with a million rays, bunny and dragon: a batch takes 0.85-0.99 of the time that the watertight test needs,
more of it saved in packets than alone; as the records cost a third of such a batch, they pay only where several share an
origin. Where leaves are few and small, the paper finds no more: 1.03 with a tree, up to 1.43 without.)

**What we changed.**

* The paper compares u + v with 1, by the sum of two products that round. Here the third edge has a plane of its own, like the
  other two: -S x E2 and S x E1 are the planes of two edges already. So two triangles see their common edge through the same
  three numbers with opposite signs, and no ray passes between them along it (Benthin's form of Pluecker's test, which the
  paper compares with, has that too). D . N is computed only for a ray that passes all three, and is the fourth exit.
* The paper drops triangles that face away, at the first exit. Here the planes are turned, when they are made, to the side
  on which the origin is: both sides of a triangle are hit at no cost, what lies behind the origin leaves at the first three
  exits, and the fourth drops triangles that are seen edge-on.
* The planes are computed in float64, by cross products of the vertices as seen from the origin, and then rounded: in float32
  their rounding would grow with the square of the distance over the length of an edge.
* Planes and directions are scaled by powers of two, which rounds nothing, so that tiny triangles do not underflow.

**Limits.** At a *vertex* the planes of several edges meet, each rounded on its own, in no common line. Of 2.9 million rays
aimed at vertices of closed convex bodies 1 in 2,800 passed through (Moeller and Trumbore: 1 in 10), of 1.7 million at points
of edges none; so the test is not `watertight`. Near the tip of a needle two planes are almost one, and a hit may lie beyond
the tip by much more than the slack: it is not `accurate`. An origin in a triangle's own plane sees it, at t = 0, from one
side only.

References:
    K. Komatsu, Y. Kaeriyama, K. Suzuki, H. Takizawa, H. Kobayashi: A fast ray frustum-triangle intersection algorithm with
        precomputation and early termination. IPSJ Transactions on Advanced Computing Systems 1(1), 2008.
    C. Benthin: Realtime ray tracing on current CPU architectures. PhD thesis, Saarland University, 2006.
"""

import warp as wp

from wrt.kernels.triangle.support.lane_form import LaneForm, RayValue, Step
from wrt.kernels.triangle.support.record_blocks import Corners, Record
from wrt.kernels.triangle.support.triangle_contract import TriangleTest
from wrt.kernels.triangle.support.vectors import cross, largest, scale_to_one

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

OriginPlanes = wp.types.vector(length=13, dtype=wp.float32)
"""A triangle as seen from an origin: the normals of the planes through the origin and the edges opposite a, b and c, towards
these, to the same scale; the triangle's normal, away from the origin, to a scale of its own; the distance of the triangle's
plane from the origin, in lengths of that normal."""


@wp.struct
class ScaledRay:
    """A direction whose largest component is between 1 and 2."""

    direction: wp.vec3
    power: float
    """The power of two by which it was divided."""


@wp.func_native("return __builtin_bit_cast(float, __builtin_bit_cast(int, size) & 0x7f800000);")
def power_of_two(size: float) -> float:
    """The power of two below a normal number."""
    ...


@wp.func
def prepare(origin: wp.vec3, direction: wp.vec3):
    """Scales the direction, finite and not zero; the origin is in the records."""
    ray = ScaledRay()
    size = wp.abs(direction)
    ray.power = power_of_two(wp.max(size[0], wp.max(size[1], size[2])))
    ray.direction = wp.vec3(direction[0] / ray.power, direction[1] / ray.power, direction[2] / ray.power)
    return ray


@wp.func
def seen_from(corners: Corners, origin: wp.vec3, turned: bool):
    """A triangle as seen from an origin; `turned`: whether planes are turned to the side on which the origin is."""
    from_origin = wp.vec3d(origin)
    a = wp.vec3d(corners.a) - from_origin
    b = wp.vec3d(corners.b) - from_origin
    c = wp.vec3d(corners.c) - from_origin
    normal = cross(b - a, c - a)
    height = (normal[0] * a[0] + normal[1] * a[1]) + normal[2] * a[2]
    side = wp.where(turned and height < wp.float64(0.0), wp.float64(-1.0), wp.float64(1.0))
    plane_a = cross(b, c)
    plane_b = cross(c, a)
    plane_c = cross(a, b)
    to_planes = side * scale_to_one(wp.max(largest(plane_a), wp.max(largest(plane_b), largest(plane_c))))
    to_normal = side * scale_to_one(largest(normal))
    planes = OriginPlanes()
    for axis in range(3):
        planes[axis] = float(plane_a[axis] * to_planes)
        planes[3 + axis] = float(plane_b[axis] * to_planes)
        planes[6 + axis] = float(plane_c[axis] * to_planes)
        planes[9 + axis] = float(normal[axis] * to_normal)
    planes[12] = float(height * to_normal)
    return planes


@wp.func
def derive(corners: Corners, origin: wp.vec3):
    """The precomputation for a triangle and an origin."""
    return seen_from(corners, origin, True)


RECORD = Record(13, derive, per_origin=True)


@wp.func
def along_plane(direction: wp.vec3, planes: OriginPlanes, first: int):
    """direction . the normal that begins at `first`."""
    return (direction[0] * planes[first] + direction[1] * planes[first + 1]) + direction[2] * planes[first + 2]


@wp.func
def intersect(ray: ScaledRay, planes: OriginPlanes):
    """One ray, one triangle: (t, u, v), t NaN if the ray misses. u, v weigh the vertices b and c."""
    miss = wp.vec3(wp.nan, 0.0, 0.0)
    alpha = along_plane(ray.direction, planes, 0)
    if not alpha >= 0.0:
        return miss
    beta = along_plane(ray.direction, planes, 3)
    if not beta >= 0.0:
        return miss
    gamma = along_plane(ray.direction, planes, 6)
    if not gamma >= 0.0:
        return miss
    along = along_plane(ray.direction, planes, 9)
    total = (alpha + beta) + gamma
    t = (planes[12] / along) / ray.power
    if not (along > 0.0 and total > 0.0 and t - t == 0.0):
        return miss
    scale = 1.0 / total
    return wp.vec3(t, beta * scale, gamma * scale)


EXITS = LaneForm(
    ray=(
        *(RayValue(f"d{axis}", f"ray.direction.c[{i}]", f"{axis} / power_k") for i, axis in enumerate("xyz")),
        RayValue("power", "ray.power", "power_k"),
    ),
    packet_setup="""
        const int exponent = __builtin_bit_cast(int, main_x ? x : main_y ? y : z) & 0x7f800000;
        const float power_k = __builtin_bit_cast(float, exponent);
    """,
    triangle=("eax", "eay", "eaz", "ebx", "eby", "ebz", "ecx", "ecy", "ecz", "nx", "ny", "nz", "height"),
    steps=(
        Step(
            exit="beyond the plane of the edge from b to c",
            code="const float alpha = (dx * eax + dy * eay) + dz * eaz;",
            passes="alpha >= 0.0f",
            keeps=("alpha",),
        ),
        Step(
            exit="beyond that from c to a",
            code="const float beta = (dx * ebx + dy * eby) + dz * ebz;",
            passes="beta >= 0.0f",
            keeps=("beta",),
        ),
        Step(
            exit="beyond that from a to b",
            code="const float gamma = (dx * ecx + dy * ecy) + dz * ecz;",
            passes="gamma >= 0.0f",
            keeps=("gamma",),
        ),
        Step(
            exit="the triangle is seen edge-on",
            code="""
                const float along = (dx * nx + dy * ny) + dz * nz;
                const float total = (alpha + beta) + gamma, scale = 1.0f / total;
                const float t = (height / along) / power, u = beta * scale, v = gamma * scale;
            """,
            passes="(along > 0.0f) & (total > 0.0f) & (t - t == 0.0f)",
        ),
    ),
)
"""The test with its four exits."""

LANES = EXITS.joined(3, 1)
"""The first three in one: nearly all vectors take it, so the branch is foreseen, as one after each plane would not be
(measured in `wrt.bench.studies.triangles.komatsu_tables`)."""

TEST = TriangleTest(
    name="komatsu",
    paper="Komatsu, Kaeriyama, Suzuki, Takizawa, Kobayashi: A fast ray frustum-triangle intersection algorithm (2008)",
    record=RECORD,
    ray_state=ScaledRay,
    prepare=prepare,
    intersect=intersect,
    lanes=LANES,
)

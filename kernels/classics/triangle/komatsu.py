"""Komatsu, Kaeriyama, Suzuki, Takizawa and Kobayashi 2008: a test for rays with a common origin.

**Problem.** Moeller and Trumbore's products depend on ray and triangle. The rays of a camera or a point light share an origin,
so most of the work is repeated for every ray.

**Idea.** Write Cramer's rule as triple products with the direction D as a separate factor. With S from the triangle to the
origin, u and v are D . (-S x E2) and D . (S x E1) over -D . N, and t is N . S over the same. The factors of D depend on
triangle and origin only and are computed once. A test takes three dot products, and most tests end after the first or the
second: each comparison is an exit, four in all.

**Steps.**

1. Once per triangle and origin: the normals of the planes through the origin and the edges opposite a, b and c; N; N . S.
2. alpha = D . (the plane opposite a). Exit: negative. Then beta and gamma likewise, each with an exit of its own.
3. D . N. Exit: the triangle is seen edge-on.
4. t = N . S / D . N; u and v are beta and gamma over alpha + beta + gamma.

**Cost.** 5, 10 or 15 operations up to the first three exits, 13 more for a hit.

**Data.** A record belongs to a triangle and an origin: the three vertices (for the triangle's box, and for packet culling), the
normals of the planes through the origin and the three edges, the triangle's normal N, and N . S: 88 bytes. The records are
computed for the origin of a batch, and again when the next batch has another origin (`wrt.Scene` keeps the most recent ones).
Computing them takes about a third of the time of one batch of a million rays, so they pay only if several batches share an
origin (notebooks/records/2026-11-21-triangle-tests.md).

**What we changed.**

* The paper compares u + v with 1, by the sum of two rounded products. Here the third edge has a plane of its own, as the others
  do: -S x E2 and S x E1 are already the planes of two edges. Two triangles then see their common edge through the same three
  numbers with opposite signs, and no ray passes between them along it. (Benthin's form of Pluecker's test, with which the paper
  compares, has this property too.) D . N is computed only for a ray that passes all three planes, and is the fourth exit.
* The paper rejects triangles that face away, at the first exit. Here the planes are turned towards the origin when they are
  computed. Both sides of a triangle are hit at no cost, triangles behind the origin leave at the first three exits, and the
  fourth exit rejects triangles that are seen edge-on.
* The planes are computed in float64, by cross products of the vertices relative to the origin, and then rounded. In float32
  their rounding would grow with the square of the distance over the length of an edge.
* Planes and directions are scaled by powers of two, which rounds nothing, so that tiny triangles do not underflow.

**Limits.** The planes of the edges at a *vertex* round independently and do not meet in a common line, so rays aimed at a
vertex occasionally pass through (figures in the record). The test is therefore not `watertight`; along edges no ray passes.
Near the tip of a needle two planes almost coincide, and a hit may lie beyond the tip by much more than the slack: the test is
not `accurate`. A triangle whose plane contains the origin is hit, at t = 0, from one side only.

References: komatsu-2008; benthin-2006.
"""

import warp as wp

from wrt.kernels.classics.triangle.published import FINITE, in_steps
from wrt.kernels.triangle import CLASSIC_TESTS
from wrt.kernels.triangle.support.lane_form import LaneForm, RayValue
from wrt.kernels.triangle.support.record_blocks import Corners, Record
from wrt.kernels.triangle.support.triangle_contract import TriangleTest
from wrt.kernels.triangle.support.vectors import cross, dotted, largest, miss, names, scale_to_one

OriginPlanes = wp.types.vector(length=13, dtype=wp.float32)
"""A triangle relative to an origin: the normals of the planes through the origin and the edges opposite a, b and c, pointing
towards these vertices, on a common scale; the triangle's normal, pointing away from the origin, on its own scale; the distance
of the triangle's plane from the origin, in lengths of that normal."""


@wp.struct
class ScaledRay:
    """A direction scaled by a power of two so that its largest component is between 1 and 2."""

    direction: wp.vec3
    power: float
    """The power of two by which the direction was divided."""


@wp.func_native("return __builtin_bit_cast(float, __builtin_bit_cast(int, size) & 0x7f800000);")
def power_of_two(size: float) -> float:
    """The largest power of two that is at most a normal number."""


@wp.func
def prepare(origin: wp.vec3, direction: wp.vec3):
    """Scales a finite, nonzero direction. The records already contain the origin."""
    ray = ScaledRay()
    size = wp.abs(direction)
    ray.power = power_of_two(wp.max(size[0], wp.max(size[1], size[2])))
    ray.direction = wp.vec3(direction[0] / ray.power, direction[1] / ray.power, direction[2] / ray.power)
    return ray


@wp.func
def seen_from(corners: Corners, origin: wp.vec3, turned: bool):
    """Planes of a triangle for an origin. With `turned`, they are turned towards the origin's side of the triangle."""
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
    """Planes of a triangle for an origin, turned towards it."""
    return seen_from(corners, origin, True)


@wp.func
def along_plane(direction: wp.vec3, planes: OriginPlanes, first: int):
    """Dot product of the direction and the normal that begins at `first`."""
    return (direction[0] * planes[first] + direction[1] * planes[first + 1]) + direction[2] * planes[first + 2]


@wp.func
def intersect(ray: ScaledRay, planes: OriginPlanes):
    """One ray, one triangle: (t, u, v); t is NaN if the ray misses. u and v weigh the vertices b and c."""
    alpha = along_plane(ray.direction, planes, 0)
    if not alpha >= 0.0:
        return miss()
    beta = along_plane(ray.direction, planes, 3)
    if not beta >= 0.0:
        return miss()
    gamma = along_plane(ray.direction, planes, 6)
    if not gamma >= 0.0:
        return miss()
    along = along_plane(ray.direction, planes, 9)
    total = (alpha + beta) + gamma
    t = (planes[12] / along) / ray.power
    if not (along > 0.0 and total > 0.0 and t - t == 0.0):
        return miss()
    scale = 1.0 / total
    return wp.vec3(t, beta * scale, gamma * scale)


HIT = f"""
    const float along = {dotted("d", "n")}, total = (alpha + beta) + gamma, scale = 1.0f / total;
    const float t = (height / along) / power, u = beta * scale, v = gamma * scale;
"""
"""C++ for the values of a hit."""

EXITS = LaneForm(
    ray=(
        *(RayValue(f"d{axis}", f"ray.direction.c[{i}]", f"{axis} / power_k") for i, axis in enumerate("xyz")),
        RayValue("power", "ray.power", "power_k"),
    ),
    packet_setup="""
        const int exponent = __builtin_bit_cast(int, main_x ? x : main_y ? y : z) & 0x7f800000;
        const float power_k = __builtin_bit_cast(float, exponent);
    """,
    triangle=(*names("ea"), *names("eb"), *names("ec"), *names("n"), "height"),
    steps=in_steps(
        ("beyond the plane of the edge from b to c", f"const float alpha = {dotted('d', 'ea')};", "alpha >= 0.0f"),
        ("beyond that from c to a", f"const float beta = {dotted('d', 'eb')};", "beta >= 0.0f"),
        ("beyond that from a to b", f"const float gamma = {dotted('d', 'ec')};", "gamma >= 0.0f"),
        ("the triangle is seen edge-on", HIT, f"(along > 0.0f) & (total > 0.0f) & ({FINITE})"),
    ),
)
"""The test with its four exits."""

TEST = TriangleTest(
    name="komatsu",
    paper=CLASSIC_TESTS["komatsu"].paper,
    record=Record(13, derive, per_origin=True),
    ray_state=ScaledRay,
    prepare=prepare,
    intersect=intersect,
    lanes=EXITS.joined(3, 1),
)
"""The first three exits are joined into one. Nearly all vectors take it, so the branch is predicted, unlike one after each
plane. `studies.triangles.komatsu_tables` measures it."""

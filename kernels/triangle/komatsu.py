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
  on which the origin is: both sides of a triangle are hit at no cost, and the fourth exit drops what lies behind the origin.
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

from functools import cache

import warp as wp

from wrt.kernels.boxes import greatest, least
from wrt.kernels.lanes import FOR_LANES, lanes
from wrt.kernels.triangle.moeller_trumbore import dot
from wrt.kernels.triangle.records import CORNER_BOX, Corners, PacketForm, Record

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

COMPONENTS = 22
"""ax ay az bx by bz cx cy cz, the normals of the edges opposite a, b and c, the triangle's normal, the height."""


@wp.struct
class ScaledRay:
    """A direction whose largest component is between 1 and 2."""

    direction: wp.vec3
    power: float
    """The power of two by which it was divided."""


@wp.struct
class OriginTriangle:
    """A triangle as seen from an origin."""

    corners: Corners
    plane_a: wp.vec3
    """Normal of the plane through the origin and the edge opposite a, towards a; likewise the next two, to the same scale."""
    plane_b: wp.vec3
    plane_c: wp.vec3
    normal: wp.vec3
    """The triangle's normal, away from the origin, to a scale of its own."""
    height: float
    """Distance of the triangle's plane from the origin, in lengths of `normal`."""


@wp.func_native("return __builtin_bit_cast(float, __builtin_bit_cast(int, size) & 0x7f800000);")
def power_of_two(size: float) -> float:
    """The power of two below a normal number."""
    ...


@wp.func_native("""
    const double power = __builtin_bit_cast(double, __builtin_bit_cast(long long, size) & 0x7ff0000000000000LL);
    return power > 0.0 ? 1.0 / power : size + 1.0;
""")
def scale_to_one(size: wp.float64) -> wp.float64:
    """What brings a size between 1 and 2, a power of two; 1 for 0, and NaN for NaN."""
    ...


@wp.func
def largest(v: wp.vec3d):
    """Largest component, without sign."""
    return wp.max(wp.abs(v[0]), wp.max(wp.abs(v[1]), wp.abs(v[2])))


@wp.func
def cross(p: wp.vec3d, q: wp.vec3d):
    """p x q: exactly -(q x p)."""
    return wp.vec3d(p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0])


@wp.func
def prepare(origin: wp.vec3, direction: wp.vec3):
    """Scales the direction, finite and not zero; the origin is in the records."""
    ray = ScaledRay()
    size = wp.abs(direction)
    ray.power = power_of_two(wp.max(size[0], wp.max(size[1], size[2])))
    ray.direction = wp.vec3(direction[0] / ray.power, direction[1] / ray.power, direction[2] / ray.power)
    return ray


@wp.func
def pack(records: wp.array(dtype=float), slot: int, width: int, corners: Corners, origin: wp.vec3):
    """The precomputation for a triangle and an origin."""
    first = (slot / width) * COMPONENTS * width + slot % width
    for axis in range(3):
        records[first + axis * width] = corners.a[axis]
        records[first + (3 + axis) * width] = corners.b[axis]
        records[first + (6 + axis) * width] = corners.c[axis]
    from_origin = wp.vec3d(origin)
    a = wp.vec3d(corners.a) - from_origin
    b = wp.vec3d(corners.b) - from_origin
    c = wp.vec3d(corners.c) - from_origin
    normal = cross(b - a, c - a)
    height = (normal[0] * a[0] + normal[1] * a[1]) + normal[2] * a[2]
    side = wp.where(height < wp.float64(0.0), wp.float64(-1.0), wp.float64(1.0))
    plane_a = cross(b, c)
    plane_b = cross(c, a)
    plane_c = cross(a, b)
    to_planes = side * scale_to_one(wp.max(largest(plane_a), wp.max(largest(plane_b), largest(plane_c))))
    to_normal = side * scale_to_one(largest(normal))
    for axis in range(3):
        records[first + (9 + axis) * width] = float(plane_a[axis] * to_planes)
        records[first + (12 + axis) * width] = float(plane_b[axis] * to_planes)
        records[first + (15 + axis) * width] = float(plane_c[axis] * to_planes)
        records[first + (18 + axis) * width] = float(normal[axis] * to_normal)
    records[first + 21 * width] = float(height * to_normal)


@wp.func_native("""
    const float* r = &records.data[(size_t)(slot / width) * 22 * width + slot % width] + component * width;
    return wp::vec3(r[0], r[width], r[2 * width]);
""")
def load_vector(records: wp.array(dtype=float), slot: int, width: int, component: int) -> wp.vec3:
    """Three components of a record, without the index checks of `records[...]`."""
    ...


@wp.func_native("return records.data[(size_t)(slot / width) * 22 * width + 21 * width + slot % width];")
def load_height(records: wp.array(dtype=float), slot: int, width: int) -> float:
    """The last component of a record."""
    ...


@wp.func
def load(records: wp.array(dtype=float), slot: int, width: int):
    """A record as `pack` stored it."""
    triangle = OriginTriangle()
    triangle.corners.a = load_vector(records, slot, width, 0)
    triangle.corners.b = load_vector(records, slot, width, 3)
    triangle.corners.c = load_vector(records, slot, width, 6)
    triangle.plane_a = load_vector(records, slot, width, 9)
    triangle.plane_b = load_vector(records, slot, width, 12)
    triangle.plane_c = load_vector(records, slot, width, 15)
    triangle.normal = load_vector(records, slot, width, 18)
    triangle.height = load_height(records, slot, width)
    return triangle


@wp.func
def box_low(triangle: OriginTriangle):
    return least(triangle.corners.a, least(triangle.corners.b, triangle.corners.c))


@wp.func
def box_high(triangle: OriginTriangle):
    return greatest(triangle.corners.a, greatest(triangle.corners.b, triangle.corners.c))


RECORD = Record(COMPONENTS, pack, load, box_low, box_high, CORNER_BOX, per_origin=True)
"""Vertices and planes: 88 bytes a triangle."""


@wp.func
def intersect(ray: ScaledRay, triangle: OriginTriangle):
    """One ray, one triangle: (t, u, v), t NaN if the ray misses. u, v weigh the vertices b and c."""
    miss = wp.vec3(wp.nan, 0.0, 0.0)
    alpha = dot(ray.direction, triangle.plane_a)
    if not alpha >= 0.0:
        return miss
    beta = dot(ray.direction, triangle.plane_b)
    if not beta >= 0.0:
        return miss
    gamma = dot(ray.direction, triangle.plane_c)
    if not gamma >= 0.0:
        return miss
    along = dot(ray.direction, triangle.normal)
    total = (alpha + beta) + gamma
    t = (triangle.height / along) / ray.power
    if not (along > 0.0 and total > 0.0 and t - t == 0.0):
        return miss
    scale = 1.0 / total
    return wp.vec3(t, beta * scale, gamma * scale)


_BLOCK = """
    const float* r = &records.data[(size_t)block * (22 * W)];
    const float dx = ray.direction.c[0], dy = ray.direction.c[1], dz = ray.direction.c[2], power = ray.power;
    float alpha[W], beta[W], gamma[W];
    unsigned mask = 0;
    WRT_FOR_LANES(i) {
        float a = (dx * r[9 * W + i] + dy * r[10 * W + i]) + dz * r[11 * W + i];
        float b = (dx * r[12 * W + i] + dy * r[13 * W + i]) + dz * r[14 * W + i];
        float c = (dx * r[15 * W + i] + dy * r[16 * W + i]) + dz * r[17 * W + i];
        alpha[i] = a; beta[i] = b; gamma[i] = c;
        mask |= ((a >= 0.0f) & (b >= 0.0f) & (c >= 0.0f)) ? 1u << i : 0u;
    }
    if (!mask) return mask;
    unsigned ahead = 0;
    WRT_FOR_LANES(i) {
        float along = (dx * r[18 * W + i] + dy * r[19 * W + i]) + dz * r[20 * W + i];
        float total = (alpha[i] + beta[i]) + gamma[i], scale = 1.0f / total;
        float t_i = (r[21 * W + i] / along) / power;
        t.c[i] = t_i; u.c[i] = beta[i] * scale; v.c[i] = gamma[i] * scale;
        ahead |= ((along > 0.0f) & (total > 0.0f) & (t_i - t_i == 0.0f)) ? 1u << i : 0u;
    }
    return mask & ahead;
"""


@cache
def block_test(width: int) -> wp.Function:
    """One ray, W triangles: the bit mask of the lanes whose triangle the ray meets; t, u, v are valid there."""
    Lanes = lanes(width)

    @wp.func_native(f"{FOR_LANES}    constexpr int W = {width};{_BLOCK}")
    def komatsu_block(
        records: wp.array(dtype=float),
        block: int,
        ray: ScaledRay,
        t: wp.ref[Lanes],
        u: wp.ref[Lanes],
        v: wp.ref[Lanes],
    ) -> wp.uint32: ...

    return komatsu_block


PACKET = PacketForm(
    state=("direction_x", "direction_y", "direction_z", "power"),
    passes=1,
    prepare="""
        const int exponent = __builtin_bit_cast(int, main_x ? x : main_y ? y : z) & 0x7f800000;
        const float power_k = __builtin_bit_cast(float, exponent);
        direction_x[k] = x / power_k; direction_y[k] = y / power_k; direction_z[k] = z / power_k; power[k] = power_k;
    """,
    triangle="""
            const float ax = corner[9 * W], ay = corner[10 * W], az = corner[11 * W];
            const float bx = corner[12 * W], by = corner[13 * W], bz = corner[14 * W];
            const float cx = corner[15 * W], cy = corner[16 * W], cz = corner[17 * W];
            const float nx = corner[18 * W], ny = corner[19 * W], nz = corner[20 * W], height = corner[21 * W];
    """,
    inside="""
                int inside[W];
                float alpha[W], beta[W], gamma[W];
                int some = 0;
                WRT_FOR_LANES(i) {
                    const int k = f + i;
                    const float dx = direction_x[k], dy = direction_y[k], dz = direction_z[k];
                    const float a = (dx * ax + dy * ay) + dz * az, b = (dx * bx + dy * by) + dz * bz;
                    const float c = (dx * cx + dy * cy) + dz * cz;
                    alpha[i] = a; beta[i] = b; gamma[i] = c;
                    inside[i] = ((a >= 0.0f) & (b >= 0.0f) & (c >= 0.0f)) ? 1 : 0;
                    some |= inside[i];
                }
                if (!some) continue;
                float t_at[W], u_at[W], v_at[W];
                WRT_FOR_LANES(i) {
                    const int k = f + i;
                    const float along = (direction_x[k] * nx + direction_y[k] * ny) + direction_z[k] * nz;
                    const float total = (alpha[i] + beta[i]) + gamma[i], scale = 1.0f / total;
                    const float t_i = (height / along) / power[k];
                    t_at[i] = t_i; u_at[i] = beta[i] * scale; v_at[i] = gamma[i] * scale;
                    inside[i] = ((inside[i] != 0) & (along > 0.0f) & (total > 0.0f) & (t_i - t_i == 0.0f)) ? 1 : 0;
                }
    """,
    hit="at = t_at[i]; hit_u = u_at[i]; hit_v = v_at[i];",
)
"""W rays x one triangle: the same arithmetic; the exits are taken where all W rays take one."""

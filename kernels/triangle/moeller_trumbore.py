"""Moeller & Trumbore 1997: solve origin + t direction = a + u (b - a) + v (c - a) by Cramer's rule.

Nothing is precomputed; edges are formed on the fly. Fast and short, but not watertight: the third edge is tested through
u + v <= 1, whose rounding differs from that of the neighbour's own edge.

Two-sided: the determinant is not compared with a small number, only with zero (through the non-finite results that a
division by zero gives, which fail every comparison).

References:
    T. Moeller, B. Trumbore: Fast, minimum storage ray/triangle intersection. Journal of Graphics Tools 2(1), 1997.
"""

from functools import cache

import warp as wp

from wrt.kernels.lanes import FOR_LANES, lanes
from wrt.kernels.triangle.records import Corners, PacketForm

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.struct
class PlainRay:
    """Origin and direction as they are."""

    origin: wp.vec3
    direction: wp.vec3


@wp.func
def prepare(origin: wp.vec3, direction: wp.vec3):
    """Nothing to prepare."""
    ray = PlainRay()
    ray.origin = origin
    ray.direction = direction
    return ray


@wp.func
def cross(p: wp.vec3, q: wp.vec3):
    """p x q, each component as the block form below writes it."""
    return wp.vec3(p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0])


@wp.func
def dot(p: wp.vec3, q: wp.vec3):
    """p . q, summed from left to right."""
    return (p[0] * q[0] + p[1] * q[1]) + p[2] * q[2]


@wp.func
def intersect(ray: PlainRay, corners: Corners):
    """One ray, one triangle: (t, u, v), t NaN if the ray's line misses. u, v weigh the vertices b and c."""
    edge_b = corners.b - corners.a
    edge_c = corners.c - corners.a
    p = cross(ray.direction, edge_c)
    scale = 1.0 / dot(edge_b, p)
    s = ray.origin - corners.a
    u = dot(s, p) * scale
    q = cross(s, edge_b)
    v = dot(ray.direction, q) * scale
    t = dot(edge_c, q) * scale
    if u >= 0.0 and v >= 0.0 and u + v <= 1.0 and t - t == 0.0:
        return wp.vec3(t, u, v)
    return wp.vec3(wp.nan, 0.0, 0.0)


_BLOCK = """
    const float* r = &records.data[(size_t)block * (9 * W)];
    const float dx = ray.direction.c[0], dy = ray.direction.c[1], dz = ray.direction.c[2];
    const float ox = ray.origin.c[0], oy = ray.origin.c[1], oz = ray.origin.c[2];
    unsigned mask = 0;
    WRT_FOR_LANES(i) {
        float ax = r[i], ay = r[W + i], az = r[2 * W + i];
        float bx = r[3 * W + i] - ax, by = r[4 * W + i] - ay, bz = r[5 * W + i] - az;
        float cx = r[6 * W + i] - ax, cy = r[7 * W + i] - ay, cz = r[8 * W + i] - az;
        float px = dy * cz - dz * cy, py = dz * cx - dx * cz, pz = dx * cy - dy * cx;
        float scale = 1.0f / ((bx * px + by * py) + bz * pz);
        float sx = ox - ax, sy = oy - ay, sz = oz - az;
        float u_i = ((sx * px + sy * py) + sz * pz) * scale;
        float qx = sy * bz - sz * by, qy = sz * bx - sx * bz, qz = sx * by - sy * bx;
        float v_i = ((dx * qx + dy * qy) + dz * qz) * scale;
        float t_i = ((cx * qx + cy * qy) + cz * qz) * scale;
        t.c[i] = t_i; u.c[i] = u_i; v.c[i] = v_i;
        bool hit = (u_i >= 0.0f) & (v_i >= 0.0f) & (u_i + v_i <= 1.0f) & (t_i - t_i == 0.0f);
        mask |= hit ? 1u << i : 0u;
    }
    return mask;
"""


@cache
def block_test(width: int) -> wp.Function:
    """One ray, W triangles: the bit mask of the lanes whose triangle the ray's line meets; t, u, v are valid there."""
    Lanes = lanes(width)

    @wp.func_native(f"{FOR_LANES}    constexpr int W = {width};{_BLOCK}")
    def moeller_trumbore_block(
        records: wp.array(dtype=float),
        block: int,
        ray: PlainRay,
        t: wp.ref[Lanes],
        u: wp.ref[Lanes],
        v: wp.ref[Lanes],
    ) -> wp.uint32: ...

    return moeller_trumbore_block


PACKET = PacketForm(
    state=("direction_x", "direction_y", "direction_z"),
    passes=1,
    prepare="direction_x[k] = x; direction_y[k] = y; direction_z[k] = z;",
    triangle="""
            const float ax = corner[0], ay = corner[W], az = corner[2 * W];
            const float bx = corner[3 * W] - ax, by = corner[4 * W] - ay, bz = corner[5 * W] - az;
            const float cx = corner[6 * W] - ax, cy = corner[7 * W] - ay, cz = corner[8 * W] - az;
    """,
    inside="""
                int inside[W];
                float t_at[W], u_at[W], v_at[W];
                int some = 0;
                WRT_FOR_LANES(i) {
                    const int k = f + i;
                    const float dx = direction_x[k], dy = direction_y[k], dz = direction_z[k];
                    const float ox = SHARED ? origin0[0] : origin_x[k], oy = SHARED ? origin0[1] : origin_y[k],
                                oz = SHARED ? origin0[2] : origin_z[k];
                    const float px = dy * cz - dz * cy, py = dz * cx - dx * cz, pz = dx * cy - dy * cx;
                    const float scale = 1.0f / ((bx * px + by * py) + bz * pz);
                    const float sx = ox - ax, sy = oy - ay, sz = oz - az;
                    const float u_i = ((sx * px + sy * py) + sz * pz) * scale;
                    const float qx = sy * bz - sz * by, qy = sz * bx - sx * bz, qz = sx * by - sy * bx;
                    const float v_i = ((dx * qx + dy * qy) + dz * qz) * scale;
                    const float t_i = ((cx * qx + cy * qy) + cz * qz) * scale;
                    t_at[i] = t_i; u_at[i] = u_i; v_at[i] = v_i;
                    inside[i] = ((u_i >= 0.0f) & (v_i >= 0.0f) & (u_i + v_i <= 1.0f) & (t_i - t_i == 0.0f)) ? 1 : 0;
                    some |= inside[i];
                }
                if (!some) continue;
    """,
    hit="at = t_at[i]; hit_u = u_at[i]; hit_v = v_at[i];",
)
"""W rays x one triangle: the same arithmetic."""

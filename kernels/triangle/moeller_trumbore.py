"""Moeller & Trumbore 1997: solve origin + t direction = a + u (b - a) + v (c - a) by Cramer's rule.

**Problem.** Find t and the barycentric coordinates without storing the plane of every triangle.

**Idea.** The three unknowns t, u, v solve a linear system of three equations. Cramer's rule gives them as ratios of triple
products that share two cross products.

**Data.** The three vertices. Nothing is precomputed; the test computes the edges for every ray.

**Departures.** The test is two-sided: the determinant is not compared with a small number. A zero determinant gives results
that are not finite, which fail every comparison.

**Limits.** Fast and short, but not watertight: the third edge is tested through u + v <= 1, whose rounding differs from that of
the same edge in the neighbouring triangle.

References: moeller-trumbore-1997.
"""

import warp as wp

from wrt.kernels.triangle.support.lane_form import DIRECTION, ORIGIN, LaneForm, Step
from wrt.kernels.triangle.support.record_blocks import Corners
from wrt.kernels.triangle.support.triangle_contract import TriangleTest
from wrt.kernels.triangle.support.vectors import PlainRay, cross, dot, miss, prepare


@wp.func
def intersect(ray: PlainRay, corners: Corners):
    """One ray, one triangle: (t, u, v); t is NaN if the ray's line misses. u and v weigh the vertices b and c."""
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
    return miss()


EXITS = LaneForm(
    ray=(*ORIGIN, *DIRECTION),
    steps=(
        Step(
            exit="beyond the edge from a to c",
            code="""
                const float e1x = bx - ax, e1y = by - ay, e1z = bz - az, e2x = cx - ax, e2y = cy - ay, e2z = cz - az;
                const float px = dy * e2z - dz * e2y, py = dz * e2x - dx * e2z, pz = dx * e2y - dy * e2x;
                const float scale = 1.0f / ((e1x * px + e1y * py) + e1z * pz);
                const float sx = ox - ax, sy = oy - ay, sz = oz - az;
                const float u = ((sx * px + sy * py) + sz * pz) * scale;
            """,
            passes="u >= 0.0f",
            keeps=("e1x", "e1y", "e1z", "e2x", "e2y", "e2z", "scale", "sx", "sy", "sz", "u"),
        ),
        Step(
            exit="beyond one of the other edges",
            code="""
                const float qx = sy * e1z - sz * e1y, qy = sz * e1x - sx * e1z, qz = sx * e1y - sy * e1x;
                const float v = ((dx * qx + dy * qy) + dz * qz) * scale;
            """,
            passes="(v >= 0.0f) & (u + v <= 1.0f)",
            keeps=("qx", "qy", "qz", "v"),
        ),
        Step(
            exit="parallel to the plane",
            code="const float t = ((e2x * qx + e2y * qy) + e2z * qz) * scale;",
            passes="t - t == 0.0f",
        ),
    ),
)
"""The test with the exits of the paper."""

LANES = EXITS.joined(3)
"""One step: all W lanes would seldom take an exit between u and v together, so it does not pay."""

TEST = TriangleTest(
    name="moeller_trumbore",
    paper="Moeller, Trumbore: Fast, minimum storage ray/triangle intersection (1997)",
    ray_state=PlainRay,
    prepare=prepare,
    intersect=intersect,
    lanes=LANES,
)

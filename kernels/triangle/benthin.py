"""Benthin 2006: Pluecker's test for rays from one point.

**Problem.** The inner product of a ray with an edge is a volume, D . (p x q) as seen from the ray's origin; the cross product
is most of the work, and the same for all rays of a camera or a point light.

**Idea.** Compute it once for a triangle and an origin: it is the normal of the plane through both ends of the edge and the
origin. What a ray pays is three dot products, whose signs tell inside from outside, and for a hit a fourth, for the distance.

**Data.** The three planes, the triangle's normal and its distance: 52 bytes, made for a batch's origin as those of
`wrt.kernels.triangle.komatsu`, whose words for them hold here too. (The thesis makes them for each packet, of 4 rays and up.)

**And Komatsu's test?** The one here has taken over the plane of the third edge, so both have the same numbers; what is left
between them is this. Here all three products come first and there is one exit, as Benthin found that most rays leave by the
inside test; and planes are not turned towards the origin: either sign will do if it is that of all three. So an origin in a
triangle's own plane sees it from both sides, and a test takes three comparisons more.

**Departures.** The weights of the vertices are the three products over their sum; the thesis computes them after the traversal.
It compares the distance with the ray's range; here that is the caller's, but for what lies behind the origin.

**Limits.** Those of Komatsu's test: neither `watertight` at vertices nor `accurate` at tips of needles.

References:
    C. Benthin: Realtime ray tracing on current CPU architectures. PhD thesis, Saarland University, 2006.
"""

import warp as wp

from wrt.kernels.triangle import komatsu
from wrt.kernels.triangle.komatsu import OriginPlanes, ScaledRay, along_plane, seen_from
from wrt.kernels.triangle.support.lane_form import LaneForm, Step
from wrt.kernels.triangle.support.record_blocks import Corners, Record
from wrt.kernels.triangle.support.triangle_contract import TriangleTest
from wrt.kernels.triangle.support.vectors import miss

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.func
def derive(corners: Corners, origin: wp.vec3):
    """The precomputation for a triangle and an origin."""
    return seen_from(corners, origin, False)


@wp.func
def intersect(ray: ScaledRay, planes: OriginPlanes):
    """One ray, one triangle: (t, u, v), t NaN if the ray misses. u, v weigh the vertices b and c."""
    alpha = along_plane(ray.direction, planes, 0)
    beta = along_plane(ray.direction, planes, 3)
    gamma = along_plane(ray.direction, planes, 6)
    if not ((alpha >= 0.0 and beta >= 0.0 and gamma >= 0.0) or (alpha <= 0.0 and beta <= 0.0 and gamma <= 0.0)):
        return miss()
    total = (alpha + beta) + gamma
    t = (planes[12] / along_plane(ray.direction, planes, 9)) / ray.power
    if not (t >= 0.0 and total != 0.0 and t - t == 0.0):
        return miss()
    scale = 1.0 / total
    return wp.vec3(t, beta * scale, gamma * scale)


LANES = LaneForm(
    ray=komatsu.LANES.ray,
    packet_setup=komatsu.LANES.packet_setup,
    triangle=komatsu.LANES.triangle,
    steps=(
        Step(
            exit="beyond the plane of an edge",
            code="""
                const float alpha = (dx * eax + dy * eay) + dz * eaz;
                const float beta = (dx * ebx + dy * eby) + dz * ebz;
                const float gamma = (dx * ecx + dy * ecy) + dz * ecz;
            """,
            passes="((alpha >= 0.0f) & (beta >= 0.0f) & (gamma >= 0.0f))"
            " | ((alpha <= 0.0f) & (beta <= 0.0f) & (gamma <= 0.0f))",
            keeps=("alpha", "beta", "gamma"),
        ),
        Step(
            exit="the triangle lies behind the origin",
            code="""
                const float along = (dx * nx + dy * ny) + dz * nz;
                const float total = (alpha + beta) + gamma, scale = 1.0f / total;
                const float t = (height / along) / power, u = beta * scale, v = gamma * scale;
            """,
            passes="(t >= 0.0f) & (total != 0.0f) & (t - t == 0.0f)",
        ),
    ),
)

TEST = TriangleTest(
    name="benthin",
    paper="Benthin: Realtime ray tracing on current CPU architectures (2006)",
    record=Record(13, derive, per_origin=True),
    ray_state=ScaledRay,
    prepare=komatsu.prepare,
    intersect=intersect,
    lanes=LANES,
)

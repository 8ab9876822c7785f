"""The tests compared by Komatsu et al. 2008 as the paper has them: in float32, with all their exits.

They serve only to reproduce the paper's tables. The engine uses `wrt.kernels.classics.triangle.komatsu` and
`.moeller_trumbore`, which are two-sided, safer at edges and better suited to wide vectors. N = E1 x E2 is the triangle's
normal, S points from P0 to the origin O, and D is the direction:

    moeller     P0, E1, E2, N precomputed                       48 bytes, 34 operations a test
    projection  the plane and two rows of the main projection   40 bytes, 23 operations a test
    pluecker    N, the planes of O and each edge, N . S         52 bytes, 21 operations a test and 41 for an origin
    proposed    N, -S x E2, S x E1, N . S                       40 bytes, 17 operations a test and 26 for an origin

All but projection reject triangles that do not face the origin, N . D >= 0, at the first exit. Pluecker's second exit comes
when everything except t has been computed. (The paper counts S among the 40 bytes of the proposed test; its listing uses N.)

The paper describes projection without a listing and refers to Wald. Its 40 bytes and its four exits, which are "different from
those of the other algorithms", are those of Wald's listing: t is not in the ray's range, which ends at the closest hit so far;
u < 0; v < 0; u + v > 1. So that is what `projection` does; it is two-sided. Wald's listing has 23 operations with the sum
u + v, and the paper says 22.

References: komatsu-2008; wald-2004.
"""

import warp as wp

from wrt.kernels.runtime.options import exact_module
from wrt.kernels.triangle.support.axis_projection import ROW_NAMES, derive_rows, permuted_lanes
from wrt.kernels.triangle.support.lane_form import DIRECTION, FAR, ORIGIN, LaneForm, Step
from wrt.kernels.triangle.support.record_blocks import Corners, Record
from wrt.kernels.triangle.support.triangle_contract import TestForm
from wrt.kernels.triangle.support.vectors import PlainRay, cross, dot, prepare

exact_module(__name__)

MoellerValues = wp.types.vector(length=12, dtype=wp.float32)
PlueckerValues = wp.types.vector(length=13, dtype=wp.float32)
ProposedValues = wp.types.vector(length=10, dtype=wp.float32)


@wp.struct
class RayInRange:
    """A ray that ends at the closest hit so far."""

    origin: wp.vec3
    direction: wp.vec3
    far: float


@wp.func
def prepare_in_range(origin: wp.vec3, direction: wp.vec3):
    """A ray that has hit nothing."""
    ray = RayInRange()
    ray.origin = origin
    ray.direction = direction
    ray.far = wp.inf
    return ray


@wp.func
def derive_moeller(corners: Corners, origin: wp.vec3):
    """P0, E1, E2, N. They do not depend on the origin."""
    first = corners.b - corners.a
    second = corners.c - corners.a
    normal = cross(first, second)
    values = MoellerValues()
    for axis in range(3):
        values[axis] = corners.a[axis]
        values[3 + axis] = first[axis]
        values[6 + axis] = second[axis]
        values[9 + axis] = normal[axis]
    return values


@wp.func
def derive_pluecker(corners: Corners, origin: wp.vec3):
    """N, T0, T1, T2, N . S."""
    a = corners.a - origin
    b = corners.b - origin
    c = corners.c - origin
    normal = cross(corners.b - corners.a, corners.c - corners.a)
    planes = wp.matrix_from_rows(cross(b, a), cross(c, b), cross(a, c))
    values = PlueckerValues()
    for axis in range(3):
        values[axis] = normal[axis]
        values[3 + axis] = planes[0, axis]
        values[6 + axis] = planes[1, axis]
        values[9 + axis] = planes[2, axis]
    values[12] = dot(normal, -a)
    return values


@wp.func
def derive_proposed(corners: Corners, origin: wp.vec3):
    """N, -S x E2, S x E1, N . S."""
    first = corners.b - corners.a
    second = corners.c - corners.a
    normal = cross(first, second)
    s = origin - corners.a
    for_u = cross(second, s)
    for_v = cross(s, first)
    values = ProposedValues()
    for axis in range(3):
        values[axis] = normal[axis]
        values[3 + axis] = for_u[axis]
        values[6 + axis] = for_v[axis]
    values[9] = dot(normal, s)
    return values


FACING = Step(
    exit="turned away",
    code="const float f1 = (dx * nx + dy * ny) + dz * nz;",
    passes="f1 < 0.0f",
    keeps=("f1",),
)

DISTANCE = """
    const float t = -f2 / f1, u = alpha / -f1, v = beta / -f1;
"""
"""The values of a hit. The paper leaves u' and v' undivided; we divide them so that hits can be compared."""

MOELLER = LaneForm(
    ray=(*ORIGIN, *DIRECTION),
    triangle=("p0x", "p0y", "p0z", "e1x", "e1y", "e1z", "e2x", "e2y", "e2z", "nx", "ny", "nz"),
    steps=(
        FACING,
        Step(
            exit="u < 0",
            code="""
                const float sx = ox - p0x, sy = oy - p0y, sz = oz - p0z;
                const float gx = dy * sz - dz * sy, gy = dz * sx - dx * sz, gz = dx * sy - dy * sx;
                const float alpha = -((gx * e2x + gy * e2y) + gz * e2z);
            """,
            passes="alpha >= 0.0f",
            keeps=("sx", "sy", "sz", "gx", "gy", "gz", "alpha"),
        ),
        Step(
            exit="v < 0",
            code="const float beta = (gx * e1x + gy * e1y) + gz * e1z;",
            passes="beta >= 0.0f",
            keeps=("beta",),
        ),
        Step(exit="u + v > 1", code="const float both = alpha + beta;", passes="both <= -f1"),
        Step(
            exit="no distance",
            code=f"const float f2 = (nx * sx + ny * sy) + nz * sz;{DISTANCE}",
            passes="t - t == 0.0f",
        ),
    ),
)

PROJECTION = LaneForm(
    ray=(*ORIGIN, *DIRECTION, FAR),
    triangle=ROW_NAMES,
    steps=(
        Step(
            exit="behind the origin or a closer hit",
            code=f"""
                {permuted_lanes("o")}{permuted_lanes("d")}
                const float t = (n0 - ((ok + np * op) + nq * oq)) / ((dk + np * dp) + nq * dq);
            """,
            passes="(t > 0.0f) & (t < far)",
            keeps=("op", "oq", "dp", "dq", "t"),
        ),
        Step(
            exit="u < 0",
            code="""
                const float x = op + t * dp, y = oq + t * dq;
                const float u = (up * x + uq * y) + u0;
            """,
            passes="u >= 0.0f",
            keeps=("x", "y", "u"),
        ),
        Step(exit="v < 0", code="const float v = (vp * x + vq * y) + v0;", passes="v >= 0.0f", keeps=("v",)),
        Step(exit="u + v > 1", code="const float both = u + v;", passes="both <= 1.0f"),
    ),
)

PLUECKER = LaneForm(
    ray=DIRECTION,
    triangle=("nx", "ny", "nz", "t0x", "t0y", "t0z", "t1x", "t1y", "t1z", "t2x", "t2y", "t2z", "f2"),
    steps=(
        FACING,
        Step(
            exit="signs differ",
            code="""
                const float gamma = (dx * t0x + dy * t0y) + dz * t0z;
                const float rest = (dx * t1x + dy * t1y) + dz * t1z;
                const float alpha = (dx * t2x + dy * t2y) + dz * t2z;
            """,
            passes="(alpha >= 0.0f) & (rest >= 0.0f) & (gamma >= 0.0f)",
            keeps=("alpha", "gamma"),
        ),
        Step(exit="no distance", code=f"const float beta = gamma;{DISTANCE}", passes="t - t == 0.0f"),
    ),
)

PROPOSED = LaneForm(
    ray=DIRECTION,
    triangle=("nx", "ny", "nz", "gux", "guy", "guz", "gvx", "gvy", "gvz", "f2"),
    steps=(
        FACING,
        Step(
            exit="u < 0",
            code="const float alpha = (dx * gux + dy * guy) + dz * guz;",
            passes="alpha >= 0.0f",
            keeps=("alpha",),
        ),
        Step(
            exit="v < 0",
            code="const float beta = (dx * gvx + dy * gvy) + dz * gvz;",
            passes="beta >= 0.0f",
            keeps=("beta",),
        ),
        Step(exit="u + v > 1", code="const float both = alpha + beta;", passes="both <= -f1"),
        Step(exit="no distance", code=DISTANCE, passes="t - t == 0.0f"),
    ),
)


def published(name: str, record: Record, lanes: LaneForm) -> TestForm:
    """One of the paper's tests."""
    if FAR in lanes.ray:
        return TestForm(name=name, record=record, ray_state=RayInRange, prepare=prepare_in_range, lanes=lanes)
    return TestForm(name=name, record=record, ray_state=PlainRay, prepare=prepare, lanes=lanes)


PUBLISHED: dict[str, TestForm] = {
    form.name: form
    for form in (
        published("moeller", Record(12, derive_moeller), MOELLER),
        published("projection", Record(10, derive_rows), PROJECTION),
        published("pluecker", Record(13, derive_pluecker, per_origin=True), PLUECKER),
        published("proposed", Record(10, derive_proposed, per_origin=True), PROPOSED),
    )
}

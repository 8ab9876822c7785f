"""The tests compared by Komatsu et al. 2008 as the paper has them: in float32, with all their exits.

**Problem.** Which test of a ray and a triangle is fastest for rays from one point, with and without what an origin lets one
compute beforehand? The paper compares four, by operations, by bytes, by where tests end, and by time.

They serve only to reproduce the paper's tables. Scenes use `wrt.kernels.classics.triangle.komatsu` and
`wrt.kernels.triangle.moeller_trumbore`, which are two-sided, safer at edges and better suited to wide vectors. N = E1 x E2 is
the triangle's normal, S points from P0 to the origin O, and D is the direction:

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

from wrt.kernels.classics.triangle.published import FINITE, StepText, in_steps
from wrt.kernels.triangle.support.axis_projection import ROW_NAMES, derive_rows, permuted_lanes
from wrt.kernels.triangle.support.lane_form import DIRECTION, FAR, ORIGIN, LaneForm
from wrt.kernels.triangle.support.record_blocks import Corners, Record
from wrt.kernels.triangle.support.triangle_contract import TestForm
from wrt.kernels.triangle.support.vectors import PlainRay, cross, crossed, dot, dotted, minus, names, prepare

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


def ray_form(name: str, record: Record, triangle: tuple[str, ...], *parts: StepText) -> TestForm:
    """A form from its steps (`in_steps`), with what they read of a ray. triangle: names of the record's own floats."""
    steps = in_steps(*parts)

    def read(values: tuple) -> tuple:
        return values if any(step.reads([value.name for value in values]) for step in steps) else ()

    ray = (*read(ORIGIN), *DIRECTION, *read((FAR,)))
    state, make = (RayInRange, prepare_in_range) if FAR in ray else (PlainRay, prepare)
    return TestForm(
        name=name, record=record, ray_state=state, prepare=make, lanes=LaneForm(ray=ray, triangle=triangle, steps=steps)
    )


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


FACING = ("turned away", f"const float f1 = {dotted('d', 'n')};", "f1 < 0.0f")

SUM = ("u + v > 1", "const float both = alpha + beta;", "both <= -f1")

DISTANCE = """
    const float t = -f2 / f1, u = alpha / -f1, v = beta / -f1;
"""
"""The values of a hit. The paper leaves u' and v' undivided; we divide them so that hits can be compared."""

MOELLER = ray_form(
    "moeller",
    Record(12, derive_moeller),
    (*names("p0"), *names("e1"), *names("e2"), *names("n")),
    FACING,
    ("u < 0", f"{minus('s', 'o', 'p0')}{crossed('g', 'd', 's')}const float alpha = -{dotted('g', 'e2')};", "alpha >= 0.0f"),
    ("v < 0", f"const float beta = {dotted('g', 'e1')};", "beta >= 0.0f"),
    SUM,
    ("no distance", f"const float f2 = {dotted('n', 's')};{DISTANCE}", FINITE),
)

PROJECTION = ray_form(
    "projection",
    Record(10, derive_rows),
    ROW_NAMES,
    (
        "behind the origin or a closer hit",
        f"""
            {permuted_lanes("o")}{permuted_lanes("d")}
            const float t = (n0 - ((ok + np * op) + nq * oq)) / ((dk + np * dp) + nq * dq);
        """,
        "(t > 0.0f) & (t < far)",
    ),
    ("u < 0", "const float x = op + t * dp, y = oq + t * dq, u = (up * x + uq * y) + u0;", "u >= 0.0f"),
    ("v < 0", "const float v = (vp * x + vq * y) + v0;", "v >= 0.0f"),
    ("u + v > 1", "const float both = u + v;", "both <= 1.0f"),
)

PLUECKER = ray_form(
    "pluecker",
    Record(13, derive_pluecker, per_origin=True),
    (*names("n"), *names("t0"), *names("t1"), *names("t2"), "f2"),
    FACING,
    (
        "signs differ",
        f"const float gamma = {dotted('d', 't0')}, rest = {dotted('d', 't1')}, alpha = {dotted('d', 't2')};",
        "(alpha >= 0.0f) & (rest >= 0.0f) & (gamma >= 0.0f)",
    ),
    ("no distance", f"const float beta = gamma;{DISTANCE}", FINITE),
)

PROPOSED = ray_form(
    "proposed",
    Record(10, derive_proposed, per_origin=True),
    (*names("n"), *names("gu"), *names("gv"), "f2"),
    FACING,
    ("u < 0", f"const float alpha = {dotted('d', 'gu')};", "alpha >= 0.0f"),
    ("v < 0", f"const float beta = {dotted('d', 'gv')};", "beta >= 0.0f"),
    SUM,
    ("no distance", DISTANCE, FINITE),
)

PUBLISHED: dict[str, TestForm] = {form.name: form for form in (MOELLER, PROJECTION, PLUECKER, PROPOSED)}

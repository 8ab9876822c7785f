"""What Pichler 2018 tried beside what he kept: ways to make the unit triangle transform, spheres, when to compare t.

These forms serve only to measure. The engine's variants of the test are those of `wrt.kernels.classics.triangle.ferko`.

**Six ways to make the transform** (4.8.1, 5.5). The first three invert the matrix A whose columns are the vertices; the last
three use Baldwin and Weber's free vector (5.1 to 5.4).

    utm_matrix         1: all of X A^-1, applied to the point as a 4 x 4 matrix
    utm_rows           2: only the two rows that are needed. 3: the same rows, with A inverted once in place of twice
    utm_free_matrix    4: the closed inverse (5.2 to 5.4), three rows of four, one column of which is 0, 0, 1
    utm_free_columns   5: the same without that column, and its number
    utm_free_rows      6: the same without the third row: what the thesis keeps, and `ferko_utm` has

A is singular if the plane passes through the coordinate system's origin, as some plane does in every scene: ways 1 to 3 then
miss the triangle, and lose digits if the plane passes nearby. 5.2 to 5.4 are right. 5.5 speaks of "the first two rows of the
inverse"; the rows of X A^-1 that are needed are the second and the third of A^-1.

**Spheres** (4.6, 5.3). `sphere_cross` is the engine's test, by the line's distance from the centre through a cross product.
`sphere_projection` is the thesis's, m^2 = l^2 - s^2, and drops spheres behind the ray. `sphere_parametric` solves the quadratic
equation for both crossings, and drops spheres behind the ray or beyond its closest hit. Both of these subtract numbers of the
size of l^2, so their spheres must be widened by `CANCELLATION` of it. `box_sphere` is `sphere_cross` with the sphere of the
triangle's box. All go on as `utm_free_rows`.

**When to compare t** (6.1): `range_first`, both ends right after the plane; `range_delayed`, the near end there and the far end
last, which the thesis found fastest; `range_last`, both last.

**Edge planes** (3.1). `edge_planes` is the first of Amanatides and Choi's two tests: the triangle's plane, and a plane through
each edge, against which the point is compared before t is divided out. It is not said how these planes stand: here a plane's
value is the weight of the vertex opposite. The second test is `wrt.kernels.classics.triangle.pluecker`.

**The ray in the unit triangle's space** (3.1). `unit_ray` is Schmittler et al.'s test of 2004, which Woop et al. adopt in 2005.
The matrix of way 4 transforms the ray's origin and direction, so t is a quotient of two of their numbers, and the plane needs
no row of its own. Way 4 transforms the point instead, which takes one product with the matrix in place of two.

References: pichler-2018; baldwin-weber-2016; amanatides-choi-1997.
"""

import warp as wp

from wrt.kernels.classics.studies.komatsu_2008 import ray_form
from wrt.kernels.classics.triangle.ferko import triangle_bounds as bounds
from wrt.kernels.classics.triangle.ferko.record_part import Part, join
from wrt.kernels.classics.triangle.ferko.triangle_bounds import CIRCLE, SPHERE_STEP
from wrt.kernels.classics.triangle.ferko.unit_triangle import STEPS, UNIT_TRIANGLE
from wrt.kernels.classics.triangle.ferko.variant import PLANE, POINT
from wrt.kernels.classics.triangle.published import FINITE, INSIDE, StepText
from wrt.kernels.triangle.support.axis_projection import main_axis
from wrt.kernels.triangle.support.record_blocks import Corners, corners_high, corners_low
from wrt.kernels.triangle.support.triangle_contract import TestForm
from wrt.kernels.triangle.support.vectors import cross, dot, dotted, minus

CANCELLATION = 2e-6
"""Rounding error of l^2 - s^2, relative to l^2: about 32 units in the last place."""

Matrix = wp.types.vector(length=16, dtype=wp.float32)
Rows = wp.types.vector(length=6, dtype=wp.float32)
FreeMatrix = wp.types.vector(length=12, dtype=wp.float32)
FreeColumns = wp.types.vector(length=10, dtype=wp.float32)
EdgePlanes = wp.types.vector(length=16, dtype=wp.float32)
Sphere = wp.types.vector(length=4, dtype=wp.float32)


@wp.func
def inverted(corners: Corners):
    """A^-1 in float64; not finite if A is singular."""
    a = wp.vec3d(corners.a)
    b = wp.vec3d(corners.b)
    c = wp.vec3d(corners.c)
    return wp.matrix_from_rows(cross(b, c), cross(c, a), cross(a, b)) / dot(a, cross(b, c))


@wp.func
def derive_matrix(corners: Corners):
    """Way 1: X A^-1, row by row."""
    inverse = inverted(corners)
    values = Matrix()
    for c in range(3):
        values[c] = float(inverse[1, c])
        values[4 + c] = float(inverse[2, c])
    values[15] = 1.0
    return values


@wp.func
def derive_rows(corners: Corners):
    """Ways 2 and 3: the second and third row of A^-1."""
    inverse = inverted(corners)
    values = Rows()
    for c in range(3):
        values[c] = float(inverse[1, c])
        values[3 + c] = float(inverse[2, c])
    return values


@wp.func
def derive_free_matrix(corners: Corners):
    """Way 4: the first three rows of equations 5.2 to 5.4."""
    a = wp.vec3d(corners.a)
    edge_b = wp.vec3d(corners.b) - a
    edge_c = wp.vec3d(corners.c) - a
    normal = cross(edge_b, edge_c)
    k = main_axis(normal)
    free = wp.vec3d()
    free[k] = wp.float64(1.0)
    height = normal[k]
    for_u = cross(edge_c, free) / height
    for_v = cross(free, edge_b) / height
    values = FreeMatrix()
    for c in range(3):
        values[c] = float(for_u[c])
        values[4 + c] = float(for_v[c])
        values[8 + c] = float(normal[c] / height)
    values[3] = float(-dot(for_u, a))
    values[7] = float(-dot(for_v, a))
    values[11] = float(-dot(normal, a) / height)
    return values


@wp.func
def derive_free_columns(corners: Corners):
    """Way 5: the number of the column 0, 0, 1, and the others of way 4."""
    matrix = derive_free_matrix(corners)
    a = wp.vec3d(corners.a)
    k = main_axis(cross(wp.vec3d(corners.b) - a, wp.vec3d(corners.c) - a))
    values = FreeColumns()
    values[0] = float(k)
    for row in range(3):
        values[1 + 3 * row] = matrix[4 * row + (k + 1) % 3]
        values[2 + 3 * row] = matrix[4 * row + (k + 2) % 3]
        values[3 + 3 * row] = matrix[4 * row + 3]
    return values


@wp.func
def derive_edge_planes(corners: Corners):
    """The triangle's plane, and for each vertex the plane through the edge opposite, upright on the triangle."""
    a = wp.vec3d(corners.a)
    b = wp.vec3d(corners.b)
    c = wp.vec3d(corners.c)
    normal = cross(b - a, c - a)
    square = dot(normal, normal)
    planes = wp.matrix_from_rows(cross(normal, c - b), cross(normal, a - c), cross(normal, b - a)) / square
    values = EdgePlanes()
    for axis in range(3):
        values[axis] = float(normal[axis] / wp.sqrt(square))
        for vertex in range(3):
            values[4 + 4 * vertex + axis] = float(planes[vertex, axis])
    values[3] = float(dot(normal, a) / wp.sqrt(square))
    values[7] = float(dot(planes[0], b))
    values[11] = float(dot(planes[1], c))
    values[15] = float(dot(planes[2], a))
    return values


@wp.func
def derive_box_sphere(corners: Corners):
    """Centre and squared radius of the sphere around the triangle's box, wide enough for the rounding of its centre."""
    low = corners_low(corners)
    high = corners_high(corners)
    centre = 0.5 * low + 0.5 * high
    reach = bounds.largest(low) + bounds.largest(high)
    radius = wp.length(high - centre) + 2.0 * bounds.ROUNDINGS * reach
    return Sphere(centre[0], centre[1], centre[2], radius * radius)


MATRIX = Part(tuple(f"m{row}{column}" for row in range(4) for column in range(4)), derive_matrix)
ROWS = Part(("ux", "uy", "uz", "vx", "vy", "vz"), derive_rows)
FREE_MATRIX = Part(tuple(f"m{row}{column}" for row in range(3) for column in range(4)), derive_free_matrix)
FREE_COLUMNS = Part(("axis", "up", "uq", "u0", "vp", "vq", "v0", "zp", "zq", "z0"), derive_free_columns)
EDGE_PLANES = Part(
    ("nx", "ny", "nz", "n0", *(f"{plane}{c}" for plane in ("e", "f", "g") for c in ("x", "y", "z", "0"))), derive_edge_planes
)
BOX_SPHERE = Part(CIRCLE.names, derive_box_sphere)


def transformed(u: str, v: str) -> tuple[StepText, ...]:
    """The two steps of a point in the unit triangle, from C++ that declares u, and then v."""
    (u_exit, _, u_passes), (v_exit, _, v_passes) = STEPS
    return (u_exit, u, u_passes), (v_exit, v, f"{v_passes} & ({FINITE})")


def turned_by(row: int, vector: str) -> str:
    """C++ expression: a row of a matrix times a vector, without the matrix's last column."""
    return f"((m{row}0 * {vector}x + m{row}1 * {vector}y) + m{row}2 * {vector}z)"


def row_of(row: int, point: str = "p") -> str:
    """C++ expression: a row of a matrix times a point."""
    return f"{turned_by(row, point)} + m{row}3"


TURNED = transformed(STEPS[0][1], STEPS[1][1])

WAYS: dict[str, tuple[Part, tuple[StepText, ...]]] = {
    "utm_matrix": (
        MATRIX,
        transformed(
            f"const float w = {row_of(3)}, x = {row_of(0)}, y = {row_of(1)}, u = w == 1.0f ? x : x / w;",
            "const float v = w == 1.0f ? y : y / w;",
        ),
    ),
    "utm_rows": (
        ROWS,
        transformed("const float u = (ux * px + uy * py) + uz * pz;", "const float v = (vx * px + vy * py) + vz * pz;"),
    ),
    "utm_free_matrix": (FREE_MATRIX, transformed(f"const float u = {row_of(0)};", f"const float v = {row_of(1)};")),
    "utm_free_columns": (FREE_COLUMNS, TURNED),
    "utm_free_rows": (UNIT_TRIANGLE, TURNED),
}
"""What each way to make the transform keeps of a triangle, and its steps after the plane."""

TO_CENTRE = f"""
    {minus("l", "m", "o")}
    const float ll = {dotted("l", "l")}, dd = {dotted("d", "d")}, ld = {dotted("l", "d")};
    const float widened = radius2 + {CANCELLATION}f * ll;
"""

PROJECTED = (
    "beside the bounding sphere or in front of it",
    TO_CENTRE + "const float s2 = ld * ld / dd;",
    "(ll - s2 <= widened) & ((ld >= 0.0f) | (ll <= widened))",
)

PARAMETRIC = (
    "beside the bounding sphere, in front of it or behind a hit",
    TO_CENTRE + "const float square = ld * ld - dd * (ll - widened), root = sqrtf(square > 0.0f ? square : 0.0f);",
    "(square >= 0.0f) & (ld + root >= 0.0f) & (ld - root <= far * dd)",
)

AFTER_NEAR, BEFORE_FAR = "(t > 0.0f)", "(t < far)"


def after_plane(*steps: StepText) -> tuple[StepText, ...]:
    """Steps of a point, with the point computed before the first."""
    (exit_, code, passes), *others = steps
    return (exit_, POINT + code, passes), *others


def compared(before: str, after: str) -> tuple[StepText, ...]:
    """The unit triangle's steps with comparisons of t right after the plane, and after all else."""
    plane = [("out of the ray's range", "", before)] if before else []
    first, (exit_, code, passes) = TURNED
    return after_plane(*plane, first, (exit_, code, f"({passes}) & ({after})" if after else passes))


def form(name: str, parts: tuple[Part, ...], *steps: StepText) -> TestForm:
    """A form whose record has these parts; its rays have an end if a step compares with it."""
    return ray_form(name, join(parts), tuple(part_name for part in parts for part_name in part.names), *steps)


def edge_planes() -> TestForm:
    """Amanatides and Choi's first test."""
    weights = "".join(
        f"const float {plane} = (det * ({dotted(plane, 'o')} - {plane}0) + num * {dotted(plane, 'd')});\n" for plane in "efg"
    )
    inside = (
        "outside an edge's plane",
        f"const float det = {dotted('n', 'd')}, num = n0 - {dotted('n', 'o')};\n{weights}",
        "((e >= 0.0f) & (f >= 0.0f) & (g >= 0.0f)) & (det > 0.0f) | ((e <= 0.0f) & (f <= 0.0f) & (g <= 0.0f)) & (det < 0.0f)",
    )
    hit = ("no distance", "const float t = num / det, u = f / det, v = g / det;", FINITE)
    return form("edge_planes", (EDGE_PLANES,), inside, hit)


def unit_ray() -> TestForm:
    """Schmittler et al.'s test."""
    height = f"const float t = (0.0f - ({row_of(2, 'o')})) / {turned_by(2, 'd')};\n"
    weights = f"const float u = ({row_of(0, 'o')}) + t * {turned_by(0, 'd')}, v = ({row_of(1, 'o')}) + t * {turned_by(1, 'd')};"
    return form("unit_ray", (FREE_MATRIX,), ("outside the unit triangle", height + weights, f"{INSIDE} & ({FINITE})"))


BASE = (PLANE, UNIT_TRIANGLE)
UNIT = after_plane(*TURNED)

STUDIED: dict[str, TestForm] = {
    found.name: found
    for found in (
        *(form(name, (PLANE, part), *after_plane(*steps)) for name, (part, steps) in WAYS.items()),
        form("sphere_cross", (*BASE, CIRCLE), SPHERE_STEP, *UNIT),
        form("sphere_projection", (*BASE, CIRCLE), PROJECTED, *UNIT),
        form("sphere_parametric", (*BASE, CIRCLE), PARAMETRIC, *UNIT),
        form("box_sphere", (*BASE, BOX_SPHERE), SPHERE_STEP, *UNIT),
        form("range_first", BASE, *compared(f"{AFTER_NEAR} & {BEFORE_FAR}", "")),
        form("range_delayed", BASE, *compared(AFTER_NEAR, BEFORE_FAR)),
        form("range_last", BASE, *compared("", f"{AFTER_NEAR} & {BEFORE_FAR}")),
        edge_planes(),
    )
}
"""By the names above."""

UNIT_RAY = unit_ray()
"""The ray in the unit triangle's space, a test that the thesis names and did not try."""

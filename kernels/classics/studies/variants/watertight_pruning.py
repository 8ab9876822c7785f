"""Pruning that leaks nothing: Ferko and Ferko's comparisons, widened by a bound of all rounding, before the watertight test.

**Problem.** The prunings of `wrt.kernels.classics.triangle.ferko` leak at edges and vertices: each triangle maps a shared edge
by its own similarity, with its own rounding. Pichler 2018 leaves the matter open (7.2).

**Idea.** A comparison needs only be safe: it may keep what misses, never cut off what hits. So each bound is widened by e, and
the watertight test (`wrt.kernels.triangle.watertight.woop`) decides on what is kept. Hits are those of that test, bit by bit.

**Bound.** u = 2^-24. The ray is o + s d, its direction divided by the component along its main axis, as the watertight test
divides it. All norms are maximum norms, so |d| = 1. V is the largest coordinate of the vertices, K = |o| + V, L the longest
edge. The plane is n . p = h with |n| = 1. The record is rounded once from float64, whose own errors stay below u / 100 if the
triangle's height is at least `MIN_HEIGHT` of the longest edge.

1.  *What the watertight test calls a hit.* A sheared vertex has an error of at most 5 u K: two differences and a product
    round by u K each, and a difference of up to 2 K by 2 u K. The signs of the areas are exact for the vertices as computed,
    so 0 is a mean of these. The same mean of the true vertices is a point p of the triangle. So the line has a point
    l = o + s d with |l - p| <= 5 u K, and l - p is 0 along the main axis. Hence |s| <= K.
2.  *The point in the plane.* N = n . d is computed with an error of at most 12 u: three products, two sums, the rounding of n.
    The numerator h - n . o has 15 u K, and (h - n . o) - s N = n . (p - l) is at most 10 u K. So the computed t differs from
    s by at most (12 + 15 + 10) u K / |N| + u K <= 40.4 u K / |N|, as |N| <= 3, with N as computed. Rounding t d and o + t d
    adds u (|o| + 2 |t|) <= 3 u K. The computed point is at most 40.4 u K / |N| + 8 u K <= 64.5 u K / |N| from p.
3.  *Its coordinates.* A row of the similarity has the length 1 / L, and the magnitudes of its components sum to at most
    sqrt(3) / L. The coordinates of the two points differ by at most sqrt(3) / L * 64.5 u K / |N|, and rounding adds
    sqrt(3) / L * 7 u K. Together eta = 150 u K / (L |N|).
4.  *Comparisons.* They hold for the coordinates of p. Those to the left and to the right change by at most 1.87 eta, as the
    third vertex has |x| <= 1 and 0 < y <= 0.87, and round by at most 6 u. As K / (L |N|) >= 1 / (2 sqrt(3) 3), that is at
    most 63 u K / (L |N|).

So a comparison of a hit is beyond its bound by at most (1.87 * 150 + 63) u K / (L |N|) = 344 u K / (L |N|), and e = 352 u K /
(L |N|) covers terms in u^2 and its own rounding. Where e is 2 or more, nothing is cut off. Elsewhere K < 2^18 L, so that
nothing overflows, and what underflows does not matter, as L is between `MIN_EDGE` and `MAX_EDGE`. Triangles beyond these
limits, and those without area, have no finite e. A NaN fails no comparison, and misses later.

**Limits.** e grows with the distance from the scene's centre in lengths of the triangle, and towards grazing rays. Where it is
large, pruning costs time and cuts off nothing.

References: pichler-2018; woop-2013.
"""

from dataclasses import replace

import warp as wp

from wrt.kernels.classics.triangle.ferko.record_part import Part, join
from wrt.kernels.classics.triangle.ferko.similarity import IN_PLANE, SIMILARITY, similarity
from wrt.kernels.classics.triangle.ferko.triangle_bounds import largest_of
from wrt.kernels.classics.triangle.ferko.variant import PLANE
from wrt.kernels.classics.triangle.published import in_steps, same_signs
from wrt.kernels.triangle.support.axis_projection import permuted_lanes
from wrt.kernels.triangle.support.lane_form import ORIGIN, LaneForm, RayValue
from wrt.kernels.triangle.support.record_blocks import VERTICES, Corners
from wrt.kernels.triangle.support.triangle_contract import TestForm
from wrt.kernels.triangle.support.vectors import dotted, largest
from wrt.kernels.triangle.watertight.woop_areas import THIN

ROUNDINGS = wp.constant(352.0 * 2.0**-24)
"""e, but for K / (L |N|)."""

MIN_HEIGHT = wp.constant(wp.float64(2.0**-18))
"""Height over the longest edge, from which on float64 computes the triangle's frame to u / 100."""

MIN_EDGE = wp.constant(wp.float64(2.0**-60))
MAX_EDGE = wp.constant(wp.float64(2.0**60))
"""Longest edges of triangles that are pruned."""

Margin = wp.types.vector(length=2, dtype=wp.float32)


@wp.func
def derive_margin(corners: Corners):
    """V, and e L |N| / K / L; infinite for a triangle that is not to be pruned."""
    frame = similarity(corners)
    edge = wp.length(frame.edge)
    fits = frame.y >= MIN_HEIGHT and edge >= MIN_EDGE and edge <= MAX_EDGE
    far = wp.max(largest(wp.vec3d(corners.a)), wp.max(largest(wp.vec3d(corners.b)), largest(wp.vec3d(corners.c))))
    return Margin(float(far), wp.where(fits, float(wp.float64(ROUNDINGS) / edge), wp.inf))


MARGIN = Part(("reach", "spread"), derive_margin)


@wp.struct
class LevelRay:
    """A ray whose direction is divided by its component along the main axis."""

    origin: wp.vec3
    direction: wp.vec3
    axis: float
    """Number of the main axis."""
    inverse: float
    """1 / the component along it."""


@wp.func
def prepare(origin: wp.vec3, direction: wp.vec3):
    """The ray; the main axis and the quotients are those of the watertight test."""
    size = wp.abs(direction)
    axis = wp.where(size[0] >= size[1], wp.where(size[0] >= size[2], 0, 2), wp.where(size[1] >= size[2], 1, 2))
    major = wp.where(axis == 0, direction[0], wp.where(axis == 1, direction[1], direction[2]))
    ray = LevelRay()
    ray.origin = origin
    ray.direction = wp.vec3(direction[0] / major, direction[1] / major, direction[2] / major)
    ray.axis = float(axis)
    ray.inverse = 1.0 / major
    return ray


RAY = (
    *ORIGIN,
    *(RayValue(f"d{axis}", f"ray.direction.c[{i}]", f"{axis} / major_k") for i, axis in enumerate("xyz")),
    RayValue("axis", "ray.axis", "main_x ? 0.0f : main_y ? 1.0f : 2.0f"),
    RayValue("inverse", "ray.inverse", "1.0f / major_k"),
)
SETUP = "        const float major_k = main_x ? x : main_y ? y : z;\n"


def cut_off(condition: str) -> str:
    """C++: whether a point is kept. A NaN is."""
    return f"!((widening < 2.0f) & ({condition}))"


PRUNING = (
    (
        "below the longest edge",
        f"""
            const float along = {dotted("n", "d")}, at = (n0 - {dotted("n", "o")}) / along;
            const float px = ox + at * dx, py = oy + at * dy, pz = oz + at * dz;
            {IN_PLANE}{largest_of("max_o", "o")}
            const float widening = (spread * (max_o + reach)) / WRT_ABS(along);
        """,
        cut_off("qy < -widening"),
    ),
    ("left of the triangle", "", cut_off("qy * apex_x - qx * apex_y > widening")),
    ("right of it", "", cut_off("apex_y * (qx - 1.0f) + qy * (1.0f - apex_x) > widening")),
)
"""Three comparisons, in the order that has the fewest (`wrt.kernels.classics.triangle.ferko.pruning`)."""

SHEARED = "".join(
    f"const float z{i} = {v}k - ok, x{i} = ({v}p - op) - dp * z{i}, y{i} = ({v}q - oq) - dq * z{i};\n"
    for i, v in enumerate("abc", start=1)
)

WATERTIGHT = (
    (
        "beside the triangle",
        f"""
            {"".join(permuted_lanes(vector) for vector in "odabc")}{SHEARED}
            const float near_a = x3 * y2 - y3 * x2, near_b = x1 * y3 - y1 * x3, near_c = x2 * y1 - y2 * x1;
            const float fine_a = (float)((double)x3 * y2 - (double)y3 * x2);
            const float fine_b = (float)((double)x1 * y3 - (double)y1 * x3);
            const float fine_c = (float)((double)x2 * y1 - (double)y2 * x1);
            const bool on_edge = (near_a == 0.0f) | (near_b == 0.0f) | (near_c == 0.0f);
            const float wa = on_edge ? fine_a : near_a, wb = on_edge ? fine_b : near_b, wc = on_edge ? fine_c : near_c;
            const float size = (WRT_ABS(x3 * y2) + WRT_ABS(x1 * y3)) + WRT_ABS(x2 * y1);
        """,
        f"({same_signs('wa', 'wb', 'wc')}) & ((wa + wb) + wc != 0.0f)",
    ),
    (
        "without weights",
        f"""
            const bool thin = WRT_ABS((wa + wb) + wc) < {float(THIN)!r}f * size;
            const bool precise = thin & ((fine_a + fine_b) + fine_c != 0.0f);
            const float a = precise ? fine_a : wa, b = precise ? fine_b : wb, c = precise ? fine_c : wc;
            const float scale = 1.0f / ((a + b) + c);
            const float t = inverse * (((a * z1 + b * z2) + c * z3) * scale), u = b * scale, v = c * scale;
        """,
        "t == t",
    ),
)
"""The watertight test as steps, with all areas in float64 too, as lanes cannot branch."""

PRUNED = TestForm(
    name="watertight_prune3",
    record=join((PLANE, SIMILARITY, MARGIN)),
    ray_state=LevelRay,
    prepare=prepare,
    lanes=LaneForm(
        ray=RAY,
        packet_setup=SETUP,
        triangle=(*PLANE.names, *SIMILARITY.names, *MARGIN.names),
        steps=in_steps(*PRUNING, *WATERTIGHT),
    ),
)
"""Three comparisons, then the watertight test."""

UNPRUNED = replace(
    PRUNED, name="watertight_steps", record=VERTICES, lanes=LaneForm(RAY, in_steps(*WATERTIGHT), packet_setup=SETUP)
)
"""The same without comparisons."""

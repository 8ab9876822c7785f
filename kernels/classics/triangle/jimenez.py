"""Jimenez, Segura and Feito 2010: distances of both ends from the plane first, then weights by one cross product, no division.

**Problem.** Segura and Feito's test (`wrt.kernels.classics.triangle.segura_feito`) computes a volume for each edge, and a
triangle whose plane both ends of the segment are far from could be told without.

**Idea.** Measure everything from one vertex. Let w and s be the heights of the segment's ends above the plane. If both have the
same sign, there is no hit. Otherwise w - s is positive from the side that w is on, and one cross product, of the first end and
the direction, gives the weights of the two other vertices times w - s. All comparisons are by signs; only a hit divides. A
weight of zero tells at no cost that the hit lies on an edge.

**Steps.**

1. N = (b - a) x (c - a), the first end s = O - a, and w - s, which is -N . D here; its sign tells the side.
2. The cross product s x D, times c - a and a - b: the weights of b and c, times w - s.
3. Exit: one is negative, or their sum exceeds w - s.
4. t, u and v are divided by w - s.

**Cost.** 48 operations up to the exit, 11 more for a hit.

**Data.** The three vertices.

**Departures.** A test here decides about the ray's whole line, so of the two heights their difference remains, which is the
direction's product with the normal; the traversal compares t. The paper's second case, an end that lies in the plane, needs no
code of its own then. A triangle seen from behind is the mirror image: all numbers are multiplied by the sign of the
difference. The values that the paper shares among neighbours in a mesh are not shared: lanes hold triangles in any order. The
thesis that names the test (Pichler 2018, section 3.1) gives its outline; the formulas here are derived from that.

**Limits.** Edges are factors of the products, so neighbours round differently: the test is not watertight. A triangle whose
plane contains the ray is missed.

References: jimenez-2010; pichler-2018.
"""

import warp as wp

from wrt.kernels.classics.triangle.published import FINITE, published
from wrt.kernels.triangle.support.record_blocks import Corners
from wrt.kernels.triangle.support.vectors import PlainRay, cross, crossed, dot, dotted, minus, miss


@wp.func
def intersect(ray: PlainRay, corners: Corners):
    """One ray, one triangle: (t, u, v); t is NaN if the ray's line misses. u and v weigh the vertices b and c."""
    edge_b = corners.b - corners.a
    edge_c = corners.c - corners.a
    normal = cross(edge_b, edge_c)
    first = ray.origin - corners.a
    falls = 0.0 - dot(normal, ray.direction)
    side = wp.where(falls < 0.0, -1.0, 1.0)
    across = cross(first, ray.direction)
    of_b = side * dot(across, edge_c)
    of_c = side * (0.0 - dot(across, edge_b))
    total = side * falls
    if not (of_b >= 0.0 and of_c >= 0.0 and of_b + of_c <= total):
        return miss()
    scale = 1.0 / total
    t = (side * dot(normal, first)) * scale
    if t - t != 0.0:
        return miss()
    return wp.vec3(t, of_b * scale, of_c * scale)


TEST = published(
    "jimenez",
    intersect,
    (
        "the line passes beside the triangle",
        f"""
            {minus("e1", "b", "a")}{minus("e2", "c", "a")}{crossed("n", "e1", "e2")}{minus("s", "o", "a")}
            const float falls = 0.0f - {dotted("n", "d")}, side = falls < 0.0f ? -1.0f : 1.0f;
            {crossed("g", "s", "d")}
            const float of_b = side * {dotted("g", "e2")}, of_c = side * (0.0f - {dotted("g", "e1")}), total = side * falls;
        """,
        "(of_b >= 0.0f) & (of_c >= 0.0f) & (of_b + of_c <= total)",
    ),
    (
        "the plane contains the line",
        f"""
            const float scale = 1.0f / total, t = (side * {dotted("n", "s")}) * scale;
            const float u = of_b * scale, v = of_c * scale;
        """,
        FINITE,
    ),
)

"""Segura and Feito 2001: the signs of three volumes, one after the other.

**Problem.** Many queries only need to know which triangles a line meets. The point is needed for few of them, and a division
rounds.

**Idea.** Treat the line as a segment and view the triangle from the end from which its vertices run counterclockwise. The
tetrahedra that segment and edges span all have positive volumes if the line passes inside. The first negative volume ends the
test. There is no division. The point of a hit is computed on demand.

**Steps.**

1. N = (b - a) x (c - a); the sign of N . D tells the end from which the vertices run counterclockwise.
2. The volume of the line and the edge a b: (D x (a - O)) . (b - a). Exit: it is negative.
3. That of c a, by the same cross product. Exit: it is negative.
4. That of b c: (D x (b - O)) . (c - b). Exit: it is negative.
5. t = N . (a - O) / N . D; u and v are two volumes over the sum of all.

**Cost.** 38 operations up to the first exit, 47 up to the second, 68 up to the third, 12 more for a hit.

**Data.** The three vertices.

**Departures.** The end of the segment lies beyond any triangle, because here the whole line counts. The sign of direction .
normal, not the position of the origin, decides which end sees the triangle counterclockwise. Volumes are taken relative to the
ray's origin, with edges as factors, so that they do not cancel far away. Both volumes at vertex a share a cross product. t, u
and v are always computed, in the last step.

**Limits.** The volume at an edge starts from a different vertex than in the neighbour and rounds differently. Unlike Pluecker's
form of the same signs it is not exactly antisymmetric, so rays may pass along edges. Each exit costs a branch over all lanes,
which all lanes seldom take together; a single step is faster (notebooks/records/2026-11-21-triangle-tests.md).

References: segura-feito-2001; segura-feito-1998.
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
    along = dot(normal, ray.direction)
    side = wp.where(along < 0.0, -1.0, 1.0)
    s = corners.a - ray.origin
    at_a = cross(ray.direction, s)
    volume_c = side * dot(at_a, edge_b)
    if not volume_c >= 0.0:
        return miss()
    volume_b = side * dot(at_a, corners.a - corners.c)
    if not volume_b >= 0.0:
        return miss()
    volume_a = side * dot(cross(ray.direction, corners.b - ray.origin), corners.c - corners.b)
    if not volume_a >= 0.0:
        return miss()
    total = (volume_a + volume_b) + volume_c
    scale = 1.0 / total
    t = dot(normal, s) / along
    if t - t != 0.0 or total == 0.0:
        return miss()
    return wp.vec3(t, volume_b * scale, volume_c * scale)


TEST = published(
    "segura_feito",
    intersect,
    (
        "the volume with the edge from a to b is negative",
        f"""
            {minus("e1", "b", "a")}{minus("e2", "c", "a")}{crossed("n", "e1", "e2")}{minus("s", "a", "o")}
            {crossed("m", "d", "s")}
            const float along = {dotted("n", "d")}, side = along < 0.0f ? -1.0f : 1.0f;
            const float volume_c = side * {dotted("m", "e1")};
        """,
        "volume_c >= 0.0f",
    ),
    (
        "the volume with the edge from c to a is negative",
        f"{minus('eb', 'a', 'c')}const float volume_b = side * {dotted('m', 'eb')};",
        "volume_b >= 0.0f",
    ),
    (
        "the volume with the edge from b to c is negative",
        f"""
            {minus("q", "b", "o")}{minus("ea", "c", "b")}{crossed("l", "d", "q")}
            const float volume_a = side * {dotted("l", "ea")};
        """,
        "volume_a >= 0.0f",
    ),
    (
        "the line lies in the triangle's plane",
        f"""
            const float t = {dotted("n", "s")} / along, total = (volume_a + volume_b) + volume_c;
            const float scale = 1.0f / total, u = volume_b * scale, v = volume_c * scale;
        """,
        f"({FINITE}) & (total != 0.0f)",
    ),
)

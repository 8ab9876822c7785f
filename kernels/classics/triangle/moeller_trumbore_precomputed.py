"""Moeller and Trumbore's test with precomputed edges and normal, as improved by Komatsu et al. 2008.

**Problem.** The plain test (`wrt.kernels.triangle.moeller_trumbore`) computes the edges and two cross products for every ray.

**Idea.** By the rules of scalar triple products, Cramer's determinants become, with S from the origin to the triangle and
G = S x D: u = G . (c - a), v = G . (a - b), t = N . S, each over N . D. The edges and their normal N are properties of the
triangle; one cross product per test remains.

**Steps.**

1. Once per triangle: a, E1 = a - b, E2 = c - a, and N.
2. S = a - O, G = S x D, and 1 / (N . D).
3. u, v and t by three dot products; then u >= 0, v >= 0, u + v <= 1.

**Cost.** 38 operations, of the plain test's 53.

**Data.** A vertex, two edges and the normal: 48 bytes, a third more than the vertices alone. The normal is computed in float64
and then rounded.

**Departures.** The paper rejects N . D >= 0: such a triangle faces away. Here both sides are hit, so the quotients are computed
before they are compared. The paper's three further exits and t form one step: lanes seldom all leave at the same exit.

**Limits.** Like the plain test it is not watertight: u + v <= 1 rounds differently from the same edge in the neighbour.

References: komatsu-2008 (Section 2.2); moeller-trumbore-1997.
"""

import warp as wp

from wrt.kernels.classics.triangle.published import FINITE, INSIDE, published
from wrt.kernels.triangle.support.record_blocks import Corners, Record
from wrt.kernels.triangle.support.vectors import PlainRay, cross, crossed, dot, dotted, minus, miss, names, three

Edges = wp.types.vector(length=12, dtype=wp.float32)
"""Vertex a, edges a - b and c - a, and the normal (b - a) x (c - a)."""


@wp.func
def derive(corners: Corners, origin: wp.vec3):
    """Vertex, edges and normal of a triangle."""
    edge_b = corners.a - corners.b
    edge_c = corners.c - corners.a
    normal = cross(wp.vec3d(corners.b) - wp.vec3d(corners.a), wp.vec3d(corners.c) - wp.vec3d(corners.a))
    edges = Edges()
    for axis in range(3):
        edges[axis] = corners.a[axis]
        edges[3 + axis] = edge_b[axis]
        edges[6 + axis] = edge_c[axis]
        edges[9 + axis] = float(normal[axis])
    return edges


@wp.func
def intersect(ray: PlainRay, edges: Edges):
    """One ray, one triangle: (t, u, v); t is NaN if the ray's line misses. u and v weigh the vertices b and c."""
    normal = three(edges, 9)
    s = three(edges, 0) - ray.origin
    g = cross(s, ray.direction)
    scale = 1.0 / dot(normal, ray.direction)
    u = dot(g, three(edges, 6)) * scale
    v = dot(g, three(edges, 3)) * scale
    t = dot(normal, s) * scale
    if u >= 0.0 and v >= 0.0 and u + v <= 1.0 and t - t == 0.0:
        return wp.vec3(t, u, v)
    return miss()


TEST = published(
    "moeller_trumbore_precomputed",
    intersect,
    (
        "the line passes beside the triangle",
        f"""
            {minus("s", "p", "o")}
            {crossed("g", "s", "d")}
            const float scale = 1.0f / {dotted("n", "d")};
            const float u = {dotted("g", "e2")} * scale, v = {dotted("g", "e1")} * scale, t = {dotted("n", "s")} * scale;
        """,
        f"{INSIDE} & ({FINITE})",
    ),
    record=Record(12, derive),
    names=(*names("p"), *names("e1"), *names("e2"), *names("n")),
)

"""Pluecker test: on which side of each edge's line does the ray's line pass?

**Problem.** A test by barycentric coordinates evaluates an edge as u >= 0 in one triangle and as u + v <= 1 in its neighbour.
The two round differently, and a ray may pass between them.

**Idea.** In Pluecker coordinates the sign of the inner product of two directed lines is the sense in which they turn about each
other. A line meets a triangle if it turns about all three edges in the same sense. The other triangle directs the edge the
other way, which negates the product exactly if it is computed symmetrically. So no ray passes along an edge.

**Steps.**

1. Move the origin to 0: a, b, c are relative to it.
2. alpha, beta, gamma = D . ((p + q) x (q - p)) for the edges b c, c a and a b. Exit: their signs differ.
3. N = (b - a) x (c - a), t = N . a / N . D; u and v are beta and gamma over alpha + beta + gamma.

**Cost.** 69 operations up to the exit, 32 more for a hit.

**Data.** The three vertices. Nothing is precomputed; for rays with a common origin see `wrt.kernels.classics.triangle.benthin`.

**Departures.**

* The origin is moved to 0, where the ray's moment vanishes. The inner product with the edge from p to q is then D . (p x q),
  the volume that ray and edge span. The moments of lines far from 0 would cancel.
* p x q itself cancels for a short, distant edge. It is half of (p + q) x (q - p), which does not cancel and is antisymmetric
  too. (Davidovic et al. write the edge functions of rasterisation in this form.)
* Signs are compared before the distance, as Benthin recommends. Rahikainen 2013 remarks that Komatsu et al. measured the
  Pluecker test with the distance first.
* The weights of the vertices are the three numbers over their sum; the test itself does not provide them.

**Limits.** The edges at a vertex round independently, so the test is not `watertight`.

References: shoemake-1998; amanatides-choi-1997; benthin-2006; davidovic-2012; rahikainen-2013.
"""

import warp as wp

from wrt.kernels.classics.triangle.published import FINITE, published, same_sign, same_signs
from wrt.kernels.triangle.support.record_blocks import Corners
from wrt.kernels.triangle.support.vectors import PlainRay, cross, crossed, dot, dotted, minus, miss, plus


@wp.func
def around(direction: wp.vec3, p: wp.vec3, q: wp.vec3):
    """Twice the inner product of a line through 0 with the line from p to q."""
    return dot(direction, cross(p + q, q - p))


@wp.func
def intersect(ray: PlainRay, corners: Corners):
    """One ray, one triangle: (t, u, v); t is NaN if the ray's line misses. u and v weigh the vertices b and c."""
    a = corners.a - ray.origin
    b = corners.b - ray.origin
    c = corners.c - ray.origin
    alpha = around(ray.direction, b, c)
    beta = around(ray.direction, c, a)
    gamma = around(ray.direction, a, b)
    if not same_sign(alpha, beta, gamma):
        return miss()
    normal = cross(b - a, c - a)
    t = dot(normal, a) / dot(normal, ray.direction)
    total = (alpha + beta) + gamma
    scale = 1.0 / total
    if t - t != 0.0 or total == 0.0:
        return miss()
    return wp.vec3(t, beta * scale, gamma * scale)


TEST = published(
    "pluecker",
    intersect,
    (
        "the line does not turn the same way about all edges",
        f"""
            {minus("p", "a", "o")}{minus("q", "b", "o")}{minus("r", "c", "o")}
            {plus("sa", "q", "r")}{minus("ea", "r", "q")}{crossed("ma", "sa", "ea")}
            {plus("sb", "r", "p")}{minus("eb", "p", "r")}{crossed("mb", "sb", "eb")}
            {plus("sc", "p", "q")}{minus("ec", "q", "p")}{crossed("mc", "sc", "ec")}
            const float alpha = {dotted("d", "ma")}, beta = {dotted("d", "mb")}, gamma = {dotted("d", "mc")};
        """,
        same_signs("alpha", "beta", "gamma"),
    ),
    (
        "the line lies in the triangle's plane",
        f"""
            {minus("e1", "q", "p")}{minus("e2", "r", "p")}{crossed("n", "e1", "e2")}
            const float t = {dotted("n", "p")} / {dotted("n", "d")};
            const float total = (alpha + beta) + gamma, scale = 1.0f / total, u = beta * scale, v = gamma * scale;
        """,
        f"({FINITE}) & (total != 0.0f)",
    ),
)

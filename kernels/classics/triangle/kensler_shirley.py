"""Kensler and Shirley 2006: the form of the volume test with the fewest operations.

**Problem.** Tests in three dimensions (Moeller and Trumbore's, Pluecker's) are ratios of volumes of tetrahedra that ray and
triangle span. A volume can be written in many ways, and the ways share different subexpressions.

**Idea.** Count the operations of all forms without precomputed data. The cheapest form uses two cross products: one is the
triangle's normal, the other that of the ray's direction and the vector from its origin to the triangle. The paper then orders
the code with a genetic algorithm. Today's compilers choose the order, so we implement the form alone.

**Steps.**

1. N = (c - a) x (a - b), and 1 / (N . D).
2. S = (a - O) / (N . D).
3. G = S x D; u = G . (c - a), v = G . (a - b), t = N . S.
4. u >= 0, v >= 0, u + v <= 1.

**Cost.** 53 operations with the sum u + v and the check of t; of 8,748 forms none has fewer.

**Data.** The three vertices.

**Departures.** The form is that of `wrt.kernels.classics.triangle.moeller_trumbore_precomputed`, with edges and normal computed
for every ray. The reciprocal is multiplied into the vector to the triangle at once, which saves two multiplications.

**Limits.** Those of Moeller and Trumbore's test: not watertight, and not accurate at needles.

References: kensler-shirley-2006.
"""

import warp as wp

from wrt.kernels.classics.triangle.published import FINITE, INSIDE, published
from wrt.kernels.triangle.support.record_blocks import Corners
from wrt.kernels.triangle.support.vectors import PlainRay, cross, crossed, dot, dotted, minus, miss


@wp.func
def intersect(ray: PlainRay, corners: Corners):
    """One ray, one triangle: (t, u, v); t is NaN if the ray's line misses. u and v weigh the vertices b and c."""
    from_b = corners.a - corners.b
    edge_c = corners.c - corners.a
    normal = cross(edge_c, from_b)
    scale = 1.0 / dot(normal, ray.direction)
    s = scale * (corners.a - ray.origin)
    g = cross(s, ray.direction)
    u = dot(g, edge_c)
    v = dot(g, from_b)
    t = dot(normal, s)
    if u >= 0.0 and v >= 0.0 and u + v <= 1.0 and t - t == 0.0:
        return wp.vec3(t, u, v)
    return miss()


TEST = published(
    "kensler_shirley",
    intersect,
    (
        "the line passes beside the triangle",
        f"""
            {minus("e1", "a", "b")}{minus("e2", "c", "a")}{crossed("n", "e2", "e1")}{minus("p", "a", "o")}
            const float scale = 1.0f / {dotted("n", "d")};
            const float sx = scale * px, sy = scale * py, sz = scale * pz;
            {crossed("g", "s", "d")}
            const float u = {dotted("g", "e2")}, v = {dotted("g", "e1")}, t = {dotted("n", "s")};
        """,
        f"{INSIDE} & ({FINITE})",
    ),
)
"""One step. A separate exit before t, which is one more product, is slower (notebooks/records/2026-11-21-triangle-tests.md)."""

"""Benthin 2006: the Pluecker test for rays with a common origin.

**Problem.** The inner product of a ray and an edge is a volume, D . (p x q) relative to the ray's origin. The cross product is
most of the work, and it is the same for all rays of a camera or a point light.

**Idea.** Compute the cross product once per triangle and origin. It is the normal of the plane through the edge and the origin.
A ray then costs three dot products, whose signs decide between inside and outside, and a hit costs a fourth, for the distance.

**Steps.**

1. Once per triangle and origin: the normals of the planes through the origin and the edges, b x c, c x a and a x b relative to
   the origin; the triangle's normal N and its height N . a.
2. alpha, beta, gamma = D . (b x c), D . (c x a), D . (a x b). Exit: their signs differ.
3. t = N . a / N . D; u and v are beta and gamma over alpha + beta + gamma. Exit: t is negative or not finite.

**Cost.** 15 operations up to the first exit, 13 more for a hit.

**Data.** The three planes, the triangle's normal and its distance: 52 bytes, computed for the origin of a batch. The layout and
its lifetime are those of `wrt.kernels.classics.triangle.komatsu`. (The thesis computes them for each packet of 4 or more rays.)

**Difference from Komatsu's test.** Our version of Komatsu's test also has a plane for the third edge, so both tests read the
same numbers. Here all three products come first and there is one exit, because Benthin found that most rays leave at the inside
test. The planes are not turned towards the origin: the ray hits if all three signs agree, whichever they are. So a triangle
whose plane contains the origin is visible from both sides, and a test needs three more comparisons.

**Departures.** The weights of the vertices are the three products over their sum; the thesis computes them after the traversal.
The thesis compares the distance with the ray's range. Here the caller does, except that the test rejects hits behind the
origin.

**Limits.** Those of Komatsu's test: it is neither `watertight` at vertices nor `accurate` at tips of needles.

References: benthin-2006.
"""

from dataclasses import replace

import warp as wp

from wrt.kernels.classics.triangle import komatsu
from wrt.kernels.classics.triangle.komatsu import OriginPlanes, ScaledRay, along_plane, seen_from
from wrt.kernels.classics.triangle.published import FINITE, in_steps, same_sign, same_signs
from wrt.kernels.triangle import CLASSIC_TESTS
from wrt.kernels.triangle.support.record_blocks import Corners, Record
from wrt.kernels.triangle.support.vectors import dotted, miss


@wp.func
def derive(corners: Corners, origin: wp.vec3):
    """Planes of a triangle for an origin."""
    return seen_from(corners, origin, False)


@wp.func
def intersect(ray: ScaledRay, planes: OriginPlanes):
    """One ray, one triangle: (t, u, v); t is NaN if the ray misses. u and v weigh the vertices b and c."""
    alpha = along_plane(ray.direction, planes, 0)
    beta = along_plane(ray.direction, planes, 3)
    gamma = along_plane(ray.direction, planes, 6)
    if not same_sign(alpha, beta, gamma):
        return miss()
    total = (alpha + beta) + gamma
    t = (planes[12] / along_plane(ray.direction, planes, 9)) / ray.power
    if not (t >= 0.0 and total != 0.0 and t - t == 0.0):
        return miss()
    scale = 1.0 / total
    return wp.vec3(t, beta * scale, gamma * scale)


TEST = replace(
    komatsu.TEST,
    name="benthin",
    paper=CLASSIC_TESTS["benthin"].paper,
    record=Record(13, derive, per_origin=True),
    intersect=intersect,
    lanes=replace(
        komatsu.EXITS,
        steps=in_steps(
            (
                "beyond the plane of an edge",
                f"const float alpha = {dotted('d', 'ea')}, beta = {dotted('d', 'eb')}, gamma = {dotted('d', 'ec')};",
                same_signs("alpha", "beta", "gamma"),
            ),
            ("the triangle lies behind the origin", komatsu.HIT, f"(t >= 0.0f) & (total != 0.0f) & ({FINITE})"),
        ),
    ),
)

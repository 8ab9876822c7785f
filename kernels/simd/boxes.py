"""Rays against axis-aligned boxes, and the rule by which every engine gives the same hits.

The test is the slab test of Kay and Kajiya in the form of Williams et al.: the ray enters the box at the latest of the three
near planes and leaves it at the earliest of the three far planes. Infinite reciprocals handle axis-parallel rays. The one
undefined case, 0 * inf for an origin in the plane of a face, yields NaN. Every comparison here is written so that a NaN leaves
the interval unchanged: the ray counts as touching the face.

**Conservative boxes.** Rounding in a triangle test (above all in Woop's shear) moves the surface by a few units in the last
place of the distance to the *farthest* vertex of a triangle, not of the distance to the hit. A box test that only absorbs its
own rounding (Ize 2013 scales the exit by 1 + 2 gamma(3)) can therefore lose a hit on a long triangle. Boxes are widened by a
slack proportional to the reach of the ray, the largest distance along an axis from its origin to the scene's bounds: `slack =
2^-20 reach`. The widening costs nothing per box: near planes are measured from an origin moved forward by the slack, far planes
from an origin moved backward (`RaySlabs`).

**Proof** that the slack is enough for the box test itself, along one axis.

    u       2^-24, the greatest relative error of a rounding
    R       reach of the ray; |o| <= R, as the scene's box has its centre at 0
    o, d    origin and direction, given in float32
    x       plane - o, |x| <= R; t = x / |d| is where the ray meets the plane, here in front of it (behind it: mirrored)
    s       slack = 16 u R, a power of two times R

    in = fl(o + s)              |in - (o + s)| <= u (R + s)                          1 u R
    plane - in                  <= x - s, rounded by u R                             1 u R
    1 / d                       relative error u, of a number up to x                1 u R
    product                     relative error u, of a number up to x                1 u R
    entry |d|                   <= x - 16 u R + 4 u R, and terms in u^2 of less than 2^-18 u R

So the entry is earlier than t by at least 11.9 u R / |d|, the exit later by as much. As |t d| <= R, that is more than any
rounding of t: the interval contains fl(t). Where numbers are subnormal, sums are exact, and the product is rounded as t is. Of
the slack, 12 of 16 roundings are left for the triangle test. Searched by `slab` of tests/bounds.

**The consistency rule.** A candidate t of a triangle test is a hit only if the ray meets the triangle's own widened box, and t
is clamped to the interval in which it does (`clamp_to_box`). Rounding is monotone, so the computed entry of any box or cell
that contains the triangle's box is never later than this t. A traversal that skips a node only if its entry lies beyond the
best hit so far therefore finds exactly the hits of brute force: the same t to the bit and the same primitive.

References: kay-kajiya-1986; williams-2005; ize-2013.
"""

import warp as wp

SLACK = wp.constant(2.0**-20)
"""Widening of boxes as a fraction of the ray's reach: 16 roundings of half a unit in the last place."""

INFINITY = wp.constant(float("inf"))


@wp.struct
class RaySlabs:
    """The numbers that a box test needs of a ray; see the module docstring."""

    inverse: wp.vec3
    """1 / direction, with signed infinities."""
    origin_in: wp.vec3
    """Origin for near planes: moved along the direction by the slack."""
    origin_out: wp.vec3
    """Origin for far planes: moved against the direction by the slack."""


@wp.struct
class BoxRay:
    """A ray as boxes see it, from t_min on."""

    slabs: RaySlabs
    t_min: float


@wp.func
def min_of(a: wp.vec3, b: wp.vec3):
    """Componentwise minimum of numbers that are not NaN; cheaper than `wp.min`, which also handles NaN."""
    return wp.vec3(wp.where(a[0] < b[0], a[0], b[0]), wp.where(a[1] < b[1], a[1], b[1]), wp.where(a[2] < b[2], a[2], b[2]))


@wp.func
def max_of(a: wp.vec3, b: wp.vec3):
    """Componentwise maximum of numbers that are not NaN."""
    return wp.vec3(wp.where(a[0] > b[0], a[0], b[0]), wp.where(a[1] > b[1], a[1], b[1]), wp.where(a[2] > b[2], a[2], b[2]))


@wp.func
def reach(origin: wp.vec3, low: wp.vec3, high: wp.vec3):
    """Largest distance along an axis from `origin` to a corner of the box."""
    far = max_of(wp.abs(low - origin), wp.abs(high - origin))
    return wp.max(far[0], wp.max(far[1], far[2]))


@wp.func
def ray_slabs(origin: wp.vec3, direction: wp.vec3, distance: float):
    """Prepares a ray for box tests; `distance` is the reach of the ray in the scene."""
    slack = SLACK * distance
    slabs = RaySlabs()
    slabs.inverse = wp.vec3(1.0 / direction[0], 1.0 / direction[1], 1.0 / direction[2])
    for axis in range(3):
        step = wp.where(slabs.inverse[axis] < 0.0, -slack, slack)
        slabs.origin_in[axis] = origin[axis] + step
        slabs.origin_out[axis] = origin[axis] - step
    return slabs


@wp.func
def slab_interval(slabs: RaySlabs, low: wp.vec3, high: wp.vec3):
    """Interval (entry, exit) of t in which the line of the ray is inside the widened box; empty if entry > exit."""
    entry = -INFINITY
    leave = INFINITY
    for axis in range(3):
        backward = slabs.inverse[axis] < 0.0
        near = (wp.where(backward, high[axis], low[axis]) - slabs.origin_in[axis]) * slabs.inverse[axis]
        far = (wp.where(backward, low[axis], high[axis]) - slabs.origin_out[axis]) * slabs.inverse[axis]
        entry = wp.where(near > entry, near, entry)
        leave = wp.where(far < leave, far, leave)
    return wp.vec2(entry, leave)


@wp.func_native("""
    const float inverse = slabs.inverse.c[axis];
    return wp::vec3(inverse, (position - slabs.origin_out.c[axis]) * inverse, (position - slabs.origin_in.c[axis]) * inverse);
""")
def cross_plane(slabs: wp.ref[RaySlabs], axis: int, position: float) -> wp.vec3:
    """Returns (1 / direction along the axis, t of leaving the first side of a plane, t of entering the second side).

    The code is native and takes its argument by reference: Warp otherwise copies a vector that is indexed by a variable to
    memory at every use.
    """


@wp.func
def clamp_to_box(slabs: RaySlabs, low: wp.vec3, high: wp.vec3, t: float):
    """The t of a candidate hit on a triangle with this box, by the consistency rule; NaN if the candidate is not a hit.
    It is never -0."""
    interval = slab_interval(slabs, low, high)
    result = wp.where(t > interval[0], t, interval[0])
    result = wp.where(result < interval[1], result, interval[1]) + 0.0
    return wp.where(interval[0] <= interval[1], result, wp.nan)

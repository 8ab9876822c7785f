"""Rays against axis-aligned boxes, and the rule that makes every engine give the same hits.

Slab test of Kay and Kajiya, in the form of Williams et al.: the box is entered at the latest of the three near planes and
left at the earliest of the three far ones. Infinite reciprocals do the right thing for axis-parallel rays; the one
undefined case, 0 * inf for an origin in the plane of a face, yields NaN, and every comparison here is written so that a
NaN leaves the interval as it was: the face counts as touched.

**Conservative by construction.** Rounding in a triangle test (Woop's shear, above all) moves the surface by a few units
in the last place of the distance to the *farthest* vertex of a triangle, not of the distance to the hit; a box test that
only absorbs its own rounding (Ize 2013: scale the exit by 1 + 2 gamma(3)) can therefore lose a hit on a long triangle.
So boxes are widened by a slack proportional to the ray's reach, the largest distance along an axis from its origin to
the scene's bounds: `slack = 2^-20 reach`. That costs nothing per box: near planes are measured from an origin moved
forward by the slack, far planes from one moved backward (`RaySlabs`).

**The consistency rule.** A candidate t from a triangle test is a hit only if the ray meets the triangle's own widened
box, and t is clamped to the interval of that meeting (`clamp_to_box`). Rounding is monotone, so the computed entry of any
box or cell that contains the triangle's box is never later than this t. A traversal that skips a node only if its entry
lies beyond the best hit so far therefore finds exactly what brute force finds: same t to the bit, same primitive.

References:
    T. L. Kay, J. T. Kajiya: Ray tracing complex scenes. SIGGRAPH 1986.
    A. Williams, S. Barrus, R. K. Morley, P. Shirley: An efficient and robust ray-box intersection algorithm.
        Journal of Graphics Tools 10(1), 2005.
    T. Ize: Robust BVH ray traversal. Journal of Computer Graphics Techniques 2(2), 2013.
"""

import warp as wp

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

SLACK = wp.constant(2.0**-20)
"""Widening of boxes, as a share of the ray's reach: 16 roundings of half a unit in the last place."""

INFINITY = wp.constant(float("inf"))


@wp.struct
class RaySlabs:
    """What a box test needs of a ray; see the module's docstring."""

    inverse: wp.vec3
    """1 / direction, with signed infinities."""
    origin_in: wp.vec3
    """Origin for planes by which boxes are entered: moved along the direction by the slack."""
    origin_out: wp.vec3
    """Origin for planes by which boxes are left: moved against the direction by the slack."""


@wp.func
def least(a: wp.vec3, b: wp.vec3):
    """Componentwise minimum of numbers; `wp.min` takes four instructions a component to order NaNs, this takes one."""
    return wp.vec3(wp.where(a[0] < b[0], a[0], b[0]), wp.where(a[1] < b[1], a[1], b[1]), wp.where(a[2] < b[2], a[2], b[2]))


@wp.func
def greatest(a: wp.vec3, b: wp.vec3):
    """Componentwise maximum of numbers."""
    return wp.vec3(wp.where(a[0] > b[0], a[0], b[0]), wp.where(a[1] > b[1], a[1], b[1]), wp.where(a[2] > b[2], a[2], b[2]))


@wp.func
def reach(origin: wp.vec3, low: wp.vec3, high: wp.vec3):
    """Largest distance along an axis from `origin` to a corner of the box."""
    far = greatest(wp.abs(low - origin), wp.abs(high - origin))
    return wp.max(far[0], wp.max(far[1], far[2]))


@wp.func
def ray_slabs(origin: wp.vec3, direction: wp.vec3, distance: float):
    """Prepares a ray for box tests; `distance` is its reach in the scene."""
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
    """Interval of t (entry, exit) in which the ray's line is inside the widened box; empty if entry > exit."""
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
    """(1 / direction along the axis, t at which the side before the plane is left, t at which the one behind is entered).

    Native and by reference, because a vector indexed by a variable is otherwise copied to memory at every use."""
    ...


@wp.func
def clamp_to_box(slabs: RaySlabs, low: wp.vec3, high: wp.vec3, t: float):
    """The t of a candidate hit on a triangle with this box, by the consistency rule; NaN if it is none."""
    interval = slab_interval(slabs, low, high)
    result = wp.where(t > interval[0], t, interval[0])
    result = wp.where(result < interval[1], result, interval[1])
    return wp.where(interval[0] <= interval[1], result, wp.nan)

"""Visibility between two points: whether the open segment between them is unobstructed.

**Problem.** The points usually lie on surfaces, up to rounding. The ray between them hits the triangles on which they lie, near
its ends and, if it leaves at a grazing angle, far from them. Such hits must not count.

**Rule.** A triangle whose plane passes through one of the end points, within rounding, does not block. This is stronger than
ignoring hits near the ends: at a grazing angle, a rounding of an end point moves the hit along the ray by many times as much,
but the distance of the end point from the plane stays small. Rounding is bounded by `PLANE_TOLERANCE` times the largest
coordinate of the triangle and of the end point, relative to the scene's centre, plus the rounding of the caller's float32
coordinates.

    u      2^-24
    C      largest coordinate of the triangle and of the end point
    w      weights of a point of the triangle as the caller gave it, sum w = 1
    n      unit normal of the triangle as it is stored

    |fl(v_i) - v_i| <= u C                           each coordinate of a vertex
    |fl(p) - p| <= u C                               each coordinate of the end point, p = sum w_i v_i
    |fl(p) - sum w_i fl(v_i)| <= 2 u C               each coordinate; the second point is in the stored plane
    |n (fl(p) - fl(v_0))| <= sqrt(3) 2 u C           <= 3.47 u C

`PLANE_TOLERANCE` is 4 u: half a rounding is left, which is for the rounding of n in float64. That is enough if the area is at
least 2^-22 of the product of two edges. A thinner triangle has no plane that float64 could find: it may be said to block what
starts on it. Searched by `planes` of tests/bounds.

**Symmetry.** The rays from a to b and from b to a are rounded differently and may pass an edge on different sides. The ray of a
pair therefore always starts at the smaller of its end points, ordered by x, then y, then z.

**Steps.** The nearest hit, searched only farther than rounding from both ends, decides most pairs: there is none, or its
triangle passes through neither end. The list of all hits decides the others.
"""

import warp as wp

from wrt.kernels.layout.ray_batch import RayBatch, is_finite
from wrt.kernels.query.hit_attributes import SceneMesh, triangle_of
from wrt.kernels.runtime.options import exact_kernel

PLANE_TOLERANCE = wp.constant(2.0**-22)
"""Tolerance as a fraction of the largest coordinate: four roundings of half a unit in the last place, two of a point, two of a
plane."""

HIDDEN = wp.constant(0)
VISIBLE = wp.constant(1)
UNDECIDED = wp.constant(2)
"""Results of a pair."""


@wp.func
def largest_component(v: wp.vec3):
    """Largest absolute component."""
    return wp.max(wp.abs(v[0]), wp.max(wp.abs(v[1]), wp.abs(v[2])))


@wp.func
def is_ordered(a: wp.vec3d, b: wp.vec3d):
    """Whether a precedes or equals b, ordered by x, then y, then z."""
    return a[0] < b[0] or (a[0] == b[0] and (a[1] < b[1] or (a[1] == b[1] and a[2] <= b[2])))


@exact_kernel
def connect_points(
    first: int,
    from_points: wp.array(dtype=wp.vec3d),
    to_points: wp.array(dtype=wp.vec3d),
    from_index: wp.array(dtype=int),
    to_index: wp.array(dtype=int),
    center: wp.vec3d,
    rounding: float,
    rays: RayBatch,
    targets: wp.array(dtype=wp.vec3),
    visibility: wp.array(dtype=int),
):
    """Writes the ray of a pair, from its smaller point, and the end point relative to the centre, at t = 1. Item: a pair of
    points.

    A pair without a ray gets its result here.
    """
    i = first + wp.tid()
    one = from_points[from_index[i]]
    other = to_points[to_index[i]]
    in_order = is_ordered(one, other)
    a = wp.where(in_order, one, other) - center
    b = wp.where(in_order, other, one) - center
    origin = wp.vec3(a)
    target = wp.vec3(b)
    direction = wp.vec3(b - a)
    length = wp.length(direction)
    margin = wp.min((PLANE_TOLERANCE * wp.min(largest_component(origin), largest_component(target)) + rounding) / length, 0.5)
    visibility[i] = wp.where(is_finite(origin) and is_finite(target), VISIBLE, HIDDEN)
    targets[i] = target
    rays.origins[i] = origin
    rays.directions[i] = direction
    rays.t_min[i] = wp.where(length > 0.0, margin, 0.0)
    rays.t_max[i] = wp.where(length > 0.0, 1.0 - margin, 0.0)


@wp.func
def passes_through(mesh: SceneMesh, primitive: int, point: wp.vec3, rounding: float):
    """Whether the plane of a triangle passes through a point, within rounding; true for a degenerate triangle."""
    corners = triangle_of(mesh, primitive)
    a = wp.vec3(corners.a)
    b = wp.vec3(corners.b)
    c = wp.vec3(corners.c)
    size = wp.max(wp.max(largest_component(a), largest_component(b)), wp.max(largest_component(c), largest_component(point)))
    normal = wp.normalize(wp.cross(corners.b - corners.a, corners.c - corners.a))
    return float(wp.abs(wp.dot(normal, wp.vec3d(point) - corners.a))) <= PLANE_TOLERANCE * size + rounding


@wp.func
def obstructs(mesh: SceneMesh, primitive: int, start: wp.vec3, end: wp.vec3, rounding: float):
    """Whether a triangle that the segment hits obstructs it."""
    return not (passes_through(mesh, primitive, start, rounding) or passes_through(mesh, primitive, end, rounding))


@exact_kernel
def classify_by_nearest(
    first: int,
    mesh: SceneMesh,
    rays: RayBatch,
    targets: wp.array(dtype=wp.vec3),
    primitive: wp.array(dtype=int),
    rounding: float,
    visibility: wp.array(dtype=int),
):
    """Decides a pair by the nearest hit of its ray, -1 for none, where that suffices. Item: a pair of points."""
    i = first + wp.tid()
    if primitive[i] >= 0:
        visibility[i] = wp.where(obstructs(mesh, primitive[i], rays.origins[i], targets[i], rounding), HIDDEN, UNDECIDED)


@exact_kernel
def classify_by_all_hits(
    first: int,
    mesh: SceneMesh,
    rays: RayBatch,
    targets: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=int),
    offsets: wp.array(dtype=wp.int64),
    primitive: wp.array(dtype=int),
    rounding: float,
    visibility: wp.array(dtype=int),
):
    """Decides an undecided pair, number order[item], by all hits of its ray, elements offsets[item] .. of `primitive`. Item: a
    pair."""
    i = first + wp.tid()
    pair = order[i]
    result = int(VISIBLE)
    for k in range(int(offsets[i]), int(offsets[i + 1])):
        if obstructs(mesh, primitive[k], rays.origins[pair], targets[pair], rounding):
            result = HIDDEN
    visibility[pair] = result

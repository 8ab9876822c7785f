"""Convex regions of space: boxes and frusta in one representation, with containment and overlap tests.

**One representation.** An axis-aligned box, an oriented box and a frustum are all a stack of rectangles along `forward`, from
depth `near` to depth `far`. Each rectangle is centred on the axis, and its half sizes grow linearly with the depth:

    |x| <= width + depth widening,   |y| <= height + depth heightening         (x along `right`, y along `up`)

A box does not grow; a frustum has size 0 at depth 0, its apex. One struct and one set of functions therefore serve all three.

**Separating axes.** Two convex bodies are disjoint if and only if their projections on some axis are. For two polyhedra it
suffices to try the face normals of both and the cross products of their edges (Gottschalk, Lin and Manocha 1996). A frustum has
5 normals and edges in 6 directions, a box has 3 and 3: 3 + 5 + 18 axes. The projection of a region is that of its near and far
rectangles, so corners are never computed.

**Precision.** All arithmetic is float64 on float32 input. The remaining rounding is far smaller than the margin that
conservative callers add to a region (`wrt.builders.influence.regions`). Projections that overlap within rounding are not
separated, and a NaN is in no region.

References: gottschalk-1996; falcone-2024 (sections 5.3 and A.4 to A.7).
"""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel

ROUNDING = wp.constant(wp.float64(2.0**-46))
"""Error of the ends of a projection, as a fraction of the magnitudes that are summed: 2^6 roundings."""


@wp.struct
class Region:
    """A stack of rectangles; coordinates are relative to the scene's centre."""

    origin: wp.vec3d
    """Point of the axis at depth 0."""
    right: wp.vec3d
    """`right`, `up` and `forward` are an orthonormal frame."""
    up: wp.vec3d
    forward: wp.vec3d
    near: wp.float64
    far: wp.float64
    width: wp.float64
    """Half size along `right` at depth 0."""
    height: wp.float64
    widening: wp.float64
    """Growth of `width` per unit of depth."""
    heightening: wp.float64
    low: wp.vec3d
    """`low` and `high` bound the region: a cheap test that rejects most points and boxes."""
    high: wp.vec3d


@wp.func
def in_frame(region: Region, v: wp.vec3d):
    """Coordinates of a vector along right, up and forward."""
    return wp.vec3d(wp.dot(region.right, v), wp.dot(region.up, v), wp.dot(region.forward, v))


@wp.func
def holds(region: Region, p: wp.vec3d):
    """Whether a point, given in the region's frame, is inside the region."""
    return (
        p[2] >= region.near
        and p[2] <= region.far
        and wp.abs(p[0]) <= region.width + p[2] * region.widening
        and wp.abs(p[1]) <= region.height + p[2] * region.heightening
    )


@wp.func
def contains_point(region: Region, point: wp.vec3d):
    """Whether a point is in the region or on its surface; false for NaN."""
    return (
        point[0] >= region.low[0]
        and point[0] <= region.high[0]
        and point[1] >= region.low[1]
        and point[1] <= region.high[1]
        and point[2] >= region.low[2]
        and point[2] <= region.high[2]
        and holds(region, in_frame(region, point - region.origin))
    )


@wp.func
def is_separated(region: Region, low: wp.vec3d, high: wp.vec3d, axis: wp.vec3d):
    """Whether the projections of the region and of a box on an axis are disjoint. The axis need not be normalised."""
    two = wp.float64(2.0)
    size = wp.vec3d(wp.abs(axis[0]), wp.abs(axis[1]), wp.abs(axis[2]))
    middle = wp.dot(low + high, axis) / two - wp.dot(region.origin, axis)
    half = wp.dot(high - low, size) / two
    a = in_frame(region, axis)
    x = wp.abs(a[0])
    y = wp.abs(a[1])
    near_half = x * (region.width + region.near * region.widening) + y * (region.height + region.near * region.heightening)
    far_half = x * (region.width + region.far * region.widening) + y * (region.height + region.far * region.heightening)
    lower = wp.min(region.near * a[2] - near_half, region.far * a[2] - far_half)
    upper = wp.max(region.near * a[2] + near_half, region.far * a[2] + far_half)
    o = region.origin
    reach = wp.dot(wp.vec3d(wp.abs(o[0]), wp.abs(o[1]), wp.abs(o[2])), size)
    slack = ROUNDING * (reach + half + wp.abs(middle) + wp.abs(lower) + wp.abs(upper))
    return middle - half > upper + slack or middle + half < lower - slack


@wp.func
def crosses_separate(region: Region, low: wp.vec3d, high: wp.vec3d, edge: wp.vec3d):
    """Whether the cross product of an edge of the region with one of the box is a separating axis."""
    zero = wp.float64(0.0)
    return (
        is_separated(region, low, high, wp.vec3d(zero, -edge[2], edge[1]))
        or is_separated(region, low, high, wp.vec3d(edge[2], zero, -edge[0]))
        or is_separated(region, low, high, wp.vec3d(-edge[1], edge[0], zero))
    )


@wp.func
def intersects_box(region: Region, low: wp.vec3d, high: wp.vec3d):
    """Whether the region and a box overlap; false for an empty box, low > high."""
    for axis in range(3):
        if not (low[axis] <= region.high[axis] and high[axis] >= region.low[axis] and low[axis] <= high[axis]):
            return False
    lean = region.widening * region.forward
    tilt = region.heightening * region.forward
    if (
        is_separated(region, low, high, region.forward)
        or is_separated(region, low, high, region.right - lean)
        or is_separated(region, low, high, region.right + lean)
        or is_separated(region, low, high, region.up - tilt)
        or is_separated(region, low, high, region.up + tilt)
    ):
        return False
    side = region.widening * region.right
    rise = region.heightening * region.up
    return not (
        crosses_separate(region, low, high, region.right)
        or crosses_separate(region, low, high, region.up)
        or crosses_separate(region, low, high, region.forward + side + rise)
        or crosses_separate(region, low, high, region.forward + side - rise)
        or crosses_separate(region, low, high, region.forward - side + rise)
        or crosses_separate(region, low, high, region.forward - side - rise)
    )


@wp.func
def encloses_box(region: Region, low: wp.vec3d, high: wp.vec3d):
    """Whether the region contains a box: it is convex, so the corners of the box decide."""
    for corner in range(8):
        x = wp.where((corner & 1) == 0, low[0], high[0])
        y = wp.where((corner & 2) == 0, low[1], high[1])
        z = wp.where((corner & 4) == 0, low[2], high[2])
        if not contains_point(region, wp.vec3d(x, y, z)):
            return False
    return True


DISJOINT = wp.constant(0)
INTERSECTING = wp.constant(1)
ENCLOSED = wp.constant(2)
"""Results of `classify_box`."""


@wp.func
def classify_box(region: Region, low: wp.vec3d, high: wp.vec3d):
    """DISJOINT, INTERSECTING, or ENCLOSED if the region contains the whole box."""
    if not intersects_box(region, low, high):
        return DISJOINT
    return wp.where(encloses_box(region, low, high), ENCLOSED, INTERSECTING)


@exact_kernel
def contain_points(
    first: int, regions: wp.array(dtype=Region), points: wp.array(dtype=wp.vec3d), inside: wp.array2d(dtype=wp.bool)
):
    """Tests a point against all regions. Item: a point. inside: (points, regions)."""
    i = first + wp.tid()
    for number in range(regions.shape[0]):
        inside[i, number] = contains_point(regions[number], points[i])


@exact_kernel
def classify_boxes(
    first: int,
    regions: wp.array(dtype=Region),
    low: wp.array2d(dtype=wp.float64),
    high: wp.array2d(dtype=wp.float64),
    result: wp.array2d(dtype=wp.uint8),
):
    """Classifies a box, a column of the (3, boxes) corners, against all regions. Item: a box. result: (boxes, regions),
    `classify_box`."""
    i = first + wp.tid()
    lowest = wp.vec3d(low[0, i], low[1, i], low[2, i])
    highest = wp.vec3d(high[0, i], high[1, i], high[2, i])
    for number in range(regions.shape[0]):
        result[i, number] = wp.uint8(classify_box(regions[number], lowest, highest))


@exact_kernel
def classify_pairs(
    first: int,
    regions: wp.array(dtype=Region),
    low: wp.array(dtype=wp.vec3d),
    high: wp.array(dtype=wp.vec3d),
    box: wp.array(dtype=int),
    region: wp.array(dtype=int),
    result: wp.array(dtype=wp.uint8),
):
    """Classifies a pair of a box, given by its corners, and a region. Item: a pair. result: (pairs,), `classify_box`."""
    i = first + wp.tid()
    result[i] = wp.uint8(classify_box(regions[region[i]], low[box[i]], high[box[i]]))

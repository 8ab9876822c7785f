"""Regions of space in which rays behave: boxes and frusta, all as one shape, tested against points, rays and boxes.

**One shape.** An axis-aligned box, an oriented box and a frustum are all a stack of rectangles: along `forward` from depth
`near` to depth `far`, each centred on the axis, whose half sizes grow linearly with the depth,

    |x| <= width + depth widening,   |y| <= height + depth heightening         (x along `right`, y along `up`)

A box grows by nothing; a frustum has no size at depth 0, which is its eye. So one struct and one set of functions serve all.

**Separating axes.** Two convex bodies are apart if and only if their shadows on some axis are; of two polyhedra, a face normal
of one or a cross product of two edges is such an axis, if any is (Gottschalk, Lin, Manocha 1996). A frustum has 5 normals and
edges in 6 directions, a box has 3 and 3: 3 + 5 + 18 axes. The shadow of a region is that of its near and far rectangle,
so that no corner is ever computed.

**Numbers.** All in float64, on float32 input: what rounding is left is smaller by far than the margin that those who need
certainty add to a region (`wrt.builders.influence.regions`). A shadow that touches another one but for rounding is not apart
from it, and what is NaN is in no region.

References:
    S. Gottschalk, M. C. Lin, D. Manocha: OBBTree: a hierarchical structure for rapid interference detection. SIGGRAPH 1996.
    L. Falcone: Ray distribution aware heuristics for bounding volume hierarchies construction in ray tracing. MSc thesis,
        Politecnico di Milano, 2024 (sections 5.3 and A.4 to A.7).
"""

import warp as wp

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

ROUNDING = wp.constant(wp.float64(2.0**-46))
"""Of a shadow's ends, as a share of the numbers they are sums of; 2^6 roundings."""


@wp.struct
class Region:
    """A stack of rectangles; coordinates are relative to the scene's centre."""

    origin: wp.vec3d
    """The point of the axis at depth 0."""
    right: wp.vec3d
    """Unit, as the next two; orthogonal to each other."""
    up: wp.vec3d
    forward: wp.vec3d
    near: wp.float64
    far: wp.float64
    width: wp.float64
    """Half size along `right` at depth 0."""
    height: wp.float64
    widening: wp.float64
    """By which `width` grows for each unit of depth."""
    heightening: wp.float64
    low: wp.vec3d
    """Corners of the box around it: a cheap test that most points and boxes fail."""
    high: wp.vec3d


@wp.func
def in_frame(region: Region, v: wp.vec3d):
    """A vector's coordinates along right, up and forward."""
    return wp.vec3d(wp.dot(region.right, v), wp.dot(region.up, v), wp.dot(region.forward, v))


@wp.func
def holds(region: Region, p: wp.vec3d):
    """Whether a point, given in the region's frame, is between its faces."""
    return (
        p[2] >= region.near
        and p[2] <= region.far
        and wp.abs(p[0]) <= region.width + p[2] * region.widening
        and wp.abs(p[1]) <= region.height + p[2] * region.heightening
    )


@wp.func
def contains_point(region: Region, point: wp.vec3d):
    """Whether a point is in the region, its surface included; NaN is not."""
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
def is_apart(region: Region, low: wp.vec3d, high: wp.vec3d, axis: wp.vec3d):
    """Whether the shadows of the region and of a box on an axis, of any length, have a gap between them."""
    two = wp.float64(2.0)
    size = wp.vec3d(wp.abs(axis[0]), wp.abs(axis[1]), wp.abs(axis[2]))
    middle = wp.dot(low + high, axis) / two - wp.dot(region.origin, axis)
    half = wp.dot(high - low, size) / two
    a = in_frame(region, axis)
    x = wp.abs(a[0])
    y = wp.abs(a[1])
    near_half = x * (region.width + region.near * region.widening) + y * (region.height + region.near * region.heightening)
    far_half = x * (region.width + region.far * region.widening) + y * (region.height + region.far * region.heightening)
    least = wp.min(region.near * a[2] - near_half, region.far * a[2] - far_half)
    most = wp.max(region.near * a[2] + near_half, region.far * a[2] + far_half)
    o = region.origin
    reach = wp.dot(wp.vec3d(wp.abs(o[0]), wp.abs(o[1]), wp.abs(o[2])), size)
    slack = ROUNDING * (reach + half + wp.abs(middle) + wp.abs(least) + wp.abs(most))
    return middle - half > most + slack or middle + half < least - slack


@wp.func
def crosses_separate(region: Region, low: wp.vec3d, high: wp.vec3d, edge: wp.vec3d):
    """Whether a cross product of an edge of the region and one of a box tells them apart."""
    zero = wp.float64(0.0)
    return (
        is_apart(region, low, high, wp.vec3d(zero, -edge[2], edge[1]))
        or is_apart(region, low, high, wp.vec3d(edge[2], zero, -edge[0]))
        or is_apart(region, low, high, wp.vec3d(-edge[1], edge[0], zero))
    )


@wp.func
def touches_box(region: Region, low: wp.vec3d, high: wp.vec3d):
    """Whether the region and a box have a point in common; an empty box, low > high, has none."""
    for axis in range(3):
        if not (low[axis] <= region.high[axis] and high[axis] >= region.low[axis] and low[axis] <= high[axis]):
            return False
    lean = region.widening * region.forward
    tilt = region.heightening * region.forward
    if (
        is_apart(region, low, high, region.forward)
        or is_apart(region, low, high, region.right - lean)
        or is_apart(region, low, high, region.right + lean)
        or is_apart(region, low, high, region.up - tilt)
        or is_apart(region, low, high, region.up + tilt)
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
    """Whether all of a box is in the region: as that is convex, whether the box's corners are."""
    for corner in range(8):
        x = wp.where((corner & 1) == 0, low[0], high[0])
        y = wp.where((corner & 2) == 0, low[1], high[1])
        z = wp.where((corner & 4) == 0, low[2], high[2])
        if not contains_point(region, wp.vec3d(x, y, z)):
            return False
    return True


APART = wp.constant(0)
TOUCHING = wp.constant(1)
ENCLOSED = wp.constant(2)


@wp.func
def classify_box(region: Region, low: wp.vec3d, high: wp.vec3d):
    """APART, TOUCHING, or ENCLOSED: all of the box is in the region."""
    if not touches_box(region, low, high):
        return APART
    return wp.where(encloses_box(region, low, high), ENCLOSED, TOUCHING)


@wp.kernel
def contain_points(
    first: int, regions: wp.array(dtype=Region), points: wp.array(dtype=wp.vec3d), inside: wp.array2d(dtype=wp.bool)
):
    """Item: a point. inside: (points, regions)."""
    i = first + wp.tid()
    for number in range(regions.shape[0]):
        inside[i, number] = contains_point(regions[number], points[i])


@wp.kernel
def classify_boxes(
    first: int,
    regions: wp.array(dtype=Region),
    low: wp.array2d(dtype=wp.float64),
    high: wp.array2d(dtype=wp.float64),
    result: wp.array2d(dtype=wp.uint8),
):
    """Item: a box, a column of the (3, boxes) corners. result: (boxes, regions), `classify_box`."""
    i = first + wp.tid()
    lowest = wp.vec3d(low[0, i], low[1, i], low[2, i])
    highest = wp.vec3d(high[0, i], high[1, i], high[2, i])
    for number in range(regions.shape[0]):
        result[i, number] = wp.uint8(classify_box(regions[number], lowest, highest))


@wp.kernel
def classify_pairs(
    first: int,
    regions: wp.array(dtype=Region),
    low: wp.array(dtype=wp.vec3d),
    high: wp.array(dtype=wp.vec3d),
    box: wp.array(dtype=int),
    region: wp.array(dtype=int),
    result: wp.array(dtype=wp.uint8),
):
    """Item: a pair of a box, by its corners, and a region. result: (pairs,), `classify_box`."""
    i = first + wp.tid()
    result[i] = wp.uint8(classify_box(regions[region[i]], low[box[i]], high[box[i]]))

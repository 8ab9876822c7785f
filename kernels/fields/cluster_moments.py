"""Moments of the children of a wide BVH: what `wrt.kernels.fields` expands the winding number in.

Sums over triangles about the scene's centre are additive, so those of a node are the sums of its children's: leaves first, then
levels of nodes from the deepest to the root. In float64, they are moved to the centres of the children without a loss.

Moments are stored with lengths multiplied by a scale, a power of two with which the farthest coordinate from the scene's centre
is from 1 to 2. The third moment grows with the fourth power of lengths and is multiplied by their third power: without a
scale, float32 would hold neither in a scene of 1e6 units.

References: barill-2018.
"""

import warp as wp

from wrt.kernels.layout.bvh_nodes import WideNodes, first_block, leaf_triangles
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

MOMENTS = wp.constant(19)
"""Floats of a lane: centre (3), area vector (3), five of the second moment, seven of the third one, radius (1)."""

RADIUS = wp.constant(18)
"""Which of them is the radius."""

vec10d = wp.types.vector(length=10, dtype=wp.float64)
"""A symmetric tensor of rank three: xxx, xxy, xxz, xyy, xyz, xzz, yyy, yyz, yzz, zzz."""


@wp.struct
class Sums:
    """Sums over the triangles of each lane, about the scene's centre; nodes * W of each."""

    area: wp.array(dtype=wp.float64)
    area_vector: wp.array(dtype=wp.vec3d)
    weighted: wp.array(dtype=wp.vec3d)
    """Area times centroid."""
    outer: wp.array(dtype=wp.mat33d)
    """Area vector times centroid, transposed."""
    third: wp.array(dtype=vec10d)
    """The symmetric part of the area vector times the mean of x x^T over the triangle."""


@wp.func
def symmetric_part(m: wp.mat33d, u: wp.vec3d):
    """Of the product of a matrix, symmetric itself, and a vector."""
    third = wp.float64(1.0) / wp.float64(3.0)
    return vec10d(
        m[0, 0] * u[0],
        (m[0, 0] * u[1] + wp.float64(2.0) * m[0, 1] * u[0]) * third,
        (m[0, 0] * u[2] + wp.float64(2.0) * m[0, 2] * u[0]) * third,
        (m[1, 1] * u[0] + wp.float64(2.0) * m[0, 1] * u[1]) * third,
        (m[0, 1] * u[2] + m[0, 2] * u[1] + m[1, 2] * u[0]) * third,
        (m[2, 2] * u[0] + wp.float64(2.0) * m[0, 2] * u[2]) * third,
        m[1, 1] * u[1],
        (m[1, 1] * u[2] + wp.float64(2.0) * m[1, 2] * u[1]) * third,
        (m[2, 2] * u[1] + wp.float64(2.0) * m[1, 2] * u[2]) * third,
        m[2, 2] * u[2],
    )


@wp.func
def corner_of(triangles: TriangleBlocks, slot: int, corner: int, width: int):
    """A vertex of the triangle in a slot."""
    base = (slot // width) * 9 * width + slot % width + 3 * width * corner
    r = triangles.records
    return wp.vec3d(wp.float64(r[base]), wp.float64(r[base + width]), wp.float64(r[base + 2 * width]))


@exact_kernel
def sum_leaves(first: int, width: int, tree: WideNodes, triangles: TriangleBlocks, sums: Sums):
    """The sums of a lane that is a leaf or is not used. Item: a lane."""
    lane = first + wp.tid()
    word = tree.child[lane]
    if word < 0:
        area = wp.float64(0.0)
        area_vector = wp.vec3d()
        weighted = wp.vec3d()
        outer = wp.mat33d()
        third = vec10d()
        begin = first_block(word) * width
        for k in range(leaf_triangles(word)):
            a = corner_of(triangles, begin + k, 0, width)
            b = corner_of(triangles, begin + k, 1, width)
            c = corner_of(triangles, begin + k, 2, width)
            own = wp.float64(0.5) * wp.cross(b - a, c - a)
            centroid = (a + b + c) / wp.float64(3.0)
            area += wp.length(own)
            area_vector += own
            weighted += wp.length(own) * centroid
            outer += wp.outer(own, centroid)
            square = wp.outer(a, a) + wp.outer(b, b) + wp.outer(c, c) + wp.float64(9.0) * wp.outer(centroid, centroid)
            third += symmetric_part(square / wp.float64(12.0), own)
        sums.area[lane] = area
        sums.area_vector[lane] = area_vector
        sums.weighted[lane] = weighted
        sums.outer[lane] = outer
        sums.third[lane] = third


@exact_kernel
def sum_children(first: int, width: int, begin: int, tree: WideNodes, sums: Sums):
    """The sums of the lanes of a node that are nodes of the next level. Item: a node of a level that begins at `begin`."""
    node = begin + first + wp.tid()
    for i in range(width):
        lane = node * width + i
        child = tree.child[lane]
        if child >= 0:
            area = wp.float64(0.0)
            area_vector = wp.vec3d()
            weighted = wp.vec3d()
            outer = wp.mat33d()
            third = vec10d()
            for j in range(width):
                area += sums.area[child * width + j]
                area_vector += sums.area_vector[child * width + j]
                weighted += sums.weighted[child * width + j]
                outer += sums.outer[child * width + j]
                third += sums.third[child * width + j]
            sums.area[lane] = area
            sums.area_vector[lane] = area_vector
            sums.weighted[lane] = weighted
            sums.outer[lane] = outer
            sums.third[lane] = third


@wp.func
def farthest_in_leaf(triangles: TriangleBlocks, word: int, width: int, center: wp.vec3d):
    """Distance of the farthest vertex of a leaf."""
    radius = wp.float64(0.0)
    begin = first_block(word) * width
    for k in range(leaf_triangles(word)):
        for corner in range(3):
            radius = wp.max(radius, wp.length(corner_of(triangles, begin + k, corner, width) - center))
    return radius


@wp.func
def farthest_of_box(tree: WideNodes, lane: int, width: int, center: wp.vec3d):
    """Distance of the farthest corner of a lane's box."""
    base = (lane // width) * 6 * width + lane % width
    square = wp.float64(0.0)
    for axis in range(3):
        low = wp.float64(tree.bounds[base + axis * width])
        high = wp.float64(tree.bounds[base + (3 + axis) * width])
        away = wp.max(wp.abs(center[axis] - low), wp.abs(high - center[axis]))
        square += away * away
    return wp.sqrt(square)


@wp.func
def second_about(sums: Sums, lane: int, center: wp.vec3d):
    """The second moment about a centre: its symmetric part, without a trace."""
    m = sums.outer[lane] - wp.outer(sums.area_vector[lane], center)
    third = (m[0, 0] + m[1, 1] + m[2, 2]) / wp.float64(3.0)
    return wp.float64(0.5) * (m + wp.transpose(m)) - third * wp.identity(n=3, dtype=wp.float64)


@wp.func
def third_about(sums: Sums, lane: int, center: wp.vec3d):
    """The third moment about a centre: its symmetric part, without traces."""
    outer = wp.float64(0.5) * (sums.outer[lane] + wp.transpose(sums.outer[lane]))
    s = sums.third[lane] - wp.float64(2.0) * symmetric_part(outer, center)
    s += symmetric_part(wp.outer(center, center), sums.area_vector[lane])
    trace = wp.vec3d(s[0] + s[3] + s[5], s[1] + s[6] + s[8], s[2] + s[7] + s[9])
    return s - wp.float64(0.6) * symmetric_part(wp.identity(n=3, dtype=wp.float64), trace)


@wp.func
def store_second(moments: wp.array(dtype=float), base: int, width: int, m: wp.mat33d):
    """Stores xx, yy, xy, xz, yz, times -3, and -6 where there are two of a kind."""
    moments[base] = float(wp.float64(-3.0) * m[0, 0])
    moments[base + width] = float(wp.float64(-3.0) * m[1, 1])
    moments[base + 2 * width] = float(wp.float64(-6.0) * m[0, 1])
    moments[base + 3 * width] = float(wp.float64(-6.0) * m[0, 2])
    moments[base + 4 * width] = float(wp.float64(-6.0) * m[1, 2])


@wp.func
def store_third(moments: wp.array(dtype=float), base: int, width: int, s: vec10d):
    """Stores xxx, xyy, yyy, xxy, xxz, yyz, xyz, times 7.5 and the number of those of a kind."""
    moments[base] = float(wp.float64(7.5) * s[0])
    moments[base + width] = float(wp.float64(22.5) * s[3])
    moments[base + 2 * width] = float(wp.float64(7.5) * s[6])
    moments[base + 3 * width] = float(wp.float64(22.5) * s[1])
    moments[base + 4 * width] = float(wp.float64(7.5) * s[2])
    moments[base + 5 * width] = float(wp.float64(7.5) * s[7])
    moments[base + 6 * width] = float(wp.float64(45.0) * s[4])


@exact_kernel
def store_moments(
    first: int,
    width: int,
    scale: wp.float64,
    tree: WideNodes,
    triangles: TriangleBlocks,
    sums: Sums,
    moments: wp.array(dtype=float),
):
    """The moments about a centre, and the radius, of a lane. Unused lanes have area 0 and radius -1. Item: a lane."""
    lane = first + wp.tid()
    word = tree.child[lane]
    base = (lane // width) * MOMENTS * width + lane % width
    radius = wp.float64(-1.0)
    center = wp.vec3d()
    if word >= 0 or leaf_triangles(word) > 0:
        box = (lane // width) * 6 * width + lane % width
        for axis in range(3):
            low = tree.bounds[box + axis * width]
            high = tree.bounds[box + (3 + axis) * width]
            middle = 0.5 * low + 0.5 * high
            if sums.area[lane] > wp.float64(0.0):
                middle = wp.clamp(float(sums.weighted[lane][axis] / sums.area[lane]), low, high)
            center[axis] = wp.float64(middle)  # as it is stored: the moments are about the rounded centre
        radius = farthest_of_box(tree, lane, width, center)
        if word < 0:
            radius = farthest_in_leaf(triangles, word, width, center)
        radius *= scale
    square = scale * scale
    for axis in range(3):
        moments[base + axis * width] = float(scale * center[axis])
        moments[base + (3 + axis) * width] = float(square * sums.area_vector[lane][axis])
    store_second(moments, base + 6 * width, width, square * scale * second_about(sums, lane, center))
    store_third(moments, base + 11 * width, width, square * square * third_about(sums, lane, center))
    moments[base + RADIUS * width] = float(radius)


@exact_kernel
def gather_radii(first: int, width: int, begin: int, tree: WideNodes, moments: wp.array(dtype=float)):
    """A smaller radius of the lanes of a node that are nodes, by those of their children. Item: a node of a level."""
    node = begin + first + wp.tid()
    for i in range(width):
        child = tree.child[node * width + i]
        if child >= 0:
            base = node * MOMENTS * width + i
            radius = float(0.0)
            for j in range(width):
                own = child * MOMENTS * width + j
                if moments[own + RADIUS * width] >= 0.0:
                    square = float(0.0)
                    for axis in range(3):
                        away = moments[base + axis * width] - moments[own + axis * width]
                        square += away * away
                    radius = wp.max(radius, wp.sqrt(square) + moments[own + RADIUS * width])
            moments[base + RADIUS * width] = wp.min(moments[base + RADIUS * width], radius)

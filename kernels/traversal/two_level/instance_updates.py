"""Instances move where their transforms are: maps, boxes and the nodes above them, by kernels that read nothing back.

**Steps.** `place_instances`: the maps of the instances that move. `bound_moved`: their boxes in float64, by a team of threads
each. `span_instances`: what all boxes span. `lay_out`: the scene's centre, which depends on that alone, placements relative to
it, and the boxes of the leaves of the upper tree. `refit_level`, `refit_levels`: the boxes of inner nodes, from the bottom up,
one launch for each large level, and one for all small ones. `measure_nodes`: the surfaces of which the tree's cost consists.

All values equal those of updates on the host (`wrt.instances.instance_boxes`) to the bit; only the sum of surfaces is taken in
another order.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.bvh_nodes import EMPTY_LANE, first_block
from wrt.kernels.layout.instance_maps import Placement
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel, specialised_kernel
from wrt.kernels.traversal.two_level.instance_bounds import (
    BoundedInstances,
    CoverPoints,
    inverse_map,
    linear_part,
    norm,
    scene_origin,
)
from wrt.kernels.traversal.two_level.instance_moves import next_float

TEAM = 32
"""Threads that bound an instance on CUDA: a warp."""

BLOCK = 512
"""Threads of the one block of `refit_levels` on CUDA."""

SPANNED = 9
"""Integers of `Spanned.found`."""

REPORTED = 20
"""Numbers of `Spanned.report`."""

EPSILON = wp.constant(wp.float64(2.0**-52))
TINY = wp.constant(wp.float64(2.0**-1022))
MAX_SQUARE_SCALE = wp.constant(wp.float64(2.0**200))
MIN_SCALE = wp.constant(wp.float64(2.0**-100))
MAX_CONDITION = wp.constant(wp.float64(1e12))
AFFINE = wp.constant(wp.float64(1e-12))
NOT_FINE = wp.constant(8)
"""Place in `Spanned` of the first instance whose transform must be looked at."""


Minima = wp.types.vector(length=SPANNED, dtype=wp.int64)


@wp.struct
class Spanned:
    """What all N instances span."""

    found: wp.array(dtype=wp.int64)
    """(`SPANNED`,) least values, ordered as integers: lowest x, y, z; highest x, y, z and the greatest norm, negated; the least
    size; the first instance whose transform is singular or close to it, not finite, or not affine."""
    report: wp.array(dtype=wp.float64)
    """(`REPORTED`,) lowest x, y, z, highest x, y, z, greatest norm, least size, that instance or a huge number, the centre x,
    y, z, the surfaces of the boxes of nodes and of instances, and the first six of `extent`."""
    extent: wp.array(dtype=float)
    """(7,) as `InstanceTree.extent`."""


@wp.struct
class UpperNodes:
    """The upper level: nodes of W children, in the order of their heights."""

    child: wp.array(dtype=int)
    """(nodes W,)"""
    order: wp.array(dtype=int)
    """As `InstanceTree.order`."""
    bounds: wp.array(dtype=float)
    """(nodes * 6 W,) boxes of the children."""
    level_first: wp.array(dtype=int)
    """First node of each level, greatest height first, and the number of nodes."""
    width: int
    """W."""


mat34f = wp.types.matrix(shape=(3, 4), dtype=wp.float32)
mat34d = wp.types.matrix(shape=(3, 4), dtype=wp.float64)
"""Transforms without their last row."""


@wp.func
def as_map(matrix: wp.mat44f):
    """A transform in float64."""
    return wp.mat44d(matrix)


@wp.func
def as_map(matrix: mat34d):  # noqa: F811
    """The transform whose last row was left out."""
    last = wp.vec4d(wp.float64(0.0), wp.float64(0.0), wp.float64(0.0), wp.float64(1.0))
    return wp.matrix_from_rows(matrix[0], matrix[1], matrix[2], last)


@wp.func
def as_map(matrix: mat34f):  # noqa: F811
    """As for `mat34d`."""
    return as_map(mat34d(matrix))


@wp.func
def as_map(matrix: wp.mat44d):  # noqa: F811  # overloads
    """A transform in float64."""
    return matrix


@wp.func
def as_map(given: wp.transformd):  # noqa: F811
    """The matrix of a position and a quaternion of any length, as `wrt.meshes.instance.matrices_of` computes it."""
    x = given[3]
    y = given[4]
    z = given[5]
    w = given[6]
    length = wp.sqrt(((x * x + y * y) + z * z) + w * w)
    x = x / length
    y = y / length
    z = z / length
    w = w / length
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    none = wp.float64(0.0)
    return wp.mat44d(
        one - two * (y * y + z * z),
        two * (x * y - z * w),
        two * (x * z + y * w),
        given[0],
        two * (x * y + z * w),
        one - two * (x * x + z * z),
        two * (y * z - x * w),
        given[1],
        two * (x * z - y * w),
        two * (y * z + x * w),
        one - two * (x * x + y * y),
        given[2],
        none,
        none,
        none,
        one,
    )


@wp.func
def as_map(given: wp.transformf):  # noqa: F811
    """As for `wp.transformd`."""
    wide = wp.transformd()
    for k in range(7):
        wide[k] = wp.float64(given[k])
    return as_map(wide)


@wp.func
def is_fine(m: wp.mat44d):
    """Whether a map is finite, affine and far from singular, by the bounds of `wrt.meshes.instance.check_transforms`."""
    a = linear_part(m)
    square = wp.float64(0.0)
    for row in range(3):
        for column in range(3):
            square += a[row, column] * a[row, column]
    volume = wp.abs(
        a[0, 0] * (a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1])
        - a[0, 1] * (a[1, 0] * a[2, 2] - a[1, 2] * a[2, 0])
        + a[0, 2] * (a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0])
    )
    smallest = volume / wp.max(square, TINY)
    fine = square <= MAX_SQUARE_SCALE and smallest >= MIN_SCALE and wp.sqrt(square) < MAX_CONDITION * smallest
    for k in range(4):
        last = wp.where(k == 3, wp.float64(1.0), wp.float64(0.0))
        fine = fine and wp.abs(m[3, k] - last) <= AFFINE and wp.isfinite(m[k, 3])
    return fine


@exact_kernel
def write_masks(first: int, rows: wp.array(dtype=int), mask: wp.uint32, table: wp.array(dtype=Placement)):
    """Writes the mask of an instance. Item: one of those in `rows`, or of all if it is empty."""
    i = first + wp.tid()
    if rows.shape[0] > 0:
        i = rows[i]
    table[i].mask = mask


@native.func_native(
    "instance_updates.h",
    """wrt::bound_by_team(
        points.data, points.shape[0] / 3, span.c[0], span.c[1], map, origin, corners.data, corners.shape[0] / 6, i, share.c[0],
        share.c[1]);""",
)
def bound_by_team(
    points: wp.array(dtype=wp.float64),
    span: wp.vec2i,
    map: wp.mat33d,
    origin: wp.vec3d,
    corners: wp.array(dtype=wp.float64),
    i: int,
    share: wp.vec2i,
):
    """As `bound_points`, by all threads of a team. span: begin and end of the points; share: number of a thread, and of all."""


@cache
def make_place_instances(dtype: type) -> wp.Kernel:
    """The kernel that places instances; dtype: of transforms, a matrix (`wp.mat44f`, `wp.mat44d`) or a `wp.transform`."""

    def place_instances(
        first: int,
        rows: wp.array(dtype=int),
        given: wp.array(dtype=dtype),
        cover: CoverPoints,
        bounded: BoundedInstances,
        transforms: wp.array(dtype=wp.mat44d),
        table: wp.array(dtype=Placement),
        spanned: Spanned,
    ):
        """Writes the maps of an instance, and where its mesh's centre is. Item: an instance that moves.

        rows: (M,) the instances; empty for all. given: (M,) transforms, or one for all. bounded, transforms, table: of all
        instances; table has their meshes and masks.
        """
        k = first + wp.tid()
        if k == 0:
            for one in range(wp.static(SPANNED)):
                spanned.found[one] = wp.int64(0x7FFFFFFFFFFFFFFF)
            spanned.report[12] = wp.float64(0.0)
            spanned.report[13] = wp.float64(0.0)
        i = k
        if rows.shape[0] > 0:
            i = rows[k]
        transform = as_map(given[wp.min(k, given.shape[0] - 1)])
        linear = linear_part(transform)
        inverse = inverse_map(linear)
        table[i].to_scene = linear
        table[i].to_object = inverse
        transforms[i] = transform
        bounded.origin[i] = scene_origin(transform, cover.centers[table[i].geometry])
        bounded.norms[i] = wp.where(is_fine(transform), norm(linear) * norm(inverse), wp.float64(wp.nan))

    return specialised_kernel(place_instances)


@exact_kernel
def bound_moved(
    first: int,
    team: int,
    rows: wp.array(dtype=int),
    cover: CoverPoints,
    transforms: wp.array(dtype=wp.mat44d),
    table: wp.array(dtype=Placement),
    bounded: BoundedInstances,
):
    """Writes the box of an instance that was placed. Item: a thread of the team of an instance that moves.

    team: threads of each. rows: as in `make_place_instances`.
    """
    item = first + wp.tid()
    i = item / team
    if rows.shape[0] > 0:
        i = rows[i]
    mesh, linear, origin = table[i].geometry, linear_part(transforms[i]), bounded.origin[i]
    span, share = wp.vec2i(cover.begins[mesh], cover.begins[mesh + 1]), wp.vec2i(item % team, team)
    bound_by_team(cover.points, span, linear, origin, bounded.corners, i, share)


@native.func_native("instance_updates.h", "return wrt::ordered_bits(value);")
def ordered_bits(value: wp.float64) -> wp.int64:
    """An integer in the order of doubles."""


@native.func_native("instance_updates.h", "return wrt::of_ordered(bits);")
def of_ordered(bits: wp.int64) -> wp.float64:
    """The double of `ordered_bits`."""


@native.func_native("instance_updates.h", "wrt::keep_min(found.data + k, value);")
def keep_min(found: wp.array(dtype=wp.int64), k: int, value: wp.int64):
    """found[k] becomes the least of it and of the values of all threads of a warp."""


@native.func_native("instance_updates.h", "wrt::add_all(sums.data + k, value);")
def add_all(sums: wp.array(dtype=wp.float64), k: int, value: wp.float64):
    """sums[k] grows by the values of all threads of a warp."""


@exact_kernel
def span_instances(first: int, items: int, bounded: BoundedInstances, spanned: Spanned):
    """Writes `Spanned.found`. Item: one of `items` shares of the instances; on CUDA a multiple of a warp."""
    share = first + wp.tid()
    count = bounded.norms.shape[0]
    huge = wp.int64(0x7FFFFFFFFFFFFFFF)
    minima = Minima(huge, huge, huge, huge, huge, huge, huge, huge, huge)
    i = share
    while i < count:
        if wp.isnan(bounded.norms[i]):
            minima[NOT_FINE] = wp.min(minima[NOT_FINE], wp.int64(i))
        else:
            size = wp.float64(0.0)
            for axis in range(3):
                low = bounded.corners[axis * count + i]
                high = bounded.corners[(axis + 3) * count + i]
                minima[axis] = wp.min(minima[axis], ordered_bits(low))
                minima[axis + 3] = wp.min(minima[axis + 3], ordered_bits(-high))
                size = wp.max(size, high - low)
            minima[6] = wp.min(minima[6], ordered_bits(-bounded.norms[i]))
            minima[7] = wp.min(minima[7], ordered_bits(size))
        i += items
    for k in range(wp.static(SPANNED)):
        keep_min(spanned.found, k, minima[k])


@native.func_native("instance_updates.h", "return wrt::step_below(value);")
def step_below(value: wp.float64) -> wp.float64:
    """A sixteenth of the power of two that is at most a positive number."""


@native.func_native("instance_updates.h", "return wrt::power_above(value);")
def power_above(value: wp.float64) -> wp.float64:
    """The least power of two that is at least a positive number."""


@wp.func
def middle_of(spanned: Spanned):
    """The scene's centre, as `InstanceBoxes.frame`."""
    middle = wp.vec3d()
    size = wp.float64(0.0)
    for axis in range(3):
        low = of_ordered(spanned.found[axis])
        high = -of_ordered(spanned.found[axis + 3])
        middle[axis] = (low + high) / wp.float64(2.0)
        size = wp.max(size, high - low)
    if size > wp.float64(0.0):
        step = step_below(size)
        for axis in range(3):
            middle[axis] = wp.rint(middle[axis] / step) * step
    return middle


@wp.func
def rounding_of(spanned: Spanned, center: wp.vec3d):
    """By which boxes are widened before they become float32, as `InstanceBoxes.frame`."""
    farthest = wp.float64(0.0)
    off = wp.float64(0.0)
    for axis in range(3):
        farthest = wp.max(farthest, wp.max(-of_ordered(spanned.found[axis + 3]), -of_ordered(spanned.found[axis])))
        off = wp.max(off, wp.abs(center[axis]))
    return wp.float64(8.0) * EPSILON * power_above(wp.max(farthest + off, TINY))


@wp.func
def rounded_below(value: wp.float64, center: wp.float64, rounding: wp.float64):
    """The lowest coordinate of a box in float32, rounded outwards."""
    return next_float(wp.float32(value - (center + rounding)), False)


@wp.func
def rounded_above(value: wp.float64, center: wp.float64, rounding: wp.float64):
    """The highest coordinate of a box in float32, rounded outwards."""
    return next_float(wp.float32(value - (center - rounding)), True)


@exact_kernel
def lay_out(
    first: int,
    is_still: int,
    still_center: wp.vec3d,
    bounded: BoundedInstances,
    table: wp.array(dtype=Placement),
    nodes: UpperNodes,
    spanned: Spanned,
):
    """Writes placements relative to the centre, and boxes of leaves. Item: an instance, and a lane of the upper tree.

    is_still: whether the centre stays at `still_center`, whatever moves. table: origins are written; an instance without a
    valid transform is hidden.
    """
    item = first + wp.tid()
    count = bounded.norms.shape[0]
    center = still_center
    if is_still == 0:
        center = middle_of(spanned)
    rounding = rounding_of(spanned, center)
    if item < count:
        table[item].origin = bounded.origin[item] - center
        if wp.isnan(bounded.norms[item]):
            table[item].mask = wp.uint32(0)
    if item < nodes.child.shape[0]:
        word = nodes.child[item]
        if word < 0:
            begin = item / nodes.width * 6 * nodes.width + item % nodes.width
            i = int(-1)
            if word != EMPTY_LANE:
                i = nodes.order[first_block(word) * nodes.width]
                if wp.isnan(bounded.norms[i]):
                    i = -1
            for axis in range(3):
                low = float(wp.inf)
                high = float(-wp.inf)
                if i >= 0:
                    low = rounded_below(bounded.corners[axis * count + i], center[axis], rounding)
                    high = rounded_above(bounded.corners[(axis + 3) * count + i], center[axis], rounding)
                nodes.bounds[begin + axis * nodes.width] = low
                nodes.bounds[begin + (axis + 3) * nodes.width] = high
    if item == 0:
        for axis in range(3):
            lowest = of_ordered(spanned.found[axis])
            highest = -of_ordered(spanned.found[axis + 3])
            spanned.report[axis] = lowest
            spanned.report[axis + 3] = highest
            spanned.report[axis + 9] = center[axis]
            spanned.extent[axis] = rounded_below(lowest, center[axis], rounding)
            spanned.extent[axis + 3] = rounded_above(highest, center[axis], rounding)
            spanned.report[axis + 14] = wp.float64(spanned.extent[axis])
            spanned.report[axis + 17] = wp.float64(spanned.extent[axis + 3])
        norms = -of_ordered(spanned.found[6])
        spanned.report[6] = norms
        spanned.report[7] = of_ordered(spanned.found[7])
        spanned.report[8] = wp.float64(spanned.found[NOT_FINE])
        spanned.extent[6] = wp.float32(wp.float64(2.0) * norms)


@native.func_native("instance_updates.h", "wrt::refit_lane(bounds.data, node, lane, child, width);")
def refit_lane(bounds: wp.array(dtype=float), node: int, lane: int, child: int, width: int):
    """Writes the box of an inner child from those of its own children."""


@native.func_native("instance_updates.h", "wrt::meet_block();")
def meet_block():
    """All threads of a block wait for each other."""


@exact_kernel
def refit_level(first: int, lane_first: int, nodes: UpperNodes):
    """Item: a lane of a level, the levels below being done."""
    lane = lane_first + first + wp.tid()
    if nodes.child[lane] >= 0:
        refit_lane(nodes.bounds, lane / nodes.width, lane % nodes.width, nodes.child[lane], nodes.width)


@cache
def make_refit_levels(block: int) -> wp.Kernel:
    """The kernel that refits many small levels in turn; block: its threads on CUDA."""

    def refit_levels(first: int, threads: int, levels: int, nodes: UpperNodes):
        """Item: a thread of the one block, of `threads`. levels: those above are refitted, from the lowest of them."""
        item = first + wp.tid()
        lane = nodes.level_first[levels - 1] * nodes.width + item
        end = nodes.level_first[levels] * nodes.width
        word = int(-1)
        if lane < end:
            word = nodes.child[lane]
        for step in range(levels):
            while lane < end:
                if word >= 0:
                    refit_lane(nodes.bounds, lane / nodes.width, lane % nodes.width, word, nodes.width)
                lane += threads
                if lane < end:
                    word = nodes.child[lane]
            if step < levels - 1:  # what the next level reads that this one does not write is read while others are at work
                end = nodes.level_first[levels - 1 - step] * nodes.width
                lane = nodes.level_first[levels - 2 - step] * nodes.width + item
                if lane < end:
                    word = nodes.child[lane]
            meet_block()

    return specialised_kernel(refit_levels, bounds=(block, 1))


@exact_kernel
def send_report(first: int, spanned: Spanned, sent: wp.array(dtype=wp.float64)):
    """Writes `Spanned.report` where the host reads it, in memory of the host; recorded like other launches. Item: a number."""
    i = first + wp.tid()
    sent[i] = spanned.report[i]


@exact_kernel
def measure_nodes(first: int, items: int, nodes: UpperNodes, spanned: Spanned):
    """Writes the surfaces in `Spanned.report`. Item: one of `items` shares of the lanes; on CUDA a multiple of a warp."""
    share = first + wp.tid()
    inner = wp.float64(0.0)
    outer = wp.float64(0.0)
    lane = share
    while lane < nodes.child.shape[0]:
        word = nodes.child[lane]
        if word != EMPTY_LANE:
            begin = lane / nodes.width * 6 * nodes.width + lane % nodes.width
            size = wp.vec3d()
            for axis in range(3):
                low = wp.float64(nodes.bounds[begin + axis * nodes.width])
                size[axis] = wp.float64(nodes.bounds[begin + (axis + 3) * nodes.width]) - low
            area = size[0] * size[1] + size[1] * size[2] + size[2] * size[0]
            if not wp.isfinite(area):
                area = wp.float64(0.0)
            inner += wp.where(word >= 0, area, wp.float64(0.0))
            outer += wp.where(word >= 0, wp.float64(0.0), area)
        lane += items
    add_all(spanned.report, 12, inner)
    add_all(spanned.report, 13, outer)

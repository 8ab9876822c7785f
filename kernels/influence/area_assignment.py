"""Assigns rays to influence areas: an octree lookup over the areas' regions, and the range of t that an area's tree covers.

An influence area is a region in which the distribution of rays is known. It has a tree of its own over the triangles that touch
the region, built for that distribution. A ray belongs to an area if it starts in the region and its direction agrees with the
distribution (Falcone 2024, section 3.1). Forward and backward directions are equivalent, because their projections are the
same.

**The octree.** A cell is one number of `child`: the index of the first of its eight consecutive children, or ~list for a leaf,
where `list` is the list of areas whose regions touch the leaf. Child 4 z + 2 y + x is the upper half along an axis if the bit
of the axis is set. Leaves with the same areas share a list, so a cell costs only a few bytes. An octree of one cell, a leaf
with all areas, is a plain array. In a kd-tree, a number is four times the index of the first of two children, plus the axis,
and `plane` has the coordinate from which on points belong to the second child. The lists are conservative; the test of the
region decides, after a test of its bounding box.

**The range that an area covers.** Regions are convex, so a ray that starts in one stays inside until the t at which it leaves.
Every triangle that it can hit before that t touches the region and is therefore in the area's tree. A hit found there is the
closest hit of the scene, and ties are resolved as everywhere, because the lists keep the order of the triangles. A ray is
therefore split in two: the area's tree is searched up to the t of leaving; if it finds nothing, the tree of the whole scene is
searched from there. The second part is empty if the ray ends, or leaves the scene's box, first.

**Rounding.** The point of a hit lies in the box of its triangle, widened by the slack of the ray (the consistency rule,
`wrt.kernels.simd.boxes`), for every triangle test. An area's tree therefore contains every triangle whose *box* touches the
region widened by a margin of several times the greatest slack of any ray that starts there
(`wrt.builders.influence.area_top_level`). With this margin the argument above holds for every computed hit, to the bit,
including triangles that are seen edge-on.

References: falcone-2024 (chapter 3, section 5.5).
"""

import warp as wp

from wrt.kernels.influence.area_lanes import LANE_WORDS, MARK_WORDS, AreaSplits, load_block, store_block, sum_blocks, try_area
from wrt.kernels.influence.region_tests import Region
from wrt.kernels.influence.view import AreaView
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.simd.boxes import INFINITY
from wrt.kernels.traversal.stream.stream_kernel import LIST_LANES

ANY_SINE = 2.0
"""A bound that the sine of no angle reaches."""


@wp.struct
class AreaTree:
    """The influence areas of a scene and an octree over their regions; coordinates are relative to the scene's centre."""

    regions: wp.array(dtype=Region)
    """(areas,) regions in which rays that belong to them start."""
    views: wp.array(dtype=AreaView)
    """(areas,) distributions of their directions."""
    sine: float
    """Sine of the greatest angle between a ray and the distribution's direction at its origin."""
    touch: float
    """Greatest distance at which an origin counts as the common point of a radial distribution; covers the rounding of
    origins."""
    low: wp.vec3d
    """Lower corner of the root cube; points outside the cube have no area."""
    high: wp.vec3d
    """Upper corner of the root cube."""
    cells: wp.float64
    """Cells per unit of length along an axis, at the greatest depth."""
    depth: int
    """Greatest number of levels below the root: 2^depth cells along an axis."""
    child: wp.array(dtype=int)
    """(cells,) index of the first of eight children, or ~list; in a kd-tree 4 * index of the first of two children + axis."""
    plane: wp.array(dtype=wp.float64)
    """(cells,) coordinates of the planes of a kd-tree; empty for an octree."""
    begin: wp.array(dtype=int)
    """(lists + 1,) start of each list in `area`."""
    area: wp.array(dtype=int)
    """Area numbers of all lists, ascending within a list."""


@wp.func
def find_in_kdtree(areas: AreaTree, point: wp.vec3d):
    """Returns the list of the leaf of a kd-tree that contains a point, -1 outside the root."""
    for axis in range(3):
        if not (point[axis] >= areas.low[axis] and point[axis] <= areas.high[axis]):
            return -1
    cell = int(0)
    child = areas.child[0]
    while child >= 0:
        cell = (child >> 2) + wp.where(point[child & 3] >= areas.plane[cell], 1, 0)
        child = areas.child[cell]
    return ~child


@wp.func
def find_list(areas: AreaTree, point: wp.vec3d):
    """Returns the list of the leaf that contains a point, -1 outside the root.

    The path to the leaf is given by the bits of the point's coordinates on the finest grid, from the highest bit down.
    """
    if areas.plane.shape[0] > 0:
        return find_in_kdtree(areas, point)
    place = (point - areas.low) * areas.cells
    end = wp.float64(1 << areas.depth)
    for axis in range(3):
        if not (place[axis] >= wp.float64(0.0) and place[axis] < end):
            return -1
    x = int(place[0])
    y = int(place[1])
    z = int(place[2])
    child = areas.child[0]
    level = int(areas.depth)
    while child >= 0:
        level -= 1
        child = areas.child[child + (((x >> level) & 1) | (((y >> level) & 1) << 1) | (((z >> level) & 1) << 2))]
    return ~child


@exact_kernel
def list_points(first: int, areas: AreaTree, points: wp.array(dtype=wp.vec3d), lists: wp.array(dtype=int)):
    """Writes the list of the leaf that contains a point, -1 outside the root. Item: a point."""
    i = first + wp.tid()
    lists[i] = find_list(areas, points[i])


@wp.func
def find_lists(areas: AreaTree, count: int, lanes: wp.array(dtype=float), marks: wp.array(dtype=int)):
    """Finds the list of each valid ray of a block. If the octree has one cell, all rays have the same list."""
    if areas.depth > 0:
        for k in range(count):
            if marks[wp.static(LIST_LANES) + k] == 0:
                point = wp.vec3d(wp.vec3(lanes[k], lanes[wp.static(LIST_LANES) + k], lanes[wp.static(2 * LIST_LANES) + k]))
                marks[wp.static(LIST_LANES) + k] = find_list(areas, point)


@wp.func
def reaches(region: Region, lanes: wp.array(dtype=float)):
    """Whether the box around a region overlaps the box around the origins of a block."""
    at = wp.static(9 * LIST_LANES)
    return (
        wp.float64(lanes[at]) <= region.high[0]
        and wp.float64(lanes[at + 1]) <= region.high[1]
        and wp.float64(lanes[at + 2]) <= region.high[2]
        and wp.float64(lanes[at + 3]) >= region.low[0]
        and wp.float64(lanes[at + 4]) >= region.low[1]
        and wp.float64(lanes[at + 5]) >= region.low[2]
    )


@wp.func
def find_areas(areas: AreaTree, count: int, lanes: wp.array(dtype=float), marks: wp.array(dtype=int)):
    """Finds the area of each ray of a block: the first one to which it belongs."""
    last = int(-1)
    for k in range(count):
        which = marks[wp.static(LIST_LANES) + k]
        if which >= 0 and which != last and marks[k] < 0:  # most blocks have one list; repeats are harmless
            for entry in range(areas.begin[which], areas.begin[which + 1]):
                area = areas.area[entry]
                if reaches(areas.regions[area], lanes):
                    try_area(area, areas.regions[area], areas.views[area], areas.sine, areas.touch, which, lanes, marks)
        last = which


@wp.func
def take_areas(
    areas: AreaTree,
    given: wp.array(dtype=int),
    stride: int,
    begin: int,
    count: int,
    lanes: wp.array(dtype=float),
    marks: wp.array(dtype=int),
):
    """Gives each ray of a block its area, if it starts in it; directions are not looked at."""
    for k in range(count):
        if marks[wp.static(LIST_LANES) + k] == 0:
            marks[wp.static(LIST_LANES) + k] = given[(begin + k) * stride]
    last = int(-1)
    for k in range(count):
        which = marks[wp.static(LIST_LANES) + k]
        if which >= 0 and which != last and marks[k] < 0 and reaches(areas.regions[which], lanes):
            try_area(which, areas.regions[which], areas.views[which], wp.static(ANY_SINE), areas.touch, which, lanes, marks)
        last = which


@exact_kernel
def assign_rays(
    first: int,
    rays: RayBatch,
    chunk: int,
    areas: AreaTree,
    given: wp.array(dtype=int),
    stride: int,
    low: wp.vec3,
    high: wp.vec3,
    splits: AreaSplits,
    sums: wp.array(dtype=wp.vec4i),
):
    """Finds the area of each ray and the t at which the ray is split. Item: a chunk of rays, a multiple of the lanes.

    Args:
        first: number of the first item.
        rays: the batch.
        chunk: rays of an item.
        areas: the influence areas.
        given, stride: `given[i * stride]` is the area of ray i, -1 for none; (0,) to find areas. A ray that does not start in
            the region of its area has none, so a wrong area changes no hit.
        low, high: corners of a box that contains all hits.
        splits: where the rays are split.
        sums: (chunks,) per chunk: rays with an area and a second part, greatest number of an area, `areas` less the least
            number, rays without an area.
    """
    item = first + wp.tid()
    lanes = wp.zeros(shape=(LANE_WORDS,), dtype=float)
    marks = wp.zeros(shape=(MARK_WORDS,), dtype=int)
    begin = item * chunk
    end = wp.min(rays.count, begin + chunk)
    while begin < end:
        count = load_block(rays, begin, end - begin, lanes, marks)
        if given.shape[0] > 0:
            take_areas(areas, given, stride, begin, count, lanes, marks)
        else:
            find_lists(areas, count, lanes, marks)
            find_areas(areas, count, lanes, marks)
        store_block(begin, count, areas.regions.shape[0], low, high, lanes, marks, splits)
        begin += count
    sums[item] = sum_blocks(marks)


@exact_kernel
def mark_unassigned(
    first: int,
    areas: int,
    area: wp.array(dtype=wp.uint16),
    rest: wp.array(dtype=float),
    primitive: wp.array(dtype=int),
    occluded: wp.array(dtype=wp.bool),
    bucket: wp.array(dtype=wp.uint16),
):
    """Writes bucket 0 for rays that the scene's tree must still trace, 1 for the others. Item: a ray.

    One of `primitive` and `occluded` holds the results of the first part; the other is empty.
    """
    i = first + wp.tid()
    done = int(area[i]) < areas
    if done and rest[i] < INFINITY:
        done = primitive[i] >= 0 if primitive.shape[0] > 0 else occluded[i]
    bucket[i] = wp.uint16(wp.where(done, 1, 0))

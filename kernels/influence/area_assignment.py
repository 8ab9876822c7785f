"""Which influence area a ray belongs to: a look into an octree over the areas' regions, and how far the area answers for it.

An influence area is a region in which rays are distributed in a known way, and has a tree of its own, made for them, over the
triangles that touch the region. A ray is affine to it if it starts in the region and runs along the distribution
(Falcone 2024, section 3.1; forward or backward, as projections are the same both ways).

**The octree.** A cell is a word of `child`: the first of its eight children, which follow one another, or ~list, a leaf and the
list of areas whose regions touch it. Child 4 z + 2 y + x has the upper half along an axis where its bit is set. Leaves with
the same areas share a list, so an octree is some bytes a cell. A tree of one cell, a leaf with all areas, is the plain array.
Lists are conservative; what counts is the test of the region itself, that of the box around it first.

**How far an area answers.** Regions are convex: a ray that starts in one is inside up to the t at which it leaves. Every
triangle that it can meet until then touches the region, and is in the area's tree: a hit there is the closest of all, with
the smaller id of two at the same t as everywhere, as lists keep the triangles' order. So a ray is cut in two: up to where it
leaves, the area's tree answers; if that finds nothing, the whole scene's tree answers for the rest. No rest is left if the
ray ends before, or leaves the scene's box first.

**Rounding.** A hit's point is in its triangle's box widened by the ray's slack (the consistency rule,
`wrt.kernels.simd.boxes`), whatever the triangle test. So an area's tree has every triangle whose *box* touches the region
widened by a margin, several times the greatest slack of any ray that starts there (`wrt.builders.influence.area_top_level`):
then the argument holds for every computed hit, to the bit, for triangles seen edge-on too.

References:
    L. Falcone: Ray distribution aware heuristics for bounding volume hierarchies construction in ray tracing. MSc thesis,
        Politecnico di Milano, 2024 (chapter 3, section 5.5).
"""

import warp as wp

from wrt.kernels.influence.area_lanes import LANE_WORDS, MARK_WORDS, load_block, store_block, sum_blocks, try_area
from wrt.kernels.influence.region_tests import Region
from wrt.kernels.influence.view import AreaView
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.simd.boxes import INFINITY
from wrt.kernels.traversal.stream.stream_kernel import LIST_LANES

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.struct
class AreaTree:
    """The influence areas of a scene and an octree over their regions; coordinates are relative to the scene's centre."""

    regions: wp.array(dtype=Region)
    """(areas,) where rays may start."""
    views: wp.array(dtype=AreaView)
    """(areas,) how rays run."""
    sine: float
    """Of the greatest angle between a ray and the area's ray through its origin."""
    touch: float
    """Distance from the point that radial rays go through below which a ray starts at it: rounding of the origin."""
    low: wp.vec3d
    """Lower corner of the root's cube; outside it there is no area."""
    cells: wp.float64
    """Cells along an axis for each unit of length, at the greatest depth."""
    depth: int
    """Levels below the root, at most: 2^depth cells along an axis."""
    child: wp.array(dtype=int)
    """(cells,) the first of eight children, or ~list."""
    begin: wp.array(dtype=int)
    """(lists + 1,) where each list begins."""
    area: wp.array(dtype=int)
    """The lists, each in ascending order."""


@wp.func
def find_list(areas: AreaTree, point: wp.vec3d):
    """The list of the leaf around a point, -1 outside the root.

    The bits of the point's place on the finest grid, from the highest down, are the way to its leaf.
    """
    place = (point - areas.low) * areas.cells
    end = wp.float64(1 << areas.depth)
    for axis in range(3):
        if not (place[axis] >= wp.float64(0.0) and place[axis] < end):
            return -1
    x = int(place[0])
    y = int(place[1])
    z = int(place[2])
    word = areas.child[0]
    level = int(areas.depth)
    while word >= 0:
        level -= 1
        word = areas.child[word + (((x >> level) & 1) | (((y >> level) & 1) << 1) | (((z >> level) & 1) << 2))]
    return ~word


@wp.kernel
def list_points(first: int, areas: AreaTree, points: wp.array(dtype=wp.vec3d), lists: wp.array(dtype=int)):
    """Item: a point. The list of the leaf around it, -1 outside the root."""
    i = first + wp.tid()
    lists[i] = find_list(areas, points[i])


@wp.func
def find_lists(areas: AreaTree, count: int, lanes: wp.array(dtype=float), marks: wp.array(dtype=int)):
    """The list of each valid ray of a block; of an array, all have the same."""
    if areas.depth > 0:
        for k in range(count):
            if marks[wp.static(LIST_LANES) + k] == 0:
                point = wp.vec3d(wp.vec3(lanes[k], lanes[wp.static(LIST_LANES) + k], lanes[wp.static(2 * LIST_LANES) + k]))
                marks[wp.static(LIST_LANES) + k] = find_list(areas, point)


@wp.func
def reaches(region: Region, lanes: wp.array(dtype=float)):
    """Whether the box around a region and that of a block's origins have a point in common."""
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
    """The area of each ray of a block: the first to which it is affine."""
    last = int(-1)
    for k in range(count):
        which = marks[wp.static(LIST_LANES) + k]
        if which >= 0 and which != last and marks[k] < 0:  # mostly, the rays of a block have one list; again does no harm
            for entry in range(areas.begin[which], areas.begin[which + 1]):
                area = areas.area[entry]
                if reaches(areas.regions[area], lanes):
                    try_area(area, areas.regions[area], areas.views[area], areas.sine, areas.touch, which, lanes, marks)
        last = which


@wp.kernel
def assign_rays(
    first: int,
    rays: RayBatch,
    chunk: int,
    areas: AreaTree,
    low: wp.vec3,
    high: wp.vec3,
    area: wp.array(dtype=wp.uint16),
    cut: wp.array(dtype=float),
    rest: wp.array(dtype=float),
    sums: wp.array(dtype=wp.vec4i),
):
    """Item: a chunk of rays, a multiple of the lanes. For each its area, and where it is cut.

    low, high: corners that hold all hits.
    area: of a ray, or the number of areas if it has none.
    cut: the t up to which the area's tree answers; -1, so that the ray misses there, if it has none.
    rest: the t from which on the scene's tree does; inf if there is nothing left.
    sums: (chunks,) of a chunk, the rays with an area and a rest, the greatest number in `area`, areas less the least one, and
        the rays without an area.
    """
    item = first + wp.tid()
    lanes = wp.zeros(shape=(LANE_WORDS,), dtype=float)
    marks = wp.zeros(shape=(MARK_WORDS,), dtype=int)
    begin = item * chunk
    end = wp.min(rays.count, begin + chunk)
    while begin < end:
        count = load_block(rays, begin, end - begin, lanes, marks)
        find_lists(areas, count, lanes, marks)
        find_areas(areas, count, lanes, marks)
        store_block(begin, count, areas.regions.shape[0], low, high, lanes, marks, area, cut, rest)
        begin += count
    sums[item] = sum_blocks(lanes, marks)


@wp.kernel
def mark_rest(
    first: int,
    areas: int,
    area: wp.array(dtype=wp.uint16),
    rest: wp.array(dtype=float),
    primitive: wp.array(dtype=int),
    occluded: wp.array(dtype=wp.bool),
    bucket: wp.array(dtype=wp.uint16),
):
    """Item: a ray. Bucket 0 for those that are left to the scene's tree, else 1; one of the two results is there."""
    i = first + wp.tid()
    done = int(area[i]) < areas
    if done and rest[i] < INFINITY:
        done = primitive[i] >= 0 if primitive.shape[0] > 0 else occluded[i]
    bucket[i] = wp.uint16(wp.where(done, 1, 0))

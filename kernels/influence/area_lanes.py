"""Lane loops that assign rays to influence areas, 16 rays at a time.

A block of 16 rays is two local arrays, `AreaLanes` and `AreaMarks` of `kernels/native/area_lanes.h`. `lanes` has rows of floats
(origin, direction, t_min, t_max, leave) and the six bounds of the box around the origins. `marks` has rows of ints: the area
found (-1 for none), the list of the octree leaf that contains the origin (-1 for rays that belong to no area), and four sums
over all blocks. Lanes are float32; a scalar float64 loop takes as long as tracing the rays
(notebooks/records/2026-11-21-single-rays.md).

**Precision.** The faces of a region are moved outward by the rounding error of an origin. The t at which a ray leaves has an
error of a few roundings of the distance. Both errors are far smaller than the margin of the areas' trees
(`wrt.kernels.influence.area_assignment`).
"""

import warp as wp

from wrt.kernels.influence.region_tests import Region
from wrt.kernels.influence.view import AreaView
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.traversal.stream.stream_kernel import LIST_LANES

LANE_WORDS = wp.constant(9 * LIST_LANES + 6)
"""Number of elements of `lanes`."""

MARK_WORDS = wp.constant(6 * LIST_LANES)
"""Number of elements of `marks`."""

_BLOCK = f"*(wrt::AreaLanes<{LIST_LANES}>*)lanes.data, *(wrt::AreaMarks<{LIST_LANES}>*)marks.data"
"""C++: the two arrays of a block."""

_CHECK = f"""
static_assert(sizeof(wrt::AreaLanes<{LIST_LANES}>) == 4 * {LANE_WORDS});
static_assert(sizeof(wrt::AreaMarks<{LIST_LANES}>) == 4 * {MARK_WORDS});
"""
"""C++: the arrays are as long as here."""


@wp.struct
class AreaSplits:
    """Where rays are split between the tree of their area and that of the scene."""

    area: wp.array(dtype=wp.uint16)
    """(rays,) area of each ray; the number of areas for a ray without one."""
    cut: wp.array(dtype=float)
    """(rays,) t up to which the area's tree is searched; -1, so that the ray misses, for a ray without an area."""
    rest: wp.array(dtype=float)
    """(rays,) t from which the scene's tree is searched; inf if nothing is left."""


@native.func_native("area_lanes.h", f"{_CHECK}return wrt::load_area_rays(batch, first, count, {_BLOCK});")
def load_block(batch: RayBatch, first: int, count: int, lanes: wp.array(dtype=float), marks: wp.array(dtype=int)) -> int:
    """Loads up to `count` rays from `first` on, with list 0, and bounds their origins; returns the number of rays."""


@native.func_native("area_lanes.h", f"wrt::try_area(number, region, view, sine, touch, which, {_BLOCK});")
def try_area(
    number: int,
    region: Region,
    view: AreaView,
    sine: float,
    touch: float,
    which: int,
    lanes: wp.array(dtype=float),
    marks: wp.array(dtype=int),
):
    """Assigns area `number` to the rays of list `which` that have no area yet and belong to it.

    A ray belongs to an area if it starts in the region, if its direction agrees with the area's distribution (forward or
    backward; in radial areas a ray that starts at the common point always agrees), and if part of its range lies in the region.
    """


@native.func_native(
    "area_lanes.h",
    f"wrt::store_area_rays(first, count, areas, low, high, {_BLOCK}, splits.area.data, splits.cut.data, splits.rest.data);",
)
def store_block(
    first: int,
    count: int,
    areas: int,
    low: wp.vec3,
    high: wp.vec3,
    lanes: wp.array(dtype=float),
    marks: wp.array(dtype=int),
    splits: AreaSplits,
):
    """Writes where the rays are split (`wrt.kernels.influence.area_assignment.assign_rays`) and adds them to the sums of the
    lanes."""


@native.func_native(
    "area_lanes.h",
    "int sums[4] = {};\n"
    f"wrt::sum_areas(*(const wrt::AreaMarks<{LIST_LANES}>*)marks.data, sums);\n"
    "return wp::vec4i(sums[0], sums[1], sums[2], sums[3]);",
)
def sum_blocks(marks: wp.array(dtype=int)) -> wp.vec4i:
    """Sums over all stored rays.

    Returns (rays that leave their area before they end, greatest area, `areas` less the least area, rays without an area).
    """

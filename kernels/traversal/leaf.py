"""One ray against one block of W triangles: the innermost step of all single-ray traversals."""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit, improves
from wrt.kernels.layout.ray_batch import Ray
from wrt.kernels.runtime import native
from wrt.kernels.simd.boxes import RaySlabs, clamp_to_box, slab_interval
from wrt.kernels.simd.lanes import lanes, lowest_bit
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import (
    Corners,
    Record,
    TriangleBlocks,
    corners_high,
    corners_low,
    load_corners,
)


@wp.struct
class Counters:
    """Work done for one ray; the work of a packet is recorded at its first ray."""

    nodes: int
    """Inner nodes visited."""
    leaves: int
    """Leaves visited, empty ones included."""
    triangles: int
    """Triangles that the ray, or at least one vector of a packet, was tested against; unused lanes of a block are not
    counted."""
    boxes: int
    """Wide trees: tests of a ray, or of a packet as a whole, against the box of a child."""
    culled: int
    """Packets: triangles in visited leaves that no ray was tested against."""
    lanes: int
    """Packets: ray-triangle lanes tested, idle lanes included."""
    active: int
    """Packets: those of them whose ray meets the triangle's box before its best hit so far."""
    avoided: int
    """Triangles that were not tested again because a mailbox remembered them."""


@wp.struct
class CounterRows:
    """The array to which kernels write counters.

    It is wrapped in a struct because Warp compiles a CPU kernel with a one-dimensional array parameter twice, for contiguous
    and for strided arrays; that takes longer and gives slower code (notebooks/records/2026-11-21-single-rays.md).
    """

    rows: wp.array(dtype=Counters)
    """(rays,); any length if counting is off."""


@wp.struct
class Leaf:
    """A leaf that a ray is in."""

    node: int
    """Its node, or the child word that leads to it."""
    within: wp.vec2
    """Closed interval of t in which the ray is in it."""
    block: int
    """Its first block of triangles."""
    count: int
    """Number of its triangles."""


@cache
def leaf_search(triangle_test: str) -> type:
    """The struct of the search state that leaf tests need: the triangles and the ray."""

    class LeafSearch:
        triangles: TriangleBlocks
        state: TRIANGLE_TESTS[triangle_test].ray_state
        slabs: RaySlabs
        t_min: float

    LeafSearch.__qualname__ = f"LeafSearch_{triangle_test}"
    return wp.struct(LeafSearch)


@cache
def begin_search(triangle_test: str) -> wp.Function:
    """`wp.func(triangles, ray, slabs) -> search`: the initial search state of a ray."""
    LeafSearch, prepare = leaf_search(triangle_test), TRIANGLE_TESTS[triangle_test].prepare

    @wp.func
    def begin(triangles: TriangleBlocks, ray: Ray, slabs: RaySlabs):
        search = LeafSearch()
        search.triangles = triangles
        search.state = prepare(ray.origin, ray.direction)
        search.slabs = slabs
        search.t_min = ray.t_min
        return search

    return begin


@wp.func
def enter(slabs: RaySlabs, low: wp.vec3, high: wp.vec3, t_min: float, t_max: float):
    """(entry, leave): the part of the ray's range inside the scene's box; empty if entry > leave."""
    interval = slab_interval(slabs, low, high)
    return wp.vec2(wp.max(interval[0], t_min), wp.min(interval[1], t_max))


@native.func_native("leaf.h", "return wrt::comes_from_front<1>((const float*)&corners, wrt::box_ray(slabs));")
def comes_from_front(slabs: wp.ref[RaySlabs], corners: wp.ref[Corners]) -> bool:
    """Whether a ray comes from the side from which a triangle is wound counter-clockwise; false if it is seen edge-on."""


@cache
def clamp_block(record: Record, width: int, cull_backfaces: bool = False) -> wp.Function:
    """`wp.func(records, block, slabs, mask, t, t_min, t_max) -> mask`: `clamp_to_box` for the W candidates of a block.

    Returns the lanes of `mask` that are hits by the consistency rule, with t_min <= t <= t_max; `t` is clamped in place. If
    back faces are culled, only hits from the front are returned.
    """
    Lanes = lanes(width)
    form = f"{width}, {record.components}, {int(cull_backfaces)}"

    @native.func_native("leaf.h", f"return wrt::clamp_block<{form}>(records.data, block, slabs, mask, t.c, t_min, t_max);")
    def clamp_block_native(
        records: wp.array(dtype=float),
        block: int,
        slabs: wp.ref[RaySlabs],
        mask: wp.uint32,
        t: wp.ref[Lanes],
        t_min: float,
        t_max: float,
    ) -> wp.uint32: ...

    return clamp_block_native


@cache
def triangle_step(config: TraversalConfig) -> wp.Function:
    """`wp.func(records, slot, state, slabs) -> vec3 (t, u, v)`: one candidate, by the scalar test; t is NaN for none."""
    test = TRIANGLE_TESTS[config.triangle_test]
    RayState, intersect, width = (
        test.ray_state,
        test.forms(config.answer.rules.crossings, config.answer.rules.oriented).intersect,
        config.width,
    )
    load, load_vertices = test.record.load, load_corners(test.record.components)
    culling = config.cull_backfaces

    @wp.func
    def step(records: wp.array(dtype=float), slot: int, state: RayState, slabs: RaySlabs):
        hit = intersect(state, load(records, slot, wp.static(width)))
        if hit[0] != hit[0]:
            return hit
        corners = load_vertices(records, slot, wp.static(width))
        if wp.static(culling):  # noqa: SIM102  (Warp evaluates both operands of `and`)
            if not comes_from_front(slabs, corners):
                return wp.vec3(wp.nan, 0.0, 0.0)
        return wp.vec3(clamp_to_box(slabs, corners_low(corners), corners_high(corners), hit[0]), hit[1], hit[2])

    return step


@cache
def block_step(config: TraversalConfig) -> wp.Function:
    """`wp.func(triangles, block, state, slabs, t_min, best) -> best` for one block of `config.width` triangles."""
    if config.single.scalar_test:
        return scalar_block_step(config)
    test = TRIANGLE_TESTS[config.triangle_test]
    width = config.width
    Lanes = lanes(width)
    RayState = test.ray_state
    intersect_block, clamp = test.block_test(width), clamp_block(test.record, width, config.cull_backfaces)
    any_hit = config.answer.rules.ends_at_first

    @wp.func
    def step(triangles: TriangleBlocks, block: int, state: RayState, slabs: wp.ref[RaySlabs], t_min: float, best: BestHit):
        t_lanes = Lanes()
        u_lanes = Lanes()
        v_lanes = Lanes()
        mask = intersect_block(triangles.records, block, state, t_lanes, u_lanes, v_lanes)
        if mask != wp.uint32(0):
            mask = clamp(triangles.records, block, slabs, mask, t_lanes, t_min, best.t)
        while mask != wp.uint32(0):
            lane = lowest_bit(mask)
            mask = mask & (mask - wp.uint32(1))
            t = t_lanes[lane]
            primitive = triangles.primitive[block * wp.static(width) + lane]
            if improves(t, primitive, t_min, best):
                best = BestHit(t, primitive, u_lanes[lane], v_lanes[lane])
                if wp.static(any_hit):
                    mask = wp.uint32(0)
        return best

    return step


@cache
def scalar_block_step(config: TraversalConfig) -> wp.Function:
    """The same as `block_step` by the scalar test, one triangle after the other: every early exit of a test is a branch."""
    width, any_hit = config.width, config.answer.rules.ends_at_first
    RayState, candidate = TRIANGLE_TESTS[config.triangle_test].ray_state, triangle_step(config)

    @wp.func
    def step(triangles: TriangleBlocks, block: int, state: RayState, slabs: wp.ref[RaySlabs], t_min: float, best: BestHit):
        slot = block * wp.static(width)
        end = slot + wp.static(width)
        while slot < end:
            primitive = triangles.primitive[slot]
            if primitive < 0:
                break
            hit = candidate(triangles.records, slot, state, slabs)
            if improves(hit[0], primitive, t_min, best):
                best = BestHit(hit[0], primitive, hit[1], hit[2])
                if wp.static(any_hit):
                    break
            slot += 1
        return best

    return step

"""Multi-frusta tracing of shadow rays to an area light (Benthin and Wald 2009).

**Problem.** The shadow rays of one point to an area light are alike, those of neighbouring points less so. A packet of both has
loose bounds: it visits many nodes that few of its rays meet.

**Idea.** The rays from one point to a group of 16 samples of the light are a *frustum*: with a common origin, bounds are
intervals of directions alone, and these are known from the point and the box of the group, without a ray. 16 frusta walk the
tree together. A node has a bit for each frustum that meets it; a frustum against the W boxes of a node is one lane loop. Each
frustum ends when all of its rays are answered. Its rays are made when it first meets a triangle, so most frusta of lit points
never have any.

**Both signs.** Where an interval of directions contains 0, slabs bound nothing (`interval_culling` says what remains). There
the box around the frustum, from the point to the group, must meet the node's box.

**At leaves** the frustum is tested against the boxes of W triangles, and these against the four planes through its corner rays:
a triangle is culled if all of its vertices lie outside one of them. (For accurate triangle tests, whose hits lie near their
triangles; others cull by boxes.) What is left is tested only if one of the rays that are still open meets the box of the leaf,
because a wide frustum meets many leaves that none of its rays meets (notebooks/records/2026-11-23-multi-frusta.md). Rays are
tested 16 x one triangle, by the code of packets (`packet_block`).

**The same answers as `occluded`** of the same rays: bounds are rounded monotonically from the same expressions, so a frustum
meets every box that one of its rays meets; triangle test and consistency rule are those of every traversal. A direction whose
component may be flushed to 0 (`wrt.kernels.layout.ray_batch`, short directions) counts as one of both signs.

**Differences from the paper.** The children of a wide node are in the lanes, as elsewhere in this project. Back faces are not
culled at leaves, because `occluded` is hit by both sides. Eye rays have a traversal of their own
(`wrt.kernels.classics.traversal.eye_frusta`).

References: benthin-wald-2009; rahikainen-2013 (section 2.3).
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.bvh_nodes import WideNodes
from wrt.kernels.layout.light_samples import GROUP, LightSamples
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.traversal.packet.leaves.packet_block import block_code
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout, cpp
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

FRUSTA = 16
"""Frusta that walk the tree together."""

FLUSHED = 2.0**-90
"""Fraction of a direction's size below which a component may be flushed to 0, with room for rounding (`NEGLIGIBLE`)."""


@cache
def make_trace(config: TraversalConfig, each: bool) -> wp.Function:
    """`wp.func(tree, triangles, rays, light, begin, count, occluded, counts)`: traces frusta begin .. begin + count -
    1."""
    layout, test = PacketLayout(GROUP, config.width, True, config.triangle_test), TRIANGLE_TESTS[config.triangle_test]
    sizes = f"{FRUSTA}, {GROUP}, {config.width}, {len(layout.components)}, {layout.record}, {config.stack.levels}"
    make = f"const auto own = all.rays_of(f); {layout.state} all.make_rays(f, rays, light, {layout.prepare});"
    check = f"auto& bounds = all.frusta[f]; const auto own = all.rays_of(f); {layout.names} {block_code(layout, any_hit=True)}"

    @native.func_native(
        f"multi_frusta.h {layout.headers}",
        f"""const auto &records = triangles.records, &boxes = tree.bounds;
        const auto& ids = triangles.primitive;
        static_assert(wrt::FLUSHED == {FLUSHED!r}f);
        wrt::MultiFrusta<{sizes}, {cpp(test.accurate)}> all;
        const auto make = [&](int f) {{ {make} }};
        const auto test = [&](int f, int block, unsigned mask) {{ {check} }};
        all.trace(tree, records.data, rays, light, begin, count, make, test);
        all.store<{cpp(each)}>(light, count, occluded.data, counts.data);""",
    )
    def trace_native(
        tree: WideNodes,
        triangles: TriangleBlocks,
        rays: RayBatch,
        light: LightSamples,
        begin: int,
        count: int,
        occluded: wp.array(dtype=wp.uint8),
        counts: wp.array(dtype=int),
    ): ...

    return trace_native


@cache
def make_multi_frusta_kernel(config: TraversalConfig, each: bool) -> wp.Kernel:
    """The kernel for one specialisation; each: whether it answers each ray, or counts those that are occluded.

    Points are the origins of `rays`, whose directions are not read. The frusta of a point are in one item.
    """
    trace = make_trace(config, each)

    def multi_frusta(
        first: int,
        tree: WideNodes,
        triangles: TriangleBlocks,
        rays: RayBatch,
        light: LightSamples,
        occluded: wp.array(dtype=wp.uint8),
        counts: wp.array(dtype=int),
    ):
        """Item: as many points as have 16 frusta, at least one."""
        points = wp.max(wp.static(FRUSTA) / light.groups, 1)
        begin = (first + wp.tid()) * points
        frustum = begin * light.groups
        end = wp.min(begin + points, rays.count) * light.groups
        while frustum < end:
            count = wp.min(wp.static(FRUSTA), end - frustum)
            trace(tree, triangles, rays, light, frustum, count, occluded, counts)
            frustum += count

    return specialised_kernel(multi_frusta)

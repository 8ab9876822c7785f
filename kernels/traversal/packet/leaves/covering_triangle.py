"""A triangle that all rays of several packets hit, found from their bounds only.

**Problem.** In scenes of large triangles, most packets of shadow rays are occluded by the triangle that occluded the packet
before. To find that again, the packet is loaded, bounded, prepared and tested, ray by ray.

**Idea.** Take the intervals of origins and directions of some packets together, as they lie in memory
(`wrt.kernels.traversal.packet.rays.joint_bounds`). A ray with origin o and direction d passes edge e of a triangle, which
begins at vertex p, on the side that the sign of (p - o) x e . d tells. If for each of the three edges the sign is the same
whatever o and d are taken from the intervals, all rays pass inside: the triangle covers the shaft of the rays. Dmitriev et al.
(2004) ask this of the corner rays of a packet; here W triangles are tested at a time, as in Komatsu et al.'s test of a frustum
of rays against a triangle.

**Arithmetic.** With the middle and the half extent of each interval, each quantity is its value in the middle plus or minus a
radius, a sum of half extents times absolute values. Directions are divided by their largest component.

**Exactness.** The answer must be that of the test of each ray, which rounds. Its areas have errors of less than 2^-19 S^2,
where S is the sum of a triangle's largest coordinates relative to the origins. So rays count as inside only by a margin of
`INSIDE` S^2, triangles count only if they span at least `MIN_AREA` S^2 as seen along the rays, and then t has an error of
less than S / 512: the plane of the triangle must be `CLOSEST` S within the rays' range. Nothing else can make such a test miss,
if it promises that (`PacketForm.certain`). NaN and infinite numbers are found on the way, and no triangle covers a zero
direction.

References: dmitriev-2004; komatsu-2008.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.runtime import native
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

INSIDE = 2.0**-14
"""Least signed area by which rays must pass inside of an edge, as a fraction of S^2: 32 times the error of a test's area."""

MIN_AREA = 2.0**-9
"""Least area of a triangle as seen along the rays, likewise."""

CLOSEST = 2.0**-8
"""Least distance from the ends of the rays' range to the triangle's plane, as a fraction of S, twice the error."""

SMALLEST, LARGEST = 1e-10, 1e12
"""Of S, so that no product of three lengths underflows or overflows."""

GUARDS = f"""
static_assert(wrt::INSIDE == {INSIDE!r}f && wrt::MIN_AREA == {MIN_AREA!r}f && wrt::CLOSEST == {CLOSEST!r}f);
static_assert(wrt::SMALLEST == {SMALLEST!r}f && wrt::LARGEST == {LARGEST!r}f);
"""
"""C++: the constants have these values."""


@cache
def covered_packets(layout: PacketLayout) -> wp.Function:
    """`wp.func(rays, first, limit, records, block, blocks) -> int`: the number of packets from ray `first` on, at most `limit`,
    all of whose rays hit one triangle of the `blocks` blocks from `block` on; 0 if that is not known.

    Only for tests whose `PacketForm.certain` is true. The packets are whole and lie side by side in the batch
    (`wrt.kernels.traversal.packet.rays.ray_numbers`). 0 on CUDA.
    """
    what = f"{layout.sizes}, {layout.record}"

    @native.func_native(
        "packet_rows.h", f"{GUARDS}return wrt::covered_packets<{what}>(rays, first, limit, records.data, block, blocks);"
    )
    def covered_native(
        rays: RayBatch, first: int, limit: int, records: wp.array(dtype=float), block: int, blocks: int
    ) -> int: ...

    return covered_native

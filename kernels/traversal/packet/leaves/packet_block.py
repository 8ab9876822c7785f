"""The rays of a packet against the triangles of a block: W rays x one triangle at a time, or each ray against those that it may
meet, on the CPU and if the test has the form for it (`PacketForm.pairs`).

**Problem.** On a fine mesh, the W rays of a vector meet several triangles of a block, each of which only a few of them meet. If
all W rays are tested against one triangle after the other, most lanes are idle.

**Idea.** Two steps.

1. *List.* All rays are tested against all triangles by signs alone, which is cheap: those through one point by linear functions
   of their slopes (`edge_functions`), others by the test's own areas (`WoopPairs.may_meet`). Each ray gets a word with a bit
   for each triangle that its line may meet. There are no branches: what the CPU does for one triangle overlaps with the next.
2. *Test.* Each ray takes the next triangle of its word, W rays at a time. A block has W triangles, and the W floats of a
   component are one register, so the triangles of W rays are a permutation of its lanes. As triangles of a surface cover a ray
   once, one or two rounds are enough for most vectors.

What does not depend on the ray is computed before, for the W triangles of the block at once: vertices less a shared origin,
boxes, and planes of the boxes less the origin. Both forms have the same bits, because each pair has the same operations.

Figures: notebooks/records/2026-11-25-packet-pairs.md.

**Lane utilisation** is the number of ray-triangle lanes tested (`lanes_tested`), and the number that held a useful test
(`active_lanes`).

References: wald-2001 (packets of rays against one triangle, which pairs depart from).
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.traversal.packet.leaves.edge_functions import GUARDS
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout, cpp
from wrt.kernels.triangle import TRIANGLE_TESTS

MIN_LISTED = {16: 1}
"""Triangles of a block from which they are listed for each ray, by width; 2 for other widths. A single one that is left of a
block is mostly hit, but with 16 lanes a round of the test costs more than all else."""


def pairs_code(pairs: str, width: int, what: str, arguments: str) -> str:
    """C++ that tests the triangles `mask` of a block. pairs: `PacketForm.pairs`; what, arguments: those of `test_triangles`
    but the test."""
    return f"{GUARDS}wrt::test_pairs<{what}, {MIN_LISTED.get(width, 2)}>({arguments}, {pairs});"


def triangles_code(layout: PacketLayout) -> str:
    """C++ expression, after `PacketLayout.names`, for a triangle test as `test_triangles` takes it."""
    return TRIANGLE_TESTS[layout.triangle_test].packet_form.triangles


def block_code(layout: PacketLayout, any_hit: bool, cull_backfaces: bool = False) -> str:
    """C++ of `test_block`, after `PacketLayout.names`."""
    form = TRIANGLE_TESTS[layout.triangle_test].packet_form
    what, arguments = f"{cpp(any_hit)}, {cpp(cull_backfaces)}", f"own, bounds, {layout.block}, ids.data + block * W, mask"
    code = f"wrt::test_triangles<{form.passes}, {what}>({arguments}, {triangles_code(layout)});"
    if form.pairs:
        pairs = pairs_code(form.pairs, layout.width, what, arguments)
        code = f"\n#if WRT_VECTORS\n{form.rays}{pairs}\n#else\n{code}\n#endif\n"
    return f"{code}wrt::shorten<{cpp(any_hit)}>(own, bounds);"


@cache
def test_block(layout: PacketLayout, any_hit: bool, cull_backfaces: bool) -> wp.Function:
    """`wp.func(records, ids, block, mask, packet, bounds)`: tests the triangles in `mask`; shortens rays and `bounds.t_max`.

    In any-hit queries a ray with a hit gets t = -inf. If back faces are culled, triangles are hit only from their front.
    """

    @native.func_native(
        f"packet_leaves.h {layout.headers}", f"{layout.own}{layout.names}\n{block_code(layout, any_hit, cull_backfaces)}"
    )
    def packet_block(
        records: wp.array(dtype=float),
        ids: wp.array(dtype=int),
        block: int,
        mask: wp.uint32,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
    ): ...

    return packet_block


@cache
def active_lanes(layout: PacketLayout) -> wp.Function:
    """`wp.func(records, block, mask, packet, bounds) -> int`: pairs of a triangle in `mask` and a ray that meets its box."""

    @native.func_native("packet_leaves.h", f"return wrt::count_active({layout.packet}, bounds, {layout.block}, mask);")
    def count_active_lanes(
        records: wp.array(dtype=float),
        block: int,
        mask: wp.uint32,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
    ) -> int: ...

    return count_active_lanes


@cache
def lanes_tested(layout: PacketLayout) -> wp.Function:
    """`wp.func(bounds) -> int`: number of lanes that `test_block` processes per triangle, over all passes."""
    passes = "1" if layout.passes == 1 else "wrt::count_bits(bounds.passes & 7)"

    @native.func_native("lanes.h", f"return {layout.rays} * {passes};")
    def count_lanes(bounds: wp.ref[PacketBounds]) -> int: ...

    return count_lanes

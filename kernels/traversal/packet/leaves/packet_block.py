"""The rays of a packet against the triangles of a block, W rays x one triangle at a time.

Tests that have the form for it (`PacketForm.pairs`) take the triangles for each ray on the CPU instead
(`wrt.kernels.traversal.packet.leaves.packet_pairs`).
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.traversal.packet.leaves.packet_pairs import pairs_code
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout, cpp
from wrt.kernels.triangle import TRIANGLE_TESTS


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

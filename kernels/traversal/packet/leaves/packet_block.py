"""The rays of a packet against the triangles of a block, W rays x one triangle at a time.

Tests that have the form for it (`PacketForm.pairs`) take the triangles for each ray on the CPU instead
(`wrt.kernels.traversal.packet.leaves.packet_pairs`).
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.traversal.leaf import FRONT
from wrt.kernels.traversal.packet.leaves.edge_functions import MACROS
from wrt.kernels.traversal.packet.leaves.packet_pairs import pairs_code
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.ray_box_slabs import SHARED_ORIGIN, SLABS
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import vertex_box

exact_module(__name__)

_BLOCK = """
    for (; mask; mask &= mask - 1u) {
        const int lane = wrt::lowest_bit(mask), id = ids.data[block * W + lane];
        const float* corner = &records.data[(size_t)block * (RECORD * W) + lane];
        float low[3], high[3];
        WRT_BOX
        WRT_NORMAL
        WRT_UNROLLED for (int pass = 0; pass < PASSES; ++pass) {
            if (PASSES > 1 && !(bounds.passes >> pass & 1)) continue;
            WRT_TRIANGLE
            for (int f = 0; f < P; f += W) {
                WRT_INSIDE
                WRT_FOR_LANES(i) {
                    const int k = f + i;
                    float at, hit_u, hit_v;
                    WRT_HIT
                    // the consistency rule: t is that of a meeting with the triangle's own widened box
                    float enter = -INF, leave = INF;
                    WRT_SLABS
                    at = at > enter ? at : enter;
                    at = at < leave ? at : leave;
                    const bool within = (inside[i] != 0) & (enter <= leave) & (at >= t_min[k])WRT_FACES;
                    if (ANY_HIT) {  // the first will do, and nobody asks for its weights
                        const bool hit = within & (at <= t[k]);
                        t[k] = hit ? -INF : t[k];
                        found[k] = hit ? id : found[k];
                    } else {  // no hit so far is -1, the greatest number without a sign
                        const bool hit = within & ((at < t[k]) | ((at == t[k]) & ((unsigned)id < (unsigned)found[k])));
                        t[k] = hit ? at : t[k];
                        found[k] = hit ? id : found[k];
                        u[k] = hit ? hit_u : u[k];
                        v[k] = hit ? hit_v : v[k];
                    }
                }
            }
        }
    }
"""

SHORTEN = """
    if (ANY_HIT) {  // whose rays get no shorter, but done
        int left = 0;
        WRT_FOR(P, k) { left |= t[k] >= -0.0f ? 1 : 0; }
        bounds.t_max = left ? bounds.t_max : -INF;
    } else {
        // as integers: in the order of the floats that are not negative (adding 0 turns -0 into +0), and -inf below them
        int most = (int)0x80000000;
        WRT_FOR(P, k) { const int bits = __builtin_bit_cast(int, t[k] + 0.0f); most = bits > most ? bits : most; }
        bounds.t_max = most < 0 ? -INF : __builtin_bit_cast(float, most);
    }
"""
"""C++ that updates `bounds.t_max` after rays have found hits. ANY_HIT: whether the query is any-hit."""


_NORMAL = "double normal[3]; wrt_normal(corner, W, normal);"
_FACES = " & wrt_front(normal, ix, iy, iz)"


def block_constants(layout: PacketLayout, any_hit: bool, cull_backfaces: bool = False) -> str:
    """C++ for the head of a function that contains `block_code`, after the constants of the layout."""
    passes = TRIANGLE_TESTS[layout.triangle_test].packet_form.passes
    return f"    constexpr bool ANY_HIT = {str(any_hit).lower()};\n    constexpr int PASSES = {passes};\n{MACROS}" + (
        FRONT if cull_backfaces else ""
    )


def block_code(layout: PacketLayout, cull_backfaces: bool = False) -> str:
    """C++ of `test_block`: its variables have the names of that function's parameters and of the packet's components."""
    form = TRIANGLE_TESTS[layout.triangle_test].packet_form
    pieces = {"WRT_TRIANGLE": form.triangle, "WRT_INSIDE": form.inside, "WRT_HIT": form.hit, "WRT_SLABS": SLABS}
    pieces |= {"WRT_BOX": vertex_box("corner", "0"), "WRT_FACES": _FACES if cull_backfaces else ""}
    pieces["WRT_NORMAL"] = _NORMAL if cull_backfaces else ""
    body = _BLOCK
    for name, piece in pieces.items():
        body = body.replace(name, piece)
    if form.pairs:
        pairs = pairs_code(form.pairs, layout.width, cull_backfaces)
        body = f"#if defined(__clang__) && !defined(__CUDA_ARCH__)\n{pairs}\n#else\n{body}\n#endif\n"
    return f"{SHARED_ORIGIN}    int* found = (int*)primitive;\n{body}{SHORTEN}"


@cache
def test_block(layout: PacketLayout, any_hit: bool, cull_backfaces: bool) -> wp.Function:
    """`wp.func(records, ids, block, mask, packet, bounds)`: tests the triangles in `mask`; shortens rays and `bounds.t_max`.

    In any-hit queries a ray with a hit gets t = -inf. If back faces are culled, triangles are hit only from their front.
    """

    @native.func_native(
        "lanes.h", layout.head + block_constants(layout, any_hit, cull_backfaces) + block_code(layout, cull_backfaces)
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

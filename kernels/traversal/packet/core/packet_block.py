"""The rays of a packet against the triangles of a block, W rays x one triangle at a time.

**Filter.** Whether any of W rays meets a triangle is hard to predict, and a branch that is mispredicted waits for all of the
arithmetic before it. So all triangles are tested first by signs alone, without branches: what the CPU does for one overlaps
with the next. Only the pairs of a triangle and W rays that may meet are then tested in full. Rays through one point take linear
functions of their slopes (`edge_functions`), others the test's own areas (`PacketForm.filter`)
(notebooks/records/2026-11-23-packet-loading.md, notebooks/records/2026-11-23-edge-functions.md).
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.lanes import BITS
from wrt.kernels.traversal.leaf import FRONT
from wrt.kernels.traversal.packet.culling.edge_functions import COEFFICIENTS, CONVERGING, EDGES, MACROS, MEETS
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.ray_box_slabs import SHARED_ORIGIN, SLABS
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.record_blocks import vertex_box

exact_module(__name__)

LEAST_FILTERED = 2
"""Triangles of a block from which they are filtered: a single one that is left of a block is mostly hit."""

MOST_VECTORS = 32
"""Greatest number of vectors of a packet whose pairs with triangles are filtered: the bits of a word."""

_VECTORS = """
                unsigned vectors = 0u;
                WRT_UNROLLED for (int f = 0; f < P; f += W) {
                    int some = 0;
                    WRT_FOR_LANES(i) {
                        const int k = f + i;
                        WRT_MEETS
                        some |= (may_meet & (t[k] >= t_min[k])) ? 1 : 0;
                    }
                    vectors |= (unsigned)(some != 0) << f / W;
                }
                meeting[lane] |= vectors;
                met |= (unsigned)(vectors != 0u) << lane;
"""

_FILTER = f"""
    unsigned meeting[W];  // of each triangle: a bit for each W rays some of which may meet it
    const bool filtered = wrt_count_bits(mask) >= {LEAST_FILTERED};
    for (int i = 0; i < W; ++i) meeting[i] = filtered ? 0u : ~0u >> ({MOST_VECTORS} - P / W);
    if (filtered) {{
        unsigned met = 0u;{CONVERGING}
        if (converging) {{{EDGES}
            for (unsigned left = mask; left; left &= left - 1u) {{
                const int lane = wrt_lowest_bit(left);{COEFFICIENTS}{_VECTORS.replace("WRT_MEETS", MEETS)}
            }}
        }} else {{
            WRT_UNROLLED for (int pass = 0; pass < PASSES; ++pass) {{
                if (PASSES > 1 && !(bounds.passes >> pass & 1)) continue;
                for (unsigned left = mask; left; left &= left - 1u) {{
                    const int lane = wrt_lowest_bit(left);
                    const float* corner = &records.data[(size_t)block * (RECORD * W) + lane];
                    WRT_TRIANGLE{_VECTORS.replace("WRT_MEETS", "WRT_MAY_MEET")}
                }}
            }}
        }}
        mask = met;
    }}
"""

_BLOCK = """
    int* found = (int*)primitive;
    WRT_FILTER
    for (; mask; mask &= mask - 1u) {
        const int lane = wrt_lowest_bit(mask), id = ids.data[block * W + lane];
        const float* corner = &records.data[(size_t)block * (RECORD * W) + lane];
        float low[3], high[3];
        WRT_BOX
        WRT_NORMAL
        WRT_UNROLLED for (int pass = 0; pass < PASSES; ++pass) {
            if (PASSES > 1 && !(bounds.passes >> pass & 1)) continue;
            WRT_TRIANGLE
            WRT_VECTORS
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
    WRT_SHORTEN
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


_ALL_VECTORS = """
            for (int f = 0; f < P; f += W) {"""

_SOME_VECTORS = """
            for (unsigned vectors = meeting[lane]; vectors; vectors &= vectors - 1u) {
                const int f = wrt_lowest_bit(vectors) * W;"""


def block_constants(layout: PacketLayout, any_hit: bool, cull_backfaces: bool = False) -> str:
    """C++ for the head of a function that contains `block_code`, after the constants of the layout."""
    passes = TRIANGLE_TESTS[layout.triangle_test].packet_form.passes
    return f"    constexpr bool ANY_HIT = {str(any_hit).lower()};\n    constexpr int PASSES = {passes};\n{BITS}{MACROS}" + (
        FRONT if cull_backfaces else ""
    )


def block_code(layout: PacketLayout, cull_backfaces: bool = False) -> str:
    """C++ of `test_block`: its variables have the names of that function's parameters and of the packet's components."""
    form = TRIANGLE_TESTS[layout.triangle_test].packet_form
    pieces = {"WRT_TRIANGLE": form.triangle, "WRT_INSIDE": form.inside, "WRT_HIT": form.hit, "WRT_SLABS": SLABS}
    pieces["WRT_SHORTEN"] = SHORTEN
    pieces["WRT_BOX"] = vertex_box("corner", "0")
    pieces |= {"WRT_NORMAL": _NORMAL, "WRT_FACES": _FACES} if cull_backfaces else {"WRT_NORMAL": "", "WRT_FACES": ""}
    filtered = bool(form.filter) and layout.rays // layout.width <= MOST_VECTORS
    body = _BLOCK.replace("WRT_FILTER", _FILTER if filtered else "")
    pieces |= {"WRT_MAY_MEET": form.filter, "WRT_VECTORS": _SOME_VECTORS if filtered else _ALL_VECTORS}
    for name, piece in pieces.items():
        body = body.replace(name, piece)
    return SHARED_ORIGIN + body


@cache
def test_block(layout: PacketLayout, any_hit: bool, cull_backfaces: bool) -> wp.Function:
    """`wp.func(records, ids, block, mask, packet, bounds)`: tests the triangles in `mask`; shortens rays and `bounds.t_max`.

    In any-hit queries a ray with a hit gets t = -inf. If back faces are culled, triangles are hit only from their front.
    """

    @wp.func_native(layout.head + block_constants(layout, any_hit, cull_backfaces) + block_code(layout, cull_backfaces))
    def packet_block(
        records: wp.array(dtype=float),
        ids: wp.array(dtype=int),
        block: int,
        mask: wp.uint32,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
    ): ...

    return packet_block

"""The rays of a packet against triangles of a block, W rays x one triangle at a time."""

from functools import cache

import warp as wp

from wrt.kernels.packet.bounds import PacketBounds
from wrt.kernels.packet.layout import PacketLayout
from wrt.kernels.triangle import TRIANGLE_TESTS

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_BLOCK = """
    int* found = (int*)primitive;
    const float slack0 = bounds.slack;
    const float origin0[3] = {bounds.origin_low.c[0], bounds.origin_low.c[1], bounds.origin_low.c[2]};
    for (; mask; mask &= mask - 1u) {
        const int lane = wrt_lowest_bit(mask), id = ids.data[block * W + lane];
        const float* corner = &records.data[(size_t)block * (9 * W) + lane];
        float low[3], high[3];
        for (int a = 0; a < 3; ++a) {
            const float p = corner[a * W], q = corner[(3 + a) * W], r = corner[(6 + a) * W];
            float least = q < r ? q : r, most = q > r ? q : r;
            low[a] = p < least ? p : least; high[a] = p > most ? p : most;
        }
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
                    const float ix = inverse_x[k], iy = inverse_y[k], iz = inverse_z[k], wide = SHARED ? slack0 : slack[k];
                    const float ox = SHARED ? origin0[0] : origin_x[k], oy = SHARED ? origin0[1] : origin_y[k],
                                oz = SHARED ? origin0[2] : origin_z[k];
                    const bool back_x = ix < 0.0f, back_y = iy < 0.0f, back_z = iz < 0.0f;
                    const float step_x = back_x ? -wide : wide, step_y = back_y ? -wide : wide, step_z = back_z ? -wide : wide;
                    float enter = -INF, leave = INF, s;
                    s = ((back_x ? high[0] : low[0]) - (ox + step_x)) * ix; enter = s > enter ? s : enter;
                    s = ((back_y ? high[1] : low[1]) - (oy + step_y)) * iy; enter = s > enter ? s : enter;
                    s = ((back_z ? high[2] : low[2]) - (oz + step_z)) * iz; enter = s > enter ? s : enter;
                    s = ((back_x ? low[0] : high[0]) - (ox - step_x)) * ix; leave = s < leave ? s : leave;
                    s = ((back_y ? low[1] : high[1]) - (oy - step_y)) * iy; leave = s < leave ? s : leave;
                    s = ((back_z ? low[2] : high[2]) - (oz - step_z)) * iz; leave = s < leave ? s : leave;
                    at = at > enter ? at : enter;
                    at = at < leave ? at : leave;
                    // no hit so far is -1, the greatest number without a sign
                    const bool hit = (inside[i] != 0) & (enter <= leave) & (at >= t_min[k])
                        & ((at < t[k]) | ((at == t[k]) & ((unsigned)id < (unsigned)found[k])));
                    t[k] = hit ? (ANY_HIT ? -INF : at) : t[k];
                    found[k] = hit ? id : found[k];
                    u[k] = hit ? hit_u : u[k];
                    v[k] = hit ? hit_v : v[k];
                }
            }
        }
    }
    // as integers: in the order of the floats that are not negative (adding 0 turns -0 into +0), and -inf below them
    int most = (int)0x80000000;
    WRT_FOR(P, k) { const int bits = __builtin_bit_cast(int, t[k] + 0.0f); most = bits > most ? bits : most; }
    bounds.t_max = most < 0 ? -INF : __builtin_bit_cast(float, most);
"""

_LOWEST_BIT = """
#if defined(__CUDA_ARCH__)
    auto wrt_lowest_bit = [](unsigned bits) { return __ffs(bits) - 1; };
#else
    auto wrt_lowest_bit = [](unsigned bits) { return __builtin_ctz(bits); };
#endif
"""


@cache
def test_block(layout: PacketLayout, any_hit: bool) -> wp.Function:
    """`wp.func(records, ids, block, mask, packet, bounds)`: tests the triangles in `mask`; shortens rays, and `bounds.t_max`.

    A ray that has its answer (any hit) is shortened to -inf.
    """
    form = TRIANGLE_TESTS[layout.triangle_test].packet_form
    constants = f"    constexpr bool ANY_HIT = {str(any_hit).lower()};\n    constexpr int PASSES = {form.passes};\n"
    body = _BLOCK.replace("WRT_TRIANGLE", form.triangle).replace("WRT_INSIDE", form.inside).replace("WRT_HIT", form.hit)

    @wp.func_native(layout.head + constants + _LOWEST_BIT + body)
    def packet_block(
        records: wp.array(dtype=float),
        ids: wp.array(dtype=int),
        block: int,
        mask: wp.uint32,
        packet: wp.array(dtype=float),
        bounds: wp.ref[PacketBounds],
    ): ...

    return packet_block

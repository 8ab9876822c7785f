"""The frusta of a block in the lanes of a vector: their bounds, a node's boxes against all of them, and the stack.

**A child against 16 frusta.** With one origin o, a ray enters the widened slab of a box at (low - (o + slack)) / d if it goes
forward, and at (high - (o - slack)) / d if it goes backward. Let `ahead` be the first distance and `behind` the second one with
its sign changed: at most one of them is positive. They are numbers of the box, the same for all frusta; what differs are the
ends of the interval of 1 / d. A frustum has, for each axis:

    near_forward   least 1 / d of the rays that go forward; the largest float if there are none
    near_backward  least -1 / d of the rays that go backward; likewise
    far_forward    greatest 1 / d if all rays go forward; inf if they go both ways, 0 if all go backward
    far_backward   greatest -1 / d if all rays go backward; inf if they go both ways, 0 if all go forward

No ray enters before ahead * near_forward, nor before behind * near_backward, and all of them have left after the greater one of
-behind * far_forward and -ahead * far_backward. These are the products that each ray computes (`wrt.kernels.simd.boxes`), with
factors that are not less, or not greater; rounding is monotone. A product 0 * inf is NaN, which bounds nothing.

**Both signs.** Where an interval of directions contains 0, nothing is known of the far planes, and a box is beyond the frustum
if it lies farther along the axis than the farthest-going ray gets while it is within the other slabs: the box around the rays
against the node's box, as Benthin and Wald have it, within these limits.

**Memory**, rows of 16 floats from the first cache line on: 12 rows of factors in the order above, x, y, z each; `t_min` and
`t_max`, the ranges; `block`, the same 14 numbers for all frusta as one; `origin`, o + slack and o - slack; then the stack, for
each waiting child the t at which each frustum enters its box, inf for those that miss it. Which child it is, is in another
array.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import DIRECTION_LANES, RayBatch
from wrt.kernels.layout.unchecked import CACHE_LINE
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.simd.boxes import SLACK
from wrt.kernels.traversal.packet.rays.lane_intervals import LANE_ENDS
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.traversal.packet.rays.ray_numbers import FETCH, NUMBERS

exact_module(__name__)

FRUSTA = 16
"""Frusta of a block."""

_FACTORS, _BLOCK, _ORIGIN, _STACK = 12, 14, 15, 16

_ROWS = f"""
    constexpr int F = {FRUSTA}, FACTORS = {_FACTORS}, BLOCK = {_BLOCK}, ORIGIN = {_ORIGIN}, STACK = {_STACK};
    const float INF = WRT_INFINITY;
    float* rows = lanes.data + (-((size_t)lanes.data / 4) & {CACHE_LINE - 1});
    float *t_min = rows + FACTORS * F, *t_max = rows + (FACTORS + 1) * F;
    float *block = rows + BLOCK * F, *origin = rows + ORIGIN * F;
"""


def lane_memory(waiting: int) -> int:
    """Floats of the memory of a block, for a stack of so many children."""
    return (_STACK + waiting) * FRUSTA + CACHE_LINE


_GATHER = """
    float least_t[P], most_t[P];
    fetch(rays.t_min_stride, [&](int k, int n) { least_t[k] = rays.t_min.data[n]; });
    fetch(rays.t_max_stride, [&](int k, int n) { most_t[k] = rays.t_max.data[n]; });
    auto wrt_size = [](float x) { return __builtin_bit_cast(int, x) & 0x7fffffff; };
    float x0[W], x1[W], y0[W], y1[W], z0[W], z1[W], from[W], until[W];
    WRT_FOR_LANES(i) {
        x0[i] = y0[i] = z0[i] = from[i] = INF; x1[i] = y1[i] = z1[i] = until[i] = -INF;
        WRT_UNROLLED for (int g = 0; g < P; g += W) {
            float x = to_x[g + i], y = to_y[g + i], z = to_z[g + i];
            wrt_direction(x, y, z);
            const float begin = least_t[g + i], end = most_t[g + i] > FARTHEST ? FARTHEST : most_t[g + i];
            const int size_x = wrt_size(x), size_y = wrt_size(y), size_z = wrt_size(z);
            int size = size_x > size_y ? size_x : size_y; size = size > size_z ? size : size_z;
            const bool valid = (size >= wrt_size(SHORTEST)) & (size < wrt_size(INF)) & (begin >= 0.0f) & (begin <= end);
            x0[i] = (valid & (x < x0[i])) ? x : x0[i]; x1[i] = (valid & (x > x1[i])) ? x : x1[i];
            y0[i] = (valid & (y < y0[i])) ? y : y0[i]; y1[i] = (valid & (y > y1[i])) ? y : y1[i];
            z0[i] = (valid & (z < z0[i])) ? z : z0[i]; z1[i] = (valid & (z > z1[i])) ? z : z1[i];
            from[i] = (valid & (begin < from[i])) ? begin : from[i]; until[i] = (valid & (end > until[i])) ? end : until[i];
        }
    }
    rows[f] = wrt_least(x0); rows[F + f] = wrt_least(y0); rows[2 * F + f] = wrt_least(z0);
    rows[3 * F + f] = wrt_greatest(x1); rows[4 * F + f] = wrt_greatest(y1); rows[5 * F + f] = wrt_greatest(z1);
    t_min[f] = wrt_least(from); t_max[f] = wrt_greatest(until);
"""


@cache
def gather_directions(layout: PacketLayout) -> wp.Function:
    """`wp.func(rays, first, lanes, f)`: the ends of the directions and of the ranges of the P rays at `first`, in lane f.

    No ray is made. An interval of no active ray is inf .. -inf.
    """
    head = f"    constexpr int W = {layout.width}, P = {layout.rays};\n{DIRECTION_LANES}"

    @native.func_native("lanes.h", head + _ROWS + NUMBERS + FETCH + LANE_ENDS + _GATHER)
    def gather_directions_native(rays: RayBatch, first: int, lanes: wp.array(dtype=float), f: int): ...

    return gather_directions_native


_BOUND = """
    const float* o = (const float*)rays.origins.data;
    float reach = 0.0f, at[3];
    bool finite = true;
    for (int a = 0; a < 3; ++a) {
        at[a] = (float)((double)o[a] - rays.center.c[a]);
        const float down = WRT_ABS(low.c[a] - at[a]), up = WRT_ABS(high.c[a] - at[a]);
        reach = down > reach ? down : reach; reach = up > reach ? up : reach;
        finite = finite & (at[a] - at[a] == 0.0f);
    }
    const float slack = SLACK * reach;
    for (int a = 0; a < 3; ++a) { origin[a] = at[a] + slack; origin[3 + a] = at[a] - slack; origin[6 + a] = at[a]; }
    origin[9] = slack;
    float own[FACTORS][F];
    WRT_FOR(F, f) t_max[f] = ((f < count) & finite) ? t_max[f] : -INF;
    for (int a = 0; a < 3; ++a) {
        WRT_FOR(F, f) {
            const float d0 = rows[a * F + f], d1 = rows[(3 + a) * F + f], p = 1.0f / d0, q = 1.0f / d1;
            const bool active = t_max[f] > -INF, backward = d1 < 0.0f, mixed = (d0 < 0.0f) & !backward;
            const float forth = (!backward & (q < FARTHEST)) ? q : FARTHEST;
            const float back = ((d0 < 0.0f) & (-p < FARTHEST)) ? -p : FARTHEST;
            const float forward_end = mixed ? INF : backward ? 0.0f : p, backward_end = mixed ? INF : backward ? -q : 0.0f;
            own[a][f] = active ? forth : FARTHEST; own[3 + a][f] = active ? back : FARTHEST;
            own[6 + a][f] = active ? forward_end : 0.0f; own[9 + a][f] = active ? backward_end : 0.0f;
        }
    }
    for (int k = 0; k < FACTORS; ++k) {
        WRT_FOR(F, f) rows[k * F + f] = own[k][f];
        if (k < FACTORS / 2) {
            WRT_UNROLLED for (int n = F / 2; n > 0; n /= 2)
                WRT_FOR(n, f) own[k][f] = own[k][f + n] < own[k][f] ? own[k][f + n] : own[k][f];
        } else {
            WRT_UNROLLED for (int n = F / 2; n > 0; n /= 2)
                WRT_FOR(n, f) own[k][f] = own[k][f + n] > own[k][f] ? own[k][f + n] : own[k][f];
        }
        block[k] = own[k][0];
    }
    float first[F];
    WRT_FOR(F, f) first[f] = t_max[f] > -INF ? t_min[f] : INF;
    WRT_UNROLLED for (int n = F / 2; n > 0; n /= 2)
        WRT_FOR(n, f) first[f] = first[f + n] < first[f] ? first[f + n] : first[f];
    block[FACTORS] = first[0];
"""


@native.func_native("lanes.h", f"    constexpr float SLACK = {SLACK!r}f;\n{DIRECTION_LANES}{_ROWS}{_BOUND}")
def bound_block(rays: RayBatch, low: wp.vec3, high: wp.vec3, lanes: wp.array(dtype=float), count: int):
    """Derives the factors of a block from the ends of the directions of its first `count` frusta; low, high: bounds of the
    scene."""
    ...


@native.func_native(
    "lanes.h",
    f"""{DIRECTION_LANES}{_ROWS}
    bounds.t_min = t_min[f]; bounds.t_max = t_max[f]; bounds.slack = origin[9];
    bounds.frame = -1;
    bounds.mixed_axes = 0;
    for (int a = 0; a < 3; ++a) {{
        const float forth = rows[a * F + f], back = rows[(3 + a) * F + f];
        const float forward_end = rows[(6 + a) * F + f], backward_end = rows[(9 + a) * F + f], none = WRT_NAN;
        const bool backward = (forward_end == 0.0f) & (backward_end < INF), mixed = (backward_end == INF);
        bounds.mixed_axes += mixed ? 1 : 0;
        bounds.inverse_large.c[a] = mixed ? none : backward ? -backward_end : forward_end;
        bounds.inverse_small.c[a] = mixed ? none : backward ? -back : forth;
        bounds.origin_in.c[a] = origin[backward ? 3 + a : a]; bounds.origin_out.c[a] = origin[backward ? a : 3 + a];
    }}
""",
)
def frustum_bounds(lanes: wp.array(dtype=float), f: int, bounds: wp.ref[PacketBounds]):
    """Sets what `wrt.kernels.traversal.packet.culling.interval_culling` reads to the bounds of lane f."""
    ...


def _factors(node: str, distance: str) -> str:
    """C++ that shrinks `enter`, `leave`; node: a format of the factors k of an axis; distance: of its distance."""
    return "".join(
        f"""
            p = {distance.format("ahead", a)} * {node.format(a)}; enter = p > enter ? p : enter;
            p = {distance.format("behind", a)} * {node.format(3 + a)}; enter = p > enter ? p : enter;
            p = -{distance.format("behind", a)} * {node.format(6 + a)};
            q = -{distance.format("ahead", a)} * {node.format(9 + a)};
            q = q > p ? q : p; leave = q < leave ? q : leave;"""
        for a in range(3)
    )


_STEP = f"""
    const float* box = &boxes.data[(size_t)node * (6 * W)];
    int farthest = (int)0x80000000;
    WRT_FOR(F, f) {{ const int bits = __builtin_bit_cast(int, t_max[f] + 0.0f); farthest = bits > farthest ? bits : farthest; }}
    const float all_t_min = block[FACTORS], all_t_max = farthest < 0 ? -INF : __builtin_bit_cast(float, farthest);
    float ahead[3][W], behind[3][W];
    int key[W], meets[W];
    WRT_FOR_LANES(i) {{
        for (int a = 0; a < 3; ++a) {{
            ahead[a][i] = box[a * W + i] - origin[a];
            behind[a][i] = origin[3 + a] - box[(3 + a) * W + i];
        }}
        float enter = all_t_min, leave = all_t_max, p, q;{_factors("block[{}]", "{}[{}][i]")}
        key[i] = (__builtin_bit_cast(int, enter) & -W) | i;
        meets[i] = enter <= leave ? -1 : 0;
    }}
    int sorted[W], count = 0;  // the farthest first
    for (unsigned bits = wrt::bits<W>(meets); bits; bits &= bits - 1u) {{
        const int k = key[wrt::lowest_bit(bits)];
        int at = count++;
        for (; at > 0 && sorted[at - 1] < k; --at) sorted[at] = sorted[at - 1];
        sorted[at] = k;
    }}
    for (int n = 0; n < count; ++n) {{
        const int i = sorted[n] & (W - 1);
        const float ahead0 = ahead[0][i], ahead1 = ahead[1][i], ahead2 = ahead[2][i];
        const float behind0 = behind[0][i], behind1 = behind[1][i], behind2 = behind[2][i];
        float* entry = rows + (STACK + top) * F;
        int some = 0;
        WRT_FOR(F, f) {{
            float enter = t_min[f], leave = t_max[f], p, q;{_factors("rows[{} * F + f]", "{}{}")}
            entry[f] = enter <= leave ? enter : INF;
            some |= enter <= leave ? 1 : 0;
        }}
        slots.data[top] = node * W + i;
        top += some;
    }}
    return top;
"""


@cache
def push_children(width: int) -> wp.Function:
    """`wp.func(boxes, node, lanes, slots, top) -> top`: pushes the children of a node that frusta meet, nearest last.

    Only those that the block meets as a whole are tested against each frustum. top: children that wait so far. A child is given
    by its slot, node * W + lane.
    """
    head = f"    constexpr int W = {width};\n"

    @native.func_native("lanes.h", head + _ROWS + _STEP)
    def push_children_native(
        boxes: wp.array(dtype=float), node: int, lanes: wp.array(dtype=float), slots: wp.array(dtype=int), top: int
    ) -> int: ...

    return push_children_native


@native.func_native(
    "lanes.h",
    f"""{_ROWS}
    const float* entry = rows + (STACK + place) * F;
    int waits[F];
    WRT_FOR(F, f) waits[f] = entry[f] <= t_max[f] ? -1 : 0;
    return wrt::bits<F>(waits);
""",
)
def frusta_waiting(lanes: wp.array(dtype=float), place: int) -> wp.uint32:
    """The frusta that enter a waiting child before their best hits, one bit each."""
    ...


@native.func_native("lanes.h", f"{_ROWS}    t_max[f] = end;\n")
def shorten_frustum(lanes: wp.array(dtype=float), f: int, end: float):
    """Sets the end of a frustum's range; -inf if all of its rays are done."""
    ...

"""Extremes of points that lie one after the other in memory, three floats each.

Extremes need no points in lanes. In 3 W floats, lane i of register j always holds the component (W j + i) mod 3, so registers
are compared lane by lane, without a shuffle. Only the last registers are folded: a fold by a multiple of 3 lanes keeps the
components apart.
"""


def triple_extremes(width: int) -> str:
    """C++ for `width` lanes, 4 or a larger power of two, after `wrt.kernels.simd.lane_vectors.vector_words`.

    `wrt_widen(value, least, greatest)` widens an interval per lane, at first [inf, -inf]; NaN widens nothing.
    `wrt_ends(least, greatest, low, high)` folds three registers of each end to one interval per component.
    """
    half, quarters = width // 2, 3 * width // 4

    def lanes(first: int, of: int) -> str:
        return ", ".join(str((first + i) % of) for i in range(width))

    code = f"""
    auto wrt_greater = [](vf a, vf b) {{ return a > b ? a : b; }};
    auto wrt_widen = [](vf value, vf& least, vf& greatest) {{
        least = value < least ? value : least; greatest = value > greatest ? value : greatest;
    }};
    auto wrt_fold = [&](vf a, vf b, vf c) {{
        // 3 W lanes to 3 W / 2, W of them in d, then to 3 W / 4 in f
        const vf d = wrt_greater(a, __builtin_shufflevector(b, c, {lanes(half, 2 * width)}));
        const vf e = wrt_greater(b, __builtin_shufflevector(c, c, {lanes(half, width)}));
        vf f = wrt_greater(d, __builtin_shufflevector(d, e, {lanes(quarters, 2 * width)}));"""
    n = quarters // 2
    while n >= 3:
        code += f"\n        f = wrt_greater(f, __builtin_shufflevector(f, f, {lanes(n, width)}));"
        n //= 2
    return (
        code
        + """
        return f;
    };
    auto wrt_ends = [&](const vf* least, const vf* greatest, float* low, float* high) {
        const vf negated = wrt_fold(-least[0], -least[1], -least[2]), most = wrt_fold(greatest[0], greatest[1], greatest[2]);
        WRT_UNROLLED for (int i = 0; i < 3; ++i) { low[i] = -negated[i]; high[i] = most[i]; }
    };
"""
    )

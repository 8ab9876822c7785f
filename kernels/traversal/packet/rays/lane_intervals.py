"""Minimum and maximum of a value over the rays of a packet, W rays at a time.

A compiler must keep the order of floating-point comparisons, so it does not vectorise these reductions. There are two remedies.
`INTERVALS` reduces integers that are ordered like the floats, for any number of rays. `PACKET_INTERVALS` reduces the P rays of
a packet per lane, and then the lanes of all intervals together (`row_maxima`).
"""

from collections.abc import Sequence

from wrt.kernels.simd.row_maxima import row_maxima

INTERVALS = """
    constexpr int LEAST = (int)0x80000000, MOST = 0x7fffffff;
    auto wrt_ordered = [](float value) { int bits = __builtin_bit_cast(int, value); return bits ^ ((bits >> 31) & MOST); };
    auto wrt_value = [](int key) { return __builtin_bit_cast(float, key ^ ((key >> 31) & MOST)); };
#ifndef WRT_WIDEN
    #define WRT_WIDEN(name, value, counts) { int key_ = wrt_ordered(value), low_ = counts ? key_ : MOST, \\
        high_ = counts ? key_ : LEAST; name##_low = low_ < name##_low ? low_ : name##_low; \\
        name##_high = high_ > name##_high ? high_ : name##_high; }
    #define WRT_INTERVAL(name) int name##_low = MOST, name##_high = LEAST
#endif
"""
"""C++ for the head of a native function: `WRT_INTERVAL(name)` declares an empty interval, `WRT_WIDEN(name, value, counts)`
widens it by a value if `counts`, and `wrt_value(name_low)`, `wrt_value(name_high)` are its ends (NaN if it is empty)."""

LANE_ENDS = """
    auto wrt_first = [](float* lane, auto precedes) {
        WRT_UNROLLED for (int n = W / 2; n > 0; n /= 2)
            WRT_FOR(n, i) lane[i] = precedes(lane[i + n], lane[i]) ? lane[i + n] : lane[i];
        return lane[0];
    };
    auto wrt_least = [&](float* lane) { return wrt_first(lane, [](float a, float b) { return a < b; }); };
    auto wrt_greatest = [&](float* lane) { return wrt_first(lane, [](float a, float b) { return a > b; }); };
"""
"""C++: `wrt_least(lane)` and `wrt_greatest(lane)` of W floats, W a power of two, which they overwrite."""

PACKET_INTERVALS = """
#ifndef WRT_ENDS
    #define WRT_ENDS(name) alignas(4 * W) float name##_low[W], name##_high[W]
    #define WRT_BOUND(name, value) { float stand_in_; { const int k = one; stand_in_ = value; } \\
        float low_ = stand_in_, high_ = stand_in_; \\
        WRT_UNROLLED for (int f_ = 0; f_ < P; f_ += W) { const int k = f_ + i; \\
            const float there_ = value, value_ = t[k] >= -0.0f ? there_ : stand_in_; \\
            low_ = value_ < low_ ? value_ : low_; high_ = value_ > high_ ? value_ : high_; } \\
        name##_low[i] = -low_; name##_high[i] = high_; }
#endif
"""
"""The same for the active rays of a packet, after `PacketLayout.head`, W a power of two: `WRT_ENDS(name)` declares the ends of
an interval per lane. `WRT_BOUND(name, value)`, in a loop over the lanes i, widens them; the value is that of ray `k`, and ray
`one`, an active one, replaces inactive rays. `packet_ends` has the ends over all lanes."""


def packet_ends(names: Sequence[str], width: int) -> str:
    """C++ that sets `NAME_least` and `NAME_most`, the ends over all lanes of the intervals of `PACKET_INTERVALS`, for all names
    together. Lower ends are kept negated until then."""
    rows = [f"{name}_{end}" for name in names for end in ("low", "high")]
    values = "".join(
        f"    const float {name}_least = -ends_of_{names[0]}[{2 * j}], {name}_most = ends_of_{names[0]}[{2 * j + 1}];\n"
        for j, name in enumerate(names)
    )
    return f"    float ends_of_{names[0]}[{len(rows)}];{row_maxima(rows, width, f'ends_of_{names[0]}')}{values}"

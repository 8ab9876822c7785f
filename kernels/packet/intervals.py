"""The least and the greatest of a value over the rays of a packet, W rays at a time.

Minima and maxima are taken of integers in the order of the floats: a compiler must keep the order of floating-point
comparisons, so it would not take W of them at a time.
"""

INTERVALS = """
    constexpr int LEAST = (int)0x80000000, MOST = 0x7fffffff;
    auto wrt_ordered = [](float value) { int bits = __builtin_bit_cast(int, value); return bits ^ ((bits >> 31) & MOST); };
    auto wrt_value = [](int key) { return __builtin_bit_cast(float, key ^ ((key >> 31) & MOST)); };
#ifndef WRT_WIDEN
    #define WRT_WIDEN(name, value, counts) { int key_ = wrt_ordered(value), low_ = counts ? key_ : MOST, \\
        high_ = counts ? key_ : LEAST; name##_low = low_ < name##_low ? low_ : name##_low; \\
        name##_high = high_ > name##_high ? high_ : name##_high; }
    #define WRT_INTERVAL(name) int name##_low = MOST, name##_high = LEAST
    #define WRT_ENDS(name) float name##_low[W], name##_high[W]
    #define WRT_ALL(name, value) { float low_, high_; { const int k = one; low_ = high_ = value; } const float one_ = low_; \\
        WRT_UNROLLED for (int f_ = 0; f_ < P; f_ += W) { const int k = f_ + i; \\
            const float there_ = value, value_ = t[k] >= -0.0f ? there_ : one_; \\
            low_ = value_ < low_ ? value_ : low_; high_ = value_ > high_ ? value_ : high_; } \\
        name##_low[i] = low_; name##_high[i] = high_; }
#endif
    auto wrt_least = [](float* lane) {
        if (W > 8) WRT_FOR(W > 8 ? 8 : 0, i) lane[i] = lane[i + 8] < lane[i] ? lane[i + 8] : lane[i];
        if (W > 4) WRT_FOR(W > 4 ? 4 : 0, i) lane[i] = lane[i + 4] < lane[i] ? lane[i + 4] : lane[i];
        if (W > 2) WRT_FOR(W > 2 ? 2 : 0, i) lane[i] = lane[i + 2] < lane[i] ? lane[i + 2] : lane[i];
        return W > 1 && lane[W > 1] < lane[0] ? lane[W > 1] : lane[0];
    };
    auto wrt_greatest = [](float* lane) {
        if (W > 8) WRT_FOR(W > 8 ? 8 : 0, i) lane[i] = lane[i + 8] > lane[i] ? lane[i + 8] : lane[i];
        if (W > 4) WRT_FOR(W > 4 ? 4 : 0, i) lane[i] = lane[i + 4] > lane[i] ? lane[i + 4] : lane[i];
        if (W > 2) WRT_FOR(W > 2 ? 2 : 0, i) lane[i] = lane[i + 2] > lane[i] ? lane[i + 2] : lane[i];
        return W > 1 && lane[W > 1] > lane[0] ? lane[W > 1] : lane[0];
    };
"""
"""C++ for the head of a native function: `WRT_INTERVAL(name)` declares an empty interval, `WRT_WIDEN(name, value, counts)`
widens it by a value that counts, and `wrt_value(name_low)`, `wrt_value(name_high)` are its ends (NaN if nothing counted)."""

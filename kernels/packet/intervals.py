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
    #define WRT_ALL(name, value) { float low_, high_; { const int k = one; low_ = high_ = value; } const float one_ = low_; \\
        WRT_UNROLLED for (int f_ = 0; f_ < P; f_ += W) { const int k = f_ + i; \\
            const float there_ = value, value_ = t[k] >= -0.0f ? there_ : one_; \\
            low_ = value_ < low_ ? value_ : low_; high_ = value_ > high_ ? value_ : high_; } \\
        const int low_key_ = wrt_ordered(low_), high_key_ = wrt_ordered(high_); \\
        name##_low = low_key_ < name##_low ? low_key_ : name##_low; \\
        name##_high = high_key_ > name##_high ? high_key_ : name##_high; }
#endif
"""
"""C++ for the head of a native function: `WRT_INTERVAL(name)` declares an empty interval, `WRT_WIDEN(name, value, counts)`
widens it by a value that counts, and `wrt_value(name_low)`, `wrt_value(name_high)` are its ends (NaN if nothing counted)."""

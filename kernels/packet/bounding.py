"""Bounds of the active rays of a packet, from its own numbers: when it is loaded, and again for each part (`parting`)."""

BOUND = """
    WRT_INTERVAL(ix); WRT_INTERVAL(iy); WRT_INTERVAL(iz);
    WRT_INTERVAL(sx); WRT_INTERVAL(sy); WRT_INTERVAL(start); WRT_INTERVAL(end);
    int active = 0, main_axes = 0;
    WRT_FOR(P, k) {
        const bool valid = t[k] >= -0.0f;
        active += valid ? 1 : 0;
        main_axes |= valid ? 1 << ((const int*)main_axis)[k] : 0;
        WRT_WIDEN(ix, inverse_x[k], valid) WRT_WIDEN(iy, inverse_y[k], valid) WRT_WIDEN(iz, inverse_z[k], valid)
        WRT_WIDEN(sx, slope_x[k], valid) WRT_WIDEN(sy, slope_y[k], valid)
        WRT_WIDEN(start, t_min[k], valid) WRT_WIDEN(end, t[k], valid)
    }
    if (!SHARED) {
        WRT_INTERVAL(ox); WRT_INTERVAL(oy); WRT_INTERVAL(oz); WRT_INTERVAL(wide);
        WRT_FOR(P, k) {
            const bool valid = t[k] >= -0.0f;
            WRT_WIDEN(ox, origin_x[k], valid) WRT_WIDEN(oy, origin_y[k], valid) WRT_WIDEN(oz, origin_z[k], valid)
            WRT_WIDEN(wide, slack[k], valid)
        }
        lows[0] = wrt_value(ox_low); lows[1] = wrt_value(oy_low); lows[2] = wrt_value(oz_low);
        highs[0] = wrt_value(ox_high); highs[1] = wrt_value(oy_high); highs[2] = wrt_value(oz_high);
        slack0 = wrt_value(wide_high);
    }
    bounds.active = active;
    bounds.main_axes = main_axes;
    bounds.passes = PASSES == 1 ? 1 : main_axes;
    bounds.t_min = wrt_value(start_low); bounds.t_max = wrt_value(end_high);
    bounds.slack = slack0;
    bounds.slope_low = wp::vec2(wrt_value(sx_low), wrt_value(sy_low));
    bounds.slope_high = wp::vec2(wrt_value(sx_high), wrt_value(sy_high));
    const int main = main_axes == 1 ? 0 : main_axes == 2 ? 1 : 2;
    const int next = main == 2 ? 0 : main + 1, other = next == 2 ? 0 : next + 1;
    bounds.plane = SHARED ? lows[main] : 0.5f * (lows[main] + highs[main]);
    if (SHARED) {
        bounds.through_low = bounds.through_high = wp::vec2(lows[next], lows[other]);
    } else {
        const float plane = bounds.plane;
        const float* along = main == 0 ? origin_x : main == 1 ? origin_y : origin_z;
        const float* across_x = main == 0 ? origin_y : main == 1 ? origin_z : origin_x;
        const float* across_y = main == 0 ? origin_z : main == 1 ? origin_x : origin_y;
        float through_x[P], through_y[P];
        WRT_FOR(P, k) { through_x[k] = across_x[k] - slope_x[k] * (along[k] - plane); }
        WRT_FOR(P, k) { through_y[k] = across_y[k] - slope_y[k] * (along[k] - plane); }
        WRT_INTERVAL(cx); WRT_INTERVAL(cy);
        WRT_FOR(P, k) {
            const bool valid = t[k] >= -0.0f;
            WRT_WIDEN(cx, through_x[k], valid) WRT_WIDEN(cy, through_y[k], valid)
        }
        bounds.through_low = wp::vec2(wrt_value(cx_low) - slack0, wrt_value(cy_low) - slack0);
        bounds.through_high = wp::vec2(wrt_value(cx_high) + slack0, wrt_value(cy_high) + slack0);
    }
    const float inverse_low[3] = {wrt_value(ix_low), wrt_value(iy_low), wrt_value(iz_low)};
    const float inverse_high[3] = {wrt_value(ix_high), wrt_value(iy_high), wrt_value(iz_high)};
    bounds.mixed_axes = 0;
    for (int a = 0; a < 3; ++a) {
        const bool backward = inverse_high[a] < 0.0f, mixed = (inverse_low[a] < 0.0f) & !backward;
        const float none = WRT_NAN;
        bounds.mixed_axes += mixed ? 1 : 0;
        bounds.backward.c[a] = backward ? 1 : 0;
        bounds.inverse_large.c[a] = mixed ? none : backward ? inverse_low[a] : inverse_high[a];
        bounds.inverse_small.c[a] = mixed ? none : backward ? inverse_high[a] : inverse_low[a];
        bounds.origin_in.c[a] = backward ? lows[a] - slack0 : highs[a] + slack0;
        bounds.origin_out.c[a] = backward ? highs[a] + slack0 : lows[a] - slack0;
        bounds.origin_low.c[a] = lows[a]; bounds.origin_high.c[a] = highs[a];
        bounds.forward_small.c[a] = 0.0f; bounds.backward_small.c[a] = 0.0f;
        if (mixed) {
            const float* inverse = a == 0 ? inverse_x : a == 1 ? inverse_y : inverse_z;
            WRT_INTERVAL(forward); WRT_INTERVAL(backward);
            WRT_FOR(P, k) {
                const bool valid = t[k] >= -0.0f, ahead = valid & !(inverse[k] < 0.0f), behind = valid & !ahead;
                WRT_WIDEN(forward, inverse[k], ahead) WRT_WIDEN(backward, inverse[k], behind)
            }
            bounds.forward_small.c[a] = wrt_value(forward_low); bounds.backward_small.c[a] = wrt_value(backward_high);
        }
    }
"""
"""C++ over `PacketLayout.head`, `INTERVALS` and PASSES: sets `bounds`. An active ray's t is not negative.

`lows[3]`, `highs[3]` and `slack0` must be there: a shared origin and its slack, else any numbers."""

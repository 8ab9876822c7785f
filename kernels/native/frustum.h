// The frusta of a block in the lanes of a vector (wrt.kernels.classics.traversal.eye_frusta).
#pragma once
#include "packet.h"

namespace wrt {
namespace {

/// The memory of a block of F frusta: rows of a float for each. factors: 12 rows, those of an axis 3 apart; t_min, t_max: the
/// ranges; block: the 14 numbers of all frusta as one; origin: moved forward by the slack, moved back, as it is, and the slack;
/// stack: the t at which each enters the box of a waiting child.
template <int FRUSTA> struct FrustumRows {
    static constexpr int F = FRUSTA, FACTORS = 12, BLOCK = 14, ORIGIN = 15, STACK = 16;
    float *factors, *t_min, *t_max, *block, *origin, *stack;

    explicit CUDA_CALLABLE FrustumRows(float* memory)
    {
        factors = memory + (-((size_t)memory / 4) & 15);
        t_min = factors + FACTORS * F, t_max = factors + (FACTORS + 1) * F;
        block = factors + BLOCK * F, origin = factors + ORIGIN * F, stack = factors + STACK * F;
    }
};

/// lane[0] becomes the least or the greatest of N floats, N a power of two; the others are overwritten.
template <bool MINIMUM, int N> inline CUDA_CALLABLE float fold_lanes(float* lane)
{
    WRT_UNROLLED
    for (int n = N / 2; n > 0; n /= 2) {
        WRT_FOR (n, i) {
            const bool other = MINIMUM ? lane[i + n] < lane[i] : lane[i + n] > lane[i];
            lane[i] = other ? lane[i + n] : lane[i];
        }
    }
    return lane[0];
}

/// Intervals of the directions and the range of the rays of a frustum, per lane.
template <int W> struct FrustumLanes {
    float low[4][W], high[4][W];

    inline CUDA_CALLABLE void clear(int i)
    {
        for (int r = 0; r < 4; ++r) low[r][i] = WRT_INFINITY, high[r][i] = -WRT_INFINITY;
    }
    inline CUDA_CALLABLE void widen(int r, int i, float lower, float upper, bool valid)
    {
        low[r][i] = (valid & (lower < low[r][i])) ? lower : low[r][i];
        high[r][i] = (valid & (upper > high[r][i])) ? upper : high[r][i];
    }
};

/// Writes the ends of the directions and of the ranges of the P rays from `first` on to lane f. No ray is made.
template <int P, int W, int F, class Batch>
inline CUDA_CALLABLE void gather_directions(const Batch& batch, int first, const FrustumRows<F>& rows, int f)
{
    const PacketRays<P> rays(batch, first);
    float to_x[P], to_y[P], to_z[P], t_min[P], t_max[P];
    rays.directions(batch, to_x, to_y, to_z);
    rays.fetch(batch.t_min_stride, [&](int k, int n) { t_min[k] = batch.t_min.data[n]; });
    rays.fetch(batch.t_max_stride, [&](int k, int n) { t_max[k] = batch.t_max.data[n]; });
    FrustumLanes<W> of;
    WRT_FOR_LANES (i) {
        of.clear(i);
        WRT_UNROLLED
        for (int g = 0; g < P; g += W) {
            float x = to_x[g + i], y = to_y[g + i], z = to_z[g + i];
            drop_negligible(x, y, z);
            const float begin = t_min[g + i], end = t_max[g + i] > FARTHEST ? FARTHEST : t_max[g + i];
            const bool valid = is_direction(x, y, z) & (begin >= 0.0f) & (begin <= end);
            of.widen(0, i, x, x, valid);
            of.widen(1, i, y, y, valid);
            of.widen(2, i, z, z, valid);
            of.widen(3, i, begin, end, valid);
        }
    }
    for (int a = 0; a < 3; ++a) {
        rows.factors[a * F + f] = fold_lanes<true, W>(of.low[a]);
        rows.factors[(3 + a) * F + f] = fold_lanes<false, W>(of.high[a]);
    }
    rows.t_min[f] = fold_lanes<true, W>(of.low[3]);
    rows.t_max[f] = fold_lanes<false, W>(of.high[3]);
}

/// Writes the origin, and its moved ones, to the memory of a block; returns whether it is finite. low, high: the scene.
template <int F, class Batch, class Vec3>
inline CUDA_CALLABLE bool set_block_origin(const Batch& batch, const Vec3& low, const Vec3& high, const FrustumRows<F>& rows)
{
    const float* o = (const float*)batch.origins.data;
    float far = 0.0f, at[3];
    bool finite = true;
    for (int a = 0; a < 3; ++a) {
        at[a] = (float)((double)o[a] - batch.center.c[a]);
        const float down = WRT_ABS(low.c[a] - at[a]), up = WRT_ABS(high.c[a] - at[a]);
        far = down > far ? down : far;
        far = up > far ? up : far;
        finite = finite & (at[a] - at[a] == 0.0f);
    }
    const float slack = SLACK * far;
    for (int a = 0; a < 3; ++a) {
        rows.origin[a] = at[a] + slack;
        rows.origin[3 + a] = at[a] - slack;
        rows.origin[6 + a] = at[a];
    }
    rows.origin[9] = slack;
    return finite;
}

/// Derives the factors of a block from the ends of the directions of its first `count` frusta.
template <int F, class Batch, class Vec3>
inline CUDA_CALLABLE void bound_block(
    const Batch& batch, const Vec3& low, const Vec3& high, const FrustumRows<F>& rows, int count)
{
    constexpr int FACTORS = FrustumRows<F>::FACTORS;
    const bool finite = set_block_origin(batch, low, high, rows);
    float own[FACTORS][F];
    WRT_FOR (F, f) {
        rows.t_max[f] = ((f < count) & finite) ? rows.t_max[f] : -WRT_INFINITY;
    }
    for (int a = 0; a < 3; ++a) {
        WRT_FOR (F, f) {
            const float d0 = rows.factors[a * F + f], d1 = rows.factors[(3 + a) * F + f], p = 1.0f / d0, q = 1.0f / d1;
            const bool active = rows.t_max[f] > -WRT_INFINITY, backward = d1 < 0.0f, mixed = (d0 < 0.0f) & !backward;
            const float forth = (!backward & (q < FARTHEST)) ? q : FARTHEST;
            const float back = ((d0 < 0.0f) & (-p < FARTHEST)) ? -p : FARTHEST;
            const float forward_end = mixed ? WRT_INFINITY : backward ? 0.0f : p;
            const float backward_end = mixed ? WRT_INFINITY : backward ? -q : 0.0f;
            own[a][f] = active ? forth : FARTHEST;
            own[3 + a][f] = active ? back : FARTHEST;
            own[6 + a][f] = active ? forward_end : 0.0f;
            own[9 + a][f] = active ? backward_end : 0.0f;
        }
    }
    for (int k = 0; k < FACTORS; ++k) {
        WRT_FOR (F, f) {
            rows.factors[k * F + f] = own[k][f];
        }
        rows.block[k] = k < FACTORS / 2 ? fold_lanes<true, F>(own[k]) : fold_lanes<false, F>(own[k]);
    }
    float first[F];
    WRT_FOR (F, f) {
        first[f] = rows.t_max[f] > -WRT_INFINITY ? rows.t_min[f] : WRT_INFINITY;
    }
    rows.block[FACTORS] = fold_lanes<true, F>(first);
}

/// Sets what cullings by intervals read to the bounds of lane f.
template <int F, class Bounds> inline CUDA_CALLABLE void frustum_bounds(const FrustumRows<F>& rows, int f, Bounds& bounds)
{
    bounds.t_min = rows.t_min[f];
    bounds.t_max = rows.t_max[f];
    bounds.slack = rows.origin[9];
    bounds.frame = -1;
    bounds.mixed_axes = 0;
    for (int a = 0; a < 3; ++a) {
        const float forth = rows.factors[a * F + f], back = rows.factors[(3 + a) * F + f], none = WRT_NAN;
        const float forward_end = rows.factors[(6 + a) * F + f], backward_end = rows.factors[(9 + a) * F + f];
        const bool backward = (forward_end == 0.0f) & (backward_end < WRT_INFINITY), mixed = (backward_end == WRT_INFINITY);
        bounds.mixed_axes += mixed ? 1 : 0;
        bounds.inverse_large.c[a] = mixed ? none : backward ? -backward_end : forward_end;
        bounds.inverse_small.c[a] = mixed ? none : backward ? -back : forth;
        bounds.origin_in.c[a] = rows.origin[backward ? 3 + a : a];
        bounds.origin_out.c[a] = rows.origin[backward ? a : 3 + a];
    }
}

/// The interval of a frustum in a box. ahead, behind: distances of the box, by axis; factor(k): of the frustum.
template <class Factor>
inline CUDA_CALLABLE Interval frustum_slab(
    const float* ahead, const float* behind, float t_min, float t_max, const Factor& factor)
{
    Interval own = {t_min, t_max};
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        float p = ahead[a] * factor(a), q;
        own.enter = p > own.enter ? p : own.enter;
        p = behind[a] * factor(3 + a);
        own.enter = p > own.enter ? p : own.enter;
        p = -behind[a] * factor(6 + a);
        q = -ahead[a] * factor(9 + a);
        q = q > p ? q : p;
        own.leave = q < own.leave ? q : own.leave;
    }
    return own;
}

/// Pushes the children of a node that frusta meet, nearest last; returns how many wait then. box: those of the node; slots:
/// which children wait, `top` of them so far. Only those that the block meets as a whole are tested against each frustum.
template <int W, int F>
inline CUDA_CALLABLE int push_children(const float* box, int node, const FrustumRows<F>& rows, int* slots, int top)
{
    const float all_t_min = rows.block[FrustumRows<F>::FACTORS], all_t_max = farthest<F>(rows.t_max);
    float ahead[3][W], behind[3][W];
    int key[W], meets[W];
    WRT_FOR_LANES (i) {
        float own_ahead[3], own_behind[3];
        for (int a = 0; a < 3; ++a) {
            ahead[a][i] = own_ahead[a] = box[a * W + i] - rows.origin[a];
            behind[a][i] = own_behind[a] = rows.origin[3 + a] - box[(3 + a) * W + i];
        }
        const Interval own = frustum_slab(own_ahead, own_behind, all_t_min, all_t_max, [&](int k) { return rows.block[k]; });
        key[i] = (__builtin_bit_cast(int, own.enter) & -W) | i;
        meets[i] = own.enter <= own.leave ? -1 : 0;
    }
    int sorted[W], count = 0;  // the farthest first
    for (unsigned left = bits<W>(meets); left; left &= left - 1u) {
        const int k = key[lowest_bit(left)];
        int at = count++;
        for (; at > 0 && sorted[at - 1] < k; --at) sorted[at] = sorted[at - 1];
        sorted[at] = k;
    }
    for (int n = 0; n < count; ++n) {
        const int i = sorted[n] & (W - 1);
        const float own_ahead[3] = {ahead[0][i], ahead[1][i], ahead[2][i]};
        const float own_behind[3] = {behind[0][i], behind[1][i], behind[2][i]};
        float* entry = rows.stack + top * F;
        int some = 0;
        WRT_FOR (F, f) {
            const Interval own = frustum_slab(
                own_ahead, own_behind, rows.t_min[f], rows.t_max[f], [&](int k) { return rows.factors[k * F + f]; });
            entry[f] = own.enter <= own.leave ? own.enter : WRT_INFINITY;
            some |= own.enter <= own.leave ? 1 : 0;
        }
        slots[top] = node * W + i;
        top += some;
    }
    return top;
}

/// The frusta that enter a waiting child before their best hits, one bit each.
template <int F> inline CUDA_CALLABLE unsigned frusta_waiting(const FrustumRows<F>& rows, int place)
{
    const float* entry = rows.stack + place * F;
    int waits[F];
    WRT_FOR (F, f) {
        waits[f] = entry[f] <= rows.t_max[f] ? -1 : 0;
    }
    return bits<F>(waits);
}

}  // namespace
}  // namespace wrt

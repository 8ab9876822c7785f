// Several packets at once, from where their rays lie in memory: bounds of all of them (wrt.kernels.traversal.packet.rays.
// joint_bounds), and triangles that all of their rays hit (wrt.kernels.traversal.packet.leaves.covering_triangle).
#pragma once
#include "packet_bounds.h"

namespace wrt {
namespace {

#if WRT_VECTORS
// Extremes of points that lie one after the other in memory, three floats each.
//
// Extremes need no points in lanes. In 3 W floats, lane i of register j always holds the component (W j + i) mod 3, so
// registers are compared lane by lane, without a shuffle. Only the last registers are folded: a fold by a multiple of 3 lanes
// keeps the components apart.

template <class V> inline V greater_of(V a, V b) { return a > b ? a : b; }

/// Widens an interval per lane, at first [inf, -inf]; NaN widens nothing.
template <class V> inline void widen(V value, V& lower, V& upper)
{
    lower = value < lower ? value : lower;
    upper = value > upper ? value : upper;
}

/// Lanes BY, BY + 1, .. of two vectors side by side, of which only the first LANES lanes count.
template <int BY, int LANES, class V, int... I> inline V moved_down(V v, V w, Numbers<int, I...>)
{
    return __builtin_shufflevector(v, w, ((BY + I) % LANES)...);
}

template <int BY, int W> inline Vector<float, W> fold_rest(Vector<float, W> v)
{
    if constexpr (BY < 3) return v;
    else return fold_rest<BY / 2, W>(greater_of(v, moved_down<BY, W>(v, v, Lanes<W>())));
}

/// The greatest of each component in 3 W lanes, in the first three lanes. W: 4 or a larger power of two.
template <int W> inline Vector<float, W> fold_triples(const Vector<float, W>* v)
{
    constexpr int HALF = W / 2, QUARTERS = 3 * W / 4;
    const auto d = greater_of(v[0], moved_down<HALF, 2 * W>(v[1], v[2], Lanes<W>()));  // W of 3 W / 2 lanes
    const auto e = greater_of(v[1], moved_down<HALF, W>(v[2], v[2], Lanes<W>()));
    return fold_rest<QUARTERS / 2, W>(greater_of(d, moved_down<QUARTERS, 2 * W>(d, e, Lanes<W>())));
}

/// Folds three registers of each end to one interval per component.
template <int W> inline void fold_ends(const Vector<float, W>* lower, const Vector<float, W>* upper, float* low, float* high)
{
    const Vector<float, W> negated[3] = {-lower[0], -lower[1], -lower[2]};
    const auto lows = fold_triples<W>(negated), highs = fold_triples<W>(upper);
    WRT_UNROLLED
    for (int i = 0; i < 3; ++i) low[i] = -lows[i], high[i] = highs[i];
}

/// Intervals of the rays of several packets. low, high: of the origins (0), the directions (1) and the ends (2) of the rays, in
/// the caller's coordinates; lows, highs: of the origins relative to the centre; start, end: lanes of the least t_min and the
/// greatest t_max of rays with ranges of their own; last: the others' t_max; odd: not 0 if a number is NaN or infinite.
template <int W> struct RayExtremes {
    float low[3][3], high[3][3], lows[3], highs[3], last;
    Vector<float, W> start, end, odd;
};

/// ENDS: whether the ends of the rays are bounded; ODD: whether `odd` is asked for.
template <bool SHARED, bool ENDS, bool ODD, int P, int W, class Batch>
inline void find_extremes(const Batch& rays, const PacketRow<P, W>& row, RayExtremes<W>& found)
{
    using vf = Vector<float, W>;
    const double center[3] = {rays.center.c[0], rays.center.c[1], rays.center.c[2]};
    const float *origins = (const float*)rays.origins.data, *directions = (const float*)rays.directions.data;
    float origin_of_all[3 * W], direction_of_all[3 * W];
    if (!rays.origin_stride)
        for (int i = 0; i < 3 * W; ++i) origin_of_all[i] = origins[i % 3];
    if (!rays.direction_stride)
        for (int i = 0; i < 3 * W; ++i) direction_of_all[i] = directions[i % 3];
    const float last = rays.t_max.data[0] > FARTHEST ? FARTHEST : rays.t_max.data[0];
    vf start = (vf)WRT_INFINITY, end = (vf)(-WRT_INFINITY), odd = (vf)0.0f;
    vf lower[3][3], upper[3][3];  // of origins, directions and ends
    WRT_UNROLLED
    for (int j = 0; j < 9; ++j) lower[j / 3][j % 3] = start, upper[j / 3][j % 3] = end;
    for (int y = 0; y < row.rows; ++y)
        for (int x = 0; x < row.length; x += W) {
            const size_t at = row.begin + (size_t)y * row.apart + x;
            const float* o = rays.origin_stride ? origins + 3 * at : origin_of_all;
            const float* d = rays.direction_stride ? directions + 3 * at : direction_of_all;
            WRT_UNROLLED
            for (int a = 0; a < 3; ++a) {
                const vf direction = load<vf>(d + a * W);
                widen(direction, lower[1][a], upper[1][a]);
                if (ODD) odd += direction * 0.0f;
                if (SHARED) continue;
                const vf origin = load<vf>(o + a * W);
                widen(origin, lower[0][a], upper[0][a]);
                if (ODD) odd += origin * 0.0f;
                if (ENDS) widen(origin + direction * last, lower[2][a], upper[2][a]);
            }
            if (rays.t_min_stride) {
                const vf t = load<vf>(rays.t_min.data + at);
                start = t < start ? t : start;
            }
            if (rays.t_max_stride) {
                const vf t = load<vf>(rays.t_max.data + at);
                end = t > end ? t : end;
            }
        }
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) found.low[0][a] = found.high[0][a] = origins[a];
    if (!SHARED) fold_ends<W>(lower[0], upper[0], found.low[0], found.high[0]);
    fold_ends<W>(lower[1], upper[1], found.low[1], found.high[1]);
    if (ENDS) fold_ends<W>(lower[2], upper[2], found.low[2], found.high[2]);
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        found.lows[a] = (float)((double)found.low[0][a] - center[a]);
        found.highs[a] = (float)((double)found.high[0][a] - center[a]);
    }
    found.last = last;
    found.start = start, found.end = end, found.odd = odd;
}

template <int W, class Batch, class Bounds>
inline void join_range(const Batch& rays, const RayExtremes<W>& found, Bounds& bounds)
{
    float t_min = WRT_INFINITY, t_max = -WRT_INFINITY;
    if (rays.t_min_stride) {
        WRT_SCALAR
        for (int i = 0; i < W; ++i) t_min = found.start[i] < t_min ? found.start[i] : t_min;
    }
    if (rays.t_max_stride) {
        WRT_SCALAR
        for (int i = 0; i < W; ++i) t_max = found.end[i] > t_max ? found.end[i] : t_max;
    }
    bounds.t_min = rays.t_min_stride ? t_min : rays.t_min.data[0];
    bounds.t_max = rays.t_max_stride ? (t_max > FARTHEST ? FARTHEST : t_max) : found.last;
}
#endif

/// Bounds the rays of the packets from ray `first` on, at most `limit`, that are whole and lie side by side; returns their
/// number, 0 for less than two. low, high: bounds of the scene; ENDS: whether the ends of rays are bounded, too.
template <int P, int W, bool SHARED, bool ENDS, class Batch, class Vec3, class Bounds>
inline CUDA_CALLABLE int join_packets(
    const Batch& rays, int first, int limit, const Vec3& low, const Vec3& high, Bounds& bounds)
{
#if WRT_VECTORS
    const PacketRow<P, W> row(rays, first, limit);
    if (row.packets < 2) return 0;
    RayExtremes<W> found;
    find_extremes<SHARED, ENDS, false>(rays, row, found);
    join_range(rays, found, bounds);
    bounds.active = row.packets * P;
    float size = 0.0f, from_zero = 0.0f;
    const auto grow = [](float value, float& largest) { largest = WRT_ABS(value) > largest ? WRT_ABS(value) : largest; };
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        grow(found.low[1][a], size), grow(found.high[1][a], size);
        if (!ENDS) continue;
        WRT_UNROLLED
        for (int r = 0; r < 3; r += 2) grow(found.low[r][a], from_zero), grow(found.high[r][a], from_zero);
    }
    const float negligible = (size > MIN_SIZE ? size : MIN_SIZE) * NEGLIGIBLE, error = ENDS_ERROR * from_zero;
    const bool one_range = !rays.t_max_stride;  // what `last` is for
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        float &lower_direction = found.low[1][a], &upper_direction = found.high[1][a];
        if ((lower_direction > 0.0f) & (lower_direction < negligible)) lower_direction = 0.0f;
        if ((upper_direction < 0.0f) & (-upper_direction < negligible)) upper_direction = 0.0f;
        if (!ENDS) continue;
        const double center = rays.center.c[a];
        bounds.end_low.c[a] = one_range ? (float)((double)found.low[2][a] - center) - error : -WRT_INFINITY;
        bounds.end_high.c[a] = one_range ? (float)((double)found.high[2][a] - center) + error : WRT_INFINITY;
    }
    bounds.slack = SlackOfEnds<Vec3> {low, high}.slack(found.lows, found.highs);
    set_direction_axes(bounds, found.low[1], found.high[1], found.lows, found.highs, bounds.slack);
    return row.packets;
#else
    return 0;
#endif
}

// Constants of wrt.kernels.traversal.packet.leaves.covering_triangle.
constexpr float INSIDE = 0x1p-14f, MIN_AREA = 0x1p-9f, CLOSEST = 0x1p-8f, SMALLEST = 1e-10f, LARGEST = 1e12f;

#if WRT_VECTORS
/// The rays of several packets: origins within `around` of `middle`, directions within `spread` of `along`, scaled; a range.
struct RayShaft {
    float middle[3], around[3], along[3], spread[3], all_around, second, first_t, last_t;
};

template <int W, class Batch> inline RayShaft shaft_of(const Batch& rays, const RayExtremes<W>& found)
{
    constexpr float ROUNDING = 0x1p-22f;
    RayShaft shaft;
    float longest = 0.0f;
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        const float lower_size = WRT_ABS(found.low[1][a]), upper_size = WRT_ABS(found.high[1][a]);
        longest = lower_size > longest ? lower_size : longest;
        longest = upper_size > longest ? upper_size : longest;
        shaft.middle[a] = 0.5f * found.lows[a] + 0.5f * found.highs[a];
        const float above = found.highs[a] - shaft.middle[a], below = shaft.middle[a] - found.lows[a];
        shaft.around[a] = above > below ? above : below;
    }
    const float scale = 1.0f / longest;
    shaft.first_t = rays.t_min.data[0] * longest;
    shaft.last_t = found.last * longest;
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        const float from = found.low[1][a] * scale, to = found.high[1][a] * scale;
        shaft.along[a] = 0.5f * (from + to);
        shaft.spread[a] = 0.5f * (to - from) + ROUNDING;
    }
    shaft.all_around = (shaft.around[0] + shaft.around[1]) + shaft.around[2];
    float widest = shaft.spread[0] > shaft.spread[1] ? shaft.spread[0] : shaft.spread[1];
    widest = shaft.spread[2] > widest ? shaft.spread[2] : widest;
    shaft.second = shaft.all_around * widest;
    return shaft;
}

template <class V, class Q> inline void cross(const V* p, const Q* q, V* to)
{
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        const int b = a == 2 ? 0 : a + 1, c = b == 2 ? 0 : b + 1;
        to[a] = p[b] * q[c] - p[c] * q[b];
    }
}

/// Of a vector whose intervals are `at` +- `radius`: adds its product with `by`, and the radius of that.
template <class V> inline void add_product(const V* by, const float* at, const float* radius, V& value, V& value_radius)
{
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) value += by[a] * at[a], value_radius += absolute(by[a]) * radius[a];
}

/// Which of the W triangles of a block all rays of a shaft hit, as far as this is known: -1 for them, else 0.
template <int W> inline Vector<int, W> covering(const RayShaft& shaft, const float* block)
{
    using vf = Vector<float, W>;
    constexpr float MORE = 1.001f;
    vf vertex[3][3], edge[3][3], reach = (vf)0.0f;
    WRT_UNROLLED
    for (int v = 0; v < 3; ++v) {
        vf own = (vf)shaft.all_around;
        WRT_UNROLLED
        for (int a = 0; a < 3; ++a) {
            vertex[v][a] = load<vf>(block + (3 * v + a) * W) - shaft.middle[a];
            own += absolute(vertex[v][a]);
        }
        reach = own > reach ? own : reach;
    }
    WRT_UNROLLED
    for (int v = 0; v < 3; ++v) {
        WRT_UNROLLED
        for (int a = 0; a < 3; ++a) edge[v][a] = vertex[v == 2 ? 0 : v + 1][a] - vertex[v][a];
    }
    const vf unit = reach * reach;
    vf normal[3], facing = (vf)0.0f, facing_radius = facing, distance = facing, distance_radius = facing;
    cross(edge[0], edge[1], normal);
    add_product(normal, shaft.along, shaft.spread, facing, facing_radius);
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        distance += normal[a] * vertex[0][a];
        distance_radius += absolute(normal[a]) * shaft.around[a];
    }
    const vf side = facing < 0.0f ? (vf)-1.0f : (vf)1.0f;
    const vf slowest = side * facing - MORE * facing_radius, fastest = side * facing + MORE * facing_radius;
    const vf nearest = side * distance - MORE * distance_radius, farthest = side * distance + MORE * distance_radius;
    const vf margin = CLOSEST * reach * fastest;
    Vector<int, W> covered = (slowest > MIN_AREA * unit) & (reach > SMALLEST) & (reach < LARGEST)
        & (nearest > shaft.first_t * fastest + margin) & (farthest < shaft.last_t * slowest - margin);
    if (!bits_of(covered)) return covered;
    WRT_UNROLLED
    for (int v = 0; v < 3; ++v) {
        vf moment[3], across[3], length = (vf)0.0f, inside = length, radius = length;
        cross(vertex[v], edge[v], moment);
        cross(edge[v], shaft.along, across);
        add_product(moment, shaft.along, shaft.spread, inside, radius);
        WRT_UNROLLED
        for (int a = 0; a < 3; ++a) {
            radius += absolute(across[a]) * shaft.around[a];
            length += absolute(edge[v][a]);
        }
        radius += length * shaft.second;  // of both intervals at once
        covered = covered & (side * inside - MORE * radius > INSIDE * unit);
    }
    return covered;
}
#endif

/// The number of packets from ray `first` on, at most `limit`, all of whose rays hit one triangle of the `blocks` blocks from
/// `block` on; 0 if that is not known. RECORD: floats of a triangle.
template <int P, int W, bool SHARED, int RECORD, class Batch>
inline CUDA_CALLABLE int covered_packets(const Batch& rays, int first, int limit, const float* records, int block, int blocks)
{
#if WRT_VECTORS
    const PacketRow<P, W> row(rays, first, limit);
    if (row.packets < 2 || rays.t_min_stride || rays.t_max_stride) return 0;
    RayExtremes<W> found;
    find_extremes<SHARED, false, true>(rays, row, found);
    if (bits_of(found.odd != 0.0f)) return 0;
    const RayShaft shaft = shaft_of(rays, found);
    if (!(rays.t_min.data[0] >= 0.0f)) return 0;
    for (int piece = 0; piece < blocks; ++piece)
        if (bits_of(covering<W>(shaft, records + (size_t)(block + piece) * (RECORD * W)))) return row.packets;
#endif
    return 0;
}

}  // namespace
}  // namespace wrt

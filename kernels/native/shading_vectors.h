// W lanes of floats and points: what the steps that shade W rays at once are written in. CPU only.
//
// Clang's vectors have the operators of floats, and `mask ? a : b` selects lane by lane. So lane code reads as the scalar
// functions do whose bits it gives: each operation is that of the scalar function, in the same order, and no two are fused.
#pragma once
#include "lanes.h"

#if WRT_VECTORS
namespace wrt {
namespace {

template <int W> using Words = Vector<unsigned, W>;

/// W vectors of three components.
template <int W> struct V3 {
    using F = Floats<W>;
    F x, y, z;

    V3 operator+(const V3& o) const { return {x + o.x, y + o.y, z + o.z}; }
    V3 operator-(const V3& o) const { return {x - o.x, y - o.y, z - o.z}; }
    V3 operator*(const V3& o) const { return {x * o.x, y * o.y, z * o.z}; }
    V3 operator*(F s) const { return {x * s, y * s, z * s}; }
    V3 operator/(F s) const { return {x / s, y / s, z / s}; }
};

template <int W> inline Floats<W> all(float x) { return (Floats<W>)x; }

/// A vector with an array of three components, in every lane.
template <int W, class Vec> inline V3<W> all3(const Vec& v)
{
    return {(Floats<W>)v.c[0], (Floats<W>)v.c[1], (Floats<W>)v.c[2]};
}

template <int W> inline V3<W> zero3() { return {all<W>(0.0f), all<W>(0.0f), all<W>(0.0f)}; }

template <int W> inline Floats<W> dot(const V3<W>& a, const V3<W>& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

template <int W> inline V3<W> cross(const V3<W>& a, const V3<W>& b)
{
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

template <class V> inline V root(V a) { return __builtin_elementwise_sqrt(a); }
template <class M, class V> inline V pick(M mask, V a, V b) { return mask ? a : b; }

template <int W> inline V3<W> pick3(Ints<W> mask, const V3<W>& a, const V3<W>& b)
{
    return {mask ? a.x : b.x, mask ? a.y : b.y, mask ? a.z : b.z};
}

template <class M> inline bool is_any(M mask) { return __builtin_reduce_or(mask) != 0; }

/// Calls act(value, its lanes) for each value in these lanes.
template <int W, class Act> inline void for_each_value(Ints<W> values, Ints<W> lanes, Act act)
{
    while (is_any(lanes)) {
        const int value = values[__builtin_ctz(bits_of(lanes))];
        const Ints<W> own = lanes & (values == value);
        act(value, own);
        lanes = lanes & ~own;
    }
}

/// a / by for a >= 0: no CPU divides vectors of integers.
template <int W> inline Ints<W> quotient(Ints<W> a, int by)
{
    return __builtin_convertvector((__builtin_convertvector(a, Vector<double, W>) + 0.5) * (1.0 / by), Ints<W>);
}

/// Component K of W points that lie one after the other in three registers.
template <int W, int K, int... I> inline Floats<W> component(Floats<W> a, Floats<W> b, Floats<W> c, Numbers<int, I...>)
{
    const Floats<W> two = __builtin_shufflevector(a, b, (3 * I + K < 2 * W ? 3 * I + K : -1)...);
    return __builtin_shufflevector(two, c, (3 * I + K < 2 * W ? I : 3 * I + K - W)...);
}

/// Register M of three in which W points lie one after the other.
template <int W, int M, int... I> inline Floats<W> part(const V3<W>& v, Numbers<int, I...>)
{
    const Floats<W> two
        = __builtin_shufflevector(v.x, v.y, ((M * W + I) % 3 < 2 ? (M * W + I) / 3 + (M * W + I) % 3 * W : -1)...);
    return __builtin_shufflevector(two, v.z, ((M * W + I) % 3 < 2 ? I : W + (M * W + I) / 3)...);
}

template <int W> inline V3<W> load3(const void* from)
{
    using F = Floats<W>;
    const F a = load<F>(from), b = load<F>((const float*)from + W), c = load<F>((const float*)from + 2 * W);
    return {component<W, 0>(a, b, c, Lanes<W>()), component<W, 1>(a, b, c, Lanes<W>()), component<W, 2>(a, b, c, Lanes<W>())};
}

template <int W, int... I> inline void load2(const void* from, Floats<W>& x, Floats<W>& y, Numbers<int, I...>)
{
    const auto a = load<Floats<W>>(from), b = load<Floats<W>>((const float*)from + W);
    x = __builtin_shufflevector(a, b, (2 * I)...);
    y = __builtin_shufflevector(a, b, (2 * I + 1)...);
}

template <int W> inline void save3(void* to, const V3<W>& v)
{
    save(to, part<W, 0>(v, Lanes<W>()));
    save((float*)to + W, part<W, 1>(v, Lanes<W>()));
    save((float*)to + 2 * W, part<W, 2>(v, Lanes<W>()));
}

/// The three floats of the elements of an array.
template <int W, class Vec> inline V3<W> gather3(const Vec* from, const int* numbers)
{
    float words[3][W];
    WRT_SCALAR
    for (int i = 0; i < W; ++i) {
        WRT_UNROLLED
        for (int k = 0; k < 3; ++k) words[k][i] = from[numbers[i]].c[k];
    }
    return {load<Floats<W>>(words[0]), load<Floats<W>>(words[1]), load<Floats<W>>(words[2])};
}

/// W records of 16 floats of a table.
template <int W, class Record> inline void gather_records(const Record* table, const int* numbers, Floats<W>* words)
{
    WRT_UNROLLED
    for (int first = 0; first < 16; first += W) {
        WRT_UNROLLED
        for (int i = 0; i < W; ++i) words[first + i] = load<Floats<W>>((const float*)(table + numbers[i]) + first);
        transpose<W>(words + first);
    }
}

/// The lanes in the mask, then others.
template <int W> inline Ints<W> lanes_of(unsigned mask)
{
#if defined(__AVX2__)
    if constexpr (W == 8) return lanes_in(FIRST_LANES_FIRST.of[mask]);
#endif
    if constexpr (can_pack<W>()) return packed(lane_numbers<W>(), mask);
    const Ints<W> numbers = lane_numbers<W>();
    int lanes[W] = {};
    append_one_by_one<W>(lanes, (const int*)&numbers, mask);
    return load<Ints<W>>(lanes);
}

/// These lanes of v, in their order.
template <class V, class M> inline V chosen_lanes(V v, M lanes)
{
    constexpr int W = sizeof(M) / sizeof(int);
    if constexpr (can_pack<W>()) return (V)permuted((M)v, lanes);
    V moved = v;
    for (int i = 0; i < W; ++i) moved[i] = v[lanes[i]];
    return moved;
}

template <int W> inline V3<W> packed3(const V3<W>& v, Ints<W> lanes)
{
    return {chosen_lanes(v.x, lanes), chosen_lanes(v.y, lanes), chosen_lanes(v.z, lanes)};
}

}  // namespace
}  // namespace wrt
#endif

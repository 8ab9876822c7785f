// Packets: the rays of a batch that form one, their components in memory, and ends of intervals over them.
#pragma once
#include "ray.h"

namespace wrt {
namespace {

/// The size of a float as an integer in the order of the floats; NaN and infinity are beyond all numbers.
inline CUDA_CALLABLE int size_bits(float x) { return __builtin_bit_cast(int, x) & 0x7fffffff; }

/// Whether a direction is finite and long enough.
inline CUDA_CALLABLE bool is_direction(float x, float y, float z)
{
    const int size_x = size_bits(x), size_y = size_bits(y), size_z = size_bits(z);
    int size = size_x > size_y ? size_x : size_y;
    size = size > size_z ? size : size_z;
    const int shortest = size_bits(SHORTEST), beyond = size_bits(WRT_INFINITY);
    return (size >= shortest) & (size < beyond);
}

/// The components of a packet, RAYS floats each (wrt.kernels.traversal.packet.rays.packet_layout). state: the first of those
/// that a triangle test keeps. OWN: the first of those that rays have if they share no origin.
template <int RAYS, int LANES, bool SHARED_ORIGIN> struct Packet {
    static constexpr int P = RAYS, W = LANES, OWN = 11, COMPONENTS = SHARED_ORIGIN ? OWN : OWN + 6;
    static constexpr bool SHARED = SHARED_ORIGIN;

    float *inverse_x, *inverse_y, *inverse_z, *t_min, *t;
    int* primitive;
    float *u, *v, *slope_x, *slope_y;
    int* main_axis;
    float *origin_x, *origin_y, *origin_z, *slack;
    int* part;
    float *kept, *state;

    explicit CUDA_CALLABLE Packet(float* memory)
    {
        float* const rows = memory + (-((size_t)memory / 4) & 15);
        inverse_x = rows, inverse_y = rows + P, inverse_z = rows + 2 * P;
        t_min = rows + 3 * P, t = rows + 4 * P, primitive = (int*)(rows + 5 * P);
        u = rows + 6 * P, v = rows + 7 * P, slope_x = rows + 8 * P, slope_y = rows + 9 * P;
        main_axis = (int*)(rows + 10 * P);
        float* const own = SHARED ? nullptr : rows + OWN * P;
        origin_x = own, origin_y = SHARED ? nullptr : own + P, origin_z = SHARED ? nullptr : own + 2 * P;
        slack = SHARED ? nullptr : own + 3 * P, part = SHARED ? nullptr : (int*)(own + 4 * P);
        kept = SHARED ? nullptr : own + 5 * P;
        state = rows + COMPONENTS * P;
    }

    // By multiplication: a choice among three members would keep the whole struct in memory.
    inline CUDA_CALLABLE float* inverse(int axis) const { return inverse_x + axis * P; }
    inline CUDA_CALLABLE float* origin(int axis) const { return SHARED ? nullptr : inverse_x + (OWN + axis) * P; }
};

/// The origin and the slack that all rays of a packet share, or the corresponding ends of their intervals.
struct SharedOrigin {
    float origin[3], slack;
};

template <class Bounds> inline CUDA_CALLABLE SharedOrigin shared_origin(const Bounds& bounds)
{
    return {{bounds.origin_low.c[0], bounds.origin_low.c[1], bounds.origin_low.c[2]}, bounds.slack};
}

/// What a box test needs of ray k.
template <int P, int W, bool SHARED>
inline CUDA_CALLABLE BoxRay box_ray(const Packet<P, W, SHARED>& packet, const SharedOrigin& shared, int k)
{
    const float wide = SHARED ? shared.slack : packet.slack[k];
    const float ox = SHARED ? shared.origin[0] : packet.origin_x[k], oy = SHARED ? shared.origin[1] : packet.origin_y[k];
    const float oz = SHARED ? shared.origin[2] : packet.origin_z[k];
    return widened_ray(packet.inverse_x[k], packet.inverse_y[k], packet.inverse_z[k], ox, oy, oz, wide);
}

/// The part of the range t_min .. t_max in which ray k is in the box from `low` to `high`.
template <int P, int W, bool SHARED>
inline CUDA_CALLABLE Interval ray_slab(const Packet<P, W, SHARED>& packet, const SharedOrigin& shared, int k, const float* low,
    const float* high, float t_min, float t_max)
{
    return meet_box(low, high, box_ray(packet, shared, k), t_min, t_max);
}

/// The band of DOWN rows of a picture in which a place is. Its whole tiles are packets, whatever the number of columns: the
/// places before the band's first packet and those after its last tile are the columns to the right of the tiles, from the top
/// down (wrt.kernels.traversal.packet.rays.ray_numbers).
template <int P> struct PictureBand {
    static constexpr int ACROSS = P < 8 ? P : 8, DOWN = P / ACROSS;
    int begin, height, before, tiles, columns;  // its first place and ray; rows; places before its first tile; whole tiles

    CUDA_CALLABLE PictureBand(int count, int all_columns, int place)
        : columns(all_columns)
    {
        const int rays = DOWN * columns, band = place / rays, below = count / columns - band * DOWN;
        begin = band * rays;
        height = below < DOWN ? below : DOWN;
        before = P % ACROSS == 0 && height == DOWN ? (P - begin % P) % P : 0;
        const int rest = height * columns - before;
        tiles = rest > 0 ? rest / (ACROSS * height) : 0;
    }

    /// The number of the ray at a place of the band.
    inline CUDA_CALLABLE int ray_at(int place) const
    {
        const int area = ACROSS * height, offset = place - begin, own = offset - before;
        if (own >= 0 && own < tiles * area) {
            const int tile = own / area, within = own - tile * area;
            return begin + within / ACROSS * columns + tile * ACROSS + within % ACROSS;
        }
        const int beside = own < 0 ? offset : offset - tiles * area;
        return begin + beside % height * columns + tiles * ACROSS + beside / height;
    }

    /// The whole tile that is the packet from a place on; -1 for another packet.
    inline CUDA_CALLABLE int tile_at(int place) const
    {
        const int own = place - begin - before;
        return P % ACROSS == 0 && height == DOWN && own >= 0 && own % P == 0 && own / P < tiles ? own / P : -1;
    }
};

/// Which rays of a batch form a packet: consecutive rays, or the pixels of a tile
/// (wrt.kernels.traversal.packet.rays.ray_numbers). here: how many of them exist; whole: whether they are DOWN runs of ACROSS
/// consecutive rays, from `begin` on, `apart` rays from each other; number: else the number of each.
template <int P> struct PacketRays {
    static constexpr int ACROSS = P < 8 ? P : 8, DOWN = P / ACROSS;
    int first, here, begin, apart, number[P];
    bool picture, whole;

    template <class Batch>
    CUDA_CALLABLE PacketRays(const Batch& rays, int place_of_first)
        : first(place_of_first)
    {
        const int rest = rays.count - first;
        here = rest < P ? rest : P;
        picture = rays.columns > 0;
        begin = first, apart = ACROSS;
        whole = here == P;
        if (picture) {
            const PictureBand<P> band(rays.count, rays.columns, first);
            const int tile = band.tile_at(first);
            begin = band.begin + tile * ACROSS;
            apart = rays.columns;
            whole = whole && tile >= 0;
            if (!whole)
                for (int k = 0; k < P; ++k) {
                    const int place = first + (k < here ? k : 0);
                    number[k] = PictureBand<P>(rays.count, rays.columns, place).ray_at(place);
                }
        } else if (!whole)
            for (int k = 0; k < P; ++k) number[k] = first + (k < here ? k : 0);
    }

    /// visit(k, n) for each ray k of the packet, n being its number in the batch.
    template <class Visit> inline CUDA_CALLABLE void each(Visit visit) const
    {
        if (whole && !picture) {
            WRT_FOR (P, k) {
                visit(k, first + k);
            }
        } else if (whole) {
            for (int y = 0; y < DOWN; ++y) {
                WRT_FOR (ACROSS, x) {
                    visit(y * ACROSS + x, begin + y * apart + x);
                }
            }
        } else {
            WRT_SCALAR
            for (int k = 0; k < here; ++k) visit(k, number[k]);
        }
    }

    /// take(k, n): ray k has what is at place n, of an array with an element for each ray, or with one for all.
    template <class Take> inline CUDA_CALLABLE void fetch(int stride, Take take) const
    {
        if (stride) each(take);
        else {
            WRT_FOR (P, k) {
                take(k, 0);
            }
        }
    }

    /// Fetches what the next packet takes from an array of points into the caches.
    template <class Vec3> inline CUDA_CALLABLE void fetch_next(const Vec3* data) const
    {
        if (!whole || picture) return;
        WRT_UNROLLED
        for (int b = 0; b < 12 * P; b += 64) WRT_FETCH((const char*)(data + first + P) + b);
    }

    /// The directions of the rays, in memory of their own, so that no component of a packet may lie in their way.
    template <class Batch> inline CUDA_CALLABLE void directions(const Batch& rays, float* x, float* y, float* z) const
    {
        fetch(rays.direction_stride, [&](int k, int n) {
            const float* d = (const float*)rays.directions.data + 3 * (size_t)n;
            x[k] = d[0], y[k] = d[1], z[k] = d[2];
        });
        if (rays.direction_stride) fetch_next(rays.directions.data);
        for (int k = here; k < P; ++k) x[k] = y[k] = z[k] = 0.0f;  // beyond the end of the batch: no direction misses
    }
};

/// The whole packets from ray `first` on that lie side by side, at most `limit`: `rows` of `length` rays, a multiple of W, from
/// ray `begin` on and `apart` rays from each other.
template <int P, int W> struct PacketRow {
    static constexpr int ACROSS = P < 8 ? P : 8, DOWN = P / ACROSS, STEP = W > ACROSS ? W / ACROSS : 1;
    int packets, rows, begin, apart, length;

    template <class Batch> CUDA_CALLABLE PacketRow(const Batch& rays, int first, int limit)
    {
        const int left_over = rays.count - first;
        packets = left_over / P < limit ? left_over / P : limit;
        rows = 1, begin = first, apart = 0;
        if (rays.columns > 0) {
            const PictureBand<P> band(rays.count, rays.columns, first);
            const int tile = band.tile_at(first), fit = band.tiles - tile;
            begin = band.begin + tile * ACROSS;
            apart = rays.columns;
            rows = DOWN;
            packets = tile < 0 ? 0 : (packets < fit ? packets : fit);
            packets -= packets % STEP;
            length = packets * ACROSS;
        } else length = packets * P;
    }
};

/// An interval over values, as integers in the order of the floats: a compiler must keep the order of comparisons of floats, so
/// it vectorises a reduction of integers only. Both ends are NaN while it is empty.
struct OrderedInterval {
    int low = 0x7fffffff, high = (int)0x80000000;

    inline CUDA_CALLABLE void widen(float value, bool counts)
    {
        const int own = key(value), low_key = counts ? own : 0x7fffffff, high_key = counts ? own : (int)0x80000000;
        low = low_key < low ? low_key : low;
        high = high_key > high ? high_key : high;
    }
    static inline CUDA_CALLABLE int key(float value)
    {
        const int bits = __builtin_bit_cast(int, value);
        return bits ^ ((bits >> 31) & 0x7fffffff);
    }
    static inline CUDA_CALLABLE float value(int key) { return __builtin_bit_cast(float, key ^ ((key >> 31) & 0x7fffffff)); }
    inline CUDA_CALLABLE float lower() const { return value(low); }
    inline CUDA_CALLABLE float upper() const { return value(high); }
};

/// The greatest t of rays, -inf for none: as integers, in the order of the floats that are not negative (adding 0 turns -0 into
/// +0), and -inf below them.
template <int P> inline CUDA_CALLABLE float farthest(const float* t)
{
    int max_bits = (int)0x80000000;
    WRT_FOR (P, k) {
        const int bits = __builtin_bit_cast(int, t[k] + 0.0f);
        max_bits = bits > max_bits ? bits : max_bits;
    }
    return max_bits < 0 ? -WRT_INFINITY : __builtin_bit_cast(float, max_bits);
}

/// Updates `bounds.t_max` after rays have found hits; any-hit rays are finished, not shortened.
template <bool ANY_HIT, int P, int W, bool SHARED, class Bounds>
inline CUDA_CALLABLE void shorten(const Packet<P, W, SHARED>& packet, Bounds& bounds)
{
    if (!ANY_HIT) {
        bounds.t_max = farthest<P>(packet.t);
        return;
    }
    int left = 0;
    WRT_FOR (P, k) {
        left |= packet.t[k] >= -0.0f ? 1 : 0;
    }
    bounds.t_max = left ? bounds.t_max : -WRT_INFINITY;
}

/// The axis of the largest component, bits 1, 2 and 4; ties as in the scalar form of the watertight test.
template <class Size> inline CUDA_CALLABLE int largest_axis(Size x, Size y, Size z)
{
    const bool xy = x >= y, xz = x >= z, yz = y >= z;
    const bool main_x = xy & xz, main_y = !xy & yz;
    return main_x ? 1 : main_y ? 2 : 4;
}

/// The number of an axis that is given by its bit.
inline CUDA_CALLABLE int axis_of(int bit) { return bit == 1 ? 0 : bit == 2 ? 1 : 2; }

}  // namespace
}  // namespace wrt

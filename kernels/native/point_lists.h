// Lists of triangles near points: the k nearest, or all within a distance.
//
// While a list grows, the first weight of a triangle has the bits of its place in the blocks.
#pragma once
#include "point_spaces.h"

namespace wrt {
namespace {

/// Rows of a list that begin at the same place.
template <class Found> struct TriangleRows {
    const Found& found;
    size_t begin;

    inline CUDA_CALLABLE float& distance(int i) const { return found.distance.data[begin + i]; }
    inline CUDA_CALLABLE int& number(int i) const { return found.primitive.data[begin + i]; }
    inline CUDA_CALLABLE float& weight(int i, int which) const { return found.uv.data[begin + i].c[which]; }
    inline CUDA_CALLABLE int slot(int i) const { return __builtin_bit_cast(int, weight(i, 0)); }

    inline CUDA_CALLABLE void put(int i, float away, int number, int slot) const
    {
        distance(i) = away, this->number(i) = number, weight(i, 0) = __builtin_bit_cast(float, slot);
    }

    inline CUDA_CALLABLE void move(int to, int from) const { put(to, distance(from), number(from), slot(from)); }

    /// Whether triangle i comes before one of this distance and number.
    inline CUDA_CALLABLE bool before(int i, float away, int number) const
    {
        return distance(i) < away || (distance(i) == away && this->number(i) < number);
    }

    /// Puts triangle i in order below those that are after it, in a heap of `size`.
    inline CUDA_CALLABLE void sink(int i, int size) const
    {
        const float away = distance(i);
        const int own = number(i), place = slot(i);
        while (true) {
            int child = 2 * i + 1;
            if (child >= size) break;
            if (child + 1 < size && before(child, distance(child + 1), number(child + 1))) ++child;
            if (before(child, away, own) || number(child) == own) break;
            move(i, child);
            i = child;
        }
        put(i, away, own, place);
    }

    inline CUDA_CALLABLE void sort(int size) const
    {
        for (int i = size / 2 - 1; i >= 0; --i) sink(i, size);
        for (int last = size - 1; last > 0; --last) {
            const float away = distance(last);
            const int own = number(last), place = slot(last);
            move(last, 0);
            put(0, away, own, place);
            sink(0, last);
        }
    }

    /// Drops triangles that follow themselves; returns how many are left.
    inline CUDA_CALLABLE int drop_repeated(int size) const
    {
        int kept = 0;
        for (int i = 0; i < size; ++i)
            if (kept == 0 || number(i) != number(kept - 1)) move(kept++, i);
        return kept;
    }

    /// Writes weights and features in place of slots.
    template <class Space> inline CUDA_CALLABLE void finish(const Space& space, int size) const
    {
        for (int i = 0; i < size; ++i) {
            const OnTriangle at = space.triangle(number(i), slot(i)).nearest();
            weight(i, 0) = at.u, weight(i, 1) = at.v;
            found.feature.data[begin + i] = (signed char)at.feature;
        }
    }
};

/// The `room` nearest triangles, sorted by distance, then number.
template <class Found> struct NearestList : Search {
    TriangleRows<Found> rows;
    int room, size = 0;

    CUDA_CALLABLE NearestList(float max_distance, const Found& found, size_t begin, int room)
        : rows {found, begin}
        , room(room)
    {
        this->max_distance = max_distance;
    }

    inline CUDA_CALLABLE float farthest() const
    {
        const float last = size == room ? rows.distance(room - 1) : WRT_INFINITY;
        return last < max_distance ? last : max_distance;
    }

    inline CUDA_CALLABLE void keep(float square, int primitive, int slot, const SearchPoint& point)
    {
        const float away = square_root(square) * scale;
        const int own = first + primitive;
        if (!(away <= max_distance)) return;
        int place = size;
        while (place > 0 && !rows.before(place - 1, away, own)) --place;
        if (place == room || (place < size && rows.number(place) == own)) return;
        if (size < room) ++size;
        for (int i = size - 1; i > place; --i) rows.move(i, i - 1);
        rows.put(place, away, own, slot);
        look_up_to(farthest(), point.slack);
    }
};

/// The number of triangles within a distance; those that are in several leaves count several times.
struct TriangleCount : Search {
    static constexpr bool NARROWS = false;
    int size = 0;

    explicit CUDA_CALLABLE TriangleCount(float max_distance) { this->max_distance = max_distance; }

    inline CUDA_CALLABLE float farthest() const { return max_distance; }

    inline CUDA_CALLABLE void keep(float square, int, int, const SearchPoint&)
    {
        size += square_root(square) * scale <= max_distance;
    }
};

/// The same triangles, in no order.
template <class Found> struct TriangleList : TriangleCount {
    TriangleRows<Found> rows;

    CUDA_CALLABLE TriangleList(float max_distance, const Found& found, size_t begin)
        : TriangleCount(max_distance)
        , rows {found, begin}
    {
    }

    inline CUDA_CALLABLE void keep(float square, int primitive, int slot, const SearchPoint&)
    {
        const float away = square_root(square) * scale;
        if (away <= max_distance) rows.put(size++, away, first + primitive, slot);
    }
};

}  // namespace
}  // namespace wrt

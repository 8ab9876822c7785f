// What is asked of a ray, for walks that test triangles of 48 bytes one by one: the kinds of wrt.kernels.answers.
//
// Each says by which rule a line meets a triangle, whether hits shorten the ray (SHORTENS) or end it (ENDS), what it does with
// a hit in the ray's range, take(hits, i, hit, best) -> whether it is kept, and what it stores. WIDE: whether triangles are
// tested in float64 instead (packed_exact.h).
#pragma once
#include "packed_triangles.h"

namespace wrt {
namespace {

/// What walks keep besides their best hit: nothing.
struct NoState { };

struct ClosestAnswer {
    using Rule = Inclusive;
    using State = NoState;
    static constexpr bool WIDE = false;
    static constexpr bool SHORTENS = true, ENDS = false;

    template <class Hits> static CUDA_CALLABLE bool take(const Hits&, int, const PackedHit& hit, PackedHit& best)
    {
        if (hit.t == best.t && best.id >= 0 && hit.id >= best.id) return false;
        best = hit;
        return true;
    }

    template <class Hits> static CUDA_CALLABLE void store(const Hits& hits, int i, const PackedHit& best)
    {
        hits.t.data[i] = best.id < 0 ? WRT_INFINITY : best.t;
        hits.primitive.data[i] = best.id;
        float* const uv = (float*)(hits.uv.data + i);
        uv[0] = best.u, uv[1] = best.v;
    }
};

struct AnyAnswer {
    using Rule = Inclusive;
    using State = NoState;
    static constexpr bool WIDE = false;
    static constexpr bool SHORTENS = false, ENDS = true;

    template <class Hits> static CUDA_CALLABLE bool take(const Hits&, int, const PackedHit& hit, PackedHit& best)
    {
        best = hit;
        return true;
    }

    template <class Hits> static CUDA_CALLABLE void store(const Hits& hits, int i, const PackedHit& best)
    {
        hits.occluded.data[i] = best.id >= 0;
    }
};

/// Of crossings, best.id is their number, or the sum of their signs, minus one.
struct CountAnswer {
    using Rule = Crossing;
    using State = NoState;
    static constexpr bool WIDE = false;
    static constexpr bool SHORTENS = false, ENDS = false;

    template <class Hits> static CUDA_CALLABLE bool take(const Hits&, int, const PackedHit&, PackedHit& best)
    {
        ++best.id;
        return true;
    }

    template <class Hits> static CUDA_CALLABLE void store(const Hits& hits, int i, const PackedHit& best)
    {
        hits.counts.data[i] = best.id + 1;
    }
};

struct WindingAnswer : CountAnswer {
    using Rule = Oriented;

    template <class Hits> static CUDA_CALLABLE bool take(const Hits&, int, const PackedHit& hit, PackedHit& best)
    {
        best.id += hit.u > 0.0f ? 1 : -1;
        return true;
    }
};

/// Lists hits in the order in which they are found (wrt.kernels.answers.all_crossings).
struct ListAnswer : CountAnswer {
    template <class Hits> static CUDA_CALLABLE bool take(const Hits& hits, int i, const PackedHit& hit, PackedHit& best)
    {
        const int number = ++best.id;
        if (hits.room == 0 || number < hits.room) {
            const size_t place = hits.room == 0 ? (size_t)hits.begins.data[i] + number : (size_t)i * hits.room + number;
            hits.t.data[place] = hit.t;
            hits.primitive.data[place] = hit.id;
            float* const uv = (float*)(hits.uv.data + place);
            uv[0] = hit.u, uv[1] = hit.v;
        }
        return true;
    }
};

/// The first crossing that follows a given one (wrt.kernels.answers.next_crossing), which `hits` is.
struct NextAnswer : ClosestAnswer {
    using Rule = Crossing;

    template <class Hits> static CUDA_CALLABLE bool take(const Hits& previous, int i, const PackedHit& hit, PackedHit& best)
    {
        const bool is_later = hit.t > previous.t || (hit.t == previous.t && hit.id > previous.primitive);
        return is_later && ClosestAnswer::take(previous, i, hit, best);
    }
};

}  // namespace
}  // namespace wrt

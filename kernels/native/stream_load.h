// Rays of a batch, appended to a stream 16 at a time (wrt.kernels.traversal.stream.stream_load): they are computed component by
// component, and then transposed.
#pragma once
#include "ray.h"
#include "triangle.h"

namespace wrt {
namespace {

/// Of triangle tests without a form for lanes: their rays are prepared one by one, after they have been stored.
struct OneByOne {
    static constexpr bool PREPARES = false;

    template <class State> static constexpr CUDA_CALLABLE bool fits(int) { return true; }

    template <int L>
    static CUDA_CALLABLE void prepare(
        float (*)[L], const float*, const float*, const float*, const float*, const float*, const float*)
    {
    }
};

/// A stream that keeps all valid rays.
struct AllRays {
    template <int L> CUDA_CALLABLE void filter(const float (*)[L], int*) { }
    CUDA_CALLABLE void list(unsigned) { }
};

/// Greatest number of rays of a group that are written word by word, without a transposition.
constexpr int FEW_RAYS = 3;

/// Appends the stored ones of the rays in lanes to a stream, which ends at `stream`; returns their bits.
///
/// low, high: bounds of the scene. own: receives what `prepare_one_by_one` reads: origins, directions and numbers. root.filter
/// may clear stored[k], then ray k is not stored; root.list gets the bits of the others, if there are any. number(k): number of
/// ray k, after the first ray of the stream.
template <class Test, int L, class Ray, class Vec, class Root, class Number>
inline CUDA_CALLABLE unsigned store_rays(
    RayLanes<L>& rays, const Vec& low, const Vec& high, Ray* stream, float* own, Root& root, const Number& number)
{
    constexpr int RAY_WORDS = sizeof(Ray) / 4, WORDS = Test::PREPARES ? RAY_WORDS : RayRows::STATE;
    static_assert(RAY_WORDS >= 16 && WORDS <= 32, "a ray is stored as one or two vectors of 16 words");
    static_assert(__builtin_offsetof(Ray, t_min) == 4 * RayRows::T_MIN && __builtin_offsetof(Ray, best) == 4 * RayRows::T);
    static_assert(__builtin_offsetof(Ray, state) == 4 * RayRows::STATE && __builtin_offsetof(Ray, number) == 4 * RAY_WORDS - 4);
    static_assert(Test::template fits<decltype(Ray::state)>(RayRows::STATE));
    if constexpr (!Test::PREPARES) {
        WRT_UNROLLED
        for (int row = 0; row < 6; ++row) {
            const float* const from = row < 3 ? rays.origin[row] : rays.direction[row - 3];
            WRT_FOR (L, k) {
                own[row * L + k] = from[k];
            }
        }
        WRT_FOR (L, k) {
            ((int*)own)[6 * L + k] = number(k);
        }
    }
    alignas(64) float words[WORDS < 16 ? 16 : WORDS][L];
    write_rows<L>(rays, low, high, words);
    root.template filter<L>(words, rays.stored);
    const unsigned kept = bits<L>(rays.stored) & ((1u << rays.here) - 1u);
    if (kept == 0) return 0;
    root.list(kept);
    Test::template prepare<L>(
        words, rays.direction[0], rays.direction[1], rays.direction[2], rays.origin[0], rays.origin[1], rays.origin[2]);
    if (WORDS > RayRows::STATE) {
        WRT_FOR (L, k) {
            ((int*)words[WORDS - 1])[k] = number(k);
        }
    }
    float* to = (float*)stream;
    if (count_bits(kept) <= FEW_RAYS) {
        for (unsigned left = kept; left; left &= left - 1u, to += RAY_WORDS) {
            const float* own_word = words[0] + lowest_bit(left);
            WRT_UNROLLED
            for (int c = 0; c < WORDS; ++c) to[c] = own_word[c * L];
        }
        return kept;
    }
    write_records(words[0], to, RAY_WORDS, kept);
    if constexpr (WORDS > 16) write_records(words[WORDS - 16], to + WORDS - 16, RAY_WORDS, kept);
    return kept;
}

/// Appends the valid ones of the `count` rays from `first` on, at most L; `place`: their place after the first ray of the
/// stream.
template <class Test, int L, class Batch, class Vec, class Ray>
inline CUDA_CALLABLE unsigned load_rays(
    const Batch& batch, int first, int count, const Vec& low, const Vec& high, Ray* stream, int place, float* own)
{
    if (count <= 0) return 0;
    RayLanes<L> rays;
    rays.here = count < L ? count : L;
    load_lanes<true>(batch, first, rays);
    check_lanes(rays);
    AllRays all;
    return store_rays<Test>(rays, low, high, stream, own, all, [&](int k) { return place + k; });
}

}  // namespace
}  // namespace wrt

// Candidates of a stream: pairs of a ray and a triangle that its line meets, 16 at a time (see
// wrt.kernels.traversal.stream.stream_candidates), and leaves of few triangles (wrt.kernels.traversal.stream.stream_leaves).
#pragma once
#include "ray.h"
#include "stream.h"
#include "triangle.h"

namespace wrt {
namespace {

/// L pairs of a ray and a triangle in lanes: the rows of the rays, and the components and numbers of the triangles.
template <class Ray, int L> struct CandidateLanes {
    static constexpr int WORDS = sizeof(Ray) / 4;

    alignas(64) float words[WORDS][L];
    alignas(64) float corner[9][L];
    int primitive[L];

    /// Reads the rays with these numbers.
    CUDA_CALLABLE void read_rays(const Ray* rays, const int* owner)
    {
        const float* from[L];
        WRT_SCALAR
        for (int i = 0; i < L; ++i) from[i] = (const float*)(rays + (unsigned)owner[i]);
        read_records(from, 0, words[0]);
        read_records(from, WORDS - 16, words[WORDS - 16]);
    }

    /// Tests the pairs and merges their hits. Lane i is of ray owner[i]; only the first `count` lanes count. ANY_HIT: a ray
    /// with a hit gets t = -inf; otherwise of equally near hits that of the least number counts.
    template <class Test, bool ANY_HIT> CUDA_CALLABLE void merge(Ray* rays, const int* owner, int count) const
    {
        float t[L], u[L], v[L];
        int near[L];
        Test::template test<L>(words, corner, t, u, v);
        WRT_FOR (L, i) {
            float low[3], high[3], at = t[i];
            vertex_box<L>(corner[0] + i, low, high);
            const Interval own = meet_box(low, high, box_ray<L>(words, i), -WRT_INFINITY, WRT_INFINITY);
            const bool hit = at == at;  // a candidate may be none; the box makes a number of a NaN
            at = clamped(at, own);
            t[i] = at;
            near[i] = (hit & (own.enter <= own.leave) & (at >= words[RayRows::T_MIN][i]) & (at <= words[RayRows::T][i])
                          & (i < count))
                ? -1
                : 0;
        }
        for (unsigned mask = bits<L>(near); mask; mask &= mask - 1u) {
            const int i = lowest_bit(mask);
            auto& best = rays[owner[i]].best;
            if constexpr (ANY_HIT) {
                best.primitive = 0;  // any
                best.t = -WRT_INFINITY;
            } else if ((t[i] < best.t) | ((t[i] == best.t) & ((best.primitive < 0) | (primitive[i] < best.primitive)))) {
                best.t = t[i];
                best.primitive = primitive[i];
                best.u = u[i];
                best.v = v[i];
            }
        }
    }
};

/// Tests the first `count` candidates and merges their hits. The lists have room for L beyond `count`. W: of a block;
/// COMPONENTS: of a triangle's record.
template <class Test, int W, int COMPONENTS, bool ANY_HIT, int L, class Ray, class PairLists>
inline CUDA_CALLABLE void test_candidates(const float* records, const int* primitives, Ray* rays, PairLists& pairs, int count)
{
    WRT_UNROLLED
    for (int i = 0; i < L; ++i) {  // the last vector is filled up
        pairs.candidates.c[count + i] = pairs.candidates.c[0];
        pairs.candidate_rays.c[count + i] = pairs.candidate_rays.c[0];
    }
    for (int first = 0; first < count; first += L) {
        CandidateLanes<Ray, L> lanes;
        const int* const owner = pairs.candidate_rays.c + first;
        WRT_SCALAR
        for (int i = 0; i < L; ++i) {
            const unsigned slot = (unsigned)pairs.candidates.c[first + i];
            if (!ANY_HIT) lanes.primitive[i] = primitives[slot];
            const float* r = records + (size_t)(slot / W) * (COMPONENTS * W) + slot % W;
            WRT_UNROLLED
            for (int c = 0; c < 9; ++c) lanes.corner[c][i] = r[c * W];
        }
        lanes.read_rays(rays, owner);
        lanes.template merge<Test, ANY_HIT>(rays, owner, count - first);
    }
}

/// Tests the `count` rays of a list against all triangles of a leaf of one block; of the list's words only the rays' numbers
/// remain. leaf: a child word of wrt.kernels.layout.bvh_nodes. A list has room for L beyond its end.
template <class Test, int W, int COMPONENTS, bool ANY_HIT, int L, class Ray>
inline CUDA_CALLABLE void test_leaf(const float* records, const int* primitives, Ray* rays, int* owner, int count, int leaf)
{
    const int block = ~leaf >> 6, triangles = ~leaf & 63;
    WRT_FOR (count, i) {
        owner[i] &= (1 << RAY_BITS) - 1;
    }
    WRT_UNROLLED
    for (int i = 0; i < L; ++i) owner[count + i] = owner[0];  // the last vector is filled up
    for (int first = 0; first < count; first += L) {
        CandidateLanes<Ray, L> lanes;
        lanes.read_rays(rays, owner + first);
        for (int k = 0; k < triangles; ++k) {
            const int id = primitives[block * W + k];
            const float* record = records + (size_t)block * (COMPONENTS * W) + k;
            for (int c = 0; c < 9; ++c) {
                const float x = record[c * W];
                WRT_FOR (L, i) {
                    lanes.corner[c][i] = x;
                }
            }
            WRT_FOR (L, i) {
                lanes.primitive[i] = id;
            }
            lanes.template merge<Test, ANY_HIT>(rays, owner + first, count - first);
        }
    }
}

/// Replaces the best hit by the hit t, u, v if that is nearer, or as near with a lesser number. By bit operations: the compiler
/// may turn a select into a branch, which is slower for incoherent rays.
template <class Best> inline CUDA_CALLABLE void record_if_better(const float* hit, int primitive, float t_min, Best& best)
{
    const float t = hit[0];
    const bool ahead = (t < best.t) | ((t == best.t) & ((best.primitive < 0) | (primitive < best.primitive)));
    const unsigned taken = 0u - (unsigned)((t >= t_min) & ahead);
    const auto pick = [&](float old, float other) {
        const unsigned kept = __builtin_bit_cast(unsigned, old) & ~taken;
        return __builtin_bit_cast(float, kept | (__builtin_bit_cast(unsigned, other) & taken));
    };
    best.primitive = (int)(((unsigned)best.primitive & ~taken) | ((unsigned)primitive & taken));
    best.t = pick(best.t, t);
    best.u = pick(best.u, hit[1]);
    best.v = pick(best.v, hit[2]);
}

}  // namespace
}  // namespace wrt

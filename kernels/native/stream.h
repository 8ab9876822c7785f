// The lane loops of streams in a wide BVH: lists of rays, filtered by the boxes of a node.
#pragma once
#include "box.h"

namespace wrt {
namespace {

/// Bits of a ray's number in a list; the bits of the children are above.
constexpr int RAY_BITS = 16;

/// Which child of a node comes first: any, the nearest, the farthest.
enum class Order { NONE, NEAR, FAR };

/// -1 for a number with a sign, else 0. Read as volatile: Clang would make a vector of the three signs of a ray, and take it
/// apart again.
inline CUDA_CALLABLE int sign_of(const float& x) { return *(const volatile int*)&x >> 31; }

/// Filters a list of `count` rays by the W boxes of a node; see `wrt.kernels.traversal.stream.stream_lanes.filter_boxes`.
template <int W, Order ORDER, class Ray>
inline CUDA_CALLABLE int filter_boxes(
    const float* bounds, const int* children, int node, const Ray* rays, int* list, int count, int* key, unsigned& leaves)
{
    constexpr int L = block_lanes(W), BACK = 3 * W;
    const float* box = bounds + (size_t)node * (6 * W);
    const int* child = children + (size_t)node * W;
    int min_order[W];
    unsigned are_leaves = 0, reached = 0;
    for (int i = 0; i < W; ++i) {
        min_order[i] = NO_CHILD;
        are_leaves |= child[i] < 0 ? 1u << i : 0u;
    }
    int kept = 0;
    for (int j = 0; j < count; ++j) {
        const int k = list[j] & ((1 << RAY_BITS) - 1);
        // of AVX2's 16 registers none is left for `rays`: it would be loaded again for each number of the ray
        const Ray& ray = W < 16 ? read_in_place(rays[k]) : rays[k];
        const float* const inverse = ray.slabs.inverse.c;
        const BoxRay slabs = box_ray(ray.slabs);
        const int x = sign_of(inverse[0]), y = sign_of(inverse[1]), z = sign_of(inverse[2]);
        const PlanePointers planes = {{box + (x & BACK), box + W + (y & BACK), box + 2 * W + (z & BACK)},
            {box + (~x & BACK), box + W + (~y & BACK), box + 2 * W + (~z & BACK)}};
        const float t_min = ray.t_min, t_max = ray.best.t;
        int hit[L] = {};
        WRT_FOR_LANES (i) {
            const Interval own = slab<Exact>(planes, slabs, i, t_min, t_max);
            hit[i] = own.enter <= own.leave ? -1 : 0;
            if (ORDER != Order::NONE) {
                const int entry = __builtin_bit_cast(int, own.enter);
                int order = ((ORDER == Order::FAR ? 0x7f7fffff - entry : entry) & -W) | i;
                order = own.enter <= own.leave ? order : NO_CHILD;
                min_order[i] = order < min_order[i] ? order : min_order[i];
            }
        }
        const unsigned met = bits<L>(hit);
        list[kept] = (int)(met << RAY_BITS) | k;
        kept += met != 0u;
        reached |= met;
    }
    const unsigned inner = reached & ~are_leaves;
    for (int i = 0; i < W; ++i) key[i] = inner >> i & 1u ? (ORDER == Order::NONE ? i : min_order[i]) : NO_CHILD;
    leaves = reached & are_leaves;
    return kept;
}

/// Lists pairs of a node's leaves and of the rays of its list from number `listed` on; returns how many.
template <int W, int ROOM>
inline CUDA_CALLABLE int list_leaves(
    const int* children, int node, const int* list, int count, unsigned leaves, int& listed, int* pair_rays, int* pair_leaves)
{
    constexpr int L = block_lanes(W);
    const int* child = children + (size_t)node * W;
    int leaf[L] = {}, paired = 0, j = listed;
    for (int c = 0; c < W; ++c) leaf[c] = child[c];
    for (; j < count && paired <= ROOM; ++j) {
        const int word = list[j], k = word & ((1 << RAY_BITS) - 1);
        WRT_FOR (L, i) {
            pair_rays[paired + i] = k;
        }
        paired += append<L>(pair_leaves + paired, leaf, (unsigned)word >> RAY_BITS & leaves);
    }
    listed = j;
    return paired;
}

/// Appends those words of a list whose rays are active in one of these children behind it; returns their number.
template <int L> inline CUDA_CALLABLE int collect_words(int* list, int count, unsigned children)
{
    int* to = list + count;
    int size = 0;
    for (int f = 0; f < count; f += L) {
        int flag[L];
        WRT_FOR (L, i) {
            flag[i] = (int)((unsigned)list[f + i] >> RAY_BITS & children) & (f + i < count ? -1 : 0);
        }
        size += append<L>(to + size, list + f, bits<L>(flag));
    }
    return size;
}

/// Filters a list of `count` rays with one sign along the axis by a plane; see
/// `wrt.kernels.traversal.stream.stream_lanes.filter_plane`. L: numbers that are filtered at a time.
template <int L, class Ray, class Intervals>
inline CUDA_CALLABLE int filter_plane(
    int axis, float position, const Ray* rays, Intervals& list, int count, Intervals& stack, int top, int& far_count)
{
    int *near_ray = list.rays.data, *near_from = (int*)list.entry.data, *near_to = (int*)list.leave.data;
    int *far_ray = stack.rays.data + top, *far_from = (int*)stack.entry.data + top, *far_to = (int*)stack.leave.data + top;
    int near_size = 0, far_size = 0;
    for (int f = 0; f < count; f += L) {
        int ray[L], from[L], to[L], to_near[L], from_far[L], near_flag[L], far_flag[L];
        WRT_FOR (L, i) {
            const int here = f + i < count ? -1 : 0, k = near_ray[f + i] & here;
            const float entry = __builtin_bit_cast(float, near_from[f + i]), leave = __builtin_bit_cast(float, near_to[f + i]);
            const float inverse = rays[k].slabs.inverse.c[axis];
            float before = (position - rays[k].slabs.origin_out.c[axis]) * inverse;
            float behind = (position - rays[k].slabs.origin_in.c[axis]) * inverse;
            before = before < leave ? before : leave;
            behind = behind > entry ? behind : entry;
            const bool visit_near = entry <= before;
            ray[i] = k;
            from[i] = __builtin_bit_cast(int, entry);
            to[i] = __builtin_bit_cast(int, leave);
            to_near[i] = __builtin_bit_cast(int, before);
            from_far[i] = __builtin_bit_cast(int, behind);
            near_flag[i] = visit_near ? here : 0;
            far_flag[i] = (!visit_near | (behind <= leave)) ? here : 0;
        }
        const unsigned near_bits = bits<L>(near_flag), far_bits = bits<L>(far_flag);
        append<L>(near_ray + near_size, ray, near_bits);
        append<L>(near_from + near_size, from, near_bits);
        near_size += append<L>(near_to + near_size, to_near, near_bits);
        append<L>(far_ray + far_size, ray, far_bits);
        append<L>(far_from + far_size, from_far, far_bits);
        far_size += append<L>(far_to + far_size, to, far_bits);
    }
    far_count = far_size;
    return near_size;
}

/// Pops a list of `count` rays from a stack, without those whose best hit lies before their entry; see
/// `wrt.kernels.traversal.stream.stream_lanes.filter_hits`.
template <int L, class Ray, class Intervals>
inline CUDA_CALLABLE int filter_hits(const Ray* rays, const Intervals& stack, int top, int count, Intervals& list)
{
    const int* far_ray = stack.rays.data + top;
    const float *far_entry = stack.entry.data + top, *far_leave = stack.leave.data + top;
    int *near_ray = list.rays.data, *near_from = (int*)list.entry.data, *near_to = (int*)list.leave.data;
    int size = 0;
    for (int f = 0; f < count; f += L) {
        int ray[L], from[L], to[L], flag[L];
        WRT_FOR (L, i) {
            const int here = f + i < count ? -1 : 0, k = far_ray[f + i] & here;
            const float entry = far_entry[f + i], leave = far_leave[f + i];
            const float best = rays[k].best.t;
            ray[i] = k;
            from[i] = __builtin_bit_cast(int, entry);
            to[i] = __builtin_bit_cast(int, leave < best ? leave : best);
            flag[i] = entry <= best ? here : 0;
        }
        const unsigned kept = bits<L>(flag);
        append<L>(near_ray + size, ray, kept);
        append<L>(near_from + size, from, kept);
        size += append<L>(near_to + size, to, kept);
    }
    return size;
}

/// Appends candidates: a ray and each of the triangles in the mask of a block; returns their new number. Writes
/// block_lanes(W) numbers. FETCHING: whether the ids of the triangles are prefetched.
template <int W, bool FETCHING, class PairLists>
inline CUDA_CALLABLE int append_candidates(
    const int* primitives, PairLists& pairs, int count, int ray, int block, unsigned mask)
{
    constexpr int L = block_lanes(W);
    if (FETCHING) WRT_FETCH(primitives + (size_t)block * W);
    int slot[L];
    WRT_FOR (L, i) {
        pairs.candidate_rays.c[count + i] = ray;
    }
#if WRT_VECTORS && defined(__AVX2__) && !defined(__AVX512F__)
    if constexpr (L == 8) {
        const unsigned char* const kept = (const unsigned char*)(FIRST_LANES_FIRST.of + (mask & 255u));
        WRT_FOR (8, i) {
            slot[i] = block * W + kept[i];
        }
        copy(pairs.candidates.c + count, slot);
        return count + count_bits(mask);
    }
#endif
    WRT_FOR (L, i) {
        slot[i] = block * W + i;
    }
    return count + append<L>(pairs.candidates.c + count, slot, mask);
}

/// Sorts the numbers of rays by octant of their directions; ends: where each octant ends.
template <class Ray> inline CUDA_CALLABLE void sort_by_octant(const Ray* rays, int count, int* order, int* ends)
{
    int first[8] = {}, last = 0;
    const auto octant_of = [&](int k) {
        const float* const inverse = rays[k].slabs.inverse.c;
        return (inverse[0] < 0.0f ? 1 : 0) | (inverse[1] < 0.0f ? 2 : 0) | (inverse[2] < 0.0f ? 4 : 0);
    };
    for (int k = 0; k < count; ++k) ++first[octant_of(k)];
    for (int o = 0; o < 8; ++o) {
        const int size = first[o];
        first[o] = last;
        last += size;
        ends[o] = last;
    }
    for (int k = 0; k < count; ++k) order[first[octant_of(k)]++] = k;
}

/// Lists those of the rays order[begin .. end - 1] that meet a box, with their intervals in it; returns their number.
template <class Ray, class Intervals>
inline CUDA_CALLABLE int enter_box(
    const Ray* rays, const int* order, int begin, int end, const float* low, const float* high, Intervals& list)
{
    int* number = list.rays.data;
    float *entry = list.entry.data, *leave = list.leave.data;
    int size = 0;
    for (int j = begin; j < end; ++j) {
        const int k = order[j];
        const Interval own = meet_box(low, high, box_ray(rays[k].slabs), rays[k].t_min, rays[k].best.t);
        number[size] = k, entry[size] = own.enter, leave[size] = own.leave;
        size += own.enter <= own.leave ? 1 : 0;
    }
    return size;
}

}  // namespace
}  // namespace wrt

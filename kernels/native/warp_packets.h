// The rays of a CUDA warp together, through trees of 64-byte nodes: packets, streams and frusta
// (wrt.kernels.classics.studies.warp_packets). On the CPU an item traces its rays one by one, by the steps of persistent.h.
#pragma once
#include "persistent.h"

namespace wrt {
namespace {

/// Threads of a warp, and of a block.
constexpr int WARP = 32, WARPS_OF_BLOCK = 2;

/// Rays of a stream; their numbers within it are bytes.
constexpr int STREAM = 128;

#if defined(__CUDA_ARCH__)
/// Begins ray i, if there is one. Until it is done its node is not `DONE`; where it is, its warp knows.
template <class Walk, class All> __device__ void begin_lane(const All& all, Walk& walk, int i)
{
    int bottom[1];
    walk.node = DONE, walk.number = -1;
    if (i < all.rays.count) walk.begin(all, i, bottom);
}

template <class Walk, class All> __device__ void test_leaf(const All& all, Walk& walk, int word)
{
    const auto given = [&]() { return given_ray(all.space.tree, all.rays, walk.number); };
    walk.test(all, word, all.space.triangles, 0, given);
}

/// Which children's boxes a ray meets, and whether the second one is the nearer of both.
struct Met {
    bool a, b, swaps;
};

template <bool FROM_ZERO> __device__ Met meet_both(const TwoBoxes& at, const FilterRay& ray, bool asks)
{
    const Quad &p = at.first, &q = at.second, &r = at.both;
    const Bits a = filtered<FROM_ZERO>(ray, p.x, p.y, p.z, p.w, r.x, r.y),
               b = filtered<FROM_ZERO>(ray, q.x, q.y, q.z, q.w, r.z, r.w);
    const bool meets_a = asks && a.enter <= a.leave, meets_b = asks && b.enter <= b.leave;
    return {meets_a, meets_b, meets_a && meets_b && b.enter < a.enter};
}

/// One way through the tree for a warp. All lanes test a node that one of those asks for which met it, and go where most of
/// them come first. What waits, with who asks for it, is in shared memory: all lanes write the same words there.
template <bool FROM_ZERO, class Walk, class All> __device__ void walk_packet(const All& all, Walk& walk, unsigned team)
{
    __shared__ int waiting[WARPS_OF_BLOCK][All::LEVELS];
    __shared__ unsigned asking[WARPS_OF_BLOCK][All::LEVELS];
    const int lane = threadIdx.x % WARP, own = threadIdx.x / WARP % WARPS_OF_BLOCK;
    unsigned who = __ballot_sync(team, walk.node != DONE);
    int node = 0, top = 0;
    for (;;) {
        const bool asks = (who >> lane & 1u) && walk.node != DONE;
        if (node < 0) {
            if (asks) test_leaf(all, walk, ~node);
        } else {
            const TwoBoxes at = load_boxes((const float*)all.space.tree.nodes.data, node);
            const Met met = meet_both<FROM_ZERO>(at, walk.filter, asks);
            const unsigned a = __ballot_sync(team, met.a), b = __ballot_sync(team, met.b);
            const int nearer = __popc(__ballot_sync(team, met.swaps));
            const bool swaps = !a || (b && 2 * nearer > __popc(a & b));
            if (a && b) {
                waiting[own][top] = swaps ? at.left : at.right;
                asking[own][top++] = swaps ? a : b;
            }
            if (a | b) {
                node = swaps ? at.right : at.left, who = swaps ? b : a;
                continue;
            }
        }
        if (top == 0) break;
        node = waiting[own][--top], who = asking[own][top];
        __syncwarp(team);
    }
}

/// Bounds of the rays of a warp that start at one point and have the same main axis and direction along it. Coordinates are
/// relative to the origin, and `turn`ed. lower, upper: slopes along the other axes, and on the main one 1 / direction, scaled.
struct WarpFrustum {
    float origin[3], lower[3], upper[3], slack;
    int main;
    bool rises;
};

__device__ inline float min_of_warp(unsigned team, float x)
{
    for (int step = WARP / 2; step > 0; step /= 2) x = min_of(x, __shfl_xor_sync(team, x, step));
    return x;
}

__device__ inline int max_of_warp(unsigned team, int x)
{
    for (int step = WARP / 2; step > 0; step /= 2) x = larger(x, __shfl_xor_sync(team, x, step));
    return x;
}

/// The frustum of the lanes whose rays are not done; false if they have none.
template <class Walk> __device__ bool bound_warp(const Walk& walk, float reach, unsigned team, WarpFrustum& frustum)
{
    const bool asks = walk.node != DONE;
    const unsigned rays = __ballot_sync(team, asks);
    const int leader = rays ? __ffs(rays) - 1 : 0;
    frustum.slack = 2.0f * FILTER_SLACK * __shfl_sync(team, reach, leader);
    frustum.main = __shfl_sync(team, walk.turned_ray.main, leader);
    bool same = !asks || walk.turned_ray.main == frustum.main;
    WRT_UNROLLED
    for (int axis = 0; axis < 3; ++axis) {
        const float own = asks ? walk.turned_ray.origin[axis] : 0.0f;
        frustum.origin[axis] = __shfl_sync(team, own, leader);
        same &= !asks || own == frustum.origin[axis];
        const float inverse = frustum.main == 0 ? walk.filter.inverse[0]
            : frustum.main == 1                 ? walk.filter.inverse[1]
                                                : walk.filter.inverse[2];
        const float slope = axis == 2 ? inverse : walk.turned_ray.shear[axis];
        frustum.lower[axis] = min_of_warp(team, asks ? slope : WRT_INFINITY);
        frustum.upper[axis] = -min_of_warp(team, asks ? -slope : WRT_INFINITY);
    }
    frustum.rises = frustum.lower[2] > 0.0f;
    return __all_sync(team, same) && (frustum.rises || frustum.upper[2] < 0.0f);
}

/// Where the first of the rays may enter a box, in their scaled t; infinite if none meets it before `last`.
__device__ inline float enter_box(const WarpFrustum& f, const float* low, const float* high, float last)
{
    float from[3], to[3];
    turn(f.main, low[0], low[1], low[2], from);
    turn(f.main, high[0], high[1], high[2], to);
    WRT_UNROLLED
    for (int axis = 0; axis < 3; ++axis) {
        from[axis] = from[axis] - f.origin[axis] - f.slack;
        to[axis] = to[axis] - f.origin[axis] + f.slack;
    }
    const float near = f.rises ? max_of(from[2], 0.0f) : min_of(to[2], 0.0f), far = f.rises ? to[2] : from[2];
    bool meets = f.rises ? far >= near : far <= near;
    WRT_UNROLLED
    for (int axis = 0; axis < 2; ++axis) {  // at a place on the main axis, rays are from the least slope's to the greatest's
        const float steep = f.rises ? f.upper[axis] : f.lower[axis], flat = f.rises ? f.lower[axis] : f.upper[axis];
        meets &= from[axis] <= max_of(steep * near, steep * far) && to[axis] >= min_of(flat * near, flat * far);
    }
    const float enter = min_of(near * f.lower[2], near * f.upper[2]);
    return meets && enter <= last ? enter : WRT_INFINITY;
}

/// A child that a frustum meets: its word, and where the first ray enters it; infinite if none does.
struct Child {
    int word;
    float enter;

    __device__ bool is_met() const { return enter < WRT_INFINITY; }
};

/// Puts the words of the lanes that have one on the stack, and returns its new top.
__device__ inline int push_lanes(unsigned team, int* stack, int top, bool has_one, int word)
{
    const unsigned pushing = __ballot_sync(team, has_one);
    if (has_one) stack[top + __popc(pushing & ((1u << threadIdx.x % WARP) - 1u))] = word;
    return top + __popc(pushing);
}

/// Tests the leaves that lanes have found, by the rays of all lanes.
template <class Walk, class All> __device__ void test_leaves(const All& all, Walk& walk, unsigned team, const Child& child)
{
    for (unsigned left = __ballot_sync(team, child.is_met() && child.word < 0); left; left &= left - 1u) {
        const int word = __shfl_sync(team, child.word, __ffs(left) - 1);
        const float enter = __shfl_sync(team, child.enter, __ffs(left) - 1);
        if (walk.node != DONE && int_of(enter) <= walk.filter.t_max) test_leaf(all, walk, ~word);
    }
}

/// One frustum for a warp: each lane tests the children of another node that waits, and all test the triangles of the leaves
/// that are found. Rays that do not start at one point are a packet.
template <bool FROM_ZERO, class Walk, class All> __device__ void walk_frustum(const All& all, Walk& walk, unsigned team)
{
    constexpr int ROOM = WARP * (All::LEVELS + 2);
    __shared__ int waiting[WARPS_OF_BLOCK][ROOM];
    WarpFrustum frustum;
    float reach = 0.0f;
    if (walk.node != DONE) reach = given_ray(all.space.tree, all.rays, walk.number).reach;
    if (!bound_warp(walk, reach, team, frustum)) {
        walk_packet<FROM_ZERO>(all, walk, team);
        return;
    }
    const int lane = threadIdx.x % WARP;
    int* const stack = waiting[threadIdx.x / WARP % WARPS_OF_BLOCK];
    int top = 1;
    stack[0] = 0;
    while (top > 0 && __any_sync(team, walk.node != DONE)) {
        const int taken = smaller(top, top + WARP + All::LEVELS <= ROOM ? WARP : 1);  // one by one, it grows by a node a level
        top -= taken;
        const int node = lane < taken ? stack[top + lane] : DONE;
        const float last = __builtin_bit_cast(float, max_of_warp(team, walk.node != DONE ? walk.filter.t_max : 0));
        Child near = {0, WRT_INFINITY}, far = {0, WRT_INFINITY};
        if (node != DONE) {
            const TwoBoxes at = load_boxes((const float*)all.space.tree.nodes.data, node);
            const Quad &p = at.first, &q = at.second, &r = at.both;
            const float low[2][3] = {{p.x, p.z, r.x}, {q.x, q.z, r.z}}, high[2][3] = {{p.y, p.w, r.y}, {q.y, q.w, r.w}};
            near = {at.left, enter_box(frustum, low[0], high[0], last)};
            far = {at.right, enter_box(frustum, low[1], high[1], last)};
            if (far.enter < near.enter) {
                const Child other = near;
                near = far, far = other;
            }
        }
        __syncwarp(team);
        top = push_lanes(team, stack, top, far.is_met() && far.word >= 0, far.word);
        top = push_lanes(team, stack, top, near.is_met() && near.word >= 0, near.word);
        test_leaves(all, walk, team, near);
        test_leaves(all, walk, team, far);
        __syncwarp(team);
    }
}

/// Rays of a node that waits, from `begin` on; from `free` on, numbers may be written: before that, those of other nodes wait.
struct StreamPart {
    int node;
    unsigned short begin, count, free;
};

/// What a warp keeps of its rays, in shared memory.
template <int LEVELS> struct StreamMemory {
    FilterRay filters[STREAM];
    PackedHit hits[STREAM];
    StreamPart parts[LEVELS + 1];
    unsigned char numbers[STREAM * (LEVELS + 1)];
};

/// Tests the triangles of a leaf by some of the rays, which are numbered from `first` on.
template <class Walk, class All, class Memory>
__device__ void test_part(const All& all, Memory& memory, const StreamPart& part, int first)
{
    for (int k = threadIdx.x % WARP; k < part.count; k += WARP) {
        const int ray = memory.numbers[part.begin + k];
        if (memory.filters[ray].t_max < 0) continue;  // it has its answer
        Walk walk;
        walk.node = 0, walk.number = first + ray;
        walk.own_t_min = first_t(all.rays, walk.number);
        walk.filter = memory.filters[ray], walk.best = memory.hits[ray];
        walk.turned_ray = turned(given_ray(all.space.tree, all.rays, walk.number));
        test_leaf(all, walk, ~part.node);
        memory.hits[ray] = walk.best;
        memory.filters[ray].t_max = walk.node == DONE ? -1 : walk.filter.t_max;
    }
}

/// Filters the rays of an inner node into those of its children, the nearer child last; returns the number of parts.
template <bool FROM_ZERO, class Memory>
__device__ int filter_part(const float* nodes, Memory& memory, const StreamPart& part, int top, unsigned team)
{
    const unsigned below = (1u << threadIdx.x % WARP) - 1u;
    const TwoBoxes at = load_boxes(nodes, part.node);
    int in_a = 0, in_b = 0, in_both = 0, nearer = 0;
    for (int begin = 0; begin < part.count; begin += WARP) {
        const int k = begin + threadIdx.x % WARP;
        const int ray = k < part.count ? memory.numbers[part.begin + k] : 0;
        const Met met = meet_both<FROM_ZERO>(at, memory.filters[ray], k < part.count);
        const unsigned a = __ballot_sync(team, met.a), b = __ballot_sync(team, met.b);
        if (met.a) memory.numbers[part.begin + in_a + __popc(a & below)] = (unsigned char)ray;
        if (met.b) memory.numbers[part.free + in_b + __popc(b & below)] = (unsigned char)ray;
        in_a += __popc(a), in_b += __popc(b), in_both += __popc(a & b);
        nearer += __popc(__ballot_sync(team, met.swaps));
    }
    const bool b_first = 2 * nearer > in_both;
    const auto end = (unsigned short)(part.free + in_b);
    const StreamPart a = {at.left, part.begin, (unsigned short)in_a, b_first ? part.free : end},
                     b = {at.right, part.free, (unsigned short)in_b, end};
    if (in_a && b_first) memory.parts[top++] = a;
    if (in_b) memory.parts[top++] = b;
    if (in_a && !b_first) memory.parts[top++] = a;
    __syncwarp(team);
    return top;
}

/// A stream of rays for a warp: at each node, rays that meet a child go on there together, whatever others do.
template <bool FROM_ZERO, class Walk, class All> __device__ void walk_stream(const All& all, int first, unsigned team)
{
    __shared__ StreamMemory<All::LEVELS> memories[WARPS_OF_BLOCK];
    const int lane = threadIdx.x % WARP;
    auto& memory = memories[threadIdx.x / WARP % WARPS_OF_BLOCK];
    int count = 0;
    for (int begin = 0; begin < STREAM; begin += WARP) {
        Walk walk;
        begin_lane(all, walk, first + begin + lane);
        const unsigned valid = __ballot_sync(team, walk.node != DONE);
        if (walk.number >= 0) memory.filters[begin + lane] = walk.filter, memory.hits[begin + lane] = walk.best;
        if (walk.node != DONE) memory.numbers[count + __popc(valid & ((1u << lane) - 1u))] = (unsigned char)(begin + lane);
        count += __popc(valid);
    }
    memory.parts[0] = {0, 0, (unsigned short)count, (unsigned short)count};
    int top = count > 0;
    __syncwarp(team);
    while (top > 0) {
        const StreamPart part = memory.parts[--top];
        __syncwarp(team);
        if (part.node < 0) test_part<Walk>(all, memory, part, first);
        else top = filter_part<FROM_ZERO>((const float*)all.space.tree.nodes.data, memory, part, top, team);
        __syncwarp(team);
    }
    for (int k = lane; k < STREAM && first + k < all.rays.count; k += WARP) {
        Walk walk;
        walk.number = first + k, walk.best = memory.hits[k];
        walk.store(all);
    }
}
#endif

/// How the rays of a warp go through the tree.
constexpr int PACKET = 0, STREAMED = 1, FRUSTUM = 2;

/// On CUDA thread i takes part in the rays of its warp; a launch has whole warps. On the CPU item i has the rays that it would
/// have to itself.
template <int WAY, bool FROM_ZERO, class All> inline CUDA_CALLABLE void walk_together(const All& all, int i)
{
    using Walk = wrt::Walk<All, FROM_ZERO>;
#if defined(__CUDA_ARCH__)
    const unsigned team = __activemask();
    if constexpr (WAY == STREAMED) {
        walk_stream<FROM_ZERO, Walk>(all, i / WARP * STREAM, team);
    } else {
        Walk walk;
        begin_lane(all, walk, i);
        if constexpr (WAY == PACKET) walk_packet<FROM_ZERO>(all, walk, team);
        else walk_frustum<FROM_ZERO>(all, walk, team);
        if (walk.number >= 0) walk.store(all);
    }
#else
    constexpr int EACH = WAY == STREAMED ? STREAM / WARP : 1;
    for (int number = EACH * i; number < EACH * (i + 1) && number < all.rays.count; ++number) {
        Walk walk;
        walk_alone(all, walk, number);
        walk.store(all);
    }
#endif
}

}  // namespace
}  // namespace wrt

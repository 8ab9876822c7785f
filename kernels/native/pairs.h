// Walks of two wide BVHs at a time: the nearest triangles of two bodies, and those that meet.
//
// wrt.kernels.pairs says which pairs of boxes are left out. A box is named by its lane, node * W + child.
#pragma once
#include "triangle_pairs.h"

namespace wrt {
namespace {
namespace pairs {

/// Greatest number of inner nodes on a path from the root of one tree.
constexpr int DEPTH = 64;

/// Greatest number of triangles in a leaf.
constexpr int LEAF = 63;

/// Child word of a lane without a box.
constexpr int EMPTY = ~0;

template <class Vec3> inline CUDA_CALLABLE Place place_of(const Vec3& v)
{
    return {(double)v.c[0], (double)v.c[1], (double)v.c[2]};
}

/// A point of a body's mesh in the scene; `origin`: where the point 0 is.
template <class Matrix> inline CUDA_CALLABLE Place placed(const Matrix& m, const Place& origin, const Place& p)
{
    return {((m.data[0][0] * p.x + m.data[0][1] * p.y) + m.data[0][2] * p.z) + origin.x,
        ((m.data[1][0] * p.x + m.data[1][1] * p.y) + m.data[1][2] * p.z) + origin.y,
        ((m.data[2][0] * p.x + m.data[2][1] * p.y) + m.data[2][2] * p.z) + origin.z};
}

/// A box in the scene, along its axes.
struct PlacedBox {
    Place middle, half;

    inline CUDA_CALLABLE double size() const { return (half.x + half.y) + half.z; }
};

/// The box of a lane.
template <int W, class Body> inline CUDA_CALLABLE PlacedBox box_at(const Body& body, int lane)
{
    const float* const from = body.nodes.bounds.data + (size_t)(lane / W) * (6 * W) + lane % W;
    const Place low = {from[0], from[W], from[2 * W]}, high = {from[3 * W], from[4 * W], from[5 * W]};
    const Place half = {0.5 * (high.x - low.x), 0.5 * (high.y - low.y), 0.5 * (high.z - low.z)};
    const Place middle = {0.5 * (low.x + high.x), 0.5 * (low.y + high.y), 0.5 * (low.z + high.z)};
    const auto& m = body.linear.data;
    return {placed(body.linear, place_of(body.center), middle),
        {(size_of(m[0][0]) * half.x + size_of(m[0][1]) * half.y) + size_of(m[0][2]) * half.z,
            (size_of(m[1][0]) * half.x + size_of(m[1][1]) * half.y) + size_of(m[1][2]) * half.z,
            (size_of(m[2][0]) * half.x + size_of(m[2][1]) * half.y) + size_of(m[2][2]) * half.z}};
}

/// The squared distance of two boxes.
inline CUDA_CALLABLE double box_square(const PlacedBox& a, const PlacedBox& b)
{
    const double x = size_of(a.middle.x - b.middle.x) - (a.half.x + b.half.x);
    const double y = size_of(a.middle.y - b.middle.y) - (a.half.y + b.half.y);
    const double z = size_of(a.middle.z - b.middle.z) - (a.half.z + b.half.z);
    return ((x > 0.0 ? x * x : 0.0) + (y > 0.0 ? y * y : 0.0)) + (z > 0.0 ? z * z : 0.0);
}

/// The triangle at a place of the blocks, in the scene.
template <class Body> inline CUDA_CALLABLE Corners corners_at(const Body& body, int slot)
{
    const auto& face = body.faces.data[body.primitive.data[slot]];
    Corners t;
    for (int i = 0; i < 3; ++i) t.v[i] = placed(body.linear, place_of(body.origin), place_of(body.vertices.data[face.c[i]]));
    t.bound();
    return t;
}

/// Lowers a number that several threads lower, none of which is negative or a NaN; returns the least of them.
inline CUDA_CALLABLE double lower_to(double* shared, double value)
{
#if defined(__CUDA_ARCH__)
    const long long before = atomicMin((long long*)shared, __double_as_longlong(value));
    const double old = __longlong_as_double(before);
    return old < value ? old : value;
#else
    long long bits = __atomic_load_n((long long*)shared, __ATOMIC_RELAXED);
    const long long own = __builtin_bit_cast(long long, value);
    while (own < bits)
        if (__atomic_compare_exchange_n((long long*)shared, &bits, own, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) return value;
    return __builtin_bit_cast(double, bits);
#endif
}

/// The nearest pair; of those at the same distance, that with the smaller triangles, first of a, then of b.
struct NearestPair {
    double* shared;  // squared distance of the nearest pair of all threads, or what is looked up to
    double slack, near_slack;  // errors of distances of the trees' boxes, and of those of triangles
    double most = 0.0, limit = 0.0, near_limit = 0.0;
    Nearest found = {__builtin_bit_cast(double, 0x7ff0000000000000ull), {0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}};
    int first = -1, second = -1;

    inline CUDA_CALLABLE void look_up_to(double square)
    {
        const double distance = square_root(square) * (1.0 + 1e-14), wide = distance + slack, near = distance + near_slack;
        most = square, limit = wide * wide, near_limit = near * near;
    }

    inline CUDA_CALLABLE void refresh()
    {
        const double now = lower_to(shared, most);
        if (now < most) look_up_to(now);
    }

    /// Whether a pair of these numbers comes before the one that is kept.
    inline CUDA_CALLABLE bool before(int one, int other) const
    {
        return first < 0 || one < first || (one == first && other < second);
    }

    inline CUDA_CALLABLE void visit(const Corners& a, const Corners& b, int one, int other)
    {
        if (!(box_square(a, b) <= near_limit) || (found.square == 0.0 && !before(one, other))) return;
        const Nearest now = nearest_of(a, b);
        if (!(now.square <= most) || (now.square == found.square && !before(one, other))) return;
        found = now, first = one, second = other;
        most = lower_to(shared, now.square);
        look_up_to(most);
    }
};

/// All pairs of triangles that meet; `rows`: where they are written, null to count them.
struct MeetingPairs {
    double limit;
    int* rows;
    int size = 0;

    inline CUDA_CALLABLE void refresh() { }

    inline CUDA_CALLABLE void visit(const Corners& a, const Corners& b, int one, int other)
    {
        if (!meet(a, b)) return;
        if (rows) rows[2 * (size_t)size] = one, rows[2 * (size_t)size + 1] = other;
        ++size;
    }
};

/// Visits each pair of triangles of two leaves.
template <int W, class Body, class Kept>
inline CUDA_CALLABLE void visit_leaves(const Body& a, const Body& b, int word_a, int word_b, Kept& kept)
{
    const int slot_a = (~word_a >> 6) * W, slot_b = (~word_b >> 6) * W, count_a = ~word_a & LEAF, count_b = ~word_b & LEAF;
    Corners own[LEAF];
    for (int i = 0; i < count_a; ++i) own[i] = corners_at(a, slot_a + i);
    for (int j = 0; j < count_b; ++j) {
        const Corners other = corners_at(b, slot_b + j);
        for (int i = 0; i < count_a; ++i) kept.visit(own[i], other, a.primitive.data[slot_a + i], b.primitive.data[slot_b + j]);
    }
}

/// Two boxes that wait.
struct Waiting {
    int a, b;
    double square;
};

/// Puts the children of a node beside a box of the other tree on the stack, the nearest on top.
template <int W, bool OF_A, class Body, class Kept>
inline CUDA_CALLABLE int push_children(
    const Body& body, int node, const PlacedBox& other, int other_lane, const Kept& kept, Waiting* stack, int size)
{
    const int bottom = size;
    for (int lane = node * W; lane < node * W + W; ++lane) {
        if (body.nodes.child.data[lane] == EMPTY) continue;
        const double square = box_square(box_at<W>(body, lane), other);
        if (!(square <= kept.limit)) continue;
        int at = size++;
        for (; at > bottom && stack[at - 1].square < square; --at) stack[at] = stack[at - 1];
        stack[at] = {OF_A ? lane : other_lane, OF_A ? other_lane : lane, square};
    }
    return size;
}

/// Walks what is below two boxes. The larger one is opened first.
template <int W, class Body, class Kept>
inline CUDA_CALLABLE void walk(const Body& a, const Body& b, int lane_a, int lane_b, double square, Kept& kept)
{
    Waiting stack[2 * DEPTH * (W - 1) + 2 * W];
    int size = 0;
    stack[size++] = {lane_a, lane_b, square};
    while (size > 0) {
        const Waiting top = stack[--size];
        kept.refresh();
        if (!(top.square <= kept.limit)) continue;
        const int word_a = a.nodes.child.data[top.a], word_b = b.nodes.child.data[top.b];
        if (word_a < 0 && word_b < 0) {
            visit_leaves<W>(a, b, word_a, word_b, kept);
            continue;
        }
        const PlacedBox box_a = box_at<W>(a, top.a), box_b = box_at<W>(b, top.b);
        if (word_b < 0 || (word_a >= 0 && box_a.size() >= box_b.size()))
            size = push_children<W, true>(a, word_a, box_b, top.b, kept, stack, size);
        else size = push_children<W, false>(b, word_b, box_a, top.a, kept, stack, size);
    }
}

/// The nearest pair below one entry of a list of boxes.
template <int W, class Body, class Work, class Found>
inline CUDA_CALLABLE void nearest_below(const Body& a, const Body& b, const Work& work, const Found& found, int i)
{
    NearestPair kept = {work.most.data, work.slack, work.near_slack};
    kept.look_up_to(work.limit);
    walk<W>(a, b, work.boxes.data[i].c[0], work.boxes.data[i].c[1], work.square.data[i], kept);
    found.square.data[i] = kept.found.square;
    found.triangles.data[i].c[0] = kept.first, found.triangles.data[i].c[1] = kept.second;
    auto &p = found.first.data[i], &q = found.second.data[i];
    p.c[0] = kept.found.p.x, p.c[1] = kept.found.p.y, p.c[2] = kept.found.p.z;
    q.c[0] = kept.found.q.x, q.c[1] = kept.found.q.y, q.c[2] = kept.found.q.z;
}

/// Counts the pairs that meet below one entry; writes them if there are arrays for them.
template <int W, class Body, class Work, class Lists>
inline CUDA_CALLABLE void meeting_below(const Body& a, const Body& b, const Work& work, const Lists& lists, int i)
{
    int* const rows = lists.begin.shape[0] ? (int*)(lists.pairs.data + lists.begin.data[i]) : nullptr;
    MeetingPairs kept = {work.slack * work.slack, rows};
    walk<W>(a, b, work.boxes.data[i].c[0], work.boxes.data[i].c[1], work.square.data[i], kept);
    lists.count.data[i] = kept.size;
}

}  // namespace pairs
}  // namespace
}  // namespace wrt

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

/// A box in the scene, along its axes, and its half size along those of the mesh.
struct PlacedBox {
    Place middle, half, own;

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
            (size_of(m[2][0]) * half.x + size_of(m[2][1]) * half.y) + size_of(m[2][2]) * half.z},
        half};
}

/// The squared distance of two boxes.
inline CUDA_CALLABLE double box_square(const PlacedBox& a, const PlacedBox& b)
{
    const double x = size_of(a.middle.x - b.middle.x) - (a.half.x + b.half.x);
    const double y = size_of(a.middle.y - b.middle.y) - (a.half.y + b.half.y);
    const double z = size_of(a.middle.z - b.middle.z) - (a.half.z + b.half.z);
    return ((x > 0.0 ? x * x : 0.0) + (y > 0.0 ? y * y : 0.0)) + (z > 0.0 ? z * z : 0.0);
}

/// An axis of the scene in a body's mesh: its product with a point there is that in the scene, but for that with the origin.
template <class Body> inline CUDA_CALLABLE Place axis_in(const Body& body, const Place& axis)
{
    const auto& m = body.linear.data;
    return {(m[0][0] * axis.x + m[1][0] * axis.y) + m[2][0] * axis.z, (m[0][1] * axis.x + m[1][1] * axis.y) + m[2][1] * axis.z,
        (m[0][2] * axis.x + m[1][2] * axis.y) + m[2][2] * axis.z};
}

/// How far a box reaches from its middle along an axis.
template <class Body> inline CUDA_CALLABLE double reach_of(const Body& body, const PlacedBox& box, const Place& axis)
{
    const Place there = axis_in(body, axis);
    return (size_of(there.x) * box.own.x + size_of(there.y) * box.own.y) + size_of(there.z) * box.own.z;
}

/// Where the triangle at a place of the blocks begins along an axis of its mesh.
template <class Body> inline CUDA_CALLABLE double begin_of(const Body& body, int slot, const Place& axis)
{
    const auto& face = body.faces.data[body.primitive.data[slot]];
    const double p = dot(place_of(body.vertices.data[face.c[0]]), axis), q = dot(place_of(body.vertices.data[face.c[1]]), axis);
    const double r = dot(place_of(body.vertices.data[face.c[2]]), axis), lower = p < q ? p : q;
    return lower < r ? lower : r;
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
    double max_square = 0.0, limit = 0.0, near_limit = 0.0, wide = 0.0, near = 0.0;
    Place axis = {0.0, 0.0, 0.0};  // of length 1, or 0: what is farther apart along it than `wide` or `near` is left out
    Nearest found = {__builtin_bit_cast(double, 0x7ff0000000000000ull), {0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}};
    int first = -1, second = -1;

    inline CUDA_CALLABLE void look_up_to(double square)
    {
        const double distance = square_root(square) * (1.0 + 1e-14);
        wide = distance + slack, near = distance + near_slack;
        max_square = square, limit = wide * wide, near_limit = near * near;
    }

    inline CUDA_CALLABLE void look_along(const Place& from, const Place& to)
    {
        const Place way = to - from;
        const double length = square_root(dot(way, way));
        if ((length > 1e-140) & (length < 1e140)) axis = {way.x / length, way.y / length, way.z / length};
    }

    inline CUDA_CALLABLE void refresh()
    {
        const double now = lower_to(shared, max_square);
        if (now < max_square) look_up_to(now);
    }

    /// Whether a pair of these numbers comes before the one that is kept.
    inline CUDA_CALLABLE bool before(int one, int other) const
    {
        return first < 0 || one < first || (one == first && other < second);
    }

    inline CUDA_CALLABLE void visit(const Corners& a, const Corners& b, int one, int other)
    {
        if (!(box_square(a, b) <= near_limit)) return;
        if (found.square == 0.0 && !before(one, other)) return;
        const Nearest now = nearest_of(a, b);
        if (!(now.square <= max_square) || (now.square == found.square && !before(one, other))) return;
        if (now.square > 0.0 && now.square < found.square) look_along(now.p, now.q);
        found = now, first = one, second = other;
        max_square = lower_to(shared, now.square);
        look_up_to(max_square);
    }
};

/// All pairs of triangles that meet; `rows`: where they are written, null to count them.
struct MeetingPairs {
    double limit, wide, near;
    int* rows;
    Place axis = {0.0, 0.0, 0.0};
    int size = 0;

    inline CUDA_CALLABLE void look_along(const Place&, const Place&) { }
    inline CUDA_CALLABLE void refresh() { }

    inline CUDA_CALLABLE void visit(const Corners& a, const Corners& b, int one, int other)
    {
        if (!meet(a, b)) return;
        if (rows) rows[2 * (size_t)size] = one, rows[2 * (size_t)size + 1] = other;
        ++size;
    }
};

/// The triangles of a leaf of the first tree, which are kept as long as the walk stays there.
struct LeafTriangles {
    Corners triangles[LEAF];
    double ends[LEAF];  // how far each goes along the axis
    int word = 0;  // of the leaf
};

/// Visits the pairs of triangles of two leaves but those that are too far apart along the axis.
template <int W, class Body, class Kept>
inline CUDA_CALLABLE void visit_leaves(const Body& a, const Body& b, int word_a, int word_b, LeafTriangles& own, Kept& kept)
{
    const int slot_a = (~word_a >> 6) * W, slot_b = (~word_b >> 6) * W, count_a = ~word_a & LEAF, count_b = ~word_b & LEAF;
    const Place axis = kept.axis;
    double end = -__builtin_bit_cast(double, 0x7ff0000000000000ull);
    for (int i = 0; i < count_a; ++i) {
        if (own.word != word_a) own.triangles[i] = corners_at(a, slot_a + i);
        const Corners& t = own.triangles[i];
        const double p = dot(t.v[0], axis), q = dot(t.v[1], axis), r = dot(t.v[2], axis), upper = p > q ? p : q;
        own.ends[i] = upper > r ? upper : r;
        end = own.ends[i] > end ? own.ends[i] : end;
    }
    own.word = word_a;
    const Place axis_b = axis_in(b, axis);
    const double origin = dot(place_of(b.origin), axis);
    for (int j = 0; j < count_b; ++j) {
        const double begin = begin_of(b, slot_b + j, axis_b) + origin;
        if (begin - end > kept.near) continue;
        const Corners other = corners_at(b, slot_b + j);
        for (int i = 0; i < count_a; ++i) {
            if (begin - own.ends[i] > kept.near) continue;
            kept.visit(own.triangles[i], other, a.primitive.data[slot_a + i], b.primitive.data[slot_b + j]);
        }
    }
}

/// Two boxes that wait.
struct Waiting {
    int a, b;
    double square;
};

/// Puts the children of a node beside a box of the other tree on the stack, the nearest on top. side: 1 if the node is of the
/// first tree, -1 if it is of the second; other_reach: how far the box reaches along the axis.
template <int W, class Body, class Kept>
inline CUDA_CALLABLE int push_children(const Body& body, int node, int side, const PlacedBox& other, double other_reach,
    int other_lane, const Kept& kept, Waiting* stack, int size)
{
    const int bottom = size;
    for (int lane = node * W; lane < node * W + W; ++lane) {
        if (body.nodes.child.data[lane] == EMPTY) continue;
        const PlacedBox box = box_at<W>(body, lane);
        const double square = box_square(box, other);
        if (!(square <= kept.limit)) continue;
        const double apart = side * dot(kept.axis, other.middle - box.middle);
        if (apart - (reach_of(body, box, kept.axis) + other_reach) > kept.wide) continue;
        int at = size++;
        for (; at > bottom && stack[at - 1].square < square; --at) stack[at] = stack[at - 1];
        stack[at] = {side > 0 ? lane : other_lane, side > 0 ? other_lane : lane, square};
    }
    return size;
}

/// Walks what is below two boxes. The larger one is opened first.
template <int W, class Body, class Kept>
inline CUDA_CALLABLE void walk(const Body& a, const Body& b, int lane_a, int lane_b, double square, Kept& kept)
{
    Waiting stack[2 * DEPTH * (W - 1) + 2 * W];
    LeafTriangles own;
    int size = 0;
    stack[size++] = {lane_a, lane_b, square};
    kept.look_along(box_at<W>(a, lane_a).middle, box_at<W>(b, lane_b).middle);
    while (size > 0) {
        const Waiting top = stack[--size];
        kept.refresh();
        if (!(top.square <= kept.limit)) continue;
        const int word_a = a.nodes.child.data[top.a], word_b = b.nodes.child.data[top.b];
        const PlacedBox box_a = box_at<W>(a, top.a), box_b = box_at<W>(b, top.b);
        const double reach_a = reach_of(a, box_a, kept.axis), reach_b = reach_of(b, box_b, kept.axis);
        if (dot(kept.axis, box_b.middle - box_a.middle) - (reach_a + reach_b) > kept.wide) continue;
        if (word_a < 0 && word_b < 0) visit_leaves<W>(a, b, word_a, word_b, own, kept);
        else if (word_b < 0 || (word_a >= 0 && box_a.size() >= box_b.size()))
            size = push_children<W>(a, word_a, 1, box_b, reach_b, top.b, kept, stack, size);
        else size = push_children<W>(b, word_b, -1, box_a, reach_a, top.a, kept, stack, size);
    }
}

/// The nearest pair below one entry of a list of boxes.
template <int W, class Body, class Work, class Found>
inline CUDA_CALLABLE void nearest_below(const Body& a, const Body& b, const Work& work, const Found& found, int i)
{
    NearestPair kept = {work.max_square.data, work.slack, work.near_slack};
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
    MeetingPairs kept = {work.slack * work.slack, work.slack, 0.0, rows};
    walk<W>(a, b, work.boxes.data[i].c[0], work.boxes.data[i].c[1], work.square.data[i], kept);
    lists.count.data[i] = kept.size;
}

}  // namespace pairs
}  // namespace
}  // namespace wrt

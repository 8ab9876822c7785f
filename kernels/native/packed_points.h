// One point a thread through a tree of 64-byte nodes, by persistent threads (wrt.kernels.points.packed_points). On the CPU an
// item searches one point, by the same steps.
#pragma once
#include "point_spaces.h"

namespace wrt {
namespace {

/// Points of a launch, where they are searched, and where answers go. PLACES: of nodes that wait.
template <int PLACES, class Tree, class Triangles, class Points, class Found> struct PointWalks {
    static constexpr int LEVELS = 2 * PLACES + 1;
    const Tree& tree;
    const Triangles& triangles;
    const Points& points;
    const Found& found;
};

template <int PLACES, class Tree, class Triangles, class Points, class Found>
inline CUDA_CALLABLE PointWalks<PLACES, Tree, Triangles, Points, Found> point_walks(
    const Tree& tree, const Triangles& triangles, const Points& points, const Found& found)
{
    return {tree, triangles, points, found};
}

/// The walk of one point; its stack is apart, as that of a ray's `Walk`.
template <class All> struct PointWalk : PackedPlace {
    static constexpr bool MOVES = false;
    int number = -1;
    SearchPoint point = {};
    NearestTriangle kept {0.0f};

    /// The point at a place in the order.
    CUDA_CALLABLE void begin(const All& all, int place, int* stack)
    {
        const auto& points = all.points;
        number = points.order.shape[0] ? points.order.data[place] : place;
        const auto& at = points.position.data[number];
        point = point_in(all.tree.low, all.tree.high, at.c[0], at.c[1], at.c[2]);
        kept = NearestTriangle(points.max_distance.data[(size_t)number * points.distance_stride]);
        if (!((point.slack == point.slack) & (kept.max_distance >= 0.0f))) return;
        start(stack);
        kept.look_up_to(kept.farthest(), point.slack);
    }

    CUDA_CALLABLE void step(const All& all, int* stack)
    {
        PackedPlace::step((const float*)all.tree.nodes.data, point, kept.limit, stack);
    }

    CUDA_CALLABLE void leaf(const All& all, const int* stack)
    {
        PackedTree::search_leaf(all.triangles, ~node, point, kept);
        take(kept.limit, stack);
    }

    CUDA_CALLABLE void store(const All& all) const
    {
        OnTriangle on = {0.0f, 0.0f, 0.0f, -1};
        if (kept.slot >= 0) on = PackedTree::triangle_in(all.triangles, kept.slot, point).nearest();
        const auto& found = all.found;
        found.distance.data[number] = kept.distance, found.primitive.data[number] = kept.number;
        found.uv.data[number].c[0] = on.u, found.uv.data[number].c[1] = on.v;
        found.feature.data[number] = (signed char)on.feature;
    }
};

/// On CUDA the points of a launch, by all of its threads; else the point at place i.
template <int FETCH, int KEEP, int STEPS, class All>
inline CUDA_CALLABLE void search_points(const All& all, int* next, int threads, int i)
{
#if defined(__CUDA_ARCH__)
    (void)i;
    walk_all<FETCH, KEEP, STEPS, PointWalk<All>>(all, all.points.count, next, threads);
#else
    (void)next, (void)threads;
    int stack[All::LEVELS];
    PointWalk<All> walk;
    walk.begin(all, i, stack);
    while (walk.node != DONE) {
        while (walk.is_inner()) walk.step(all, stack);
        if (walk.is_leaf()) walk.leaf(all, stack);
    }
    walk.store(all);
#endif
}

}  // namespace
}  // namespace wrt

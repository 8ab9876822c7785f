// Where points are searched: in one tree, or in the trees of instances below a tree of their boxes.
#pragma once
#include "packed_tree.h"
#include "upper_level.h"

namespace wrt {
namespace {

/// Slack of the boxes of instances over that of boxes of triangles: maps round, and turn the sum over the axes that slack is a
/// part of, by up to the root of 3; their axes may differ by 1e-6 (wrt.query.points.similar_instances).
constexpr float INSTANCE_SLACK = 8.0f;

/// Number of the point at a place in the order.
template <class Points> inline CUDA_CALLABLE int point_at(const Points& points, int place)
{
    return points.order.shape[0] ? points.order.data[place] : place;
}

/// Slack of the boxes that a group of points looks into, over that of one point: computed distances of a triangle may be above
/// those of its vertices by twice as much.
constexpr float SLACKS_OF_GROUP = 4.0f;

/// Points whose box has a squared diagonal below this part of the sum of the squared edges of a triangle near them walk as a
/// packet.
constexpr float DENSE = 0.5f;

/// What is known of some points before they are searched.
struct GroupBounds {
    BoxOfPoints box;
    float limit;  // no box is farther from theirs that has what is nearest to one of them; squared
    bool are_dense;

    /// reach: at least the sum over the axes of the greatest distance of a point from the tree's box.
    inline CUDA_CALLABLE void look_around(const Triangle& near, float reach)
    {
        float min_square = WRT_INFINITY, edges = 0.0f, diagonal = 0.0f;
        for (int vertex = 0; vertex < 3; ++vertex) {
            const Offset &at = near.vertex[vertex], edge = near.vertex[(vertex + 1) % 3] - at;
            const float x = larger(at.x - box.low[0], box.high[0] - at.x), y = larger(at.y - box.low[1], box.high[1] - at.y);
            const float z = larger(at.z - box.low[2], box.high[2] - at.z);
            min_square = smaller((x * x + y * y) + z * z, min_square);
            edges += dot(edge, edge);
        }
        for (int a = 0; a < 3; ++a) diagonal += (box.high[a] - box.low[a]) * (box.high[a] - box.low[a]);
        const float wide = square_root(min_square) + SLACKS_OF_GROUP * (reach * POINT_SLACK + MIN_DISTANCE);
        limit = wide * wide * WIDENED;
        are_dense = diagonal < DENSE * edges;
    }
};

/// One tree. Kind: of it, as `BoxTree`.
template <class Kind, class Tree, class Triangles> struct PointTree {
    using Start = typename Kind::Start;
    static constexpr int LANES = Kind::LANES;
    using Leaves = Kind;

    const Tree& tree;
    const Triangles& triangles;
    SearchPoint point;
    int tried = -1;
    const Start* start_at = nullptr;

    CUDA_CALLABLE PointTree(const Tree& tree, const Triangles& triangles)
        : tree(tree)
        , triangles(triangles)
    {
    }

    /// Whether the point, relative to the scene's centre, can find anything.
    inline CUDA_CALLABLE bool enter(float x, float y, float z)
    {
        point = point_in(tree.low, tree.high, x, y, z), tried = -1;
        return point.slack == point.slack;
    }

    template <class Points> inline CUDA_CALLABLE bool load(const Points& points, int i)
    {
        const auto& at = points.position.data[i];
        return enter(at.c[0], at.c[1], at.c[2]);
    }

    template <class Kept> inline CUDA_CALLABLE void start(Kept& kept) const { kept.look_up_to(kept.farthest(), point.slack); }

    /// Tries the triangles around one that another point has found.
    template <class Kept> inline CUDA_CALLABLE void try_near(int, int slot, Kept& kept)
    {
        Kind::search_around(triangles, slot, point, kept), tried = slot;
    }

    template <class Kept> inline CUDA_CALLABLE void search(Kept& kept) const
    {
        Kind::walk(tree, triangles, point, kept, tried, start_at);
    }

    /// What is known of some points. slot: of a triangle near them.
    template <class Points>
    inline CUDA_CALLABLE GroupBounds bounds_of_group(const Points& points, int begin, int count, int slot) const
    {
        GroupBounds all;
        for (int a = 0; a < 3; ++a) all.box.low[a] = WRT_INFINITY, all.box.high[a] = -WRT_INFINITY;
        for (int j = begin; j < begin + count; ++j) {
            const auto& at = points.position.data[point_at(points, j)];
            for (int a = 0; a < 3; ++a) {
                all.box.low[a] = smaller(at.c[a], all.box.low[a]);
                all.box.high[a] = larger(at.c[a], all.box.high[a]);
            }
        }
        float reach = 0.0f;
        for (int a = 0; a < 3; ++a) reach += larger(tree.high.c[a], all.box.high[a]) - smaller(tree.low.c[a], all.box.low[a]);
        all.look_around(Kind::triangle_in(triangles, slot, SearchPoint {0.0f, 0.0f, 0.0f, 0.0f}), reach);
        return all;
    }

    inline CUDA_CALLABLE Triangle triangle(int, int slot) const { return Kind::triangle_in(triangles, slot, point); }
};

/// What a walk over boxes of instances needs of a search.
template <class Kept> struct InstanceLimit {
    Kept& kept;
    float slack, limit;

    inline CUDA_CALLABLE void update()
    {
        const float wide = kept.farthest() + slack;
        limit = wide * wide * WIDENED;
    }

    inline CUDA_CALLABLE void visit_node() { kept.visit_node(); }
};

/// Trees of instances. Kind: of these; U: children of a node above them.
template <class Kind, int U, class Top, class Parts> struct PointInstances {
    using Start = AtRoot;
    static constexpr int LANES = 0;

    const Top& top;
    const Parts& parts;
    double x, y, z;
    SearchPoint point;
    unsigned mask;
    int root, tried;

    CUDA_CALLABLE PointInstances(const Top& top, const Parts& parts)
        : top(top)
        , parts(parts)
    {
    }

    /// Whether the point, relative to the scene's centre, can find anything.
    inline CUDA_CALLABLE bool enter(double px, double py, double pz, unsigned seen, int environment)
    {
        x = px, y = py, z = pz, mask = seen, tried = -1, root = root_of(top, environment);
        const Extent above = extent_of(top);
        point = point_in(above.low, above.high, (float)x, (float)y, (float)z);
        return (point.slack == point.slack) & (root >= 0);
    }

    template <class Points> inline CUDA_CALLABLE bool load(const Points& points, int i)
    {
        const auto& at = points.exact.data[i];
        const unsigned seen = points.mask.shape[0] ? points.mask.data[(size_t)i * points.mask_stride] : ~0u;
        const bool has = points.environment.shape[0];
        return enter(
            at.c[0], at.c[1], at.c[2], seen, has ? points.environment.data[(size_t)i * points.environment_stride] : -1);
    }

    template <class Kept> inline CUDA_CALLABLE void start(Kept&) const { }

    /// The point in the space of an instance.
    template <class Place, class Tree> inline CUDA_CALLABLE SearchPoint mapped(const Place& place, const Tree& tree) const
    {
        const auto& m = place.to_object.data;
        const double px = x - place.origin.c[0], py = y - place.origin.c[1], pz = z - place.origin.c[2];
        float own[3];
        for (int a = 0; a < 3; ++a) own[a] = (float)((m[a][0] * px + m[a][1] * py) + m[a][2] * pz);
        return point_in(tree.low, tree.high, own[0], own[1], own[2]);
    }

    /// The nearest triangles in an instance. slot: of one to be tried first; -1 for none.
    template <class Kept> inline CUDA_CALLABLE void visit(int instance, int slot, Kept& kept) const
    {
        const auto& place = top.placements.data[instance];
        if (!(place.mask & mask)) return;
        const auto& part = parts.data[place.geometry];
        const SearchPoint own = mapped(place, part.tree);
        if (!(own.slack == own.slack)) return;
        double square = 0.0;
        for (int a = 0; a < 9; ++a) square += place.to_scene.data[a / 3][a % 3] * place.to_scene.data[a / 3][a % 3];
        kept.scale = square_root((float)(square / 3.0)), kept.shrink = WIDENED / kept.scale;
        kept.first = place.first;
        kept.look_up_to(kept.farthest(), own.slack);
        if (slot >= 0) Kind::search_around(part.triangles, slot, own, kept);
        Kind::walk(part.tree, part.triangles, own, kept, slot, nullptr);
    }

    /// The instance of a triangle.
    inline CUDA_CALLABLE int instance_of(int number) const
    {
        int low = 0, high = top.placements.shape[0];
        while (high - low > 1) {
            const int middle = (low + high) / 2;
            if (top.placements.data[middle].first <= number) low = middle;
            else high = middle;
        }
        return low;
    }

    template <class Kept> inline CUDA_CALLABLE void try_near(int number, int slot, Kept& kept)
    {
        if (tried >= 0 || root != top.root) return;  // other roots are not above all instances
        tried = instance_of(number);
        visit(tried, slot, kept);
    }

    template <class Kept> inline CUDA_CALLABLE void search(Kept& kept) const
    {
        InstanceLimit<Kept> above = {kept, INSTANCE_SLACK * point.slack, 0.0f};
        above.update();
        walk_boxes<U>(top.tree, root, point, above, [&](int block, int) {
            const int instance = top.order.data[block * U];
            if (instance == tried) return;
            visit(instance, -1, kept);
            above.update();
        });
    }

    inline CUDA_CALLABLE Triangle triangle(int number, int slot) const
    {
        const auto& place = top.placements.data[instance_of(number)];
        const auto& part = parts.data[place.geometry];
        return Kind::triangle_in(part.triangles, slot, mapped(place, part.tree));
    }
};

/// Distance, weights and number (its bits) of the nearest triangle to a point that has entered a space, or that cannot find
/// anything.
template <class Vec4, class Space> inline CUDA_CALLABLE Vec4 nearest_in(Space space, bool has_entered, float max_distance)
{
    NearestTriangle kept(max_distance);
    OnTriangle at = {0.0f, 0.0f, 0.0f, -1};
    if (has_entered & (max_distance >= 0.0f)) {
        space.start(kept);
        space.search(kept);
    }
    if (kept.slot >= 0) at = space.triangle(kept.number, kept.slot).nearest();
    return Vec4(kept.distance, at.u, at.v, __builtin_bit_cast(float, kept.number));
}

template <class Kind, class Tree, class Triangles>
inline CUDA_CALLABLE PointTree<Kind, Tree, Triangles> point_tree(const Tree& tree, const Triangles& triangles)
{
    return PointTree<Kind, Tree, Triangles>(tree, triangles);
}

template <class Kind, int U, class Top, class Parts>
inline CUDA_CALLABLE PointInstances<Kind, U, Top, Parts> point_instances(const Top& top, const Parts& parts)
{
    return PointInstances<Kind, U, Top, Parts>(top, parts);
}

}  // namespace
}  // namespace wrt

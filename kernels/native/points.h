// Searches of the triangles near points: what is kept of them, and walks of trees.
//
// wrt.kernels.points has the bounds of rounding by which boxes are left out. Coordinates are those of a tree. Distances are the
// scene's: a map of an instance multiplies those in its tree by a scale, which is 1 in a scene without instances.
#pragma once
#include "point_blocks.h"
#include "square_root.h"

namespace wrt {
namespace {

/// Factor of bounds that are computed from distances, so that rounding loses nothing that is as near.
constexpr float WIDENED = 1.000001f;

/// Greatest number of inner nodes on a path from the root.
constexpr int TREE_DEPTH = 64;

/// What every search has: up to which distance it looks for triangles, and the tree that it is in.
struct Search {
    float max_distance;  // greatest distance of a triangle that is found
    float scale = 1.0f;  // of distances in the tree
    float shrink = WIDENED;  // its inverse, widened
    int first = 0;  // number of the tree's first triangle
    float limit = 0.0f;  // no box is entered whose squared distance in the tree is greater
    float bound = 0.0f;  // no triangle is kept whose squared distance in the tree is greater

    /// Whether what is kept lowers the bound, so that the nearest is best kept first.
    static constexpr bool NARROWS = true;

    /// Whether work is counted.
    static constexpr bool COUNTS = false;

    /// Looks up to a distance of the scene.
    inline CUDA_CALLABLE void look_up_to(float distance, float slack)
    {
        const float own = distance * shrink + MIN_DISTANCE, wide = own + slack;
        bound = own * own;
        limit = wide * wide * WIDENED;
    }

    /// Counts of work, by searches that count it.
    inline CUDA_CALLABLE void visit_node() { }
    inline CUDA_CALLABLE void visit_leaf(int) { }
};

/// The nearest triangle: of those at the same distance, that with the smallest number. slot: where it is in the blocks.
struct NearestTriangle : Search {
    float distance = WRT_INFINITY;
    int number = -1, slot = -1;

    explicit CUDA_CALLABLE NearestTriangle(float max_distance) { this->max_distance = max_distance; }

    inline CUDA_CALLABLE float farthest() const { return distance < max_distance ? distance : max_distance; }

    inline CUDA_CALLABLE void keep(float square, int primitive, int place, const SearchPoint& point)
    {
        const float away = square_root(square) * scale;
        const int own = first + primitive;
        if (!(away <= max_distance) || !((away < distance) | ((away == distance) & (own < number)))) return;
        distance = away, number = own, slot = place;
        look_up_to(away, point.slack);
    }
};

/// The same, with its work.
struct CountedNearest : NearestTriangle {
    static constexpr bool COUNTS = true;
    int nodes = 0, leaves = 0, triangles = 0;

    using NearestTriangle::NearestTriangle;

    inline CUDA_CALLABLE void visit_node() { ++nodes; }
    inline CUDA_CALLABLE void visit_leaf(int count) { ++leaves, triangles += count; }
};

/// Squared distance along an axis, of an interval.
inline CUDA_CALLABLE float outside(float low, float high, float x)
{
    const float below = low - x, above = x - high, outside = below > above ? below : above;
    return outside > 0.0f ? outside : 0.0f;
}

/// The same, from the coordinate of a point.
inline CUDA_CALLABLE float distance_along(float low, float high, const SearchPoint& point, int axis)
{
    return outside(low, high, axis == 0 ? point.x : axis == 1 ? point.y : point.z);
}

/// The box of some points.
struct BoxOfPoints {
    float low[3], high[3];
};

inline CUDA_CALLABLE float distance_along(float low, float high, const BoxOfPoints& box, int axis)
{
    const float below = low - box.high[axis], above = box.low[axis] - high, outside = below > above ? below : above;
    return outside > 0.0f ? outside : 0.0f;
}

/// Keys of the children of a node: the squared distance, whose lowest bits name the child; -1 for those that can hold nothing
/// nearer. Returns a bit for each of the others.
template <int W, class Point>
inline CUDA_CALLABLE unsigned child_keys(const float* box, const Point& point, float limit, int* key)
{
    int near[W];
    WRT_FOR_LANES (i) {
        const float x = distance_along(box[i], box[3 * W + i], point, 0),
                    y = distance_along(box[W + i], box[4 * W + i], point, 1);
        const float z = distance_along(box[2 * W + i], box[5 * W + i], point, 2), square = (x * x + y * y) + z * z;
        const bool meets = (square <= limit) & (square < WRT_INFINITY);
        near[i] = meets ? -1 : 0;
        key[i] = meets ? (__builtin_bit_cast(int, square) & ~(W - 1)) | i : -1;
    }
    return bits<W>(near);
}

/// Sorts keys, the greatest first.
template <int W> inline CUDA_CALLABLE void sort_keys(int* key)
{
#if WRT_VECTORS
    save(key, sort<W>(load<Vector<int, W>>(key)));
#else
    for (int i = 1; i < W; ++i)
        for (int j = i; j > 0 && key[j] > key[j - 1]; --j) {
            const int other = key[j];
            key[j] = key[j - 1], key[j - 1] = other;
        }
#endif
}

/// Children that wait, those of a node sorted, the nearest on top.
template <int W> struct WaitingChildren {
    int keys[TREE_DEPTH * (W - 1) + 1 + W], words[TREE_DEPTH * (W - 1) + 1 + W], size = 0;

    inline CUDA_CALLABLE void put(int key, const int* child)
    {
        keys[size] = key, words[size] = child[key & (W - 1)];
        ++size;
    }

    /// Puts the children of a node that are near, and returns whether there are any.
    inline CUDA_CALLABLE bool put_near(unsigned near, int* key, const int* child)
    {
        const int count = count_bits(near);
        if (count == 1) put(key[lowest_bit(near)], child);
        else if (count == 2) {
            const int one = key[lowest_bit(near)], other = key[lowest_bit(near & (near - 1u))];
            put(one > other ? one : other, child);
            put(one > other ? other : one, child);
        } else if (count > 2) {
            sort_keys<W>(key);
            for (int i = 0; i < count; ++i) put(key[i], child);
        }
        return count > 0;
    }

    /// Takes the nearest that is within the limit; returns whether there is one.
    inline CUDA_CALLABLE bool take(float limit, int& word)
    {
        while (size > 0) {
            --size;
            word = words[size];
            if (__builtin_bit_cast(float, keys[size] & ~(W - 1)) <= limit) return true;
        }
        return false;
    }
};

/// Walks a wide BVH from a node on, which need not be one of the tree's.
///
/// box, children: of the node. point: one, or what has a distance from intervals. leaf(block, count): visits one. kept: `limit`
/// says which boxes are entered, and may fall at leaves.
template <int W, class Tree, class Point, class Kept, class Leaf>
inline CUDA_CALLABLE void walk_below(
    const Tree& tree, const float* box, const int* children, const Point& point, Kept& kept, Leaf&& leaf)
{
    WaitingChildren<W> waiting;
    while (true) {
        int key[W], node;
        kept.visit_node();
        const unsigned near = child_keys<W>(box, point, kept.limit, key);
        waiting.put_near(near, key, children);
        do {
            if (!waiting.take(kept.limit, node)) return;
            if (node < 0) leaf(~node >> 6, ~node & 63);
        } while (node < 0);
        box = tree.bounds.data + (size_t)node * (6 * W), children = tree.child.data + (size_t)node * W;
    }
}

/// The same, from a node of the tree.
template <int W, class Tree, class Point, class Kept, class Leaf>
inline CUDA_CALLABLE void walk_boxes(const Tree& tree, int node, const Point& point, Kept& kept, Leaf&& leaf)
{
    walk_below<W>(
        tree, tree.bounds.data + (size_t)node * (6 * W), tree.child.data + (size_t)node * W, point, kept, (Leaf&&)leaf);
}

/// A node above the subtrees of a wide BVH that some points have to look into: as deep as W of them allow.
template <int W> struct NodeOfPoints {
    float box[6 * W];
    int child[W], size;

    /// Gathers what is within a limit, a squared distance, of a box around the points.
    template <class Tree> inline CUDA_CALLABLE void gather(const Tree& tree, const BoxOfPoints& points, float limit)
    {
        size = 0;
        replace(0, tree, 0, points, limit);
        for (int i = 0; i < size;) i += child[i] < 0 || !replace(i, tree, child[i], points, limit);
        for (int i = size; i < W; ++i)
            for (int row = 0; row < 6; ++row) box[row * W + i] = row < 3 ? WRT_INFINITY : -WRT_INFINITY;
    }

private:
    /// Puts the children of a node that are near in the place of child i, if there is room for them; returns whether there was.
    template <class Tree>
    inline CUDA_CALLABLE bool replace(int i, const Tree& tree, int node, const BoxOfPoints& points, float limit)
    {
        const float* const from = tree.bounds.data + (size_t)node * (6 * W);
        int key[W];
        unsigned near = child_keys<W>(from, points, limit, key);
        const int others = i < size ? size - 1 : 0;
        if (others + count_bits(near) > W) return false;
        if (!near && others > i) {  // the last one comes here
            for (int row = 0; row < 6; ++row) box[row * W + i] = box[row * W + others];
            child[i] = child[others];
        }
        size = others;
        for (; near; near &= near - 1u, ++size, i = size) {
            const int lane = lowest_bit(near);
            for (int row = 0; row < 6; ++row) box[row * W + i] = from[row * W + lane];
            child[i] = tree.child.data[(size_t)node * W + lane];
        }
        return true;
    }
};

/// A cell that waits, with its distance from the point along each axis.
struct WaitingCell {
    int node;
    float away[3];
};

/// Walks a kd-tree, the nearer child first; arguments as in `walk_boxes`.
template <class Tree, class Kept, class Leaf>
inline CUDA_CALLABLE void walk_cells(const Tree& tree, const SearchPoint& point, Kept& kept, Leaf&& leaf)
{
    const float at[3] = {point.x, point.y, point.z};
    WaitingCell stack[TREE_DEPTH + 1], cell = {tree.root, {}};
    for (int a = 0; a < 3; ++a) cell.away[a] = outside(tree.low.c[a], tree.high.c[a], at[a]);
    int size = 0;
    stack[size++] = cell;
    while (size > 0) {
        cell = stack[--size];
        const float square = (cell.away[0] * cell.away[0] + cell.away[1] * cell.away[1]) + cell.away[2] * cell.away[2];
        if (!(square <= kept.limit)) continue;
        int first = tree.nodes.data[cell.node].c[0], second = tree.nodes.data[cell.node].c[1];
        while ((second & 3) != 3) {
            kept.visit_node();
            const int axis = second & 3, right = second >> 2;
            const float away = at[axis] - __builtin_bit_cast(float, first);
            WaitingCell far = cell;
            far.node = away < 0.0f ? right : cell.node + 1;
            const float own = WRT_ABS(away);
            far.away[axis] = own > cell.away[axis] ? own : cell.away[axis];
            cell.node = away < 0.0f ? cell.node + 1 : right;
            stack[size++] = far;
            first = tree.nodes.data[cell.node].c[0], second = tree.nodes.data[cell.node].c[1];
        }
        leaf(first, second >> 2);
    }
}

/// Leaves of blocks of W triangles, whose records have ROWS rows.
template <int W, int ROWS> struct BlockLeaves {
    /// Searches the triangles around one.
    template <class Triangles, class Kept>
    static CUDA_CALLABLE void search_around(const Triangles& triangles, int slot, const SearchPoint& point, Kept& kept)
    {
        search_block<W, ROWS>(triangles.records.data, triangles.primitive.data, slot / W, point, kept);
    }

    template <class Triangles>
    static CUDA_CALLABLE Triangle triangle_in(const Triangles& triangles, int slot, const SearchPoint& point)
    {
        return triangle_in_slot<W, ROWS>(triangles.records.data, slot, point);
    }
};

/// Where searches of trees begin that have no other place than the root.
struct AtRoot { };

/// Kinds of trees, as searches walk them: wide nodes, and the cells of a kd-tree. `PackedTree` is another.
///
/// start: where the walk begins; null for the root. tried: a slot around which triangles have been tested; -1 for none. LANES:
/// of nodes below which groups of points begin together; 0 if they do not.
template <int W, int ROWS> struct BoxTree : BlockLeaves<W, ROWS> {
    using Start = NodeOfPoints<W>;
    static constexpr int LANES = W, TRIANGLE_ROWS = ROWS;

    template <class Tree, class Triangles, class Kept>
    static CUDA_CALLABLE void walk(
        const Tree& tree, const Triangles& triangles, const SearchPoint& point, Kept& kept, int tried, const Start* start)
    {
        LeafSearch<W, ROWS, Triangles, Kept> search(triangles, point, kept, tried);
        walk_below<W>(tree, start ? start->box : tree.bounds.data, start ? start->child : tree.child.data, point, kept, search);
        search.finish();
    }
};

template <int W, int ROWS> struct CellTree : BlockLeaves<W, ROWS> {
    using Start = AtRoot;
    static constexpr int LANES = 0;

    template <class Tree, class Triangles, class Kept>
    static CUDA_CALLABLE void walk(
        const Tree& tree, const Triangles& triangles, const SearchPoint& point, Kept& kept, int tried, const Start*)
    {
        LeafSearch<W, ROWS, Triangles, Kept> search(triangles, point, kept, tried);
        walk_cells(tree, point, kept, search);
        search.finish();
    }
};

}  // namespace
}  // namespace wrt

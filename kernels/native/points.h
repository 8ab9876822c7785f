// Searches of the triangles near points: what is kept of them, W triangles of a block at a time, and walks of trees.
//
// wrt.kernels.points has the bounds of rounding by which boxes are left out. Coordinates are those of a tree. Distances are the
// scene's: a map of an instance multiplies those in its tree by a scale, which is 1 in a scene without instances.
#pragma once
#include "lanes.h"
#include "nearest_on_triangle.h"
#include "square_root.h"

namespace wrt {
namespace {

/// Distances of boxes and of triangles may be wrong by this part of the distance of the farthest point of the scene.
constexpr float POINT_SLACK = 1.9073486328125e-6f;

/// Squares of distances below this are no normal numbers.
constexpr float LEAST_DISTANCE = 1e-18f;

/// Factor of bounds that are computed from distances, so that rounding loses nothing that is as near.
constexpr float WIDENED = 1.000001f;

/// Greatest number of inner nodes on a path from the root.
constexpr int TREE_DEPTH = 64;

/// A point; slack: POINT_SLACK of the distance of the farthest point of the tree's box, a NaN for a point that finds nothing.
struct SearchPoint {
    float x, y, z, slack;
};

template <class Vec3> inline CUDA_CALLABLE SearchPoint point_in(const Vec3& low, const Vec3& high, float x, float y, float z)
{
    const float at[3] = {x, y, z};
    float reach = 0.0f;
    for (int a = 0; a < 3; ++a) {
        const float below = WRT_ABS(low.c[a] - at[a]), above = WRT_ABS(high.c[a] - at[a]);
        reach += below > above ? below : above;
    }
    return {x, y, z, reach - reach == 0.0f ? reach * POINT_SLACK + LEAST_DISTANCE : WRT_NAN};
}

/// What every search has: up to which distance it looks for triangles, and the tree that it is in.
struct Search {
    float most;  // greatest distance of a triangle that is found
    float scale = 1.0f;  // of distances in the tree
    float shrink = WIDENED;  // its inverse, widened
    int first = 0;  // number of the tree's first triangle
    float limit = 0.0f;  // no box is entered whose squared distance in the tree is greater
    float bound = 0.0f;  // no triangle is kept whose squared distance in the tree is greater

    /// Looks up to a distance of the scene.
    inline CUDA_CALLABLE void look_up_to(float distance, float slack)
    {
        const float own = distance * shrink + LEAST_DISTANCE, wide = own + slack;
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

    explicit CUDA_CALLABLE NearestTriangle(float most) { this->most = most; }

    inline CUDA_CALLABLE float farthest() const { return distance < most ? distance : most; }

    inline CUDA_CALLABLE void keep(float square, int primitive, int place, const SearchPoint& point)
    {
        const float away = square_root(square) * scale;
        const int own = first + primitive;
        if (!(away <= most) || !((away < distance) | ((away == distance) & (own < number)))) return;
        distance = away, number = own, slot = place;
        look_up_to(away, point.slack);
    }
};

/// The same, with its work.
struct CountedNearest : NearestTriangle {
    int nodes = 0, leaves = 0, triangles = 0;

    using NearestTriangle::NearestTriangle;

    inline CUDA_CALLABLE void visit_node() { ++nodes; }
    inline CUDA_CALLABLE void visit_leaf(int count) { ++leaves, triangles += count; }
};

/// The vertex of a record, less the point.
template <int W> inline CUDA_CALLABLE Offset vertex_at(const float* record, int vertex, const SearchPoint& point)
{
    const float* const from = record + 3 * W * vertex;
    return {from[0] - point.x, from[W] - point.y, from[2 * W] - point.z};
}

/// The W triangles of a block. records: of ROWS rows of W lanes, the first nine of which are vertices.
template <int W, int ROWS, class Kept>
inline CUDA_CALLABLE void search_block(const float* records, const int* ids, int block, const SearchPoint& point, Kept& kept)
{
    const float* const record = records + (size_t)block * (ROWS * W);
    float square[W];
    int flat[W], near[W];
    const float bound = kept.bound;
    WRT_FOR_LANES (i) {
        const Offset a = vertex_at<W>(record + i, 0, point), b = vertex_at<W>(record + i, 1, point);
        const Offset c = vertex_at<W>(record + i, 2, point);
        const float aa = dot(a, a), bb = dot(b, b), cc = dot(c, c);
        const float ab = nearest_on_edge(a, b, aa, bb).square, bc = nearest_on_edge(b, c, bb, cc).square;
        const float ca = nearest_on_edge(c, a, cc, aa).square;
        float least = bc < ab ? bc : ab;
        least = ca < least ? ca : least;
        const Offset e1 = b - a, e2 = c - a;
        const Foot<float> foot = foot_on_plane(a, e1, e2);
        const bool is_thin = is_flat(foot, e1, e2);
        const float face = square_of_foot(a, e1, e2, foot);
        flat[i] = (is_thin & (least == least)) ? -1 : 0;
        least = ((face <= least * FACE_SHARE + aa * FACE_SLACK) & !is_thin) ? face : least;
        square[i] = least;
        near[i] = least <= bound ? -1 : 0;
    }
    unsigned left = bits<W>(near);
    for (unsigned thin = bits<W>(flat); thin; thin &= thin - 1u) {
        const int i = lowest_bit(thin);
        const Offset a = vertex_at<W>(record + i, 0, point), b = vertex_at<W>(record + i, 1, point);
        square[i] = nearest_on_triangle(a, b, vertex_at<W>(record + i, 2, point)).square;
        left |= square[i] <= bound ? 1u << i : 0u;
    }
    for (; left; left &= left - 1u) {
        const int i = lowest_bit(left), slot = block * W + i;
        kept.keep(square[i], ids[slot], slot, point);
    }
}

/// A leaf of some triangles, whose blocks begin at `block`.
template <int W, int ROWS, class Triangles, class Kept>
inline CUDA_CALLABLE void search_leaf(const Triangles& triangles, int block, int count, const SearchPoint& point, Kept& kept)
{
    kept.visit_leaf(count);
    for (; count > 0; count -= W) search_block<W, ROWS>(triangles.records.data, triangles.primitive.data, block++, point, kept);
}

/// Squared distance along an axis, of an interval.
inline CUDA_CALLABLE float outside(float low, float high, float x)
{
    const float below = low - x, above = x - high, most = below > above ? below : above;
    return most > 0.0f ? most : 0.0f;
}

/// Keys of the children of a node that may hold something nearer: the squared distance, whose lowest bits name the child; -1 for
/// others. Returns how many there are.
template <int W> inline CUDA_CALLABLE int child_keys(const float* box, const SearchPoint& point, float limit, int* key)
{
    int near[W];
    WRT_FOR_LANES (i) {
        const float x = outside(box[i], box[3 * W + i], point.x), y = outside(box[W + i], box[4 * W + i], point.y);
        const float z = outside(box[2 * W + i], box[5 * W + i], point.z), square = (x * x + y * y) + z * z;
        const bool meets = (square <= limit) & (square < WRT_INFINITY);
        near[i] = meets ? -1 : 0;
        key[i] = meets ? (__builtin_bit_cast(int, square) & ~(W - 1)) | i : -1;
    }
    return count_bits(bits<W>(near));
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

/// Walks a wide BVH from a node on. Children wait on a stack, those of a node sorted, the nearest on top.
///
/// leaf(block, count): visits one. kept: `limit` says which boxes are entered, and may fall at leaves.
template <int W, class Tree, class Kept, class Leaf>
inline CUDA_CALLABLE void walk_boxes(const Tree& tree, int node, const SearchPoint& point, Kept& kept, const Leaf& leaf)
{
    int keys[TREE_DEPTH * (W - 1) + 1 + W], nodes[TREE_DEPTH * (W - 1) + 1 + W], size = 0;
    const float* const bounds = tree.bounds.data;
    const int* const child = tree.child.data;
    while (true) {
        kept.visit_node();
        const int count = child_keys<W>(bounds + (size_t)node * (6 * W), point, kept.limit, keys + size);
        if (count > 1) sort_keys<W>(keys + size);
        else if (count == 1) {
            int only = -1;
            for (int i = 0; i < W; ++i) only = keys[size + i] > only ? keys[size + i] : only;
            keys[size] = only;
        }
        for (int i = 0; i < W; ++i) nodes[size + i] = node;
        size += count;
        node = -1;
        while (size > 0 && node < 0) {
            --size;
            if (!(__builtin_bit_cast(float, keys[size] & ~(W - 1)) <= kept.limit)) continue;
            const int word = child[nodes[size] * W + (keys[size] & (W - 1))];
            if (word >= 0) node = word;
            else leaf(~word >> 6, ~word & 63);
        }
        if (node < 0) return;
    }
}

/// A cell that waits, with its distance from the point along each axis.
struct WaitingCell {
    int node;
    float away[3];
};

/// Walks a kd-tree, the nearer child first; arguments as in `walk_boxes`.
template <class Tree, class Kept, class Leaf>
inline CUDA_CALLABLE void walk_cells(const Tree& tree, const SearchPoint& point, Kept& kept, const Leaf& leaf)
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

/// The trees, as searches walk them.
struct BoxTree {
    template <int W, int ROWS, class Tree, class Triangles, class Kept>
    static CUDA_CALLABLE void walk(const Tree& tree, const Triangles& triangles, const SearchPoint& point, Kept& kept)
    {
        const auto leaf = [&](int block, int count) { search_leaf<W, ROWS>(triangles, block, count, point, kept); };
        walk_boxes<W>(tree, 0, point, kept, leaf);
    }
};

struct CellTree {
    template <int W, int ROWS, class Tree, class Triangles, class Kept>
    static CUDA_CALLABLE void walk(const Tree& tree, const Triangles& triangles, const SearchPoint& point, Kept& kept)
    {
        const auto leaf = [&](int block, int count) { search_leaf<W, ROWS>(triangles, block, count, point, kept); };
        walk_cells(tree, point, kept, leaf);
    }
};

}  // namespace
}  // namespace wrt

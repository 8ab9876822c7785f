// Searches of the triangles near points in a tree of 64-byte nodes (wrt.kernels.layout.binary_nodes), a triangle at a time.
//
// Boxes are a filter: they are tested by fused operations. Distances of triangles have the bits of blocks.
#pragma once
#include "binary_nodes.h"
#include "persistent_threads.h"
#include "points.h"

namespace wrt {
namespace {

/// Squared distance of a point from a box.
inline CUDA_CALLABLE float square_to(const SearchPoint& p, float x0, float x1, float y0, float y1, float z0, float z1)
{
    const float x = p.x - min_of(max_of(p.x, x0), x1), y = p.y - min_of(max_of(p.y, y0), y1),
                z = p.z - min_of(max_of(p.z, z0), z1);
    return fused(z, z, fused(y, y, x * x));
}

/// Where a walk is, a node or a leaf's word. What waits is on a stack: the bits of its squared distance, then its word.
struct PackedPlace {
    int node = DONE, top = 0;

    CUDA_CALLABLE bool is_inner() const { return (unsigned)node < (unsigned)BACK; }

    CUDA_CALLABLE bool is_leaf() const { return node < 0; }

    CUDA_CALLABLE void start(int* stack) { node = 0, top = 1, stack[0] = DONE; }

    /// From an inner node to the nearer child, or to what waits.
    CUDA_CALLABLE void step(const float* nodes, const SearchPoint& point, float limit, int* stack)
    {
        const TwoBoxes at = load_boxes(nodes, node);
        const Quad &p = at.first, &q = at.second, &r = at.both;
        const float a = square_to(point, p.x, p.y, p.z, p.w, r.x, r.y), b = square_to(point, q.x, q.y, q.z, q.w, r.z, r.w);
        const bool near_a = (a <= limit) & (a < WRT_INFINITY), near_b = (b <= limit) & (b < WRT_INFINITY);
        const bool swaps = near_b & (!near_a | (b < a));
        if (near_a & near_b) {
            stack[top++] = int_of(swaps ? a : b);
            stack[top++] = swaps ? at.left : at.right;
        }
        node = swaps ? at.right : at.left;
        if (!(near_a | near_b)) take(limit, stack);
    }

    /// Goes to what waits last and is near enough.
    CUDA_CALLABLE void take(float limit, const int* stack)
    {
        do {
            node = stack[--top];
            if (node == DONE) return;
            --top;
        } while (!(__builtin_bit_cast(float, stack[top]) <= limit));
    }
};

/// The tree, as searches walk it.
struct PackedTree {
    using Start = AtRoot;
    static constexpr int LANES = 0;

    static inline CUDA_CALLABLE Triangle less(const Quad& a, const Quad& b, const Quad& c, const SearchPoint& p)
    {
        return {{{a.x - p.x, a.y - p.y, a.z - p.z}, {b.x - p.x, b.y - p.y, b.z - p.z}, {c.x - p.x, c.y - p.y, c.z - p.z}}};
    }

    template <class Triangles>
    static CUDA_CALLABLE Triangle triangle_in(const Triangles& triangles, int slot, const SearchPoint& point)
    {
        const float* const at = (const float*)triangles.corners.data + TRIANGLE_WORDS * (size_t)slot;
        return less(load_quad(at), load_quad(at + 4), load_quad(at + 8), point);
    }

    template <class Triangles, class Kept>
    static CUDA_CALLABLE void search_around(const Triangles& triangles, int slot, const SearchPoint& point, Kept& kept)
    {
        const float* const at = (const float*)triangles.corners.data + TRIANGLE_WORDS * (size_t)slot;
        const Quad first = load_quad(at);
        const Triangle own = less(first, load_quad(at + 4), load_quad(at + 8), point);
        bool is_thin;
        float square = square_in_float32(own.vertex[0], own.vertex[1], own.vertex[2], is_thin);
        if (is_thin) square = own.nearest().square;
        if (square <= kept.bound) kept.keep(square, int_of(first.w), slot, point);
    }

    template <class Triangles, class Kept>
    static CUDA_CALLABLE void search_leaf(const Triangles& triangles, int word, const SearchPoint& point, Kept& kept)
    {
        const int count = word & ((1 << LEAF_BITS) - 1), begin = 2 * (word >> LEAF_BITS);
        kept.visit_leaf(count);
        for (int slot = begin; slot < begin + count; ++slot) search_around(triangles, slot, point, kept);
    }

    template <class Tree, class Triangles, class Kept>
    static CUDA_CALLABLE void walk(
        const Tree& tree, const Triangles& triangles, const SearchPoint& point, Kept& kept, int, const Start*)
    {
        int stack[2 * TREE_DEPTH + 1];
        PackedPlace place;
        place.start(stack);
        while (place.node != DONE) {
            while (place.is_inner()) {
                kept.visit_node();
                place.step((const float*)tree.nodes.data, point, kept.limit, stack);
            }
            if (!place.is_leaf()) continue;
            search_leaf(triangles, ~place.node, point, kept);
            place.take(kept.limit, stack);
        }
    }
};

}  // namespace
}  // namespace wrt

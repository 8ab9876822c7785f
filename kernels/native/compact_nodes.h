// Compact subtrees of a kd-tree: `wrt.kernels.layout.compact_nodes`.
#pragma once
#include "loops.h"

namespace wrt {
namespace {

/// A node as in `wrt.kernels.layout.kdtree_nodes`, without the index of its children. `index` is moved from an exit to the
/// subtree that begins there. HEIGHT: levels of planes; LONG: number of triangles that stands for this many or more.
template <int HEIGHT, int LONG, class Node> inline CUDA_CALLABLE Node load_compact(const Node* nodes, int& index)
{
    constexpr int HALF = 1 << HEIGHT, SIZE = 2 * HALF;
    const int* words = (const int*)nodes;
    int at = index & (SIZE - 1), word = words[index];
    if (at >= HALF && word >= 0) {
        at = 1;
        index = word * SIZE + at;
        word = words[index];
    }
    if (at < HALF) {
        const int* subtree = words + (index - at);
        const int axis = (subtree[0] >> (2 * at)) & 3;
        if (axis != 3) return Node(word, axis);
        while (at < HALF) at *= 2;
        word = subtree[at];
    }
    const int first = ~word >> 6, triangles = ~word & 63;
    return triangles == LONG ? nodes[first] : Node(first, triangles << 2 | 3);
}

}  // namespace
}  // namespace wrt

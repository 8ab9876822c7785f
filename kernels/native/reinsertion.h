// Reinsertion of the nodes of a merged tree (wrt.builders.bvh.phases.parallel_reinsertion): the search for places, the choice
// of moves that can be made together, the moves, and the boxes after them. The CPU and CUDA do the same operations on the same
// numbers, so they make the same tree.
#pragma once
#include "lanes.h"

namespace wrt {
namespace {

/// A node as trees keep it: its low corner, its high one with its sign changed, and its children; -1 for those of a triangle.
struct alignas(16) LinkedBox {
    float low[3];
    int left;
    float high[3];
    int right;
};

inline CUDA_CALLABLE float lesser(float a, float b)
{
#if defined(__CUDA_ARCH__)
    return fminf(a, b);
#else
    return smaller(a, b);
#endif
}

inline CUDA_CALLABLE float area_of(const LinkedBox& box)
{
    const float x = -(box.low[0] + box.high[0]), y = -(box.low[1] + box.high[1]), z = -(box.low[2] + box.high[2]);
    return x * y + y * z + z * x;
}

/// The box around both; children are those of a.
inline CUDA_CALLABLE LinkedBox around(LinkedBox a, const LinkedBox& b)
{
    for (int k = 0; k < 3; ++k) {
        a.low[k] = lesser(a.low[k], b.low[k]);
        a.high[k] = lesser(a.high[k], b.high[k]);
    }
    return a;
}

/// Pairs of nodes that a search looks at below one node, and those of them that it leaves for later, at most. More are left
/// out: so no search takes long, and trees of meshes do not show it.
constexpr int MAX_STEPS = 64, MAX_WAITING = 16;

/// Share of its parent's area that moving a node must gain: less may be rounding.
constexpr float LEAST_GAIN = 0x1p-18f;

/// Where a node is to move: to the sibling `beside`, -1 for none. Below `pivot` are both; -1 above the root.
struct Place {
    int beside, pivot;
};

/// A tree whose nodes move.
template <class Tree, class Moves> struct MovingTree {
    const Tree& tree;
    const Moves& moves;
    int count;

    CUDA_CALLABLE LinkedBox& box(int node) const { return ((LinkedBox*)tree.box.data)[node]; }
    CUDA_CALLABLE int& link(int node) const { return tree.parent.data[node]; }
    CUDA_CALLABLE int parent(int node) const { return link(node) < 0 ? -1 : count + (link(node) >> 1); }
    CUDA_CALLABLE int sibling(int node) const
    {
        const LinkedBox& both = box(parent(node));
        return (link(node) & 1) ? both.left : both.right;
    }
    CUDA_CALLABLE Place& place(int node) const { return ((Place*)moves.place.data)[node]; }
    CUDA_CALLABLE unsigned long long& key(int node) const { return ((unsigned long long*)moves.key.data)[node]; }
    CUDA_CALLABLE unsigned long long& owner(int node) const { return ((unsigned long long*)moves.owner.data)[node]; }

    /// Links a node to a parent, or makes it the root.
    CUDA_CALLABLE void put(int node, int at) const
    {
        link(node) = at;
        if (at < 0) {
            tree.root.data[0] = node;
        } else {
            LinkedBox& above = box(count + (at >> 1));
            ((at & 1) ? above.right : above.left) = node;
        }
    }

    /// The box of a node that another thread may have computed just now.
    CUDA_CALLABLE LinkedBox made_box(int node) const
    {
#if defined(__CUDA_ARCH__)
        const float4 low = __ldcg((const float4*)&box(node)), high = __ldcg((const float4*)&box(node) + 1);
        return {{low.x, low.y, low.z}, 0, {high.x, high.y, high.z}, 0};
#else
        return box(node);
#endif
    }

    /// Its number of triangles.
    CUDA_CALLABLE int made_size(int node) const
    {
        if (node < count) return 1;
        const int* const at = tree.size.data + (node - count);
#if defined(__CUDA_ARCH__)
        return __ldcg(at);
#else
        return *at;
#endif
    }
};

/// The best place found so far for a node: it becomes the sibling of `beside`; both are below `pivot` then, -1 for the root.
struct BestPlace {
    float gain;
    int beside, pivot;

    CUDA_CALLABLE void consider(float found, int node, int above)
    {
        if (!(found > gain)) return;
        gain = found;
        beside = node;
        pivot = above;
    }
};

/// Searches below a node whose children are left and right. before: the gain of a place there, less what it costs from them on.
template <class All>
inline CUDA_CALLABLE void search_below(
    const All& all, const LinkedBox& own, float own_area, int left, int right, float before, int pivot, BestPlace& best)
{
    int lefts[MAX_WAITING], rights[MAX_WAITING];
    float gains[MAX_WAITING];
    int waiting = 0;
    for (int step = 0; step < MAX_STEPS; ++step) {
        const LinkedBox a = all.box(left), b = all.box(right);
        const float here_a = before - area_of(around(a, own)), here_b = before - area_of(around(b, own));
        best.consider(here_a, left, pivot);
        best.consider(here_b, right, pivot);
        const float below_a = here_a + area_of(a), below_b = here_b + area_of(b);
        const bool enters_a = a.left >= 0 && below_a - own_area > best.gain;
        const bool enters_b = b.left >= 0 && below_b - own_area > best.gain;
        if (enters_a || enters_b) {
            const bool a_first = enters_a && !(enters_b && below_b > below_a);
            if (enters_a && enters_b && waiting < MAX_WAITING) {
                lefts[waiting] = a_first ? b.left : a.left;
                rights[waiting] = a_first ? b.right : a.right;
                gains[waiting++] = a_first ? below_b : below_a;
            }
            left = a_first ? a.left : b.left;
            right = a_first ? a.right : b.right;
            before = a_first ? below_a : below_b;
        } else {
            do {
                if (waiting == 0) return;
                before = gains[--waiting];
            } while (!(before - own_area > best.gain));
            left = lefts[waiting];
            right = rights[waiting];
        }
    }
}

/// The place with the greatest gain. Goes up from the node's parent; from each node on the way, down into the other child.
template <class All> inline CUDA_CALLABLE BestPlace best_place(const All& all, int node)
{
    const LinkedBox own = all.box(node);
    const float own_area = area_of(own);
    int at = all.parent(node);
    float gain = area_of(all.box(at));  // of taking the node away, from what is below `at`
    BestPlace best = {gain * LEAST_GAIN, -1, -1};
    LinkedBox rest = all.box(all.sibling(node));  // of `at`, without the node
    if (rest.left >= 0 && area_of(rest) - own_area > best.gain) {
        search_below(all, own, own_area, rest.left, rest.right, area_of(rest), at, best);
    }
    for (int link = all.link(at); link >= 0; link = all.link(at)) {
        at = all.count + (link >> 1);
        const LinkedBox outer = all.box(at);
        const int beside = (link & 1) ? outer.left : outer.right;
        const LinkedBox other = all.box(beside);
        const float here = gain - area_of(around(other, own)), below = here + area_of(other);
        best.consider(here, beside, at);
        if (other.left >= 0 && below - own_area > best.gain) {
            search_below(all, own, own_area, other.left, other.right, below, at, best);
        }
        rest = around(rest, other);
        best.consider(gain - area_of(rest), at, all.parent(at));
        gain += area_of(outer) - area_of(rest);
    }
    return best;
}

/// Replaces a number by a greater one.
inline CUDA_CALLABLE void raise(unsigned long long* at, unsigned long long value)
{
#if defined(__CUDA_ARCH__)
    atomicMax(at, value);
#else
    unsigned long long before = __atomic_load_n(at, __ATOMIC_RELAXED);
    while (before < value && !__atomic_compare_exchange_n(at, &before, value, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) { }
#endif
}

/// Whether a thread is the first of two to come to a node. Who comes second sees what the first one wrote.
inline CUDA_CALLABLE bool comes_first(int* arrived)
{
#if defined(__CUDA_ARCH__)
    __threadfence();
    const int before = atomicAdd(arrived, 1);
    __threadfence();
#else
    const int before = __atomic_fetch_add(arrived, 1, __ATOMIC_ACQ_REL);
#endif
    return (before & 1) == 0;
}

/// The number by which moves are compared, of two no two the same: the gain, and the node.
inline CUDA_CALLABLE unsigned long long key_of(float gain, int node)
{
    return (unsigned long long)__builtin_bit_cast(unsigned, gain) << 32 | (unsigned)node;
}

/// Calls a function with the nodes whose links to their parents belong to a move: the node, its parent, the siblings.
template <class All, class Function> inline CUDA_CALLABLE void for_links(const All& all, int node, int beside, Function&& call)
{
    const int parent = all.parent(node);
    call(node);
    call(parent);
    call(all.sibling(node));
    call(beside);
}

/// Finds where a node is to move, and claims the links of the move: of moves that share one, that of the greatest key gets it.
template <class Tree, class Moves>
inline CUDA_CALLABLE void find_move(const Tree& tree, const Moves& moves, int node, int count)
{
    const MovingTree<Tree, Moves> all = {tree, moves, count};
    BestPlace best = {0.0f, -1, -1};
    if (node != count && all.link(node) >= 0) best = best_place(all, node);
    all.place(node) = {best.beside, best.pivot};
    const unsigned long long key = all.key(node) = key_of(best.gain, node);
    if (best.beside < 0) return;
    for_links(all, node, best.beside, [&](int at) { raise(&all.owner(at), key); });
}

/// Takes back a move that does not own all its links, or that could meet another one in a circle: of two nodes that move below
/// each other, neither would be below the root. So no node moves below one that may move on its part, and has the greater key.
template <class Tree, class Moves>
inline CUDA_CALLABLE void choose_move(const Tree& tree, const Moves& moves, int node, int count)
{
    const MovingTree<Tree, Moves> all = {tree, moves, count};
    const Place place = all.place(node);
    if (place.beside < 0) return;
    const unsigned long long key = all.key(node);
    bool moves_now = true;
    for_links(all, node, place.beside, [&](int at) { moves_now = moves_now && all.owner(at) == key; });
    for (int at = place.beside; moves_now && at != place.pivot; at = all.parent(at)) {
        const unsigned long long owner = all.owner(at);
        moves_now = owner <= key || (int)(unsigned)owner != at;
    }
    if (!moves_now) all.place(node).beside = -1;
}

/// Moves a node: its sibling takes the place of their parent, which becomes the parent of the node and of its new sibling.
template <class Tree, class Moves>
inline CUDA_CALLABLE void move_node(const Tree& tree, const Moves& moves, int node, int count)
{
    const MovingTree<Tree, Moves> all = {tree, moves, count};
    const int beside = all.place(node).beside;
    if (beside < 0) return;
    const int link = all.link(node), parent = all.parent(node), sibling = all.sibling(node);
    const int from = all.link(parent), to = all.link(beside);
    all.put(sibling, from);
    all.put(parent, to);
    all.put(beside, link ^ 1);
}

/// Goes up from a triangle, and where it comes second, computes the box and the size of a node. All links become free.
template <class Tree, class Moves>
inline CUDA_CALLABLE void refit_from(const Tree& tree, const Moves& moves, int triangle, int count)
{
    const MovingTree<Tree, Moves> all = {tree, moves, count};
    all.owner(triangle) = 0;
    all.owner(count + triangle) = 0;
    for (int link = all.link(triangle); link >= 0; link = all.link(count + (link >> 1))) {
        const int inner = link >> 1;
        if (comes_first(moves.arrived.data + inner)) return;
        LinkedBox& box = all.box(count + inner);
        const int left = box.left, right = box.right;
        LinkedBox both = around(all.made_box(left), all.made_box(right));
        both.left = left;
        both.right = right;
        box = both;
        tree.size.data[inner] = all.made_size(left) + all.made_size(right);
    }
}

}  // namespace
}  // namespace wrt

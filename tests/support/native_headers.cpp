// Instantiates what kernels/native/*.h declare, so that a compiler checks the headers on their own. WIDTH: lanes.
#include "interleaved.h"

struct Vec3 {
    float c[3];
};
struct Slabs {
    Vec3 inverse, origin_in, origin_out;
};
struct Best {
    float t;
};
struct Ray {
    Slabs slabs;
    float t_min;
    Best best;
};
template <class T> struct Array {
    T* data;
};
struct Tree {
    Array<float> bounds;
    Array<int> child;
};
struct Intervals {
    Array<int> rays;
    Array<float> entry, leave;
};
template <int N> struct List {
    int c[N];
};
struct PairLists {
    List<288> rays, leaves, candidate_rays, candidates;
};

using namespace wrt;

int interleaved(const Tree& tree, const Ray* rays, const int* list, int* memory, int& n, int* pairs)
{
    const float* const records = tree.bounds.data;
    return walk_to_leaves<WIDTH, true, true, 100, 208, 9>(tree, records, rays, list, 3, memory, n, n, n, n, pairs)
        + walk_to_leaves<WIDTH, false, false, 100, 208, 9>(tree, records, rays, list, 3, memory, n, n, n, n, pairs);
}

int box_streams(const Tree& tree, const Ray* rays, int* list, int* keys, unsigned& leaves)
{
    const float* const bounds = tree.bounds.data;
    return filter_boxes<WIDTH, Order::NEAR>(bounds, tree.child.data, 1, rays, list, 3, keys, leaves)
        + filter_boxes<WIDTH, Order::FAR>(bounds, tree.child.data, 1, rays, list, 3, keys, leaves)
        + filter_boxes<WIDTH, Order::NONE>(bounds, tree.child.data, 1, rays, list, 3, keys, leaves);
}

int plane_streams(const Ray* rays, Intervals& list, Intervals& stack, int& count)
{
    return filter_plane<16>(1, 0.5f, rays, list, 3, stack, 4, count) + filter_hits<16>(rays, stack, 4, 3, list);
}

int lists(const int* children, int* list, int& listed, int* pairs, PairLists& candidates)
{
    return list_leaves<WIDTH, 256>(children, 1, list, 3, 7u, listed, pairs, pairs) + collect_words<16>(list, 3, 7u)
        + append_candidates<WIDTH, true>(children, candidates, 0, 1, 2, 3u)
        + append_candidates<WIDTH, false>(children, candidates, 0, 1, 2, 3u);
}

unsigned boxes(const Tree& tree, const Ray& ray, int* keys, float* entry)
{
    return (unsigned)ray_keys<WIDTH>(tree.bounds.data, 1, ray.slabs, 0.0f, 1.0f, keys)
        + ray_mask<WIDTH>(tree.bounds.data, 1, ray.slabs, 0.0f, 1.0f, entry) + (unsigned)next_key<WIDTH>(keys, 3)
        + (unsigned)least_key<WIDTH>(keys);
}

void records(const float* const* from, float* columns, float* to)
{
    read_records(from, 0, columns);
    write_records(columns, to, 24, 0xffffu);
}

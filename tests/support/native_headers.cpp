// Instantiates what kernels/native/*.h declare, so that a compiler checks the headers on their own. WIDTH: lanes.
#include "bare_frusta.h"
#include "compact_nodes.h"
#include "interleaved.h"
#include "leaf.h"
#include "lockstep.h"
#include "nearest64.h"
#include "stream_candidates.h"
#include "stream_root.h"
#include "woop_packets.h"

struct Vec3 {
    float c[3];
};
struct Slabs {
    Vec3 inverse, origin_in, origin_out;
};
struct Best {
    float t;
    int primitive;
    float u, v;
};
struct WoopRay {
    Vec3 origin;
    int x, y, z;
    Vec3 shear;
};
struct Ray {
    Slabs slabs;
    float t_min;
    Best best;
    WoopRay state;
    int number;
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
struct Batch {
    Array<Vec3> origins, directions;
    Array<float> t_min, t_max;
    int origin_stride, direction_stride, t_min_stride, t_max_stride;
    struct {
        double c[3];
    } center;
};
struct RootLoad {
    unsigned used;
    int loaded, kept, waiting, unboxed;
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

int kdtree_streams(const Ray* rays, Intervals& list, int* order, const float* low)
{
    sort_by_octant(rays, 3, order, order);
    return enter_box(rays, order, 1, 2, low, low, list);
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
        + (unsigned)min_key<WIDTH>(keys);
}

void records(const float* const* from, float* columns, float* to)
{
    read_records(from, 0, columns);
    write_records(columns, to, 24, 0xffffu);
}

unsigned watertight(const float* of, const WoopRay& ray, float* t, float (*words)[WIDTH], const float (*corner)[WIDTH])
{
    Woop::prepare<WIDTH>(words, of, of, of, of, of, of);
    Woop::test<WIDTH>(words, corner, t, t, t);
    return woop_block<WIDTH, Inclusive, true>(of, 1, ray, t, t, t) + woop_block<WIDTH, Crossing, true>(of, 1, ray, t, t, t)
        + woop_block<WIDTH, Crossing, false>(of, 1, ray, t, t, t) + woop_lines<WIDTH>(of, 1, ray);
}

unsigned steps(const float* of, int* inside)
{
    const auto first = [&](int i) { return of[i] > 0.0f; };
    const auto second = [&](int i) { return of[i] < 1.0f; };
    return block_steps<WIDTH>(~0u, first, second) + block_steps<WIDTH>(~0u, first) + packet_steps<WIDTH>(inside, first, second)
        + packet_steps<WIDTH>(inside, first);
}

bool watertight_packets(const WoopRays& rays, const float* corner, int* inside, WoopRay& ray)
{
    woop_ray<true>(rays, 1, ray);
    woop_ray<false>(rays, 1, ray);
    WoopPacket<WIDTH, true> one(rays);
    WoopPacket<WIDTH, false> other(rays);
    one.begin(corner, 1), other.begin(corner, 2);
    return one.meet(0, inside) && other.meet(0, inside) && one.hit(1, 1).t < other.hit(1, 1).t
        && along_main_axis(true, false, corner[0], corner[1], corner[2]) > 0.0f;
}

bool watertight_pairs(const WoopRays& rays, const float (*corners)[WIDTH], Ints<WIDTH> which, Ints<WIDTH>& inside)
{
    WoopPairs<WIDTH, true> one(rays);
    WoopPairs<WIDTH, false> other(rays);
    one.begin(1), other.begin(2);
    TriangleHit<Floats<WIDTH>> hit;
    inside = one.may_meet(corners[0], 0) & other.may_meet(corners[0], 0);
    const Floats<WIDTH> row = load<Floats<WIDTH>>(corners[0]);
    replace<WIDTH>(&inside, which, sum_of_product(row, row, row));
    return one.test(corners, which, inside, 0, inside, hit) && other.test(corners, which, inside, 0, inside, hit);
}

unsigned stream_load(const Batch& batch, const Vec3& low, Ray* stream, float* own)
{
    return load_rays<Woop, 16>(batch, 1, 2, low, low, stream, 3, own)
        + load_rays<OneByOne, 16>(batch, 1, 2, low, low, stream, 3, own);
}

template <Order ORDER, bool BOXES>
unsigned root(const Batch& batch, const Vec3& low, Ray* stream, int* list, float* lanes, RootLoad& state)
{
    using Test = RootTest<WIDTH, ORDER, 16>;
    state.used = Test::begin(list, -1, lanes);
    RootGrid<WIDTH, 16>(lanes).begin(lanes, state.used, low, low, batch.center);
    return load_root<Woop, WIDTH, ORDER, BOXES, 16>(batch, 1, 2, low, low, stream, lanes, list, lanes, lanes, state)
        + Test::end(list, lanes, list);
}

unsigned roots(const Batch& batch, const Vec3& low, Ray* stream, int* list, float* lanes, RootLoad& state)
{
    return root<Order::NONE, true>(batch, low, stream, list, lanes, state)
        + root<Order::NEAR, false>(batch, low, stream, list, lanes, state)
        + root<Order::FAR, true>(batch, low, stream, list, lanes, state);
}

void candidates(const float* of, const int* primitives, Ray* rays, PairLists& pairs, int* owner)
{
    test_candidates<Woop, WIDTH, 9, true, 16>(of, primitives, rays, pairs, 3);
    test_candidates<Woop, WIDTH, 9, false, 16>(of, primitives, rays, pairs, 3);
    test_leaf<Woop, WIDTH, 9, false, 16>(of, primitives, rays, owner, 3, -9);
}

unsigned leaves(const float* of, const int* ids, const Slabs& slabs, float* t, int* mailbox)
{
    return clamp_block<WIDTH, 9, true>(of, 1, slabs, 7u, t, 0.0f, 1.0f)
        + clamp_block<WIDTH, 9, false>(of, 1, slabs, 7u, t, 0.0f, 1.0f) + plain_mailbox<WIDTH, 256>(ids, 7u, mailbox)
        + hashed_mailbox<WIDTH, 64>(ids, 7u, mailbox) + inverse_mailbox<WIDTH, 8>(ids, 7u, mailbox);
}

struct Walks {
    List<WIDTH> node, top, word0, word1, nodes;
    struct {
        float c[WIDTH];
    } inverse_x, inverse_y, inverse_z, in_x, in_y, in_z, out_x, out_y, out_z, entry, leave, best;
};

unsigned lockstep(Walks& walks, const Slabs& slabs, const float* interval, int* log, int& row)
{
    start_walk(walks, 1, slabs, interval, 1.0f);
    return advance_walks<WIDTH, 128, true>(interval, walks, log, row, 3) + skip_leaf_blocks<WIDTH, 8>(walks, 1)
        + pop_walks<WIDTH>(walks, log, 3u) + (unsigned)compact_log<WIDTH, 64>(walks, log);
}

struct Node {
    int first, second;
    Node(int a, int b)
        : first(a)
        , second(b)
    {
    }
};

int compact(const Node* nodes, int& index) { return load_compact<3, 63>(nodes, index).first; }

struct Nearest {
    double t;
    int triangle;
};

void nearest(const double* corners, Nearest& found) { nearest_of<8>(corners, 64, 0, 8, corners, corners, 1, found); }

void corners_of(const float* vertices, const int* faces, float* to, Best& best)
{
    copy_corners(vertices, faces, 3, WIDTH, 0.0f, to);
    record_if_better(vertices, 1, 0.0f, best);
}

void bare_frusta(const float* of, const WoopRays& rays)
{
    BareFrustum<2 * WIDTH> frustum;
    frustum.start(of, of, [&](int, const LoadedRay&) { });
    frustum.trace<WIDTH, 3, 9>(of, 5, [&](const float* corner, int pass, const auto& each) {
        WoopPacket<WIDTH, true> woop(rays);
        woop.begin(corner, pass);
        each([&](int f, const auto& accept) {
            int inside[WIDTH];
            if (woop.meet(f, inside)) accept(inside, [&](int i, int k) { return woop.hit(i, k); });
        });
    });
}

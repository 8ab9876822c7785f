// Instantiates what the headers of packets and frusta in kernels/native declare. WIDTH: lanes.
#include "frustum.h"
#include "instances.h"
#include "multi_frusta.h"
#include "packet_cells.h"
#include "packet_frusta.h"
#include "packet_leaves.h"
#include "packet_load.h"
#include "packet_parts.h"
#include "packet_rows.h"
#include "packet_store.h"
#include "woop_packets.h"

template <class T, int N> struct Vec {
    T c[N];
};
using Vec2 = Vec<float, 2>;
using Vec3 = Vec<float, 3>;
template <class T> struct Array {
    T* data;
    int shape[4];
};
struct Batch {
    int count;
    Array<Vec3> origins, directions;
    Array<float> t_min, t_max;
    int origin_stride, direction_stride, t_min_stride, t_max_stride, columns;
    Array<unsigned> mask;
    int mask_stride;
    Vec<double, 3> center;
};
struct Hits {
    Array<float> t;
    Array<int> primitive;
    Array<Vec2> uv;
    Array<bool> occluded;
};
struct Bounds {
    int active, mixed_axes, finished, passes, main_axes, frame;
    float t_min, t_max, slack, plane, forward, near_plane, depth, margin;
    Vec<int, 3> backward;
    Vec3 inverse_large, inverse_small, forward_small, backward_small, origin_in, origin_out, origin_low, origin_high;
    Vec3 end_low, end_high;
    Vec2 slope_low, slope_high, through_low, through_high, side_low, side_high, rise_low, rise_high;
    Vec<int, 2> few;
};
struct Slabs {
    Vec3 inverse, origin_in, origin_out;
};
struct Hit {
    float t, u, v;
    int primitive;
};
struct Tree {
    Array<float> bounds;
    Array<int> child;
    Vec3 low, high;
};
struct Triangles {
    Array<float> records;
    Array<int> primitive;
};
struct Light {
    int samples, groups, patterns;
    Array<float> positions, bounds;
};
struct Matrix {
    double data[3][3];
};
struct Place {
    Matrix to_object;
    Vec<double, 3> origin;
    unsigned mask;
};
struct Memory {
    Array<int> number;
    Array<float> bound, scene, packet;
    Array<double> origin;
};

using namespace wrt;

constexpr int P = 2 * WIDTH;
constexpr auto nothing = [](int, const LoadedRay&) { };

template <bool SHARED>
void loads(float* memory, const Batch& rays, const Hits& hits, const Vec3& low, const Vec3& high, Bounds& bounds)
{
    const Packet<P, WIDTH, SHARED> packet(memory);
    load_packet<Bounding<3, true>>(packet, rays, 0, low, high, bounds, nothing);
    load_packet<Bounding<3, false, true, !SHARED>>(packet, rays, 0, low, high, bounds, nothing);
    finish_packet<3>(packet, low, high, bounds, nothing);
    reverse_bounds(low, high, bounds);
    bound_rays<64>(rays, 0, 9, low, high, bounds);
    join_packets<P, WIDTH, SHARED, !SHARED>(rays, 0, 9, low, high, bounds);
    covered_packets<P, WIDTH, SHARED, 9>(rays, 0, 9, memory, 1, 2);
    store_packet<false, true>(packet, rays, 0, hits, false);
    store_packet<true, false>(packet, rays, 0, hits, true);
    store_row<P, WIDTH, false, true, false>(rays, 0, 9, hits);
    store_row<P, WIDTH, true, false, true>(rays, 0, 9, hits);
    fetch_row<P, WIDTH>(rays, 0, 9, hits);
    fetch_hits<P>(rays, 0, hits);
    clear_packet(packet);
    finish_stores();
}

template <bool SHARED>
unsigned cullings(float* memory, const float* box, const Vec3& low, const Vec3& high, Bounds& bounds, int* key)
{
    const Packet<P, WIDTH, SHARED> packet(memory);
    set_slope_frustum(bounds);
    set_two_plane_frustum(low, high, packet, bounds);
    set_transient_frustum(box, packet, bounds);
    frustum_keys<WIDTH>(box, bounds, key);
    every_ray_keys(box, packet, bounds, key);
    list_meeting(box, packet, bounds);
    enters_behind_exit(box, packet, bounds);
    return frustum_mask<WIDTH>(box, bounds) | side_mask<WIDTH>(box, bounds) | used_mask<WIDTH>(box)
        | vertex_mask<WIDTH>(box, bounds) | corner_mask<WIDTH, SHARED>(box, bounds) | front_mask<WIDTH>(box, bounds);
}

template <bool SHARED>
void parts(float* memory, float* inner, const float* box, const Vec3& low, const Vec3& high, Bounds& bounds, int* numbers)
{
    const Packet<P, WIDTH, SHARED> packet(memory);
    const Packet<WIDTH, WIDTH, SHARED> smaller(inner);
    Slabs slabs;
    Hit hit = {};
    enter_cell(packet, bounds, low, high, inner);
    split_cell(packet, bounds, 1, 0.5f, inner);
    cross_plane(bounds, 1, 0.5f, 0.0f, 1.0f);
    extract_ray(packet, shared_origin(bounds), 1, slabs, hit);
    store_hit<true>(packet, 1, hit);
    shorten<true>(packet, bounds);
    shorten<false>(packet, bounds);
    gather_rays<!SHARED, 12>(box, packet, bounds, smaller, numbers);
    bound_entries<Bounding<3, false>, !SHARED>(box, packet, bounds, bounds);
    scatter_rays(packet, smaller, numbers, 3);
    if constexpr (!SHARED) {
        activate_part<Bounding<3, true, false, true>>(packet, bounds, 1);
        finish_part(packet, bounds, 1, 2, false);
        count_single_rays(packet);
        is_wide(memory[0], bounds, low, high, true);
    }
}

template <bool SHARED, bool ANY_HIT, bool FRONTS>
void leaves(float* memory, Bounds& bounds, const float* block, const int* ids, unsigned mask)
{
    const Packet<P, WIDTH, SHARED> packet(memory);
    const SharedOrigin shared = shared_origin(bounds);
    const WoopRays rays = {{packet.origin_x, packet.origin_y, packet.origin_z}, shared.origin, packet.slope_x, packet.slope_y,
        packet.state, packet.main_axis};
    const auto test = [&](const float* corner, int pass, const auto& each) {
        WoopPacket<WIDTH, SHARED> woop(rays);
        woop.begin(corner, pass);
        each([&](int f, const auto& accept) {
            int inside[WIDTH];
            if (woop.meet(f, inside)) accept(inside, [&](int i, int k) { return woop.hit(i, k); });
        });
    };
    test_triangles<3, ANY_HIT, FRONTS>(packet, bounds, block, ids, mask, test);
    test_pairs<ANY_HIT, FRONTS, 2>(packet, bounds, block, ids, mask, WoopPairs<WIDTH, SHARED>(rays));
    count_active(packet, bounds, block, mask);
}

void shadows(const Tree& tree, const Triangles& triangles, const Batch& rays, const Light& light, unsigned char* dark, int* n)
{
    MultiFrusta<16, 16, WIDTH, 12, 9, 20, true> all;
    const auto make = [&](int f) { all.make_rays(f, rays, light, nothing); };
    const auto test = [&](int f, int, unsigned) { all.frusta[f].t_max = -1.0f; };
    all.trace(tree, triangles.records.data, rays, light, 0, 3, make, test);
    all.store<true>(light, 3, dark, n);
    all.store<false>(light, 3, dark, n);
    fetch_kept<WIDTH, 9>(tree, triangles, 1, n);
}

int frusta(float* memory, const Batch& rays, const float* box, const Vec3& low, const Vec3& high, Bounds& bounds, int* slots)
{
    const FrustumRows<16> rows(memory);
    gather_directions<P, WIDTH>(rays, 0, rows, 1);
    bound_block(rays, low, high, rows, 3);
    frustum_bounds(rows, 1, bounds);
    return push_children<WIDTH>(box, 1, rows, slots, 2) + (int)frusta_waiting(rows, 1);
}

template <bool SHARED>
float instances(const Memory& memory, const Batch& rays, const Place& place, const Vec3& low, const Vec3& high,
    const Hits& hits, Bounds& bounds)
{
    const SceneRays<P, WIDTH, SHARED> scene(memory);
    load_instance<Bounding<3, false>>(scene, rays, place, low, high, bounds, nothing);
    keep_ranges(scene);
    store_rays<true>(scene, rays, 0, hits);
    store_rays<false>(scene, rays, 0, hits);
    bound_points<8>(memory.origin.data, 8, 0, 8, place.to_object, place.origin, memory.origin.data, 1, 0);
    return keep_rays(scene, rays, 0) + merge_hits<true>(scene, 1) + merge_hits<false>(scene, 1);
}

template void loads<true>(float*, const Batch&, const Hits&, const Vec3&, const Vec3&, Bounds&);
template void loads<false>(float*, const Batch&, const Hits&, const Vec3&, const Vec3&, Bounds&);
template unsigned cullings<true>(float*, const float*, const Vec3&, const Vec3&, Bounds&, int*);
template unsigned cullings<false>(float*, const float*, const Vec3&, const Vec3&, Bounds&, int*);
template void parts<true>(float*, float*, const float*, const Vec3&, const Vec3&, Bounds&, int*);
template void parts<false>(float*, float*, const float*, const Vec3&, const Vec3&, Bounds&, int*);
template void leaves<true, true, false>(float*, Bounds&, const float*, const int*, unsigned);
template void leaves<false, false, true>(float*, Bounds&, const float*, const int*, unsigned);
template float instances<true>(const Memory&, const Batch&, const Place&, const Vec3&, const Vec3&, const Hits&, Bounds&);
template float instances<false>(const Memory&, const Batch&, const Place&, const Vec3&, const Vec3&, const Hits&, Bounds&);

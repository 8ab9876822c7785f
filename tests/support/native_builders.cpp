// Instantiates the headers of builders/; see native_headers.cpp.
#include "bins.h"
#include "clip.h"
#include "clusters.h"
#include "corner_bounds.h"
#include "event_moves.h"
#include "events.h"
#include "instance_updates.h"
#include "light_raster.h"
#include "merging.h"
#include "reinsertion.h"
#include "top_levels.h"

struct Vec2i {
    int c[2];
    CUDA_CALLABLE Vec2i(int a, int b)
        : c {a, b}
    {
    }
};
struct Vec3i {
    int c[3] = {};
};
struct Vec3 {
    float c[3];
};
struct Vec4 {
    float c[4];
};
struct Vec3d {
    double c[3];
};
struct Map {
    double data[3][3];
};
template <class T> struct Rows {
    T* data;
    int shape[2];
};
struct Boxes {
    Rows<float> low, high;
};
struct Mesh {
    Rows<Vec3> vertices;
    Rows<Vec3i> faces;
    float pad;
    bool shrinks;
};
struct Leaves {
    Rows<int> primitive, begin, count, kept;
    Rows<unsigned char> keeps;
    Rows<Vec3> low, high, inner_low, inner_high;
};
struct MergedTree {
    Rows<float> box;
    Rows<int> parent, size, code, cluster, waiting, root;
};
struct Moves {
    Rows<Vec2i> place;
    Rows<unsigned long long> key, owner;
    Rows<int> arrived;
};
struct Cost {
    float block, empty_factor;
    int unit_bits;
};
struct AxisFrame {
    float low, high, face, perimeter, inverse_area, base;
};
struct Binning {
    Vec4 low, scale;
    int bins, axes;
};
struct KdBinning {
    Vec3 low, high, scale;
    int bins;
};
struct Plane {
    float cost;
    int axis, bin, left, right, event;
};
struct Split {
    int axis;
    float position;
    bool planar_left;
};
struct Sides {
    int left, right;
    Vec3 left_low, left_high, right_low, right_high;
};
struct Slabs {
    int axis, count;
    float low, scale;
};
struct Frame {
    Vec3i first;
    int triangles;
    Vec3 low, high, inner_low, inner_high;
};
struct Pair {
    Vec3 low, high, planar_end;
    int begin, end, to;
};
struct Grid {
    Vec3 low, scale;
    Vec3i cells;
};

struct Words {
    int c[4];
};
struct CellNode {
    struct {
        int axis, left;
        float position;
        bool planar_left;
    } split;
    bool is_leaf;
    int left_before, right_before, child;
};

using namespace wrt;

void binned(const Cost& cost, const Binning& binning, float* boxes, int* counts, Plane& plane, const Vec2i* ranges)
{
    centroid_domain(boxes, 3, boxes);
    range_box(boxes, 3, boxes);
    bin_range<128>(boxes, 3, binning, boxes, counts);
    merge_bins<128>(boxes, counts, 0, 1, 2, 96);
    find_best_plane<32>(cost, boxes, counts, 32, 3, 7, plane);
    write_child_boxes(boxes, 32, 5, boxes);
    partition_range(boxes, 3, binning, 1, 5, boxes, boxes, boxes, boxes);
    sweep_axis(boxes, counts, counts, 32, 0.5f, boxes, boxes);
    combine<16>(boxes, WIDTH, boxes, 0.5f, nullptr, 0.5f, 1.0f, 2.0f, true);
    find_block<WIDTH>(boxes, 0, 3, boxes, counts, ranges, 20, boxes, counts);
}

float references(const Boxes& boxes, const Vec3& low, const Vec3& high, float* to, int* ids)
{
    write_references(boxes, 0, 3, to);
    write_sizes(to, 0, 3);
    write_ids(to, 3, ids);
    write_box(to, ids, boxes, 2);
    write_clipped(boxes, 2, low, high, to);
    join_boxes(to, to, to);
    return sides_of(to).is_flat(0.01f) ? sides_of(to).half_area() : sides_of_both(to, to + 8).half_area();
}

Vec3i scanned(float* list, int* counts, const KdBinning& binning, Sides& sides)
{
    measure_sides(list, 3, 1, 0.5f, true, sides);
    move_range(list, 3, 1, 0.5f, true, list, list, sides);
    count_ends(list, 3, 1, binning, counts);
    sum_counters(counts, 192, 0, 1, 2, 192);
    gather_axis(list, 3, 1, list, list, 16);
    count_samples<8>(list, 3, 1, list, counts);
    return count_sides<16, Vec3i>(list, list, 16, 0.5f);
}

Vec2i clipped(const Mesh& mesh, const Boxes& boxes, Vec3& low, Vec3& high, const Slabs& slabs, float* list, int* counts,
    const Leaves& leaves, Sides& sides)
{
    const ClipCell cell = cell_of(low, high, 0.1f);
    clip_sides(mesh, cell, cell, list, 3, Split {1, 0.5f, true}, {true, list, list, {}}, sides);
    counts[0] = clip_range(mesh, cell, list, 3, 1, true, low, high) + clip_straddlers(mesh, cell, list, 3, counts, list)
        + clip_part(mesh, cell, boxes, 1, 2, 3);
    measure_leaf(mesh, boxes, leaves, 1, true);
    bin_parts(mesh, list, 3, slabs, list, counts, counts);
    return divide_parts<Vec2i>(mesh, list, 3, slabs, 2, list, list);
}

int swept(const Cost& cost, const AxisFrame& frame, Vec2i* events, Vec3i* counts, float* list, int* numbers, Plane& found)
{
    note_event(events[0], 1, list);
    sort_pairs(events, 3);
    count_digits(list, 3, 8, numbers, 4);
    move_digits(list, numbers, 3, 8, numbers, 4, list, numbers);
    const auto digit = [&](int i) { return numbers[i] & 2047; };
    count_digits<2048>(digit, 3, numbers, 4);
    move_digits<2048>(digit, [&](int i, size_t to) { numbers[to] = i; }, 3, numbers, 4);
    find_best_plane(cost, frame, events, 3, 1, 2, found);
    count_events(numbers, 0, 3, numbers, numbers, counts, 2);
    return write_events(list, 3, 1, events) + write_new_events(list, 3, 1, events);
}

int clustered(const Boxes& boxes, int* ids, float* list, const Pair& pair, const Grid& grid, Frame& frame)
{
    gather_references(boxes, ids, list, frame);
    count_cells(boxes, ids, 0, 3, grid, ids, ids, list, 8);
    box_of_range(boxes, ids, 0, 3, list);
    return choose_triangles(boxes, ids, pair, true, ids);
}

void merged(const MergedTree& tree, const Moves& moves, const Mesh& mesh, int* found)
{
    merge_from(tree, 0, 3, true);
    rebuild_top(tree, moves, 3);
    find_move(tree, moves, 0, 3);
    choose_move(tree, moves, 0, 3);
    move_node(tree, moves, 0, 3);
    refit_from(tree, moves, 0, 3);
    reduce_corners(mesh.vertices.data, mesh.faces.data, 3, 1, 0, found);
}

void moved(const Map& map, const Vec3d& origin, double* numbers, long long* found, float* bounds)
{
    bound_by_team(numbers, 8, 0, 8, map, origin, numbers, 4, 0, 0, 1);
    keep_min(found, ordered_bits(step_below(numbers[0])));
    add_all(numbers, of_ordered(found[0]) + power_above(numbers[1]));
    refit_lane(bounds, 0, 1, 1, 2);
    meet_block();
}

void lit(const Vec3d& a, const Vec3d& b, const Vec3d& c, int* words, unsigned long long* entries)
{
    rasterise<RasterStage::COVER, false, true, false>(a, b, c, 1, 64, 1e-6, words, entries);
    rasterise<RasterStage::COUNT, true, false, true>(a, b, c, 1, 64, 1e-6, words, entries);
    rasterise<RasterStage::FILL, false, false, false>(a, b, c, 1, 64, 1e-6, words, entries);
    sort_entries(entries, 20);
}

void levelled(const float* boxes, Words* events, const CellNode* nodes, int* numbers, long long* keys)
{
    Tile tile = {};
    keep_least(keys, 1, add_to(keys, 2));
    numbers[0] = sums_before(&tile, 1, {{1, 2, 3, 4}}).of[3];
    move_events(1, 8, boxes, boxes, 3, events, nodes, numbers, &tile, 2, events, 8, numbers);
}

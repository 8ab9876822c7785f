// Instantiates the header of kernels/points; see native_headers.cpp.
#include "exact_points.h"
#include "packed_points.h"
#include "point_cells.h"
#include "point_packets.h"

struct Vec2 {
    float c[2];
};
struct Vec2i {
    int c[2];
};
struct Vec2d {
    double c[2];
};
struct Vec3i {
    int c[3];
};
struct Vec3 {
    float c[3];
};
struct Vec3d {
    double c[3];
};
template <class T> struct Array {
    T* data;
    int shape[1];
};
struct WideTree {
    Array<float> bounds;
    Array<int> child;
    Vec3 low, high;
};
struct KdTree {
    Array<Vec2i> nodes;
    int root;
    Vec3 low, high;
};
struct Triangles {
    Array<float> records;
    Array<int> primitive;
};
struct Points {
    int count;
    Array<Vec3> position;
    Array<Vec3d> exact;
    Array<int> order;
    Array<float> max_distance;
    int distance_stride;
    Array<unsigned> mask;
    int mask_stride;
    Array<int> environment;
    int environment_stride;
};
struct Found {
    Array<float> distance;
    Array<int> primitive;
    Array<Vec2> uv;
    Array<signed char> feature;
};
struct Lists {
    Found found;
    int room;
    Array<int> begin, count;
};
struct Matrix {
    double data[3][3];
};
struct Placement {
    Matrix to_scene;
    Vec3d origin;
    Matrix to_object;
    int geometry, first;
    unsigned mask;
};
struct Top {
    WideTree tree;
    Array<int> order;
    Array<Placement> placements;
    float slack_scale;
    Array<float> extent;
    int root, shared_root;
    Array<int> environments, roots;
};
struct BinaryTree {
    Array<float> nodes;
    Vec3 low, high;
};
struct Corners {
    Array<float> corners;
};
template <class Tree, class Leaves = Triangles> struct Part {
    Tree tree;
    Leaves triangles;
};
struct Mesh {
    Array<Vec3d> vertices;
    Array<Vec3i> faces;
};
struct Geometry {
    Mesh mesh;
    Vec3d center;
};
struct Exact {
    Array<Vec3d> point;
    Array<double> max_distance, t;
    Array<Vec2d> uv;
    int room;
};
struct Work {
    int nodes, leaves, triangles;
};
struct Rows {
    Array<Work> rows;
};

using Boxes = wrt::BoxTree<WIDTH, 9>;
using Cells = wrt::CellTree<WIDTH, 9>;
constexpr int UPPER = WIDTH > 2 ? WIDTH : 2;

template <class Space> void search(const Space& space, const Points& points, const Lists& lists, const Rows& work)
{
    wrt::nearest_of_group<wrt::NearestTriangle, 32>(space, points, lists.found, work, 0);
    wrt::nearest_of_group<wrt::CountedNearest, 32>(space, points, lists.found, work, 32);
    wrt::nearest_lists_of_group<32>(space, points, lists.found, lists.room, 0);
    wrt::count_within_group<32>(space, points, lists, 0);
    wrt::list_within_group<32>(space, points, lists, 0);
}

void search_trees(const WideTree& boxes, const KdTree& cells, const Triangles& triangles, const Points& points,
    const Lists& lists, const Rows& work)
{
    search(wrt::point_tree<Boxes>(boxes, triangles), points, lists, work);
    search(wrt::point_tree<Cells>(cells, triangles), points, lists, work);
}

void search_instances(const Top& top, const Array<Part<WideTree>>& boxes, const Array<Part<KdTree>>& cells,
    const Points& points, const Lists& lists, const Rows& work)
{
    search(wrt::point_instances<Boxes, UPPER>(top, boxes), points, lists, work);
    search(wrt::point_instances<Cells, UPPER>(top, cells), points, lists, work);
}

void search_exactly(const WideTree& boxes, const Top& top, const Array<Part<KdTree>>& cells, const Triangles& triangles,
    const Mesh& mesh, const Array<Geometry>& geometries, const Points& points, const Exact& exact, const Found& found)
{
    const auto tree = wrt::point_tree<Boxes>(boxes, triangles);
    wrt::exact_nearest_of_group<32>(tree, points, mesh, exact, found, 0);
    const auto trees = wrt::point_instances<Cells, UPPER>(top, cells);
    wrt::exact_nearest_of_group<32>(trees, points, geometries, exact, found, 0);
    wrt::exact_lists_of_group<32>(tree, points, mesh, exact, found, 0);
    wrt::exact_lists_of_group<32>(trees, points, geometries, exact, found, 0);
}

void search_packed(const BinaryTree& nodes, const Corners& corners, const Top& top,
    const Array<Part<BinaryTree, Corners>>& parts, const Points& points, const Lists& lists, const Rows& work, int* next)
{
    search(wrt::point_tree<wrt::PackedTree>(nodes, corners), points, lists, work);
    search(wrt::point_instances<wrt::PackedTree, 2>(top, parts), points, lists, work);
    wrt::search_points<16, 4, 3>(wrt::point_walks<24>(nodes, corners, points, lists.found), next, 64, 0);
}

void find_cells(const Points& points, const Vec3& low, const Vec3& scale, int* cells)
{
    wrt::find_cells(points.position.data, points.count, low, scale, cells);
}

// Instantiates the headers of kernels/traversal/persistent; see native_headers.cpp.
#include "persistent.h"
#include "warp_packets.h"

struct Vec3 {
    float c[3];
};
struct Vec4 {
    float c[4];
};
struct Vec2 {
    float c[2];
};
template <class T> struct Array {
    T* data;
    int shape[1];
};
struct Vec3d {
    double c[3];
};
struct Tree {
    Array<Vec4> nodes;
    Vec3 low, high;
};
struct Triangles {
    Array<Vec4> corners;
};
struct Batch {
    int count;
    Array<Vec3> origins, directions;
    Array<float> t_min, t_max;
    int origin_stride, direction_stride, t_min_stride, t_max_stride;
    Array<unsigned> mask;
    Array<int> environment;
    int mask_stride, environment_stride;
    Vec3d center;
};
struct Ray {
    Vec3 origin, direction;
    float t_min, t_max;
};
struct Place {
    struct {
        double data[3][3];
    } to_object;
    Vec3d origin;
    int geometry, first;
    unsigned mask;
};
struct Wide {
    Array<float> bounds;
    Array<int> child;
    Vec3 low, high;
};
struct Top {
    Wide tree;
    Array<int> order, environments, roots, lists;
    Array<Place> placements;
    float slack_scale;
    Array<float> extent;
    int root, shared_root;
};
struct Part {
    Tree tree;
    Triangles triangles;
};
struct Found {
    Array<float> t;
    Array<int> primitive;
    Array<Vec2> uv;
    Array<bool> occluded;
    Array<int> counts, begins;
    int room;
};
struct Best {
    float t, u, v;
    int primitive;
};
struct Previous {
    float t;
    int primitive;
};
struct Face {
    int c[3];
};
struct Mesh {
    Array<Vec3d> vertices;
    Array<Face> faces;
};
struct Geometry {
    Mesh mesh;
    Vec3d center;
};
struct Exact {
    Array<Vec3d> origins, directions;
    Array<double> t_min, t_max;
    int origin_stride, direction_stride, t_min_stride, t_max_stride;
};
struct Vec2d {
    double c[2];
};
struct ExactFound {
    Found rounded;
    Array<double> t;
    Array<Vec2d> uv;
};
struct Row {
    int nodes, leaves, triangles;
};
struct Rows {
    Array<Row> rows;
};

void trace(const Tree& tree, const Triangles& triangles, const Batch& rays, const Found& found, const Rows& rows,
    const Array<int>& skipped, int* next)
{
    const auto space = wrt::one_tree(tree, triangles);
    const auto closest = wrt::walks_of<25, wrt::ClosestAnswer, false, true, true>(space, rays, found, rows, skipped);
    const auto any = wrt::walks_of<25, wrt::AnyAnswer, true, false, false>(space, rays, found, rows, skipped);
    const auto winding = wrt::walks_of<25, wrt::WindingAnswer, false, false, false>(space, rays, found, rows, skipped);
    wrt::walk_rays<20, 4, 3, true>(closest, next, 64, WIDTH);
    wrt::walk_rays<20, 4, 3, false>(any, next, 64, WIDTH);
    wrt::walk_rays<20, 4, 3, true>(winding, next, 64, WIDTH);
    wrt::walk_together<wrt::PACKET, true>(closest, WIDTH);
    wrt::walk_together<wrt::STREAMED, false>(any, WIDTH);
    wrt::walk_together<wrt::FRUSTUM, true>(any, WIDTH);
}

void trace_instances(const Top& top, const Array<Part>& parts, const Batch& rays, const Found& found, const Rows& rows,
    const Array<int>& skipped, int* next)
{
    const auto space = wrt::instance_trees(top, parts);
    const auto closest = wrt::walks_of<34, wrt::ClosestAnswer, false, true, true>(space, rays, found, rows, skipped);
    const auto list = wrt::walks_of<34, wrt::ListAnswer, false, false, false>(space, rays, found, rows, skipped);
    wrt::walk_rays<20, 4, 3, true>(closest, next, 64, WIDTH);
    wrt::walk_rays<20, 4, 3, false>(list, next, 64, WIDTH);
}

void trace_one(const Tree& tree, const Triangles& triangles, const Top& top, const Array<Part>& parts, const Ray& ray,
    const Vec3d& origin, const Previous& previous, Best& best)
{
    wrt::walk_one<25, wrt::NextAnswer>(wrt::one_tree(tree, triangles), ray, previous, origin, ~0u, -1, best);
    wrt::walk_one<34, wrt::CountAnswer>(wrt::instance_trees(top, parts), ray, previous, origin, 1u, 2, best);
}

void trace_exactly(
    const Part& part, const Geometry& geometry, const Batch& seen, const Exact& rays, const ExactFound& found, int* next)
{
    const auto own = wrt::wide_rays(rays, seen, geometry.center);
    const auto space = wrt::wide_tree(part.tree, part.triangles, geometry.mesh);
    wrt::walk_rays<20, 4, 3, false>(
        wrt::walks_of<25, wrt::WideAnswer, false, false, false>(space, own, found, found, found), next, 64, WIDTH);
}

void trace_exactly_there(const Top& top, const Array<Part>& parts, const Array<Geometry>& geometries, const Batch& seen,
    const Exact& rays, const ExactFound& found, int* next)
{
    const auto own = wrt::wide_rays(rays, seen, seen.center);
    const auto space = wrt::wide_instances(top, parts, geometries);
    wrt::walk_rays<20, 4, 3, false>(
        wrt::walks_of<34, wrt::WideAnswer, false, false, false>(space, own, found, found, found), next, 64, WIDTH);
}

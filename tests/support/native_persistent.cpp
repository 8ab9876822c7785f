// Instantiates the headers of kernels/traversal/persistent; see native_headers.cpp.
#include "persistent.h"

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
    struct {
        double c[3];
    } center;
};
struct Found {
    Array<float> t;
    Array<int> primitive;
    Array<Vec2> uv;
    Array<bool> occluded;
};
struct Row {
    int nodes, leaves, triangles;
};
struct Rows {
    Array<Row> rows;
};

void trace(const Tree& tree, const Triangles& triangles, const Batch& rays, const Found& found, const Rows& rows, int* next)
{
    wrt::walk_rays<20, 4, 3, true>(wrt::walks_of<24, false, false, true>(tree, triangles, rays, found, rows), next, 64, WIDTH);
    wrt::walk_rays<20, 4, 3, false>(wrt::walks_of<24, true, true, false>(tree, triangles, rays, found, rows), next, 64, WIDTH);
}

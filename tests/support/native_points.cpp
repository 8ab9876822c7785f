// Instantiates the header of kernels/points; see native_headers.cpp.
#include "points.h"

struct Vec2 {
    float c[2];
};
struct Vec2i {
    int c[2];
};
struct Vec3 {
    float c[3];
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
    Array<int> order;
    Array<float> most;
    int most_stride;
};
struct Found {
    Array<float> distance;
    Array<int> primitive;
    Array<Vec2> uv;
    Array<signed char> feature;
};

void nearest(const WideTree& boxes, const KdTree& cells, const Triangles& triangles, const Points& points, const Found& found)
{
    wrt::nearest_of_group<wrt::BoxTree, WIDTH, 32>(boxes, triangles, points, found, 0);
    wrt::nearest_of_group<wrt::CellTree, WIDTH, 32>(cells, triangles, points, found, 32);
}

// Instantiates the header of kernels/fields; see native_headers.cpp.
#include "winding.h"

template <class T> struct Array {
    T* data;
    int shape[1];
};
struct WideTree {
    Array<int> child;
};
struct Triangles {
    Array<float> records;
};
struct Clusters {
    Array<float> moments, far;
    float scale;
};

float winding_of(const WideTree& tree, const Triangles& triangles, const Clusters& clusters, float x, float y, float z)
{
    return wrt::winding::number_at<WIDTH>(tree, triangles, clusters, {x, y, z});
}

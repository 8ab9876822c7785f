// Instantiates the header of kernels/clouds; see native_headers.cpp.
#include "spheres.h"

struct Vec3 {
    float c[3];
};
struct Slabs {
    Vec3 inverse, origin_in, origin_out;
};
struct PointRay {
    Vec3 origin, direction, unit;
};

template <int COMPONENTS> float nearest(const float* records, int block, const PointRay& ray, const Slabs& slabs, float* uv)
{
    const unsigned mask = wrt::points_near<WIDTH, COMPONENTS>(records, block, ray);
    return mask == 0 ? 0.0f : wrt::meet_point<WIDTH, COMPONENTS>(records, block * WIDTH, ray, slabs, 0.0f, uv[0], uv[1]);
}

template float nearest<wrt::SPHERE>(const float*, int, const PointRay&, const Slabs&, float*);
template float nearest<wrt::DISC>(const float*, int, const PointRay&, const Slabs&, float*);
template float nearest<wrt::BOX>(const float*, int, const PointRay&, const Slabs&, float*);

void pack(const float* points, const float* normals, float* record, float* low, float* high)
{
    wrt::copy_point(points, points, true, normals, wrt::DISC, 0, WIDTH, record);
    wrt::point_box(record, wrt::DISC, WIDTH, low, high);
}

void tangent(const float* centre, const float* normal, float* corners)
{
    wrt::tangent_triangle(centre, 1.0, normal, false, 0.5, 0.5, 1.0, corners);
}

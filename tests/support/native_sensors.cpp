// Instantiates the headers of kernels/sensors; see native_headers.cpp.
#include "sensor_rays.h"
#include "table_rows.h"

template <class T> struct Vector {
    T c[3];
    Vector() = default;
    Vector(T x, T y, T z)
        : c {x, y, z}
    {
    }
};
using Vec3 = Vector<float>;
using Vec3d = Vector<double>;
struct Quat {
    double x, y, z, w;
};
inline Vec3d normalize(const Vec3d& v) { return v; }
inline Vec3d cross(const Vec3d& a, const Vec3d& b) { return {a.c[1] * b.c[2], a.c[2] * b.c[0], a.c[0] * b.c[1]}; }
inline float dot(const Vec3& a, const Vec3& b) { return a.c[0] * b.c[0]; }
inline Vec3d quat_rotate(const Quat& q, const Vec3d& v) { return {q.w * v.c[0], q.w * v.c[1], q.w * v.c[2]}; }

struct Column {
    unsigned long long data;
    long long stride;
    int offset, kind, divisor, modulus;
};

void turn(const Vec3* axes, const Quat& by, Vec3* turned) { wrt::turn_axes<Vec3d>(axes, by, 0, 8, turned); }

void images(const float* t, const int* primitive, const Vec3* directions, const Vec3d* origins, float* depth, Vec3d* position)
{
    wrt::write_depths(t, primitive, directions, primitive, 0, 8, 1.0f, 0, 8, depth, depth);
    wrt::write_positions(t, primitive, directions, origins, true, primitive, 0, 0, 8, position);
}

struct Detector {
    float min_range, max_range, reference_range, threshold;
};
struct Noise {
    double range, angle, dropout;
    struct {
        unsigned c[2];
    } key;
};

struct Pose {
    Vec3d position;
    Quat rotation;
};

void returns(const Detector& detector, const Noise& noise, const float* t, const int* primitive, const Vec3* directions,
    float* range, float* intensity, double* distance, const Quat& turn, Vec3d* point)
{
    const int end = wrt::end_of_run(primitive, 0, 8);
    wrt::write_returns(detector, true, t, directions, directions[0], 1.0f, primitive, 0, 0, end, range, intensity);
    wrt::write_distances(detector, t, primitive, primitive, 0, 0, 8, range);
    wrt::write_ranges(noise, 0, 8, range, intensity, distance);
    const Pose pose {point[0], turn};
    wrt::write_points(noise, directions, range, distance, pose, 0, 8, point, point);
}

template <class T> struct Array {
    T* data;
    int shape[1];
};
struct Placement {
    int geometry;
};
struct Mesh {
    Array<int> geometry_first;
    Array<Placement> placements;
};

void ids(const Mesh& mesh, const Array<int>& labels, const int* primitive, const float* range, int* out)
{
    wrt::write_ids(mesh, labels, primitive, range, 0, 8, 0, {out, out, out, nullptr});
}

void table(const Column* columns, const int* order, const int* id, unsigned char* out)
{
    wrt::RowItems rows;
    wrt::rows_of_block(order, 8, id, 0, wrt::count_rows(order, 8, id, 0, 8), rows);
    wrt::write_columns(columns, 2, rows, out, 0, 27);
}

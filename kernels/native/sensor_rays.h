// Rays of sensors, and what a ray alone says of its pixel or its return: loops over blocks of rays that Clang vectorises.
//
// Vectors and quaternions are Warp's, and so are normalize, quat_rotate and dot: a ray has the bits that the kernels of
// wrt.kernels.sensors give one alone.
#pragma once
#include "sensor_noise.h"

namespace wrt {
namespace {

/// The directions begin .. end - 1 of axes, normalised and turned.
template <class Vec3d, class Vec3, class Quat>
inline CUDA_CALLABLE void turn_axes(const Vec3* __restrict axes, const Quat& turn, int begin, int end, Vec3* __restrict turned)
{
    const int n = end - begin;
    WRT_FOR (n, i) {
        const Vec3 axis = axes[begin + i];
        const Vec3d v = quat_rotate(turn, normalize(Vec3d(axis.c[0], axis.c[1], axis.c[2])));
        turned[begin + i] = Vec3(float(v.c[0]), float(v.c[1]), float(v.c[2]));
    }
}

/// Distance and depth of the rays begin .. end - 1; null for an image that is not asked for. `order` is null if ray i is that
/// of pixel place + i; `own` is the number of pixels of a camera.
template <class Vec3>
inline CUDA_CALLABLE void write_depths(const float* __restrict t, const int* __restrict primitive, const Vec3* __restrict axes,
    const int* __restrict order, int place, int own, float miss, int begin, int end, float* __restrict distance,
    float* __restrict depth)
{
    const int n = end - begin, pixel = place + begin;
    if (order == nullptr && pixel + n <= own) {
        if (distance)
            WRT_FOR (n, i) distance[pixel + i] = primitive[begin + i] >= 0 ? t[begin + i] : miss;
        if (depth)
            WRT_FOR (n, i) {
                const float seen = t[begin + i] * axes[pixel + i].c[2];
                depth[pixel + i] = primitive[begin + i] >= 0 ? seen : miss;
            }
        return;
    }
    for (int i = begin; i < end; ++i) {
        const int at = order ? order[place + i] : place + i;
        const bool hit = primitive[i] >= 0;
        if (distance) distance[at] = hit ? t[i] : miss;
        if (depth) depth[at] = hit ? t[i] * axes[at % own].c[2] : miss;
    }
}

/// The points of the rays begin .. end - 1; NaN for a miss. `shared` says whether all rays have the first origin.
template <class Vec3, class Vec3d>
inline CUDA_CALLABLE void write_positions(const float* __restrict t, const int* __restrict primitive,
    const Vec3* __restrict directions, const Vec3d* __restrict origins, bool shared, const int* __restrict order, int place,
    int begin, int end, Vec3d* __restrict position)
{
    const double nan = WRT_NAN;
    const int n = end - begin;
    if (order == nullptr && shared) {
        const double x = origins[0].c[0], y = origins[0].c[1], z = origins[0].c[2];
        WRT_FOR (n, i) {
            const double far = t[begin + i];
            const Vec3 d = directions[begin + i];
            const bool hit = primitive[begin + i] >= 0;
            const double px = x + far * double(d.c[0]), py = y + far * double(d.c[1]), pz = z + far * double(d.c[2]);
            position[place + begin + i] = Vec3d(hit ? px : nan, hit ? py : nan, hit ? pz : nan);
        }
        return;
    }
    for (int i = begin; i < end; ++i) {
        const Vec3d from = origins[shared ? 0 : i];
        const double far = t[i];
        const Vec3 d = directions[i];
        const Vec3d point(from.c[0] + far * double(d.c[0]), from.c[1] + far * double(d.c[1]), from.c[2] + far * double(d.c[2]));
        position[order ? order[place + i] : place + i] = primitive[i] >= 0 ? point : Vec3d(nan, nan, nan);
    }
}

/// The end of the rays, from place `begin` on, that met one of `count` triangles from number `first` on, or nothing.
inline CUDA_CALLABLE int end_of_instance(const int* primitive, int begin, int end, int first, int count)
{
    const auto is_other = [&](int i) { return primitive[i] >= 0 && unsigned(primitive[i] - first) >= unsigned(count); };
    int i = begin;
    constexpr int TOGETHER = 16;
    for (; i + TOGETHER <= end; i += TOGETHER) {
        int others = 0;
        WRT_FOR (TOGETHER, k) others += is_other(i + k);
        if (others) break;
    }
    while (i < end && !is_other(i)) ++i;
    return i;
}

/// Where what is known of surfaces is written; null for what is not asked for.
struct IdColumns {
    int *instance, *geometry, *primitive, *semantic;
};

/// What neighbours that met one instance have in common.
struct MetInstance {
    int number, geometry, label, first;
};

template <class Hit, class Value>
inline CUDA_CALLABLE void write_where(int* column, int begin, int n, const Hit& is_hit, const Value& value_of)
{
    if (column == nullptr) return;
    int* __restrict out = column + begin;
    WRT_FOR (n, k) out[k] = is_hit(k) ? value_of(k) : -1;
}

/// Writes entries begin .. begin + n - 1 of all columns; `met` are the triangles.
template <class Hit>
inline CUDA_CALLABLE void write_met(
    const IdColumns& out, int begin, int n, const int* met, const MetInstance& common, const Hit& is_hit)
{
    write_where(out.instance, begin, n, is_hit, [&](int) { return common.number; });
    write_where(out.geometry, begin, n, is_hit, [&](int) { return common.geometry; });
    write_where(out.primitive, begin, n, is_hit, [&](int k) { return met[k] - common.first; });
    write_where(out.semantic, begin, n, is_hit, [&](int) { return common.label; });
}

/// What the rays begin .. end - 1 met, ray i as entry place + i of the columns; -1 for nothing, and where `range` of that entry
/// (null if all hits count) is infinite. `labels` are those of instances, (0,) for none.
template <class Mesh, class Labels>
inline CUDA_CALLABLE void write_ids(const Mesh& mesh, const Labels& labels, const int* primitive, const float* range, int begin,
    int end, int place, const IdColumns& out)
{
    const int* first = mesh.geometry_first.data;
    MetInstance common {-1, -1, -1, 0};
    for (int i = begin, stop, count = 0; i < end; i = stop) {
        if (primitive[i] >= 0) {
            int low = 0;
            for (int left = mesh.geometry_first.shape[0] - 1; left > 1;) {
                const int half = left / 2;
                low = first[low + half] <= primitive[i] ? low + half : low;
                left -= half;
            }
            count = first[low + 1] - first[low];
            common.number = common.geometry = low;
            if (mesh.placements.shape[0] > 0) common.geometry = mesh.placements.data[low].geometry;
            if (labels.shape[0] > 0) common.label = labels.data[low];
            common.first = first[low];
        }
        stop = end_of_instance(primitive, i, end, common.first, count);
        const int n = stop - i, at = place + i;
        const int* met = primitive + i;
        if (range == nullptr) write_met(out, at, n, met, common, [&](int k) { return met[k] >= 0; });
        else {
            const float *far = range + at, none = WRT_INFINITY;
            write_met(out, at, n, met, common, [&](int k) { return met[k] >= 0 && far[k] < none; });
        }
    }
}

/// Where the rays of one value begin to end, from place `begin` on: those that met one triangle.
inline CUDA_CALLABLE int end_of_run(const int* primitive, int begin, int end)
{
    const int first = primitive[begin];
    int i = begin + 1;
    while (i < end && primitive[i] == first) ++i;
    return i;
}

/// Range and intensity of a return: inf and 0 if it is not detected.
template <class Detector>
inline CUDA_CALLABLE void write_return(const Detector& detector, float t, float power, float& range, float& intensity)
{
    const bool lost = t < detector.min_range || t > detector.max_range || power < detector.threshold;
    range = lost ? WRT_INFINITY : t;
    intensity = lost ? 0.0f : power;
}

/// Ranges of the rays begin .. end - 1 if the power of returns does not matter; inf for those that are not detected. `order` as
/// in `write_returns`.
template <class Detector>
inline CUDA_CALLABLE void write_distances(const Detector& detector, const float* __restrict t, const int* __restrict primitive,
    const int* __restrict order, int place, int begin, int end, float* __restrict range)
{
    const float nearest = detector.min_range, farthest = detector.max_range, none = WRT_INFINITY;
    const auto range_of = [&](int i) { return primitive[i] < 0 || t[i] < nearest || t[i] > farthest ? none : t[i]; };
    if (order)
        for (int i = begin; i < end; ++i) range[order[place + i]] = range_of(i);
    else {
        const int n = end - begin;
        WRT_FOR (n, i) range[place + begin + i] = range_of(begin + i);
    }
}

/// Ranges and intensities of the rays begin .. end - 1, which met one surface, or none if `reflectance` is negative, by a range
/// law of exponent 2 (`squared`) or 0 without extinction. `order` is null if ray i is beam place + i.
template <class Detector, class Vec3>
inline CUDA_CALLABLE void write_returns(const Detector& detector, bool squared, const float* __restrict t,
    const Vec3* __restrict directions, const Vec3& normal, float reflectance, const int* __restrict order, int place, int begin,
    int end, float* __restrict range, float* __restrict intensity)
{
    const int n = end - begin;
    const bool hit = reflectance >= 0.0f;
    const auto power_of = [&](int i) {
        const float power = reflectance * WRT_ABS(dot(normal, directions[i])), ratio = detector.reference_range / t[i];
        return squared ? power * ratio * ratio : power;
    };
    if (order != nullptr || !hit)
        for (int i = begin; i < end; ++i) {
            const int at = order ? order[place + i] : place + i;
            range[at] = WRT_INFINITY;
            intensity[at] = 0.0f;
            if (hit) write_return(detector, t[i], power_of(i), range[at], intensity[at]);
        }
    else
        WRT_FOR (n, i) {
            float far, power;
            write_return(detector, t[begin + i], power_of(begin + i), far, power);
            range[place + begin + i] = far;
            intensity[place + begin + i] = power;
        }
}

/// A beam as it is reported: with noise, turned by two angles, whose tangents are so small that they are the angles.
template <bool NOISY, class Vec3d> inline CUDA_CALLABLE Vec3d shown_beam(const Vec3d& axis, double turn_0, double turn_1)
{
    const Vec3d shown = normalize(axis);
    if (!NOISY) return shown;
    const double x = shown.c[0], y = shown.c[1];
    const bool vertical = y * y + x * x + 0.0 < 1e-12;
    const Vec3d side = normalize(Vec3d(vertical ? 0.0 : -y, vertical ? 1.0 : x, 0.0)), other = cross(shown, side);
    return normalize(Vec3d(x + turn_0 * side.c[0] + turn_1 * other.c[0], y + turn_0 * side.c[1] + turn_1 * other.c[1],
        shown.c[2] + turn_0 * side.c[2] + turn_1 * other.c[2]));
}

/// Where points are written.
template <class Vec3d, class Quat> struct PointFrame {
    bool world;
    Vec3d from;
    Quat turn;
    Vec3d* __restrict point;
};

/// `write_points` of n returns; `turns` are those of their beams, if there is noise.
template <bool NOISY, class Vec3, class Distance, class Vec3d, class Quat>
inline CUDA_CALLABLE void points_of_block(const Vec3* __restrict axes, const Distance* __restrict distance,
    const double* turn_0, const double* turn_1, const PointFrame<Vec3d, Quat>& frame, int begin, int n)
{
    const double nan = WRT_NAN;
    const Distance none = WRT_INFINITY;
    Vec3d* __restrict point = frame.point + begin;
    const auto point_of = [&](int i) {
        const Vec3 axis = axes[i];
        const Vec3d shown
            = shown_beam<NOISY>(Vec3d(axis.c[0], axis.c[1], axis.c[2]), NOISY ? turn_0[i] : 0.0, NOISY ? turn_1[i] : 0.0);
        const double far = distance[begin + i];
        return Vec3d(0.0 + far * shown.c[0], 0.0 + far * shown.c[1], 0.0 + far * shown.c[2]);
    };
    const auto write = [&](int i, const Vec3d& p) {
        const bool seen = distance[begin + i] < none;
        point[i] = Vec3d(seen ? p.c[0] : nan, seen ? p.c[1] : nan, seen ? p.c[2] : nan);
    };
    if (frame.world)
        WRT_FOR (n, i) {
            const Vec3d p = quat_rotate(frame.turn, point_of(i));
            write(i, Vec3d(frame.from.c[0] + p.c[0], frame.from.c[1] + p.c[1], frame.from.c[2] + p.c[2]));
        }
    else
        WRT_FOR (n, i) write(i, point_of(i));
}

/// Points of the returns begin .. end - 1, one of each beam, of a sensor at rest whose beams start at its origin; NaN for none.
/// `axes` begins with that of return `begin`. Without noise, distances are ranges.
template <class Noise, class Vec3, class Vec3d, class Quat>
inline CUDA_CALLABLE void write_points(const Noise& noise, const Vec3* axes, const float* range, const double* distance,
    const PointFrame<Vec3d, Quat>& frame, int begin, int end)
{
    if (noise.angle == 0.0) {
        if (is_noisy(noise)) points_of_block<false>(axes, distance, nullptr, nullptr, frame, begin, end - begin);
        else points_of_block<false>(axes, range, nullptr, nullptr, frame, begin, end - begin);
        return;
    }
    double turn_0[NOISY], turn_1[NOISY];
    NoiseWords words;
    for (int first = begin; first < end; first += NOISY) {
        const int n = end - first < NOISY ? end - first : NOISY;
        words.draw(first, n, 1u, noise.key.c[0], noise.key.c[1]);
        WRT_FOR (n, i) {
            const double radius = square_root(-2.0 * log_of_unit(words.c[0][i]));
            const CosineSine turn = turn_by_unit(words.c[1][i]);
            turn_0[i] = noise.angle * (radius * turn.cosine);
            turn_1[i] = noise.angle * (radius * turn.sine);
        }
        points_of_block<true>(axes + (first - begin), distance, turn_0, turn_1, frame, first, n);
    }
}

/// Points in the frame of the sensor and in the world; null for those that are not asked for.
template <class Noise, class Vec3, class Vec3d, class Pose>
inline CUDA_CALLABLE void write_points(const Noise& noise, const Vec3* axes, const float* range, const double* distance,
    const Pose& pose, int begin, int end, Vec3d* point, Vec3d* position)
{
    using Frame = PointFrame<Vec3d, decltype(pose.rotation)>;
    if (point) write_points(noise, axes, range, distance, Frame {false, pose.position, pose.rotation, point}, begin, end);
    if (position) write_points(noise, axes, range, distance, Frame {true, pose.position, pose.rotation, position}, begin, end);
}

}  // namespace
}  // namespace wrt

// Assigns rays to influence areas, L rays at a time: wrt.kernels.influence.area_lanes.
#pragma once
#include "ray.h"

namespace wrt {
namespace {

/// A block of L rays, as it is kept between calls: rows of floats, then the bounds of the origins.
template <int L> struct AreaLanes {
    float ox[L], oy[L], oz[L], dx[L], dy[L], dz[L], t_min[L], t[L], leave[L];
    float low[3], high[3];
};

/// found: the area, -1 for none. list: the list of the octree's leaf that contains the origin, -1 for rays that belong to no
/// area. The others are sums over all blocks: rays that leave their area, greatest area, `areas` less the least area, rays
/// without an area.
template <int L> struct AreaMarks {
    int found[L], list[L], left[L], max_area[L], max_below[L], alone[L];
};

/// Loads up to `count` rays from `first` on, with list 0, and bounds their origins; returns the number of rays.
template <int L, class Batch>
inline CUDA_CALLABLE int load_area_rays(const Batch& batch, int first, int count, AreaLanes<L>& lanes, AreaMarks<L>& marks)
{
    RayLanes<L> rays;
    rays.here = count < L ? count : L;
    load_lanes<true>(batch, first, rays);
    check_lanes(rays);
    float low_x[L], low_y[L], low_z[L], high_x[L], high_y[L], high_z[L];
    WRT_FOR (L, k) {
        const float px = rays.origin[0][k], py = rays.origin[1][k], pz = rays.origin[2][k];
        const bool valid = rays.stored[k] != 0;
        lanes.ox[k] = px, lanes.oy[k] = py, lanes.oz[k] = pz;
        lanes.dx[k] = rays.direction[0][k], lanes.dy[k] = rays.direction[1][k], lanes.dz[k] = rays.direction[2][k];
        lanes.t_min[k] = rays.t_min[k], lanes.t[k] = rays.t[k], lanes.leave[k] = WRT_INFINITY;
        marks.found[k] = -1, marks.list[k] = valid ? 0 : -1;
        low_x[k] = valid ? px : WRT_INFINITY, low_y[k] = valid ? py : WRT_INFINITY, low_z[k] = valid ? pz : WRT_INFINITY;
        high_x[k] = valid ? px : -WRT_INFINITY, high_y[k] = valid ? py : -WRT_INFINITY, high_z[k] = valid ? pz : -WRT_INFINITY;
    }
    for (int half = L / 2; half > 0; half /= 2)
        for (int k = 0; k < half; ++k) {
            low_x[k] = smaller(low_x[k], low_x[k + half]), high_x[k] = larger(high_x[k], high_x[k + half]);
            low_y[k] = smaller(low_y[k], low_y[k + half]), high_y[k] = larger(high_y[k], high_y[k + half]);
            low_z[k] = smaller(low_z[k], low_z[k + half]), high_z[k] = larger(high_z[k], high_z[k + half]);
        }
    lanes.low[0] = low_x[0], lanes.low[1] = low_y[0], lanes.low[2] = low_z[0];
    lanes.high[0] = high_x[0], lanes.high[1] = high_y[0], lanes.high[2] = high_z[0];
    return rays.here;
}

/// `Region` in single precision; eye, ahead: of the area's view.
struct AreaRegion {
    float right[3], up[3], forward[3], origin[3], eye[3], ahead[3];
    float near, far, width, height, widening, heightening;
    bool radial;
};

template <class Region, class View> inline CUDA_CALLABLE AreaRegion region_of(const Region& region, const View& view)
{
    AreaRegion r;
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        r.right[a] = (float)region.right.c[a], r.up[a] = (float)region.up.c[a], r.forward[a] = (float)region.forward.c[a];
        r.origin[a] = (float)region.origin.c[a], r.eye[a] = view.eye.c[a], r.ahead[a] = view.forward.c[a];
    }
    r.near = (float)region.near, r.far = (float)region.far, r.width = (float)region.width, r.height = (float)region.height;
    r.widening = (float)region.widening, r.heightening = (float)region.heightening;
    r.radial = view.radial;
    return r;
}

inline CUDA_CALLABLE float dot3(const float* a, float x, float y, float z) { return a[0] * x + a[1] * y + a[2] * z; }

/// The earlier of two ends, the second of which is after `room` at `rate`.
inline CUDA_CALLABLE float earlier(float until, float room, float rate)
{
    const float s = room / rate;
    return ((rate > 0.0f) & (s < until)) ? s : until;
}

/// Whether rays along v from a point s away from the eye agree with the directions of an area, forward or backward.
inline CUDA_CALLABLE bool agrees(
    const AreaRegion& r, float bound, float at_eye, float sx, float sy, float sz, float vx, float vy, float vz)
{
    const float start = sx * sx + sy * sy + sz * sz;
    const float lx = r.radial ? sx : r.ahead[0], ly = r.radial ? sy : r.ahead[1], lz = r.radial ? sz : r.ahead[2];
    const float cx = ly * vz - lz * vy, cy = lz * vx - lx * vz, cz = lx * vy - ly * vx;
    const float lengths = (lx * lx + ly * ly + lz * lz) * (vx * vx + vy * vy + vz * vz);
    const bool along = (lengths > 0.0f) & (lengths < WRT_INFINITY) & (cx * cx + cy * cy + cz * cz <= bound * lengths);
    return along | (r.radial & (start <= at_eye));
}

/// Assigns area `number` to the rays of list `which` that have no area yet and belong to it.
template <int L, class Region, class View>
inline CUDA_CALLABLE void try_area(int number, const Region& region, const View& view, float sine, float touch, int which,
    AreaLanes<L>& lanes, AreaMarks<L>& marks)
{
    const AreaRegion r = region_of(region, view);
    const float bound = sine * sine, at_eye = touch * touch;
    WRT_FOR (L, k) {
        const float px = lanes.ox[k] - r.origin[0], py = lanes.oy[k] - r.origin[1], pz = lanes.oz[k] - r.origin[2];
        const float vx = lanes.dx[k], vy = lanes.dy[k], vz = lanes.dz[k];
        const float x = dot3(r.right, px, py, pz), y = dot3(r.up, px, py, pz), z = dot3(r.forward, px, py, pz);
        const float wide = r.width + z * r.widening, tall = r.height + z * r.heightening;
        const bool inside = (z >= r.near) & (z <= r.far) & (WRT_ABS(x) <= wide) & (WRT_ABS(y) <= tall);
        const bool aligned
            = agrees(r, bound, at_eye, lanes.ox[k] - r.eye[0], lanes.oy[k] - r.eye[1], lanes.oz[k] - r.eye[2], vx, vy, vz);
        const float right = dot3(r.right, vx, vy, vz), up = dot3(r.up, vx, vy, vz), ahead = dot3(r.forward, vx, vy, vz);
        const float spread = ahead * r.widening, rise = ahead * r.heightening;
        float until = WRT_INFINITY;
        until = earlier(until, r.far - z, ahead), until = earlier(until, z - r.near, -ahead);
        until = earlier(until, wide - x, right - spread), until = earlier(until, wide + x, -right - spread);
        until = earlier(until, tall - y, up - rise), until = earlier(until, tall + y, -up - rise);
        const bool belongs = inside & aligned & (until > lanes.t_min[k]) & (marks.list[k] == which) & (marks.found[k] < 0);
        marks.found[k] = belongs ? number : marks.found[k];
        lanes.leave[k] = belongs ? until : lanes.leave[k];
    }
}

/// t at which a ray has left a box: in a plane of the box, 0 * inf is NaN: such a ray has no hits, as the corners are beyond
/// them.
template <class Vec>
inline CUDA_CALLABLE float end_of_box(const Vec& low, const Vec& high, float px, float py, float pz, float x, float y, float z)
{
    const float ix = 1.0f / x, iy = 1.0f / y, iz = 1.0f / z;
    const float until = larger((high.c[0] - px) * ix, (low.c[0] - px) * ix);
    const float until_y = larger((high.c[1] - py) * iy, (low.c[1] - py) * iy);
    const float until_z = larger((high.c[2] - pz) * iz, (low.c[2] - pz) * iz);
    return smaller(until_z, smaller(until_y, until));
}

/// Writes where `count` rays are split, and adds them to the sums. low, high: the box of the scene.
template <int L, class Vec>
inline CUDA_CALLABLE void store_area_rays(int first, int count, int areas, const Vec& low, const Vec& high, AreaLanes<L>& lanes,
    AreaMarks<L>& marks, unsigned short* area, float* cut, float* rest)
{
    WRT_FOR (L, k) {
        const float until = end_of_box(low, high, lanes.ox[k], lanes.oy[k], lanes.oz[k], lanes.dx[k], lanes.dy[k], lanes.dz[k]);
        const int found = marks.found[k] < 0 ? areas : marks.found[k];
        const bool done = (lanes.leave[k] >= lanes.t[k]) | (lanes.leave[k] >= until);
        lanes.leave[k] = (done & (marks.found[k] >= 0)) ? WRT_INFINITY : lanes.leave[k];
        marks.found[k] = found;
        marks.alone[k] += ((found == areas) & (k < count)) ? 1 : 0;
        marks.left[k] += ((found < areas) & !done & (k < count)) ? 1 : 0;
        marks.max_area[k] = found > marks.max_area[k] ? found : marks.max_area[k];
        marks.max_below[k] = areas - found > marks.max_below[k] ? areas - found : marks.max_below[k];
    }
    if (count == L) {
        WRT_FOR (L, k) {
            area[first + k] = (unsigned short)marks.found[k];
        }
        WRT_FOR (L, k) {
            cut[first + k] = marks.found[k] == areas ? -1.0f : smaller(lanes.leave[k], lanes.t[k]);
        }
        WRT_FOR (L, k) {
            rest[first + k] = marks.found[k] == areas ? lanes.t_min[k] : lanes.leave[k];
        }
    } else {
        WRT_SCALAR
        for (int k = 0; k < count; ++k) {
            area[first + k] = (unsigned short)marks.found[k];
            cut[first + k] = marks.found[k] == areas ? -1.0f : smaller(lanes.leave[k], lanes.t[k]);
            rest[first + k] = marks.found[k] == areas ? lanes.t_min[k] : lanes.leave[k];
        }
    }
}

/// Sums over the lanes: rays that leave their area, greatest area, `areas` less the least area, rays without an area.
template <int L> inline CUDA_CALLABLE void sum_areas(const AreaMarks<L>& marks, int (&sums)[4])
{
    for (int k = 0; k < L; ++k) {
        sums[0] += marks.left[k];
        sums[1] = marks.max_area[k] > sums[1] ? marks.max_area[k] : sums[1];
        sums[2] = marks.max_below[k] > sums[2] ? marks.max_below[k] : sums[2];
        sums[3] += marks.alone[k];
    }
}

}  // namespace
}  // namespace wrt

// A packet against the children of a node and the triangles of a block (wrt.kernels.traversal.packet.culling): by intervals, by
// every ray, by the slopes of its rays.
#pragma once
#include "packet.h"

namespace wrt {
namespace {

template <class Bounds> inline CUDA_CALLABLE BoxRays box_rays(const Bounds& bounds)
{
    BoxRays rays;
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        rays.large[a] = bounds.inverse_large.c[a];
        rays.small[a] = bounds.inverse_small.c[a];
        rays.in[a] = bounds.origin_in.c[a];
        rays.out[a] = bounds.origin_out.c[a];
    }
    return rays;
}

/// What bounds boxes along axes on which directions have both signs: 0 along the others, where it bounds nothing. ahead,
/// behind: ends of the origins; forward, backward: the 1 / direction of the fastest rays either way.
struct MixedAxes {
    float ahead[3], behind[3], forward[3], backward[3];
};

template <class Bounds> inline CUDA_CALLABLE MixedAxes mixed_axes(const Bounds& bounds)
{
    MixedAxes axes;
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        axes.ahead[a] = bounds.origin_high.c[a] + bounds.slack;
        axes.behind[a] = bounds.origin_low.c[a] - bounds.slack;
        axes.forward[a] = bounds.forward_small.c[a];
        axes.backward[a] = bounds.backward_small.c[a];
    }
    return axes;
}

/// The later entry into box i that follows from both signs.
inline CUDA_CALLABLE float mixed_entry(const PlanePointers& planes, const MixedAxes& axes, int i, float enter)
{
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        float t = (planes.in[a][i] - axes.ahead[a]) * axes.forward[a];
        enter = t > enter ? t : enter;
        t = (planes.out[a][i] - axes.behind[a]) * axes.backward[a];
        enter = t > enter ? t : enter;
    }
    return enter;
}

/// Writes the keys of the W children whose boxes are at `box`, by intervals over the rays; returns the smallest.
template <int W, class Bounds> inline CUDA_CALLABLE int interval_keys(const float* box, const Bounds& all_bounds, int* key)
{
    constexpr int BACK = 3 * W;
    // a walk meets more leaves than nodes; after each, what is read here would be loaded, spread and put on the stack ahead
    const Bounds& bounds = read_in_place(all_bounds);
    const BoxRays rays = box_rays(bounds);
    const PlanePointers planes
        = planes_at<W>(box, rays.large[0] < 0.0f ? BACK : 0, rays.large[1] < 0.0f ? BACK : 0, rays.large[2] < 0.0f ? BACK : 0);
    const float t_min = bounds.t_min, t_max = bounds.t_max;
    int nearest = NO_CHILD;
    if (bounds.mixed_axes == 0) {
        WRT_FOR_LANES (i) {
            const Interval own = slab(planes, rays, i, t_min, t_max);
            const int k = child_key<W>(own, i, own.enter <= own.leave);
            key[i] = k;
            nearest = k < nearest ? k : nearest;
        }
        return nearest;
    }
    const MixedAxes axes = mixed_axes(bounds);
    WRT_FOR_LANES (i) {
        Interval own = slab(planes, rays, i, t_min, t_max);
        own.enter = mixed_entry(planes, axes, i, own.enter);
        const int k = child_key<W>(own, i, own.enter <= own.leave);
        key[i] = k;
        nearest = k < nearest ? k : nearest;
    }
    return nearest;
}

/// The triangles of a block whose boxes some rays may meet. An unused lane holds NaN, which bounds nothing: it is recognised by
/// its first vertex.
template <int W, class Bounds> inline CUDA_CALLABLE unsigned interval_mask(const float* block, const Bounds& bounds)
{
    const BoxRays rays = box_rays(bounds);
    const float t_min = bounds.t_min, t_max = bounds.t_max;
    int kept[W];
    WRT_FOR_LANES (i) {
        float low[3], high[3];
        vertex_box<W>(block + i, low, high);
        const Interval own = slab(planes_of(low, high, rays.large), rays, 0, t_min, t_max);
        kept[i] = ((own.enter <= own.leave) & (block[i] == block[i])) ? -1 : 0;
    }
    return bits<W>(kept);
}

/// The lanes of a block that are used.
template <int W> inline CUDA_CALLABLE unsigned used_mask(const float* block)
{
    int kept[W];
    WRT_FOR_LANES (i) {
        kept[i] = block[i] == block[i] ? -1 : 0;
    }
    return bits<W>(kept);
}

/// The keys by every ray: of the earliest entry of any of them.
template <int P, int W, bool SHARED, class Bounds>
inline CUDA_CALLABLE int every_ray_keys(const float* box, const Packet<P, W, SHARED>& packet, const Bounds& bounds, int* key)
{
    const SharedOrigin shared = shared_origin(bounds);
    int nearest = NO_CHILD;
    for (int c = 0; c < W; ++c) {
        const float low[3] = {box[c], box[W + c], box[2 * W + c]};
        const float high[3] = {box[3 * W + c], box[4 * W + c], box[5 * W + c]};
        int entry = NO_CHILD;
        if (low[0] <= high[0]) {  // an unused lane has no box
            WRT_FOR (P, k) {
                const Interval own = ray_slab(packet, shared, k, low, high, packet.t_min[k], packet.t[k]);
                // adding 0 turns -0 into +0; the t_min of a ray that is not active may be anything, of either sign
                const bool meets = (own.enter <= own.leave) & (packet.t[k] > -WRT_INFINITY);
                const int met = meets ? __builtin_bit_cast(int, own.enter + 0.0f) : NO_CHILD;
                entry = met < entry ? met : entry;
            }
        }
        entry = entry == NO_CHILD ? NO_CHILD : (entry & -W) | c;
        key[c] = entry;
        nearest = entry < nearest ? entry : nearest;
    }
    return nearest;
}

/// Rays of a packet at a leaf that are tested one by one, at most (wrt.kernels.traversal.packet.rays.packet_bounds).
constexpr int MAX_FEW_RAYS = 2;

/// The rays of a packet that meet the box in a lane of a node, as -1 in `meets`, and as bits, W rays each.
template <int P, int W> struct MeetingRays {
    int meets[P], met = 0;
    unsigned vectors[P / W];

    /// box: the lane of the node's boxes; visit(k, interval): for each ray.
    template <bool SHARED, class Visit>
    inline CUDA_CALLABLE void find(
        const Packet<P, W, SHARED>& packet, const SharedOrigin& shared, const float* box, Visit visit)
    {
        const float low[3] = {box[0], box[W], box[2 * W]}, high[3] = {box[3 * W], box[4 * W], box[5 * W]};
        for (int f = 0; f < P; f += W) {
            WRT_FOR_LANES (i) {
                const int k = f + i;
                const Interval own = ray_slab(packet, shared, k, low, high, packet.t_min[k], packet.t[k]);
                visit(k, own);
                meets[k] = ((own.enter <= own.leave) & (packet.t[k] > -WRT_INFINITY)) ? -1 : 0;
            }
            vectors[f / W] = bits<W>(meets + f);
            met += count_bits(vectors[f / W]);
        }
    }

    /// Writes the numbers of the rays; returns how many.
    inline CUDA_CALLABLE int list(int* to) const
    {
        int place = 0;
        for (int f = 0; f < P; f += W)
            for (unsigned left = vectors[f / W]; left; left &= left - 1u) to[place++] = f + lowest_bit(left);
        return place;
    }
};

/// The number of rays that meet the box in a lane of a node; if they are few, they are listed in `bounds.few`.
template <int P, int W, bool SHARED, class Bounds>
inline CUDA_CALLABLE int list_meeting(const float* box, const Packet<P, W, SHARED>& packet, Bounds& bounds)
{
    MeetingRays<P, W> rays;
    rays.find(packet, shared_origin(bounds), box, [](int, const Interval&) { });
    if (rays.met <= MAX_FEW_RAYS) rays.list(bounds.few.c);
    return rays.met;
}

/// The range of rays along an axis, by intervals.
struct AxisRange {
    float in, out, large, small, t_min, t_max;

    template <class Bounds>
    CUDA_CALLABLE AxisRange(const Bounds& bounds, int axis)
        : in(bounds.origin_in.c[axis])
        , out(bounds.origin_out.c[axis])
        , large(bounds.inverse_large.c[axis])
        , small(bounds.inverse_small.c[axis])
        , t_min(bounds.t_min)
        , t_max(bounds.t_max)
    {
    }
    /// The least t of a near plane and the greatest of a far plane.
    inline CUDA_CALLABLE float entry(float near) const
    {
        const float d = near - in, p = d * large, q = d * small;
        return q < p ? q : p;
    }
    inline CUDA_CALLABLE float exit(float far) const
    {
        const float d = far - out, p = d * large, q = d * small;
        return q > p ? q : p;
    }
    /// Whether all that is between two planes begins behind the farthest of the best hits, or ends before the rays begin.
    inline CUDA_CALLABLE bool is_beside(float near, float far) const
    {
        const bool late = entry(near) > t_max, early = exit(far) < t_min;
        return late | early;
    }
};

/// The ends of three numbers.
struct Ends {
    float lower, upper;
};
inline CUDA_CALLABLE Ends ends_of(float p, float q, float r)
{
    const float lower = p < q ? p : q, upper = p > q ? p : q;
    return {lower < r ? lower : r, upper > r ? upper : r};
}

/// Triangles of a block of which no side plane of the slopes has all three vertices outside (Reshetov 2007).
template <int W, class Bounds> inline CUDA_CALLABLE unsigned vertex_mask(const float* block, const Bounds& bounds)
{
    if (bounds.main_axes & (bounds.main_axes - 1)) return (1u << W) - 1u;
    const int z = axis_of(bounds.main_axes), x = z == 2 ? 0 : z + 1, y = x == 2 ? 0 : x + 1;
    const float plane = bounds.plane, x_low = bounds.through_low.c[0], y_low = bounds.through_low.c[1];
    const float x_high = bounds.through_high.c[0], y_high = bounds.through_high.c[1];
    const float s0 = bounds.slope_low.c[0], s1 = bounds.slope_high.c[0];
    const float t0 = bounds.slope_low.c[1], t1 = bounds.slope_high.c[1];
    const AxisRange range(bounds, z);
    const bool back = bounds.backward.c[z];
    int kept[W];
    WRT_FOR_LANES (i) {
        const Ends depths = ends_of(block[z * W + i], block[(3 + z) * W + i], block[(6 + z) * W + i]);
        const bool beside = range.is_beside(back ? depths.upper : depths.lower, back ? depths.lower : depths.upper);
        // whether some vertex is not beyond each side; false for NaN, so that unused lanes are culled
        bool left = false, right = false, below = false, above = false;
        for (int k = 0; k < 3; ++k) {
            const float vx = block[(3 * k + x) * W + i], vy = block[(3 * k + y) * W + i], vz = block[(3 * k + z) * W + i];
            const float depth = vz - plane;
            float p = depth * s0, q = depth * s1;
            left = left | ((vx - x_low) - (p < q ? p : q) >= 0.0f);
            right = right | ((vx - x_high) - (p > q ? p : q) <= 0.0f);
            p = depth * t0, q = depth * t1;
            below = below | ((vy - y_low) - (p < q ? p : q) >= 0.0f);
            above = above | ((vy - y_high) - (p > q ? p : q) <= 0.0f);
        }
        kept[i] = (left & right & below & above & !beside) ? -1 : 0;
    }
    return bits<W>(kept);
}

/// Error bound of an area, in slacks times the distance of its vertices from the ray.
constexpr float CORNER_MARGIN = 4.0f;

/// Triangles of a block that the four corner rays of a packet from one point do not all pass on one side (Dmitriev et al.
/// 2004).
template <int W, bool SHARED, class Bounds> inline CUDA_CALLABLE unsigned corner_mask(const float* block, const Bounds& bounds)
{
    const unsigned met = interval_mask<W>(block, bounds);
    if (!SHARED || (bounds.main_axes & (bounds.main_axes - 1)) || !met) return met;
    const int z = axis_of(bounds.main_axes), x = z == 2 ? 0 : z + 1, y = x == 2 ? 0 : x + 1;
    const float ox = bounds.origin_low.c[x], oy = bounds.origin_low.c[y], oz = bounds.origin_low.c[z];
    const float s0 = bounds.slope_low.c[0], s1 = bounds.slope_high.c[0];
    const float t0 = bounds.slope_low.c[1], t1 = bounds.slope_high.c[1];
    const float slack = bounds.slack, wide = CORNER_MARGIN * slack;
    int kept[W];
    WRT_FOR_LANES (i) {
        float px[3], qx[3], py[3], qy[3], size[3];  // sheared by the least and by the greatest slope
        for (int k = 0; k < 3; ++k) {
            const float vx = block[(3 * k + x) * W + i] - ox, vy = block[(3 * k + y) * W + i] - oy;
            const float vz = block[(3 * k + z) * W + i] - oz;
            px[k] = vx - s0 * vz, qx[k] = vx - s1 * vz;
            py[k] = vy - t0 * vz, qy[k] = vy - t1 * vz;
            const float ax = WRT_ABS(px[k]), bx = WRT_ABS(qx[k]);
            const float ay = WRT_ABS(py[k]), by = WRT_ABS(qy[k]);
            size[k] = (ax > bx ? ax : bx) + (ay > by ? ay : by);
        }
        bool front = true, back = true;  // whether some ray may see all areas >= 0, or all <= 0
        for (int k = 0; k < 3; ++k) {
            const int l = k == 2 ? 0 : k + 1;
            const float a = px[k] * py[l] - py[k] * px[l], b = px[k] * qy[l] - qy[k] * px[l];
            const float c = qx[k] * py[l] - py[k] * qx[l], d = qx[k] * qy[l] - qy[k] * qx[l];
            const float margin = wide * (size[k] + size[l] + 4.0f * slack) + SHORTEST;
            // NaN, where products overflow, keeps the triangle
            front = front & !((a < -margin) & (b < -margin) & (c < -margin) & (d < -margin));
            back = back & !((a > margin) & (b > margin) & (c > margin) & (d > margin));
        }
        kept[i] = (front | back) ? -1 : 0;
    }
    return bits<W>(kept) & met;
}

/// Triangles of a block whose front some ray may see: the least product of a direction and the normal is negative.
template <int W, class Bounds> inline CUDA_CALLABLE unsigned front_mask(const float* block, const Bounds& bounds)
{
    double end[3][2];  // of the directions, derived as those of the rays are
    for (int a = 0; a < 3; ++a) {
        const float large = bounds.inverse_large.c[a], small = bounds.inverse_small.c[a];
        const bool mixed = large != large;
        end[a][0] = (double)(1.0f / (mixed ? bounds.forward_small.c[a] : large));
        end[a][1] = (double)(1.0f / (mixed ? bounds.backward_small.c[a] : small));
    }
    int faces[W];
    WRT_FOR_LANES (i) {
        double normal[3], product[3];
        face_normal<W>(block + i, normal);
        for (int a = 0; a < 3; ++a) {
            const double p = normal[a] * end[a][0], q = normal[a] * end[a][1];
            product[a] = p < q ? p : q;
        }
        faces[i] = (product[0] + product[1]) + product[2] < 0.0 ? -1 : 0;
    }
    return bits<W>(faces);
}

/// Fetches those children of a node into the caches that have a key, of leaves the first block. RECORD: floats of a triangle.
template <int W, int RECORD, class Tree, class Triangles>
inline CUDA_CALLABLE void fetch_kept(const Tree& tree, const Triangles& triangles, int node, const int* key)
{
#if !defined(__CUDA_ARCH__)
    int kept[W];
    WRT_FOR_LANES (i) {
        kept[i] = key[i] != NO_CHILD ? -1 : 0;
    }
    for (unsigned left = bits<W>(kept); left; left &= left - 1u) {
        const int child = tree.child.data[node * W + lowest_bit(left)], block = ~child >> 6;
        if (child < 0) {
            const char* record = (const char*)(triangles.records.data + (size_t)block * (RECORD * W));
            WRT_UNROLLED
            for (int b = 0; b < 4 * RECORD * W; b += 64) WRT_FETCH(record + b);
            WRT_FETCH(triangles.primitive.data + (size_t)block * W);
        } else {
            const char* boxes = (const char*)(tree.bounds.data + (size_t)child * (6 * W));
            WRT_UNROLLED
            for (int b = 0; b < 24 * W; b += 64) WRT_FETCH(boxes + b);
            WRT_FETCH(tree.child.data + child * W);
        }
    }
#endif
}

}  // namespace
}  // namespace wrt

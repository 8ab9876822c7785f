// Frusta of packets along their main axis, and what they cull (wrt.kernels.classics.culling.inverse_frustum).
#pragma once
#include "packet_culling.h"

namespace wrt {
namespace {

/// Widening of boxes and triangles against a frustum, in slacks; the greatest 1 / direction along the main axis.
constexpr float FRUSTUM_MARGIN = 8.0f, STEEPEST_INVERSE = 0x1p100f;

/// Begins the set-up of a frustum: its axes and its start at the rearmost origin; false if the packet has none.
template <class Bounds> inline CUDA_CALLABLE bool find_frame(Bounds& bounds)
{
    const int axes = bounds.main_axes, z = axes == 1 ? 0 : axes == 2 ? 1 : axes == 4 ? 2 : -1;
    // a main axis along which directions have both signs has NaN here
    bounds.frame = z >= 0 && WRT_ABS(bounds.inverse_large.c[z]) <= STEEPEST_INVERSE ? z : -1;
    if (bounds.frame < 0) return false;
    const bool back = bounds.backward.c[z];
    bounds.forward = back ? -1.0f : 1.0f;
    bounds.margin = FRUSTUM_MARGIN * bounds.slack;
    bounds.near_plane = back ? bounds.origin_high.c[z] : bounds.origin_low.c[z];
    return true;
}

/// The frustum of a packet's origins and slopes.
template <class Bounds> inline CUDA_CALLABLE void set_slope_frustum(Bounds& bounds)
{
    if (!find_frame(bounds)) return;
    const int z = bounds.frame, x = z == 2 ? 0 : z + 1, y = x == 2 ? 0 : x + 1;
    const bool back = bounds.backward.c[z];
    bounds.depth = WRT_INFINITY;
    const float spread = bounds.origin_high.c[z] - bounds.origin_low.c[z];
    for (int a = 0; a < 2; ++a) {
        const int axis = a ? y : x;
        const float low = back ? -bounds.slope_high.c[a] : bounds.slope_low.c[a];
        const float high = back ? -bounds.slope_low.c[a] : bounds.slope_high.c[a];
        bounds.rise_low.c[a] = low;
        bounds.rise_high.c[a] = high;
        // a ray begins up to `spread` behind the near plane, and only from there on it rises
        bounds.side_low.c[a] = bounds.origin_low.c[axis] - (low > 0.0f ? low * spread : 0.0f);
        bounds.side_high.c[a] = bounds.origin_high.c[axis] - (high < 0.0f ? high * spread : 0.0f);
    }
}

/// Sets the sides of the frustum between two planes of those rays for which counts(k).
template <int P, int W, bool SHARED, class Bounds, class Counts>
inline CUDA_CALLABLE void set_sides_between(const Packet<P, W, SHARED>& packet, Bounds& bounds, Counts counts)
{
    const int z = bounds.frame;
    const float near_plane = bounds.near_plane, forward = bounds.forward, depth = bounds.depth;
    const float x0 = bounds.origin_low.c[0], y0 = bounds.origin_low.c[1], z0 = bounds.origin_low.c[2];
    OrderedInterval near_x, near_y, far_x, far_y;
    WRT_FOR (P, k) {
        const float o0 = SHARED ? x0 : packet.origin_x[k], o1 = SHARED ? y0 : packet.origin_y[k];
        const float o2 = SHARED ? z0 : packet.origin_z[k];
        // chosen as numbers: a loop with pointers chosen at run time would not be vectorised
        const float ox = z == 0 ? o1 : z == 1 ? o2 : o0, oy = z == 0 ? o2 : z == 1 ? o0 : o1;
        const float oz = z == 0 ? o0 : z == 1 ? o1 : o2;
        const bool own = counts(k);
        const float rise_x = packet.slope_x[k] * forward, rise_y = packet.slope_y[k] * forward;
        const float begin = (oz - near_plane) * forward;
        near_x.widen(ox - rise_x * begin, own);
        far_x.widen(ox + rise_x * (depth - begin), own);
        near_y.widen(oy - rise_y * begin, own);
        far_y.widen(oy + rise_y * (depth - begin), own);
    }
    bounds.side_low.c[0] = near_x.lower(), bounds.side_low.c[1] = near_y.lower();
    bounds.side_high.c[0] = near_x.upper(), bounds.side_high.c[1] = near_y.upper();
    bounds.rise_low.c[0] = (far_x.lower() - near_x.lower()) / depth;
    bounds.rise_low.c[1] = (far_y.lower() - near_y.lower()) / depth;
    bounds.rise_high.c[0] = (far_x.upper() - near_x.upper()) / depth;
    bounds.rise_high.c[1] = (far_y.upper() - near_y.upper()) / depth;
}

/// The frustum between the rearmost origin and the end of the scene, low to high (Overbeck et al. 2008).
template <int P, int W, bool SHARED, class Vec3, class Bounds>
inline CUDA_CALLABLE void set_two_plane_frustum(
    const Vec3& low, const Vec3& high, const Packet<P, W, SHARED>& packet, Bounds& bounds)
{
    if (!find_frame(bounds)) return;
    const int z = bounds.frame;
    const float last = bounds.backward.c[z] ? low.c[z] : high.c[z];
    const float scene_end = (last - bounds.near_plane) * bounds.forward + bounds.margin;
    const float min_depth = bounds.slack * (0.5f / SLACK);  // half of the reach
    bounds.depth = scene_end > min_depth ? scene_end : min_depth;
    set_sides_between(packet, bounds, [&](int k) { return packet.t[k] > -WRT_INFINITY; });
}

/// The frustum of the rays that meet the box of a leaf, between its planes (Reshetov 2007); returns how many do. Few are
/// listed.
template <int P, int W, bool SHARED, class Bounds>
inline CUDA_CALLABLE int set_transient_frustum(const float* box, const Packet<P, W, SHARED>& packet, Bounds& bounds)
{
    MeetingRays<P, W> rays;
    rays.find(packet, shared_origin(bounds), box, [](int, const Interval&) { });
    if (rays.met <= MAX_FEW_RAYS) {
        rays.list(bounds.few.c);
        return rays.met;
    }
    const int z = bounds.frame;
    if (z < 0) return rays.met;
    const float low = box[z * W], high = box[(3 + z) * W];
    bounds.near_plane = bounds.forward < 0.0f ? high + bounds.margin : low - bounds.margin;
    bounds.depth = (high - low) + 2.0f * bounds.margin;
    set_sides_between(packet, bounds, [&](int k) { return rays.meets[k] != 0; });
    return rays.met;
}

/// The frustum of a packet: its axes, the lines of its sides over the depth, the range along its axis.
struct Frustum {
    int x, y, z;
    float near_plane, forward, end, margin, low_x, low_y, high_x, high_y, rise_low_x, rise_low_y, rise_high_x, rise_high_y;
    AxisRange range;

    template <class Bounds>
    CUDA_CALLABLE explicit Frustum(const Bounds& bounds)
        : z(bounds.frame)
        , near_plane(bounds.near_plane)
        , forward(bounds.forward)
        , end(bounds.depth)
        , margin(bounds.margin)
        , low_x(bounds.side_low.c[0])
        , low_y(bounds.side_low.c[1])
        , high_x(bounds.side_high.c[0])
        , high_y(bounds.side_high.c[1])
        , rise_low_x(bounds.rise_low.c[0])
        , rise_low_y(bounds.rise_low.c[1])
        , rise_high_x(bounds.rise_high.c[0])
        , rise_high_y(bounds.rise_high.c[1])
        , range(bounds, bounds.frame)
    {
        x = z == 2 ? 0 : z + 1;
        y = x == 2 ? 0 : x + 1;
    }

    /// Whether no ray meets a box, in the frustum's order of axes; near and far: its planes along the frustum.
    inline CUDA_CALLABLE bool is_beside(float near, float far, float x0, float x1, float y0, float y1) const
    {
        float d0 = (near - near_plane) * forward - margin, d1 = (far - near_plane) * forward + margin;
        d0 = d0 > 0.0f ? d0 : 0.0f, d1 = d1 > 0.0f ? d1 : 0.0f;
        d0 = d0 < end ? d0 : end, d1 = d1 < end ? d1 : end;
        float e, f;
        e = low_x + rise_low_x * d0, f = low_x + rise_low_x * d1;
        const float rays_x0 = (e < f ? e : f) - margin;
        e = high_x + rise_high_x * d0, f = high_x + rise_high_x * d1;
        const float rays_x1 = (e > f ? e : f) + margin;
        e = low_y + rise_low_y * d0, f = low_y + rise_low_y * d1;
        const float rays_y0 = (e < f ? e : f) - margin;
        e = high_y + rise_high_y * d0, f = high_y + rise_high_y * d1;
        const float rays_y1 = (e > f ? e : f) + margin;
        return (rays_x0 > x1) | (rays_x1 < x0) | (rays_y0 > y1) | (rays_y1 < y0);
    }
};

/// The keys of the W children whose boxes are at `box`, by the frustum; a packet without one is culled by intervals.
template <int W, class Bounds> inline CUDA_CALLABLE int frustum_keys(const float* box, const Bounds& bounds, int* key)
{
    if (bounds.frame < 0) return interval_keys<W>(box, bounds, key);
    const Frustum frustum(bounds);
    const int x = frustum.x, y = frustum.y, z = frustum.z;
    const bool back = frustum.forward < 0.0f;
    int nearest = NO_CHILD;
    WRT_FOR_LANES (i) {
        const float x0 = box[x * W + i], y0 = box[y * W + i], z0 = box[z * W + i];
        const float x1 = box[(3 + x) * W + i], y1 = box[(3 + y) * W + i], z1 = box[(3 + z) * W + i];
        const float near = back ? z1 : z0, far = back ? z0 : z1;
        const bool beside = frustum.is_beside(near, far, x0, x1, y0, y1);
        Interval own = {frustum.range.t_min, frustum.range.t_max};
        const float first = frustum.range.entry(near), last = frustum.range.exit(far);
        own.enter = first > own.enter ? first : own.enter;
        own.leave = last < own.leave ? last : own.leave;
        const int k = child_key<W>(own, i, (own.enter <= own.leave) & !beside);
        key[i] = k;
        nearest = k < nearest ? k : nearest;
    }
    return nearest;
}

/// Triangles of a block whose boxes neither the frustum nor the intervals of a packet cull.
template <int W, class Bounds> inline CUDA_CALLABLE unsigned frustum_mask(const float* block, const Bounds& bounds)
{
    const unsigned met = interval_mask<W>(block, bounds);  // the two tests at a leaf
    if (bounds.frame < 0 || !met) return met;
    const Frustum frustum(bounds);
    const int x = frustum.x, y = frustum.y, z = frustum.z;
    const bool back = frustum.forward < 0.0f;
    int kept[W];
    WRT_FOR_LANES (i) {
        const Ends own_x = ends_of(block[x * W + i], block[(3 + x) * W + i], block[(6 + x) * W + i]);
        const Ends own_y = ends_of(block[y * W + i], block[(3 + y) * W + i], block[(6 + y) * W + i]);
        const Ends own_z = ends_of(block[z * W + i], block[(3 + z) * W + i], block[(6 + z) * W + i]);
        const bool beside = frustum.is_beside(back ? own_z.upper : own_z.lower, back ? own_z.lower : own_z.upper, own_x.lower,
            own_x.upper, own_y.lower, own_y.upper);
        kept[i] = beside ? 0 : -1;
    }
    return bits<W>(kept) & met;
}

/// Triangles of a block whose vertices are not all outside of one side of the frustum.
template <int W, class Bounds> inline CUDA_CALLABLE unsigned side_mask(const float* block, const Bounds& bounds)
{
    if (bounds.frame < 0) return interval_mask<W>(block, bounds);
    const Frustum frustum(bounds);
    const int x = frustum.x, y = frustum.y, z = frustum.z;
    const bool rear = frustum.range.large < 0.0f;  // not `backward`: the range may be seen from the rays' ends
    int kept[W];
    WRT_FOR_LANES (i) {
        const Ends depths = ends_of(block[z * W + i], block[(3 + z) * W + i], block[(6 + z) * W + i]);
        const bool beside = frustum.range.is_beside(rear ? depths.upper : depths.lower, rear ? depths.lower : depths.upper);
        bool left = true, right = true, below = true, above = true;
        for (int k = 0; k < 3; ++k) {
            const float vx = block[(3 * k + x) * W + i], vy = block[(3 * k + y) * W + i];
            const float depth = (block[(3 * k + z) * W + i] - frustum.near_plane) * frustum.forward;
            left = left & (vx < (frustum.low_x + frustum.rise_low_x * depth) - frustum.margin);
            right = right & (vx > (frustum.high_x + frustum.rise_high_x * depth) + frustum.margin);
            below = below & (vy < (frustum.low_y + frustum.rise_low_y * depth) - frustum.margin);
            above = above & (vy > (frustum.high_y + frustum.rise_high_y * depth) + frustum.margin);
        }
        // an unused lane holds NaN, which is beyond nothing: it is recognised by its first vertex
        kept[i] = (!(left | right | below | above | beside) & (block[i] == block[i])) ? -1 : 0;
    }
    return bits<W>(kept);
}

/// Whether the rays as a whole pass beside the box in a lane of a node: all enter it along one axis after they have left it
/// along another.
template <int P, int W, bool SHARED, class Bounds>
inline CUDA_CALLABLE bool enters_behind_exit(const float* box, const Packet<P, W, SHARED>& packet, const Bounds& bounds)
{
    const SharedOrigin shared = shared_origin(bounds);
    float first[3], last[3];
    for (int a = 0; a < 3; ++a) {
        const float low = box[a * W], high = box[(3 + a) * W];
        const float* inverse = packet.inverse(a);
        const float* origin = packet.origin(a);
        OrderedInterval entry, leave;
        WRT_FOR (P, k) {
            const float i = inverse[k], o = SHARED ? shared.origin[a] : origin[k],
                        wide = SHARED ? shared.slack : packet.slack[k];
            const bool back = i<0.0f, counts = packet.t[k]> - WRT_INFINITY;
            const float step = back ? -wide : wide;
            float in = ((back ? high : low) - (o + step)) * i, out = ((back ? low : high) - (o - step)) * i;
            in = in == in ? in : -WRT_INFINITY;
            out = out == out ? out : WRT_INFINITY;  // 0 * inf bounds nothing
            entry.widen(in, counts);
            leave.widen(out, counts);
        }
        first[a] = entry.lower();
        last[a] = leave.upper();
    }
    for (int a = 0; a < 3; ++a) {
        const int b = a == 2 ? 0 : a + 1;
        if ((first[a] > last[b]) | (first[b] > last[a])) return true;
    }
    return false;
}

}  // namespace
}  // namespace wrt

// Packets in the cells of a kd-tree: an interval of t for each ray, or one for all
// (wrt.kernels.classics.traversal.omnidirectional and packet_cells).
#pragma once
#include "packet.h"

namespace wrt {
namespace {

/// Writes the interval of each ray in the box from `low` to `high`, clipped to its range; returns the number of rays inside.
/// cells: `entry` of the P rays, then `leave`.
template <int P, int W, bool SHARED, class Bounds, class Vec3>
inline CUDA_CALLABLE int enter_cell(
    const Packet<P, W, SHARED>& packet, const Bounds& bounds, const Vec3& low, const Vec3& high, float* cells)
{
    float *entry = cells, *leave = cells + P;
    const SharedOrigin shared = shared_origin(bounds);
    const float lows[3] = {low.c[0], low.c[1], low.c[2]}, highs[3] = {high.c[0], high.c[1], high.c[2]};
    int inside = 0;
    WRT_FOR (P, k) {
        const Interval own = ray_slab(packet, shared, k, lows, highs, packet.t_min[k], packet.t[k]);
        entry[k] = own.enter;
        leave[k] = own.leave;
        inside += own.enter <= own.leave ? 1 : 0;
    }
    return inside;
}

/// Moves the rays to a child of a node, along one axis. inverse: 1 / direction along it; from, from_all: the origins, or that
/// of all rays.
template <int P, int W, bool SHARED>
inline CUDA_CALLABLE int split_along(const Packet<P, W, SHARED>& packet, const float* inverse, const float* from,
    float from_all, float slack_of_all, float position, float* entry, float* leave)
{
    float before[P], behind[P];
    int left = 0, right = 0, leftwards = 0;
    WRT_FOR (P, k) {
        const float i = inverse[k], o = SHARED ? from_all : from[k], wide = SHARED ? slack_of_all : packet.slack[k];
        const bool back = i < 0.0f, inside = entry[k] <= leave[k];
        const float step = back ? -wide : wide;
        float out = (position - (o - step)) * i, in = (position - (o + step)) * i;
        out = out < leave[k] ? out : leave[k];
        in = in > entry[k] ? in : entry[k];
        before[k] = out;
        behind[k] = in;
        const bool near = inside & (entry[k] <= out), far = inside & (in <= leave[k]);
        left += (back ? far : near) ? 1 : 0;
        right += (back ? near : far) ? 1 : 0;
        leftwards += (near & far) ? (back ? -1 : 1) : 0;
    }
    const bool both = (left > 0) & (right > 0), go_right = both ? leftwards < 0 : right > 0;
    WRT_FOR (P, k) {
        const bool far = (inverse[k] < 0.0f) != go_right;
        const float e = entry[k], l = leave[k], b = before[k], c = behind[k];
        entry[k] = far ? c : e;
        leave[k] = far ? l : b;
    }
    return (go_right ? 1 : 0) | (both ? 2 : 0);
}

/// Moves the rays to a child of a node. Bit 0: the child is the right one. Bit 1: both must be visited; the move is then to the
/// child that is near for the majority of the rays that visit both.
template <int P, int W, bool SHARED, class Bounds>
inline CUDA_CALLABLE int split_cell(
    const Packet<P, W, SHARED>& packet, const Bounds& bounds, int axis, float position, float* cells)
{
    const float from = bounds.origin_low.c[axis], slack = bounds.slack;
    // a loop is vectorised only if its pointers are known: once for each axis
    if (axis == 0) return split_along(packet, packet.inverse_x, packet.origin_x, from, slack, position, cells, cells + P);
    if (axis == 1) return split_along(packet, packet.inverse_y, packet.origin_y, from, slack, position, cells, cells + P);
    return split_along(packet, packet.inverse_z, packet.origin_z, from, slack, position, cells, cells + P);
}

/// A plane for all rays in a cell from `entry` to `leave`. turn: negative if the right child comes first; near_leave,
/// far_enter: t at which the last ray leaves the first child, and at which the first ray enters the second.
struct Crossed {
    float turn, near_leave, far_enter;
};

template <class Bounds>
inline CUDA_CALLABLE Crossed cross_plane(const Bounds& bounds, int axis, float position, float entry, float leave)
{
    const float large = bounds.inverse_large.c[axis], small = bounds.inverse_small.c[axis];
    if (large == large) {
        float d = position - bounds.origin_out.c[axis], p = d * large, q = d * small;
        q = q > p ? q : p;
        const float near_leave = q < leave ? q : leave;
        d = position - bounds.origin_in.c[axis], p = d * large, q = d * small;
        q = q < p ? q : p;
        return {large, near_leave, q > entry ? q : entry};
    }
    const float forward = bounds.forward_small.c[axis], backward = bounds.backward_small.c[axis];
    const float right_of = position - (bounds.origin_high.c[axis] + bounds.slack);
    const float left_of = position - (bounds.origin_low.c[axis] - bounds.slack);
    const bool no_right = (right_of > 0.0f) & (right_of * forward > leave) & (right_of * backward < entry);
    const bool no_left = (left_of < 0.0f) & (left_of * backward > leave) & (left_of * forward < entry);
    const bool right_first = -backward < forward;
    return {right_first ? -1.0f : 1.0f, (right_first ? no_right : no_left) ? -WRT_INFINITY : leave,
        (right_first ? no_left : no_right) ? WRT_INFINITY : entry};
}

}  // namespace
}  // namespace wrt

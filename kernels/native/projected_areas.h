// Areas of the projections of boxes along the rays of an influence area: wrt.kernels.influence.box_projection, .box_clipping.
#pragma once
#include "lanes.h"

namespace wrt {
namespace {

/// Results in place of an area: the box must be clipped to the window, or to the near plane.
constexpr float NEEDS_WINDOW = -1.0f, NEEDS_NEAR = -2.0f;

/// `AreaView` as plain numbers; across: sizes of the components of forward, z.
struct AreaFrame {
    float eye[3], x[3], y[3], z[3], across[3];
    float half_x, half_y, near;
    bool radial;
};

template <class View> inline CUDA_CALLABLE AreaFrame frame_of(const View& view)
{
    AreaFrame frame;
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        frame.eye[a] = view.eye.c[a];
        frame.x[a] = view.right.c[a];
        frame.y[a] = view.up.c[a];
        frame.z[a] = view.forward.c[a];
        frame.across[a] = WRT_ABS(view.forward.c[a]);
    }
    frame.half_x = view.half.c[0], frame.half_y = view.half.c[1], frame.near = view.near;
    frame.radial = view.radial;
    return frame;
}

/// The contribution of the lower and upper ends of a box to a coordinate of its corners.
struct Terms {
    float low[3], high[3];

    /// Bit a of a corner's number selects the upper end along axis a.
    CUDA_CALLABLE float corner(int c) const
    {
        return (c & 1 ? high[0] : low[0]) + (c & 2 ? high[1] : low[1]) + (c & 4 ? high[2] : low[2]);
    }
    CUDA_CALLABLE float lower() const { return smaller(low[0], high[0]) + smaller(low[1], high[1]) + smaller(low[2], high[2]); }
    CUDA_CALLABLE float upper() const { return larger(low[0], high[0]) + larger(low[1], high[1]) + larger(low[2], high[2]); }
};

struct Box {
    float low[3], high[3];
};

inline CUDA_CALLABLE Terms terms_of(const Box& box, const float* eye, const float* axis)
{
    Terms terms;
    WRT_UNROLLED
    for (int a = 0; a < 3; ++a) {
        terms.low[a] = (box.low[a] - eye[a]) * axis[a];
        terms.high[a] = (box.high[a] - eye[a]) * axis[a];
    }
    return terms;
}

/// The bounds of a projection.
struct Extent {
    float left, right, bottom, top, depth, farthest;

    CUDA_CALLABLE bool is_whole(const AreaFrame& frame) const
    {
        return (left >= -frame.half_x) & (right <= frame.half_x) & (bottom >= -frame.half_y) & (top <= frame.half_y)
            & (depth >= frame.near);
    }
    CUDA_CALLABLE bool is_ahead(const AreaFrame& frame) const
    {
        return (left <= frame.half_x) & (right >= -frame.half_x) & (bottom <= frame.half_y) & (top >= -frame.half_y);
    }
};

/// The area if a box is whole; else what must be done if it is shown.
inline CUDA_CALLABLE float whole_or_less(
    const AreaFrame& frame, const Box& box, const Extent& extent, float area, bool is_shown)
{
    const float less = extent.depth >= frame.near ? NEEDS_WINDOW : NEEDS_NEAR;
    return extent.is_whole(frame) ? area : ((box.low[0] <= box.high[0]) & is_shown) ? less : 0.0f;
}

/// Parallel rays: three parallelograms.
inline CUDA_CALLABLE float parallel_area(const AreaFrame& frame, const Box& box)
{
    const Terms x = terms_of(box, frame.eye, frame.x), y = terms_of(box, frame.eye, frame.y);
    const Terms z = terms_of(box, frame.eye, frame.z);
    const float dx = box.high[0] - box.low[0], dy = box.high[1] - box.low[1], dz = box.high[2] - box.low[2];
    const float area = frame.across[0] * (dy * dz) + frame.across[1] * (dx * dz) + frame.across[2] * (dx * dy);
    const Extent extent = {x.lower(), x.upper(), y.lower(), y.upper(), z.lower(), z.upper()};
    return whole_or_less(frame, box, extent, area, extent.is_ahead(frame) & (extent.farthest >= frame.near));
}

/// The corners of the faces of a box, in order around each.
struct FaceCorners {
    int of[6][4] = {{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}};
};

/// Radial rays: half the sum of the areas of six quadrilaterals, each half the cross product of its diagonals.
inline CUDA_CALLABLE float radial_area(const AreaFrame& frame, const Box& box)
{
    constexpr FaceCorners FACES;
    const Terms along_x = terms_of(box, frame.eye, frame.x), along_y = terms_of(box, frame.eye, frame.y);
    const Terms along_z = terms_of(box, frame.eye, frame.z);
    float x[8], y[8], z[8];
    WRT_UNROLLED
    for (int c = 0; c < 8; ++c) {
        z[c] = along_z.corner(c);
        const float inverse = 1.0f / z[c];
        x[c] = along_x.corner(c) * inverse;
        y[c] = along_y.corner(c) * inverse;
    }
    float area = 0.0f;
    WRT_UNROLLED
    for (int f = 0; f < 6; ++f) {
        const int a = FACES.of[f][0], b = FACES.of[f][1], c = FACES.of[f][2], d = FACES.of[f][3];
        area += WRT_ABS((x[c] - x[a]) * (y[d] - y[b]) - (x[d] - x[b]) * (y[c] - y[a]));
    }
    Extent extent = {x[0], x[0], y[0], y[0], z[0], z[0]};
    WRT_UNROLLED
    for (int c = 1; c < 8; ++c) {
        extent.left = smaller(extent.left, x[c]), extent.right = larger(extent.right, x[c]);
        extent.bottom = smaller(extent.bottom, y[c]), extent.top = larger(extent.top, y[c]);
        extent.depth = smaller(extent.depth, z[c]), extent.farthest = larger(extent.farthest, z[c]);
    }
    const bool is_shown = (extent.is_ahead(frame) | (extent.depth < frame.near)) & (extent.farthest >= frame.near);
    return whole_or_less(frame, box, extent, 0.25f * area, is_shown);
}

template <class View, class Vec> inline CUDA_CALLABLE float whole_area(const View& view, const Vec& low, const Vec& high)
{
    const AreaFrame frame = frame_of(view);
    const Box box = {{low.c[0], low.c[1], low.c[2]}, {high.c[0], high.c[1], high.c[2]}};
    return frame.radial ? radial_area(frame, box) : parallel_area(frame, box);
}

/// boxes: six rows of `count` numbers.
template <class View>
inline CUDA_CALLABLE void whole_areas(const View& view, const float* __restrict__ boxes, int count, float* __restrict__ to)
{
    const AreaFrame frame = frame_of(view);
    const auto box = [&](int i) {
        return Box {{boxes[i], boxes[count + i], boxes[2 * count + i]},
            {boxes[3 * count + i], boxes[4 * count + i], boxes[5 * count + i]}};
    };
    if (frame.radial) {
        WRT_FOR (count, i) {
            to[i] = radial_area(frame, box(i));
        }
    } else {
        WRT_FOR (count, i) {
            to[i] = parallel_area(frame, box(i));
        }
    }
}

}  // namespace
}  // namespace wrt

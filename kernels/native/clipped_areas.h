// Areas of the projections of boxes that the window or the near plane of an influence area cuts:
// wrt.kernels.influence.box_clipping.
//
// The outer loops go over corners, edges and faces, and each inner loop over W boxes: as fast as one loop over the boxes, and
// half the compile time.
#pragma once
#include "projected_areas.h"

#if WRT_VECTORS
#define WRT_ROLLED _Pragma("clang loop unroll(disable)")
#else
#define WRT_ROLLED
#endif

namespace wrt {
namespace {

/// The corners of W boxes in the view's frame, and their projections.
template <int W> struct BoxCorners {
    float x[8][W], y[8][W], z[8][W], picture_x[8][W], picture_y[8][W];
};

/// Where the near plane cuts the edges of W boxes.
template <int W> struct EdgeCuts {
    float x[12][W], y[12][W];
};

/// The 12 edges of W boxes, and of each face the edge in the near plane. Edges that are not there run from 0 to 0.
template <int W> struct BoxEdges {
    float from_x[18][W], from_y[18][W], to_x[18][W], to_y[18][W];
};

/// Corners at the ends of edges; edges around each face, where they begin, and whether they are run along or against.
struct EdgeTables {
    int from[12] = {0, 2, 4, 6, 0, 1, 4, 5, 0, 1, 2, 3}, to[12] = {1, 3, 5, 7, 2, 3, 6, 7, 4, 5, 6, 7};
    int face[6][4] = {{8, 6, 10, 4}, {5, 11, 7, 9}, {0, 9, 2, 8}, {10, 3, 11, 1}, {4, 1, 5, 0}, {2, 7, 3, 6}};
    FaceCorners start;
    float turn[4] = {1.0f, 1.0f, -1.0f, -1.0f};
};

template <int W> inline CUDA_CALLABLE void place_corners(const AreaFrame& frame, const float (&box)[6][W], BoxCorners<W>& at)
{
    const float eye0 = frame.eye[0], eye1 = frame.eye[1], eye2 = frame.eye[2];
    const float x0 = frame.x[0], x1 = frame.x[1], x2 = frame.x[2], y0 = frame.y[0], y1 = frame.y[1], y2 = frame.y[2];
    const float z0 = frame.z[0], z1 = frame.z[1], z2 = frame.z[2];
    const bool radial = frame.radial;
    WRT_ROLLED
    for (int c = 0; c < 8; ++c) {
        const float *along0 = box[c & 1 ? 3 : 0], *along1 = box[c & 2 ? 4 : 1], *along2 = box[c & 4 ? 5 : 2];
        WRT_FOR_LANES (i) {
            const float u = along0[i] - eye0, v = along1[i] - eye1, w = along2[i] - eye2;
            at.x[c][i] = u * x0 + v * x1 + w * x2;
            at.y[c][i] = u * y0 + v * y1 + w * y2;
            at.z[c][i] = u * z0 + v * z1 + w * z2;
            const float scale = radial ? 1.0f / at.z[c][i] : 1.0f;
            at.picture_x[c][i] = at.x[c][i] * scale;
            at.picture_y[c][i] = at.y[c][i] * scale;
        }
    }
}

/// Edges of boxes that the near plane does not cut; those of boxes behind it are not there.
template <int W>
inline CUDA_CALLABLE void place_edges(const EdgeTables& tables, float near, const BoxCorners<W>& at, BoxEdges<W>& edges)
{
    WRT_ROLLED
    for (int e = 0; e < 12; ++e) {
        const int a = tables.from[e], b = tables.to[e];
        WRT_FOR_LANES (i) {
            const bool ahead = at.z[a][i] >= near;
            edges.from_x[e][i] = ahead ? at.picture_x[a][i] : 0.0f;
            edges.from_y[e][i] = ahead ? at.picture_y[a][i] : 0.0f;
            edges.to_x[e][i] = ahead ? at.picture_x[b][i] : 0.0f;
            edges.to_y[e][i] = ahead ? at.picture_y[b][i] : 0.0f;
        }
    }
}

/// The part of each edge in front of the near plane.
template <int W>
inline CUDA_CALLABLE void cut_edges(
    const EdgeTables& tables, const AreaFrame& frame, const BoxCorners<W>& at, EdgeCuts<W>& cuts, BoxEdges<W>& edges)
{
    const float near = frame.near, at_near = frame.radial ? 1.0f / near : 1.0f;
    WRT_ROLLED
    for (int e = 0; e < 12; ++e) {
        const int a = tables.from[e], b = tables.to[e];
        WRT_FOR_LANES (i) {
            const bool ahead_a = at.z[a][i] >= near, ahead_b = at.z[b][i] >= near, ahead = ahead_a | ahead_b;
            const float share = (near - at.z[a][i]) / (at.z[b][i] - at.z[a][i]);
            const float at_x = ahead ? (at.x[a][i] + share * (at.x[b][i] - at.x[a][i])) * at_near : 0.0f;
            const float at_y = ahead ? (at.y[a][i] + share * (at.y[b][i] - at.y[a][i])) * at_near : 0.0f;
            cuts.x[e][i] = at_x;
            cuts.y[e][i] = at_y;
            edges.from_x[e][i] = ahead_a ? at.picture_x[a][i] : at_x;
            edges.from_y[e][i] = ahead_a ? at.picture_y[a][i] : at_y;
            edges.to_x[e][i] = ahead_b ? at.picture_x[b][i] : at_x;
            edges.to_y[e][i] = ahead_b ? at.picture_y[b][i] : at_y;
        }
    }
}

/// The edge of each face in the near plane.
template <int W>
inline CUDA_CALLABLE void close_faces(
    const EdgeTables& tables, float near, const BoxCorners<W>& at, const EdgeCuts<W>& cuts, BoxEdges<W>& edges)
{
    WRT_ROLLED
    for (int f = 0; f < 6; ++f) {
        const int *e = tables.face[f], *a = tables.start.of[f];
        WRT_FOR_LANES (i) {
            const bool ahead0 = at.z[a[0]][i] >= near, ahead1 = at.z[a[1]][i] >= near;
            const bool ahead2 = at.z[a[2]][i] >= near, ahead3 = at.z[a[3]][i] >= near;
            const float x0 = cuts.x[e[0]][i], x1 = cuts.x[e[1]][i], x2 = cuts.x[e[2]][i], x3 = cuts.x[e[3]][i];
            const float y0 = cuts.y[e[0]][i], y1 = cuts.y[e[1]][i], y2 = cuts.y[e[2]][i], y3 = cuts.y[e[3]][i];
            const bool leaves0 = ahead0 & !ahead1, leaves1 = ahead1 & !ahead2;
            const bool leaves2 = ahead2 & !ahead3, leaves3 = ahead3 & !ahead0;
            const bool enters0 = !ahead0 & ahead1, enters1 = !ahead1 & ahead2;
            const bool enters2 = !ahead2 & ahead3, enters3 = !ahead3 & ahead0;
            edges.from_x[12 + f][i] = leaves0 ? x0 : leaves1 ? x1 : leaves2 ? x2 : leaves3 ? x3 : 0.0f;
            edges.from_y[12 + f][i] = leaves0 ? y0 : leaves1 ? y1 : leaves2 ? y2 : leaves3 ? y3 : 0.0f;
            edges.to_x[12 + f][i] = enters0 ? x0 : enters1 ? x1 : enters2 ? x2 : enters3 ? x3 : 0.0f;
            edges.to_y[12 + f][i] = enters0 ? y0 : enters1 ? y1 : enters2 ? y2 : enters3 ? y3 : 0.0f;
        }
    }
}

inline CUDA_CALLABLE float clamped(float a, float half) { return smaller(larger(a, -half), half); }

/// The mean of what two ends of a line are above 0.
inline CUDA_CALLABLE float mean_above(float p, float q, float rise)
{
    const float above_p = larger(p, 0.0f), above_q = larger(q, 0.0f);
    return ((p > 0.0f) & (q > 0.0f)) ? 0.5f * (p + q) : 0.5f * (above_p * above_p + above_q * above_q) * rise;
}

/// The integral of y - base over x along each edge, both clamped to the window. size: the sum of their sizes.
template <int W>
inline CUDA_CALLABLE void integrate(const AreaFrame& frame, int count, const float (&base_y)[W], const BoxEdges<W>& edges,
    float (&integral)[18][W], float (&size)[W])
{
    const float half_x = frame.half_x, half_y = frame.half_y;
    WRT_FOR_LANES (i) {
        size[i] = 0.0f;
    }
    WRT_ROLLED
    for (int k = 0; k < count; ++k) {
        WRT_FOR_LANES (i) {
            const float xa = edges.from_x[k][i], ya = edges.from_y[k][i], xb = edges.to_x[k][i], yb = edges.to_y[k][i];
            const float base = clamped(base_y[i], half_y), begin = clamped(xa, half_x), end = clamped(xb, half_x);
            const float slope = xb == xa ? 0.0f : (yb - ya) / (xb - xa);
            const float p = ya + (begin - xa) * slope, q = ya + (end - xa) * slope;
            const float rise = p == q ? 1.0f : 1.0f / WRT_ABS(q - p);
            const float above = mean_above(p - half_y, q - half_y, rise), below = mean_above(-half_y - p, -half_y - q, rise);
            integral[k][i] = (0.5f * (p + q) - above + below - base) * (end - begin);
            size[i] += WRT_ABS(integral[k][i]);
        }
    }
}

/// Half the sum of the areas of the faces; 0 for a box that is empty, or whose faces cancel but for rounding.
template <int W>
inline CUDA_CALLABLE void add_faces(const EdgeTables& tables, bool by_near, const float (&box)[6][W],
    const float (&integral)[18][W], const float (&size)[W], float (&area)[W])
{
    constexpr float ROUNDING = 4.76837158203125e-07f;  // 2^-21
    const float* s = tables.turn;
    float rest[W];
    WRT_FOR_LANES (i) {
        area[i] = rest[i] = 0.0f;
    }
    WRT_ROLLED
    for (int f = 0; f < 6; ++f) {
        const int* e = tables.face[f];
        WRT_FOR_LANES (i) {
            const float closing = by_near ? integral[12 + f][i] : 0.0f;
            const float face = s[0] * integral[e[0]][i] + s[1] * integral[e[1]][i] + s[2] * integral[e[2]][i]
                + s[3] * integral[e[3]][i] + closing;
            area[i] += WRT_ABS(face);
            rest[i] += face;
        }
    }
    WRT_FOR_LANES (i) {
        const float all = 0.5f * (area[i] + (by_near ? WRT_ABS(rest[i]) : 0.0f));
        const bool seen = !by_near | (all > ROUNDING * size[i]);
        area[i] = ((box[0][i] <= box[3][i]) & seen) ? all : 0.0f;
    }
}

/// Areas of W boxes. by_near: whether the near plane may cut them.
template <int W>
inline CUDA_CALLABLE void clip_boxes(const AreaFrame& frame, bool by_near, const float (&box)[6][W], float (&area)[W])
{
    constexpr EdgeTables TABLES;
    BoxCorners<W> at;
    EdgeCuts<W> cuts;
    BoxEdges<W> edges;
    float integral[18][W], size[W];
    place_corners<W>(frame, box, at);
    if (by_near) {
        cut_edges<W>(TABLES, frame, at, cuts, edges);
        close_faces<W>(TABLES, frame.near, at, cuts, edges);
    } else {
        place_edges<W>(TABLES, frame.near, at, edges);
    }
    integrate<W>(frame, by_near ? 18 : 12, at.picture_y[0], edges, integral, size);
    add_faces<W>(TABLES, by_near, box, integral, size, area);
}

template <class View, class Vec>
inline CUDA_CALLABLE float clipped_area(const View& view, const Vec& low, const Vec& high, bool by_near)
{
    float area[1];
    const float box[6][1] = {{low.c[0]}, {low.c[1]}, {low.c[2]}, {high.c[0]}, {high.c[1]}, {high.c[2]}};
    clip_boxes<1>(frame_of(view), by_near, box, area);
    return area[0];
}

/// boxes: six rows of `count` numbers. On CUDA, boxes are processed one by one.
template <class View>
inline CUDA_CALLABLE void clipped_areas(const View& view, const float* boxes, int count, bool by_near, float* areas)
{
#if defined(__CUDA_ARCH__)
    constexpr int W = 1;
#else
    constexpr int W = 16;
#endif
    const AreaFrame frame = frame_of(view);
    float box[6][W], area[W];
    for (int begin = 0; begin < count; begin += W) {
        const int here = count - begin < W ? count - begin : W;
        for (int a = 0; a < 6; ++a) {
            const float* from = boxes + a * count + begin;
            if (here == W) {
                WRT_FOR_LANES (i) {
                    box[a][i] = from[i];
                }
            } else {
                WRT_SCALAR
                for (int i = 0; i < W; ++i) box[a][i] = from[i < here - 1 ? i : here - 1];
            }
        }
        clip_boxes<W>(frame, by_near, box, area);
        for (int i = 0; i < here; ++i) areas[begin + i] = area[i];
    }
}

}  // namespace
}  // namespace wrt

"""Projected areas of boxes that the window or the near plane of an influence area cuts.

**Window.** A window cuts polygons. The area of the part inside is the sum, over the polygon's edges, of the integral of y,
clamped to the window, over the part of x inside the window. y is linear in x, so the mean of the clamped excess is that of a
trapezoid or triangle above the window's edge. All cases evaluate the same expression at the same points.

**Near plane.** A near plane cuts boxes. A cut box has at most one more edge per face, from where the face crosses the plane to
where it crosses back, and one more face, in the plane. The signed areas of the projections of all faces, each traversed as seen
from outside, sum to 0. So the new face has minus the summed area of the others, and is never constructed.

Rounding leaves a residue for a box that the near plane cuts and that lies beside the window: a result below 2^-21 of the sum of
all edges' integrals becomes 0.

Neither case needs a branch, so both run in vector lanes. The outer loops go over corners, edges and faces, and each inner loop
over the lanes: as fast as a single loop over the lanes, and half the compile time
(notebooks/records/2026-11-21-bvh-builders.md). On CUDA, boxes are processed one by one.
"""

import warp as wp

from wrt.kernels.influence.box_projection import FACES, HEAD, NEEDS_NEAR, whole_area
from wrt.kernels.influence.view import AreaView
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module

exact_module(__name__)

_EDGES = [(a, a | 1 << axis) for axis in range(3) for a in range(8) if not a >> axis & 1]
_SIDES = [[(a, b) for a, b in zip(face, (*face[1:], face[0]), strict=True)] for face in FACES]
"""Edges around each face, as pairs of corners."""


def _table(rows: list) -> str:
    """A C++ initialiser list of numbers."""
    return f"{{{', '.join(_table(row) if isinstance(row, list) else str(row) for row in rows)}}}"


_TABLES = f"""
    const int edge_from[12] = {_table([a for a, _ in _EDGES])}, edge_to[12] = {_table([b for _, b in _EDGES])};
    const int side_edge[6][4] = {_table([[_EDGES.index((min(side), max(side))) for side in face] for face in _SIDES])};
    const int side_from[6][4] = {_table([[a for a, _ in face] for face in _SIDES])};
    const float turn[6][4] = {_table([[1.0 if a < b else -1.0 for a, b in face] for face in _SIDES])};
"""

_CORNERS = """
        WRT_ROLLED for (int c = 0; c < 8; ++c) {
            const float *along0 = box[c & 1 ? 3 : 0], *along1 = box[c & 2 ? 4 : 1], *along2 = box[c & 4 ? 5 : 2];
            WRT_FOR_LANES(i) {
                const float u = along0[i] - eye0, v = along1[i] - eye1, w = along2[i] - eye2;
                x[c][i] = u * x_0 + v * x_1 + w * x_2;
                y[c][i] = u * y_0 + v * y_1 + w * y_2;
                z[c][i] = u * z_0 + v * z_1 + w * z_2;
                const float scale = radial ? 1.0f / z[c][i] : 1.0f;
                picture_x[c][i] = x[c][i] * scale;
                picture_y[c][i] = y[c][i] * scale;
            }
        }
"""
"""C++: the corners in the view's frame, and their projections."""

_WHOLE_EDGES = """
            WRT_ROLLED for (int e = 0; e < 12; ++e) {
                const int a = edge_from[e], b = edge_to[e];
                WRT_FOR_LANES(i) {
                    const bool ahead = z[a][i] >= near;
                    from_x[e][i] = ahead ? picture_x[a][i] : 0.0f; from_y[e][i] = ahead ? picture_y[a][i] : 0.0f;
                    to_x[e][i] = ahead ? picture_x[b][i] : 0.0f; to_y[e][i] = ahead ? picture_y[b][i] : 0.0f;
                }
            }
"""
"""C++: edges of boxes that the near plane does not cut; edges of boxes behind it run from 0 to 0."""

_CUT_EDGES = """
            WRT_ROLLED for (int e = 0; e < 12; ++e) {
                const int a = edge_from[e], b = edge_to[e];
                WRT_FOR_LANES(i) {
                    const bool ahead_a = z[a][i] >= near, ahead_b = z[b][i] >= near, ahead = ahead_a | ahead_b;
                    const float share = (near - z[a][i]) / (z[b][i] - z[a][i]);
                    const float at_x = ahead ? (x[a][i] + share * (x[b][i] - x[a][i])) * at_near : 0.0f;
                    const float at_y = ahead ? (y[a][i] + share * (y[b][i] - y[a][i])) * at_near : 0.0f;
                    cut_x[e][i] = at_x; cut_y[e][i] = at_y;
                    from_x[e][i] = ahead_a ? picture_x[a][i] : at_x; from_y[e][i] = ahead_a ? picture_y[a][i] : at_y;
                    to_x[e][i] = ahead_b ? picture_x[b][i] : at_x; to_y[e][i] = ahead_b ? picture_y[b][i] : at_y;
                }
            }
            WRT_ROLLED for (int f = 0; f < 6; ++f) {
                const int *e = side_edge[f], *a = side_from[f];
                WRT_FOR_LANES(i) {
                    const bool ahead0 = z[a[0]][i] >= near, ahead1 = z[a[1]][i] >= near;
                    const bool ahead2 = z[a[2]][i] >= near, ahead3 = z[a[3]][i] >= near;
                    const float x0 = cut_x[e[0]][i], x1 = cut_x[e[1]][i], x2 = cut_x[e[2]][i], x3 = cut_x[e[3]][i];
                    const float y0 = cut_y[e[0]][i], y1 = cut_y[e[1]][i], y2 = cut_y[e[2]][i], y3 = cut_y[e[3]][i];
                    const bool leaves0 = ahead0 & !ahead1, leaves1 = ahead1 & !ahead2;
                    const bool leaves2 = ahead2 & !ahead3, leaves3 = ahead3 & !ahead0;
                    const bool enters0 = !ahead0 & ahead1, enters1 = !ahead1 & ahead2;
                    const bool enters2 = !ahead2 & ahead3, enters3 = !ahead3 & ahead0;
                    from_x[12 + f][i] = leaves0 ? x0 : leaves1 ? x1 : leaves2 ? x2 : leaves3 ? x3 : 0.0f;
                    from_y[12 + f][i] = leaves0 ? y0 : leaves1 ? y1 : leaves2 ? y2 : leaves3 ? y3 : 0.0f;
                    to_x[12 + f][i] = enters0 ? x0 : enters1 ? x1 : enters2 ? x2 : enters3 ? x3 : 0.0f;
                    to_y[12 + f][i] = enters0 ? y0 : enters1 ? y1 : enters2 ? y2 : enters3 ? y3 : 0.0f;
                }
            }
"""
"""C++: the part of each edge in front of the near plane, from 0 to 0 if there is none; then the edge of each face in the
plane."""

_INTEGRALS = """
        WRT_ROLLED for (int k = 0; k < (by_near ? 18 : 12); ++k) WRT_FOR_LANES(i) {
            const float xa = from_x[k][i], ya = from_y[k][i], xb = to_x[k][i], yb = to_y[k][i];
            const float base = WRT_CUT(picture_y[0][i], half_y), begin = WRT_CUT(xa, half_x), end = WRT_CUT(xb, half_x);
            const float slope = xb == xa ? 0.0f : (yb - ya) / (xb - xa);
            const float p = ya + (begin - xa) * slope, q = ya + (end - xa) * slope;
            const float rise = p == q ? 1.0f : 1.0f / WRT_ABS(q - p);
            const float above = WRT_BEYOND(p - half_y, q - half_y, rise), below = WRT_BEYOND(-half_y - p, -half_y - q, rise);
            integral[k][i] = (0.5f * (p + q) - above + below - base) * (end - begin);
            size[i] += WRT_ABS(integral[k][i]);
        }
"""
"""C++: the integral of y - base over x along each edge, both clamped to the window."""

_FACES_ADDED = """
        float area[W], rest[W];
        WRT_FOR_LANES(i) area[i] = rest[i] = 0.0f;
        WRT_ROLLED for (int f = 0; f < 6; ++f) {
            const int* e = side_edge[f];
            const float* s = turn[f];
            WRT_FOR_LANES(i) {
                const float closing = by_near ? integral[12 + f][i] : 0.0f;
                const float face = s[0] * integral[e[0]][i] + s[1] * integral[e[1]][i] + s[2] * integral[e[2]][i]
                    + s[3] * integral[e[3]][i] + closing;
                area[i] += WRT_ABS(face);
                rest[i] += face;
            }
        }
        WRT_FOR_LANES(i) {
            const float all = 0.5f * (area[i] + (by_near ? WRT_ABS(rest[i]) : 0.0f));
            const bool seen = !by_near | (all > ROUNDING * size[i]);
            area[i] = ((box[0][i] <= box[3][i]) & seen) ? all : 0.0f;
        }
"""


def _clipped(lanes: int, count: str, load: str, store: str) -> str:
    """C++ that clips `lanes` boxes at once; `begin` is the first of them."""
    return f"""{HEAD}
#ifndef WRT_ROLLED
#if defined(__clang__) && !defined(__CUDA_ARCH__)
#define WRT_ROLLED _Pragma("clang loop unroll(disable)")
#else
#define WRT_ROLLED
#endif
#define WRT_CUT(a, half) WRT_LESS(WRT_MORE(a, -(half)), half)
#define WRT_ABOVE_0(a) WRT_MORE(a, 0.0f)
#define WRT_BEYOND(p, q, rise) ((((p) > 0.0f) & ((q) > 0.0f)) ? 0.5f * ((p) + (q)) \\
    : 0.5f * (WRT_ABOVE_0(p) * WRT_ABOVE_0(p) + WRT_ABOVE_0(q) * WRT_ABOVE_0(q)) * (rise))
#endif
#if defined(__CUDA_ARCH__)
    constexpr int W = 1;
#else
    constexpr int W = {lanes};
#endif
{_TABLES}
    constexpr float ROUNDING = {2.0**-21!r}f;
    const float at_near = radial ? 1.0f / near : 1.0f;
    float box[6][W], x[8][W], y[8][W], z[8][W], picture_x[8][W], picture_y[8][W], integral[18][W];
    float cut_x[12][W], cut_y[12][W], from_x[18][W], from_y[18][W], to_x[18][W], to_y[18][W];
    for (int begin = 0; begin < {count}; begin += W) {{
        {load}
{_CORNERS}
        float size[W];
        WRT_FOR_LANES(i) size[i] = 0.0f;
        if (by_near) {{
{_CUT_EDGES}
        }} else {{
{_WHOLE_EDGES}
        }}
{_INTEGRALS}
{_FACES_ADDED}
        {store}
    }}
"""


@native.func_native(
    "lanes.h",
    _clipped(
        1,
        "1",
        "for (int a = 0; a < 3; ++a) { box[a][0] = low.c[a]; box[a + 3][0] = high.c[a]; }",
        "return area[0];",
    )
    + "return 0.0f;",
)
def clipped_area(view: AreaView, low: wp.vec3, high: wp.vec3, by_near: bool) -> float:
    """Area of a box's projection within the window. `by_near`: whether the near plane may cut the box."""
    ...


@native.func_native(
    "lanes.h",
    _clipped(
        16,
        "count",
        """const int here = WRT_LESS(count - begin, W);
        for (int a = 0; a < 6; ++a) {
            const float* from = boxes.data + a * count + begin;
            if (here == W) WRT_FOR_LANES(i) box[a][i] = from[i];
            else WRT_SCALAR for (int i = 0; i < W; ++i) box[a][i] = from[WRT_LESS(i, here - 1)];
        }""",
        "for (int i = 0; i < here; ++i) areas.data[begin + i] = area[i];",
    ),
)
def clipped_areas(view: AreaView, boxes: wp.array(dtype=float), count: int, by_near: bool, areas: wp.array(dtype=float)):
    """`clipped_area` of many boxes. Arrays as in `whole_areas`."""
    ...


@wp.func
def projected_area(view: AreaView, low: wp.vec3, high: wp.vec3):
    """Area of a box's projection within the window. Parallel rays: in square units across the rays; radial rays: in the plane
    at depth 1. 0 for a box that no ray of the area meets."""
    area = whole_area(view, low, high)
    if area < 0.0:
        area = clipped_area(view, low, high, area == NEEDS_NEAR)
    return area

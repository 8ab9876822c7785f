"""Projected areas of boxes: the share of an influence area's rays that meet a box.

**Problem.** Surface area measures how many lines of all directions meet a box. If all rays are parallel, or all pass through
one point, the right measure is the area that the box covers as seen along the rays (Falcone 2024, chapter 2): its shadow on a
plane across parallel rays, its perspective image for radial rays. Rays leave the area's near plane through its window, so only
the part of a box behind the plane and within the window counts (section 6.2.2).

**A box that needs no clipping** takes one expression without branches:

    parallel    |f_x| d_y d_z + |f_y| d_x d_z + |f_z| d_x d_y       three parallelograms, seen along the unit vector f
    radial      1/2 sum over the six faces of |projected area|      each point of the projection lies on two faces

The eight corners of the radial form are sums of one of two terms per axis, so they cost 18 products. The projections of the
faces are quadrilaterals, whose area is half the cross product of their diagonals. The published form follows the silhouette
instead. That takes less arithmetic, but the corners differ from box to box; the form here runs in vector lanes, one box per
lane.

`box_clipping` handles boxes that the window or the near plane cuts.

The far end of an area is ignored, because rays continue beyond it. Projections of radial areas are measured in the plane at
depth 1.

References:
    L. Falcone: Ray distribution aware heuristics for bounding volume hierarchies construction in ray tracing. MSc thesis,
        Politecnico di Milano, 2024.
"""

import warp as wp

from wrt.kernels.influence.view import AreaView
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_module

exact_module(__name__)

NEEDS_WINDOW = wp.constant(-1.0)
"""Returned instead of an area: the box must be clipped to the window."""

NEEDS_NEAR = wp.constant(-2.0)
"""Returned instead of an area: the box must be clipped to the near plane."""


_TERMS = "\n".join(
    f"const float {name}{axis}{end} = ({end}{axis} - eye{axis}) * {name}_{axis};"
    for axis in range(3)
    for end in ("low", "high")
    for name in ("x", "y", "z")
)
"""C++: the contribution of each coordinate low0 .. high2 of a box to (x, y, z) of a corner."""

_PARALLEL = f"""{_TERMS}
    const float dx = high0 - low0, dy = high1 - low1, dz = high2 - low2;
    float area = across0 * (dy * dz) + across1 * (dx * dz) + across2 * (dx * dy);
    const float left = WRT_LESS(x0low, x0high) + WRT_LESS(x1low, x1high) + WRT_LESS(x2low, x2high);
    const float right = WRT_MORE(x0low, x0high) + WRT_MORE(x1low, x1high) + WRT_MORE(x2low, x2high);
    const float bottom = WRT_LESS(y0low, y0high) + WRT_LESS(y1low, y1high) + WRT_LESS(y2low, y2high);
    const float top = WRT_MORE(y0low, y0high) + WRT_MORE(y1low, y1high) + WRT_MORE(y2low, y2high);
    const float depth = WRT_LESS(z0low, z0high) + WRT_LESS(z1low, z1high) + WRT_LESS(z2low, z2high);
    const float farthest = WRT_MORE(z0low, z0high) + WRT_MORE(z1low, z1high) + WRT_MORE(z2low, z2high);
    const bool whole = (left >= -half_x) & (right <= half_x) & (bottom >= -half_y) & (top <= half_y) & (depth >= near);
    const bool shown = (left <= half_x) & (right >= -half_x) & (bottom <= half_y) & (top >= -half_y) & (farthest >= near);
    area = whole ? area : ((low0 <= high0) & shown) ? (depth >= near ? -1.0f : -2.0f) : 0.0f;
"""

_ENDS = [["high" if corner >> axis & 1 else "low" for axis in range(3)] for corner in range(8)]
_CORNERS = "\n".join(
    f"const float z{c} = z0{a} + z1{b} + z2{d}, inverse{c} = 1.0f / z{c};"
    f"const float x{c} = (x0{a} + x1{b} + x2{d}) * inverse{c}, y{c} = (y0{a} + y1{b} + y2{d}) * inverse{c};"
    for c, (a, b, d) in enumerate(_ENDS)
)
FACES = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))
"""Corners of each face, in order around it."""
_QUADRILATERALS = "\n".join(
    f"area += WRT_ABS((x{c} - x{a}) * (y{d} - y{b}) - (x{d} - x{b}) * (y{c} - y{a}));" for a, b, c, d in FACES
)
_EXTENT = "\n".join(
    f"left = WRT_LESS(left, x{c}); right = WRT_MORE(right, x{c}); bottom = WRT_LESS(bottom, y{c}); top = WRT_MORE(top, y{c});"
    f"depth = WRT_LESS(depth, z{c}); farthest = WRT_MORE(farthest, z{c});"
    for c in range(1, 8)
)

_RADIAL = f"""{_TERMS}
{_CORNERS}
    float area = 0.0f, left = x0, right = x0, bottom = y0, top = y0, depth = z0, farthest = z0;
{_QUADRILATERALS}
{_EXTENT}
    const bool whole = (left >= -half_x) & (right <= half_x) & (bottom >= -half_y) & (top <= half_y) & (depth >= near);
    const bool ahead = (left <= half_x) & (right >= -half_x) & (bottom <= half_y) & (top >= -half_y);
    const bool shown = (ahead | (depth < near)) & (farthest >= near);
    area = whole ? 0.25f * area : ((low0 <= high0) & shown) ? (depth >= near ? -1.0f : -2.0f) : 0.0f;
"""

HEAD = """
#ifndef WRT_LESS
#define WRT_LESS(a, b) ((a) < (b) ? (a) : (b))
#define WRT_MORE(a, b) ((a) > (b) ? (a) : (b))
#endif
    const float eye0 = view.eye.c[0], eye1 = view.eye.c[1], eye2 = view.eye.c[2];
    const float x_0 = view.right.c[0], x_1 = view.right.c[1], x_2 = view.right.c[2];
    const float y_0 = view.up.c[0], y_1 = view.up.c[1], y_2 = view.up.c[2];
    const float z_0 = view.forward.c[0], z_1 = view.forward.c[1], z_2 = view.forward.c[2];
    const float half_x = view.half.c[0], half_y = view.half.c[1], near = view.near;
    const bool radial = view.radial;
"""
"""C++ at the start of every snippet for boxes: the view as plain numbers."""

_WHOLE = f"""{HEAD}
    const float across0 = WRT_ABS(z_0), across1 = WRT_ABS(z_1), across2 = WRT_ABS(z_2);
    (void)across0; (void)across1; (void)across2;
"""

_ONE = "\n".join(f"const float low{a} = low.c[{a}], high{a} = high.c[{a}];" for a in range(3))
_LANE = "\n".join(f"const float low{a} = from[{a} * count + i], high{a} = from[{a + 3} * count + i];" for a in range(3))


@native.func_native(
    "lanes.h",
    f"""{_WHOLE}
{_ONE}
    if (radial) {{ {_RADIAL} return area; }}
    {_PARALLEL}
    return area;
""",
)
def whole_area(view: AreaView, low: wp.vec3, high: wp.vec3) -> float:
    """Area of a box's projection if it lies wholly inside or outside the window; else NEEDS_WINDOW. NEEDS_NEAR if the near
    plane cuts the box, whatever the window does. 0 for an empty box."""
    ...


@native.func_native(
    "lanes.h",
    f"""{_WHOLE}
    const float* __restrict__ from = boxes.data;
    float* __restrict__ to = areas.data;
    if (radial) WRT_FOR(count, i) {{ {_LANE} {_RADIAL} to[i] = area; }}
    else WRT_FOR(count, i) {{ {_LANE} {_PARALLEL} to[i] = area; }}
""",
)
def whole_areas(view: AreaView, boxes: wp.array(dtype=float), count: int, areas: wp.array(dtype=float)):
    """`whole_area` of many boxes in vector lanes, with the same bits.

    boxes: (6 * count,) lower x, then lower y, lower z, upper x, upper y, upper z. areas: (count,) results."""
    ...

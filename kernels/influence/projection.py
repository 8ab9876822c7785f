"""Boxes as a ray distribution sees them: the share of its rays that meet a box is the area of the box's projection.

**Problem.** Surface area is the right measure of a box for lines in all directions. Where all rays are parallel, or all go
through one point, it is the area that the box covers as seen along the rays (Falcone 2024, chapter 2): of its shadow on a
plane across parallel rays, of its perspective picture for radial ones. Rays leave the area's near plane and pass through its
window, so only what is behind the one and within the other counts (section 6.2.2).

**A box that needs no clipping** takes one expression, without a branch:

    parallel    |f_x| d_y d_z + |f_y| d_x d_z + |f_z| d_x d_y       three parallelograms, seen along the unit vector f
    radial      1/2 sum over the six faces of |area of its picture|  each point of the picture lies on two faces

The eight corners of the second are sums of one of two terms an axis, so they cost 18 products, and the pictures of the faces
are quadrilaterals, whose area is half the cross product of their diagonals. The published form follows the silhouette
around, which is less arithmetic, but other corners for other boxes: this one runs in vector lanes, a box a lane.

**A box that the window cuts** does, too: the part of a polygon within the window is the sum, over its edges, of the integral
of y, cut off at the window, over the part of x within the window. y is linear in x, so the mean of what is cut off above is
that of the trapezoid or triangle above the window's edge: no case needs a corner that the others have not. Only a box that
the near plane cuts is left to `silhouette`.

The far end of an area plays no part: rays go on. Pictures of radial areas are measured in the plane at depth 1.

References:
    L. Falcone: Ray distribution aware heuristics for BVHs construction in ray tracing. MSc thesis, Politecnico di Milano,
        2024.
"""

import warp as wp

from wrt.kernels.influence.view import AreaView
from wrt.kernels.lanes import FOR_LANES

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

NEEDS_CLIPPING = wp.constant(-1.0)
"""In place of an area: the box has to be cut off at the window or at the near plane first."""


_TERMS = "\n".join(
    f"const float {name}{axis}{end} = ({end}{axis} - eye{axis}) * {name}_{axis};"
    for axis in range(3)
    for end in ("low", "high")
    for name in ("x", "y", "z")
)
"""What a coordinate low0 .. high2 of a box adds to (x, y, z) of a corner."""

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
    area = whole ? area : ((low0 <= high0) & shown) ? -1.0f : 0.0f;
"""

_ENDS = [["high" if corner >> axis & 1 else "low" for axis in range(3)] for corner in range(8)]
_CORNERS = "\n".join(
    f"const float z{c} = z0{a} + z1{b} + z2{d}, inverse{c} = 1.0f / z{c};"
    f"const float x{c} = (x0{a} + x1{b} + x2{d}) * inverse{c}, y{c} = (y0{a} + y1{b} + y2{d}) * inverse{c};"
    for c, (a, b, d) in enumerate(_ENDS)
)
_FACES = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))
"""Corners of each face, one after the other around it."""
_QUADRILATERALS = "\n".join(
    f"area += WRT_ABS((x{c} - x{a}) * (y{d} - y{b}) - (x{d} - x{b}) * (y{c} - y{a}));" for a, b, c, d in _FACES
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
    area = whole ? 0.25f * area : ((low0 <= high0) & shown) ? -1.0f : 0.0f;
"""

# -- a box that the window cuts ------------------------------------------------------------------------------------------

_PARALLEL_CORNERS = "\n".join(
    f"const float x{c} = x0{a} + x1{b} + x2{d}, y{c} = y0{a} + y1{b} + y2{d}, z{c} = z0{a} + z1{b} + z2{d};"
    for c, (a, b, d) in enumerate(_ENDS)
)


def _edge(a: int, b: int) -> str:
    """The integral of y - base over x from corner a to corner b, both cut off at the window."""
    x, y = f"x{b} - x{a}", f"y{b} - y{a}"
    e = f"{a}{b}"
    return f"""
    const float from{e} = WRT_CUT(x{a}, half_x), to{e} = WRT_CUT(x{b}, half_x);
    const float slope{e} = x{b} == x{a} ? 0.0f : ({y}) / ({x});
    const float p{e} = y{a} + (from{e} - x{a}) * slope{e}, q{e} = y{b} + (to{e} - x{b}) * slope{e};
    const float rise{e} = p{e} == q{e} ? 1.0f : 1.0f / WRT_ABS(q{e} - p{e});
    const float above{e} = WRT_BEYOND(p{e} - half_y, q{e} - half_y, rise{e});
    const float below{e} = WRT_BEYOND(-half_y - p{e}, -half_y - q{e}, rise{e});
    const float edge{e} = (0.5f * (p{e} + q{e}) - above{e} + below{e} - base) * (to{e} - from{e});"""


_EDGES = "\n".join(_edge(a, a | 1 << axis) for axis in range(3) for a in range(8) if not a >> axis & 1)
_CUT_FACES = "\n".join(
    "area += WRT_ABS("
    + " ".join(f"+ edge{a}{b}" if a < b else f"- edge{b}{a}" for a, b in zip(face, (*face[1:], face[0]), strict=True))
    + ");"
    for face in _FACES
)

_IN_WINDOW = f"""
    float area = 0.0f, depth = z0, farthest = z0;
    const float base = WRT_CUT(y0, half_y);
{_EDGES}
{_CUT_FACES}
{chr(10).join(f"depth = WRT_LESS(depth, z{c}); farthest = WRT_MORE(farthest, z{c});" for c in range(1, 8))}
    area = depth >= near ? 0.5f * area : ((low0 <= high0) & (farthest >= near)) ? -1.0f : 0.0f;
"""

_HEAD = f"""{FOR_LANES}
#ifndef WRT_LESS
#define WRT_LESS(a, b) ((a) < (b) ? (a) : (b))
#define WRT_MORE(a, b) ((a) > (b) ? (a) : (b))
#define WRT_CUT(a, half) WRT_LESS(WRT_MORE(a, -(half)), half)
#define WRT_ABOVE_0(a) WRT_MORE(a, 0.0f)
#define WRT_BEYOND(p, q, rise) ((((p) > 0.0f) & ((q) > 0.0f)) ? 0.5f * ((p) + (q)) \\
    : 0.5f * (WRT_ABOVE_0(p) * WRT_ABOVE_0(p) + WRT_ABOVE_0(q) * WRT_ABOVE_0(q)) * (rise))
#endif
    const float eye0 = view.eye.c[0], eye1 = view.eye.c[1], eye2 = view.eye.c[2];
    const float x_0 = view.right.c[0], x_1 = view.right.c[1], x_2 = view.right.c[2];
    const float y_0 = view.up.c[0], y_1 = view.up.c[1], y_2 = view.up.c[2];
    const float z_0 = view.forward.c[0], z_1 = view.forward.c[1], z_2 = view.forward.c[2];
    const float across0 = WRT_ABS(z_0), across1 = WRT_ABS(z_1), across2 = WRT_ABS(z_2);
    const float half_x = view.half.c[0], half_y = view.half.c[1], near = view.near;
    (void)across0; (void)across1; (void)across2;
"""

_ONE = "\n".join(f"const float low{a} = low.c[{a}], high{a} = high.c[{a}];" for a in range(3))
_LANE = "\n".join(f"const float low{a} = from[{a} * stride + i], high{a} = from[{a + 3} * stride + i];" for a in range(3))


def _for_one(parallel: str, radial: str) -> str:
    """A snippet that returns the area of one box."""
    return f"""{_HEAD}
{_ONE}
    if (view.radial) {{ {radial} return area; }}
    {parallel}
    return area;
"""


def _for_lanes(parallel: str, radial: str) -> str:
    """A snippet that writes the areas of many boxes."""
    return f"""{_HEAD}
    const float* __restrict__ from = boxes.data + first * 6;
    float* __restrict__ to = areas.data + first;
    const int stride = count;
    if (view.radial) WRT_FOR(count, i) {{ {_LANE} {radial} to[i] = area; }}
    else WRT_FOR(count, i) {{ {_LANE} {parallel} to[i] = area; }}
"""


_CUT = (_TERMS + _PARALLEL_CORNERS + _IN_WINDOW, _TERMS + _CORNERS + _IN_WINDOW)


@wp.func_native(_for_one(_PARALLEL, _RADIAL))
def whole_area(view: AreaView, low: wp.vec3, high: wp.vec3) -> float:
    """Area of what the window shows of a box's picture, if that is all or nothing; else NEEDS_CLIPPING. An empty box has 0."""
    ...


@wp.func_native(_for_lanes(_PARALLEL, _RADIAL))
def whole_areas(view: AreaView, boxes: wp.array(dtype=float), first: int, count: int, areas: wp.array(dtype=float)):
    """`whole_area` of many boxes, in vector lanes, the same to the bit.

    boxes: from 6 * first on, `count` lower x, then y, z and upper x, y, z. areas: from `first` on."""
    ...


@wp.func_native(_for_one(*_CUT))
def window_area(view: AreaView, low: wp.vec3, high: wp.vec3) -> float:
    """Area of what the window shows of a box's picture; NEEDS_CLIPPING if the near plane cuts the box."""
    ...


@wp.func_native(_for_lanes(*_CUT))
def window_areas(view: AreaView, boxes: wp.array(dtype=float), first: int, count: int, areas: wp.array(dtype=float)):
    """`window_area` of many boxes, as `whole_areas`."""
    ...

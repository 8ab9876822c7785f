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

References: falcone-2024.
"""

import warp as wp

from wrt.kernels.influence.view import AreaView
from wrt.kernels.runtime import native

NEEDS_WINDOW = wp.constant(-1.0)
"""Returned instead of an area: the box must be clipped to the window."""

NEEDS_NEAR = wp.constant(-2.0)
"""Returned instead of an area: the box must be clipped to the near plane."""

_SAME = f"static_assert(wrt::NEEDS_WINDOW == {NEEDS_WINDOW} && wrt::NEEDS_NEAR == {NEEDS_NEAR});"


@native.func_native("projected_areas.h", f"{_SAME}\nreturn wrt::whole_area(view, low, high);")
def whole_area(view: AreaView, low: wp.vec3, high: wp.vec3) -> float:
    """Area of a box's projection if it lies wholly inside or outside the window; else NEEDS_WINDOW. NEEDS_NEAR if the near
    plane cuts the box, whatever the window does. 0 for an empty box."""


@native.func_native("projected_areas.h", "wrt::whole_areas(view, boxes.data, count, areas.data);")
def whole_areas(view: AreaView, boxes: wp.array(dtype=float), count: int, areas: wp.array(dtype=float)):
    """`whole_area` of many boxes in vector lanes, with the same bits.

    boxes: (6 * count,) lower x, then lower y, lower z, upper x, upper y, upper z. areas: (count,) results."""

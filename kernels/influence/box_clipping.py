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

from wrt.kernels.influence.box_projection import NEEDS_NEAR, whole_area
from wrt.kernels.influence.view import AreaView
from wrt.kernels.runtime import native


@native.func_native("clipped_areas.h", "return wrt::clipped_area(view, low, high, by_near);")
def clipped_area(view: AreaView, low: wp.vec3, high: wp.vec3, by_near: bool) -> float:
    """Area of a box's projection within the window. `by_near`: whether the near plane may cut the box."""


@native.func_native("clipped_areas.h", "wrt::clipped_areas(view, boxes.data, count, by_near, areas.data);")
def clipped_areas(view: AreaView, boxes: wp.array(dtype=float), count: int, by_near: bool, areas: wp.array(dtype=float)):
    """`clipped_area` of many boxes. Arrays as in `whole_areas`."""


@wp.func
def projected_area(view: AreaView, low: wp.vec3, high: wp.vec3):
    """Area of a box's projection within the window. Parallel rays: in square units across the rays; radial rays: in the plane
    at depth 1. 0 for a box that no ray of the area meets."""
    area = whole_area(view, low, high)
    if area < 0.0:
        area = clipped_area(view, low, high, area == NEEDS_NEAR)
    return area

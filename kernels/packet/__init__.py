"""Packets: several rays that go through a tree together (survey, chapter 3).

A packet of P rays lives in one local array, component by component (`layout`), with intervals over its rays beside it
(`bounds`). `load` and `store` bring rays in and hits out, `block` tests the rays against the triangles of a leaf, W rays at
a time, and a *culling* decides for all rays at once which child boxes and which triangles none of them can hit.

**Contract of a culling.** `boxes(width)` makes a function of W child boxes, `triangles(width)` one of W
triangles; both take the packet's bounds and must keep whatever any of its rays may hit: what they compute is a lower bound
of every ray's computed entry, an upper bound of its exit (rounding is monotone, so the same expressions on the ends of
intervals bound the rounded values too). So culling never shows in the hits (`wrt.kernels.boxes`, the consistency rule).

References:
    I. Wald, P. Slusallek, C. Benthin, M. Wagner: Interactive rendering with coherent ray tracing. Eurographics 2001.
    S. Boulos, I. Wald, P. Shirley: Geometric and arithmetic culling methods for entire ray packets. Technical report
        UUCS-06-010, University of Utah, 2006.
    V. Rahikainen: On real-time ray tracing. MSc thesis, University of Tampere, 2013 (the survey).
"""

from collections.abc import Callable
from dataclasses import dataclass

import warp as wp

from wrt.kernels.packet import interval, vertices
from wrt.kernels.triangle import TriangleTest


@dataclass(frozen=True)
class Culling:
    """A way to cull for a whole packet.

    Attributes:
        name: key in `CULLINGS`.
        paper: authors, title, year.
        boxes: width -> `wp.func(bounds, node, packet bounds, keys, first) -> key of the nearest child`.
        triangles: width -> `wp.func(records, block, packet bounds) -> mask` of the triangles to be tested.
        accurate: whether `triangles` looks at the vertices, so that it holds only for tests that find no hits beside them.
    """

    name: str
    paper: str
    boxes: Callable[[int], wp.Function]
    triangles: Callable[[int], wp.Function]
    accurate: bool = False

    def holds_for(self, test: TriangleTest) -> bool:
        """Whether it keeps whatever the test may find."""
        return test.accurate or not self.accurate


CULLINGS: dict[str, Culling] = {
    culling.name: culling
    for culling in (
        Culling(
            "interval",
            "Boulos, Wald, Shirley: Geometric and arithmetic culling methods for entire ray packets (2006)",
            interval.cull_boxes,
            interval.cull_triangles,
        ),
        Culling(
            "vertex",
            "Reshetov: Faster ray packets - triangle intersection through vertex culling (2007)",
            interval.cull_boxes,
            vertices.cull_triangles,
            accurate=True,
        ),
    )
}

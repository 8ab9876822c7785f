"""Ray packets: several rays that traverse a tree together.

A packet of P rays is one local array, component by component (`packet_layout`), with intervals over its rays (`packet_bounds`).
`packet_load` and `packet_store` move rays in and hits out. `packet_block` tests the rays against the triangles of a leaf, W
rays at a time, or each ray against those that it may meet. A *culling* decides for all rays at once which child
boxes and which triangles no ray can hit. A packet whose rays diverge is split (`packet_splitting`).

**Contract of a culling.** All its functions are made for a `PacketLayout`: `boxes` tests W child boxes, `triangles` tests the W
triangles of a block, `start` prepares a packet for its traversal, `leaf` inspects its rays before a leaf is tested. They must
keep everything that any ray may hit, and the keys of boxes must not be later than the computed entry of any ray. `interval` and
`vertex` compute lower and upper bounds of the rays' own numbers; rounding is monotone, so the same expressions on the ends of
intervals bound the rounded values too. The cullings that use planes are widened by more than rounding can move a hit. Culling
therefore never changes the hits (`wrt.kernels.simd.boxes`, the consistency rule).

To add a culling, write its file and add one line to `CULLINGS` (those that "auto" never chooses are in
`wrt.kernels.classics.culling`); tests, command line and benchmarks use the table. The
tests have a scalar form of each loop over W boxes or triangles, in plain Warp (tests/support/scalar_cullings.py).

References: wald-2001; boulos-2006; rahikainen-2013 (chapter 3, a survey of packets and culling).
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Flag, auto

import warp as wp

from wrt.kernels.on_demand import OnDemand
from wrt.kernels.traversal.packet.culling import interval_culling as interval
from wrt.kernels.traversal.packet.culling import leaf_boxes, side_planes
from wrt.kernels.traversal.packet.culling import transient_frustum as transient
from wrt.kernels.traversal.packet.culling import vertex_culling as vertices
from wrt.kernels.traversal.packet.culling.culling_hooks import no_leaf, no_start
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.triangle import TriangleTest


class CullingTraits(Flag):
    """What the functions of a culling read, and for which packets they hold."""

    NONE = 0
    VERTICES = auto()
    """`triangles` uses the vertices, so that it is valid only for triangle tests that find no hits outside the triangle."""
    SLOPES = auto()
    """It needs bounds of the slopes, or of the points in which lines cross a plane normal to the main axis."""
    EVERY_RAY = auto()
    """`boxes` tests each ray instead of the packet as a whole."""
    REVERSIBLE = auto()
    """Its functions also hold for bounds as seen from the ends of the rays
    (`wrt.kernels.traversal.packet.rays.reversed_bounds`)."""


@dataclass(frozen=True)
class Culling:
    """A culling method for whole packets; its functions are made for a layout.

    Attributes:
        name: key in `CULLINGS`.
        paper: authors, title, year.
        boxes: `wp.func(boxes, node, packet, bounds, keys, first) -> key of the nearest child`.
        triangles: `wp.func(records, block, bounds) -> mask` of the triangles that must be tested.
        traits: what the functions read, and for which packets they hold.
        start: `wp.func(low, high, packet, bounds)`, called once per packet; low, high: bounds of the scene.
        leaf: `wp.func(boxes, node, lane, packet, bounds) -> int`, called once per leaf, whose box is a lane of a node: the
            number of rays that meet the box, or any number above `MAX_FEW_RAYS`. If it is at most `MAX_FEW_RAYS`, the rays
            are listed in `bounds.few`, and no other bounds are updated. 0 skips the leaf.
        scores: how well it suits dense rays from one point, and other rays. "auto" takes the highest score among the cullings
            that fit, and never one whose score is 0.
        filtered_scores: the same if the test lists pairs of rays and triangles (`PacketForm.pairs`), after which a triangle
            that culling leaves costs little.
    """

    name: str
    paper: str
    boxes: Callable[[PacketLayout], wp.Function]
    triangles: Callable[[PacketLayout], wp.Function]
    traits: CullingTraits = CullingTraits.NONE
    start: Callable[[PacketLayout], wp.Function] = no_start
    leaf: Callable[[PacketLayout], wp.Function] = no_leaf
    scores: tuple[float, float] = (0.0, 0.0)
    filtered_scores: tuple[float, float] = (0.0, 0.0)

    @property
    def needs_boxes(self) -> bool:
        """Whether the culling uses the boxes of leaves, which only a bounding volume hierarchy has."""
        return self.leaf is not no_leaf

    def holds_for(self, test: TriangleTest) -> bool:
        """Whether the culling keeps every hit that the test may find."""
        return test.accurate or CullingTraits.VERTICES not in self.traits


EVERY_RAY, CORNER_RAYS = "culling.every_ray", "culling.corner_rays"
FRUSTUM, TWO_PLANE, ENTRY_EXIT = "culling.inverse_frustum", "culling.two_plane_frustum", "culling.entry_exit"
"""Modules of `wrt.kernels.classics`."""

CULLINGS: dict[str, Culling] = {
    culling.name: culling
    for culling in (
        Culling(
            "none",
            "Wald, Slusallek, Benthin, Wagner: Interactive rendering with coherent ray tracing (2001)",
            OnDemand(EVERY_RAY, "cull_boxes"),
            OnDemand(EVERY_RAY, "cull_triangles"),
            traits=CullingTraits.EVERY_RAY,
        ),
        Culling(
            "interval",
            "Boulos, Wald, Shirley: Geometric and arithmetic culling methods for entire ray packets (2006)",
            interval.cull_boxes,
            interval.cull_triangles,
            traits=CullingTraits.REVERSIBLE,
            scores=(1.0, 1.0),
            filtered_scores=(4.0, 1.0),
        ),
        Culling(
            "leaf_boxes",
            "Reshetov: Faster ray packets - triangle intersection through vertex culling (2007), rays at leaves, interval",
            interval.cull_boxes,
            interval.cull_triangles,
            traits=CullingTraits.REVERSIBLE,
            leaf=leaf_boxes.leaf,
            filtered_scores=(1.0, 4.0),
        ),
        Culling(
            "corner_rays",
            "Dmitriev, Havran, Seidel: Faster ray tracing with SIMD shaft culling (2004), boxes as interval",
            interval.cull_boxes,
            OnDemand(CORNER_RAYS, "cull_triangles"),
            traits=CullingTraits.VERTICES | CullingTraits.SLOPES,
        ),
        Culling(
            "frustum",
            "Reshetov, Soupikov, Hurley: Multi-level ray tracing algorithm (2005), inverse frustum culling",
            OnDemand(FRUSTUM, "cull_boxes"),
            OnDemand(FRUSTUM, "cull_triangles"),
            traits=CullingTraits.SLOPES,
            start=OnDemand(FRUSTUM, "start"),
        ),
        Culling(
            "vertex",
            "Reshetov: Faster ray packets - triangle intersection through vertex culling (2007)",
            interval.cull_boxes,
            vertices.cull_triangles,
            traits=CullingTraits.VERTICES | CullingTraits.SLOPES | CullingTraits.REVERSIBLE,
            scores=(3.0, 2.0),
            filtered_scores=(3.0, 2.0),
        ),
        Culling(
            "transient_frustum",
            "Reshetov: Faster ray packets - triangle intersection through vertex culling (2007), a frustum a leaf",
            interval.cull_boxes,
            side_planes.cull_triangles,
            traits=CullingTraits.VERTICES | CullingTraits.REVERSIBLE,
            start=transient.start,
            leaf=transient.leaf,
            scores=(2.0, 3.0),
            filtered_scores=(2.0, 3.0),
        ),
        Culling(
            "two_plane",
            "Overbeck, Ramamoorthi, Mark: Large ray packets for real-time Whitted ray tracing (2008)",
            OnDemand(FRUSTUM, "cull_boxes"),
            side_planes.cull_triangles,
            traits=CullingTraits.VERTICES,
            start=OnDemand(TWO_PLANE, "start"),
        ),
        Culling(
            "entry_exit",
            "Reshetov, Soupikov, Hurley: Multi-level ray tracing algorithm (2005), frustum with two tests at leaves",
            OnDemand(FRUSTUM, "cull_boxes"),
            OnDemand(FRUSTUM, "cull_triangles"),
            traits=CullingTraits.SLOPES,
            start=OnDemand(FRUSTUM, "start"),
            leaf=OnDemand(ENTRY_EXIT, "leaf"),
        ),
    )
}
"""Culling methods by name."""

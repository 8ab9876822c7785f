"""Packets by bounce: orders, repacking, omnidirectional packets and two-plane frusta on the rays of path tracing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from studies.light.bounce_rays import BOUNCES, BounceRays, trace_paths
from wrt.accelerators.tree_descriptions import KdTree
from wrt.bench.core.paired_timing import Contender, Timing, take_turns
from wrt.classics.packet_arrangement import ArrangedRays, arrange_rays
from wrt.engine.rays.rays import Rays
from wrt.kernels.query.ordering.packet_orders import PACKET_ORDERS
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

PACKET = 64
"""Rays of a packet, 8 x 8 pixels, as in Boulos et al. (2007)."""


@dataclass(frozen=True)
class Way:
    """A way to trace the rays of a bounce.

    Attributes:
        traversal: key in `wrt.kernels.traversal.TRAVERSALS`.
        tree: "bvh" or "kdtree".
        order: key in `wrt.kernels.query.ordering.packet_orders.PACKET_ORDERS`; packets are made before the time is taken.
        culling: of packets.
        reorder: the plan's order; its sort is part of the time.
    """

    traversal: str
    tree: str = "bvh"
    order: str = "types"
    culling: str = "transient_frustum"
    reorder: str = "none"


WAYS = {name: Way("packet", order=name) for name in PACKET_ORDERS} | {
    "sorted by cells": Way("packet", order="blind", reorder="cells"),
    "repacked": Way("repacked_packet"),
    "intervals": Way("packet", culling="interval"),
    "two-plane": Way("packet", culling="two_plane"),
    "kd-tree packets": Way("packet", "kdtree", culling="interval"),
    "omnidirectional": Way("omnidirectional", "kdtree", culling="interval"),
    "single": Way("single", order="blind", culling=""),
}
"""What is measured, by name. Packets have frusta made at leaves, the best culling of scattered rays, if nothing else is said;
two-plane frusta are compared with intervals."""


@dataclass(frozen=True)
class BounceFigures:
    """What was measured of one way at one bounce.

    Attributes:
        model: name of the model.
        way: key in `WAYS`.
        bounce: 0 for camera rays.
        rays: number of rays.
        megarays: millions of rays a second, median.
        ratios: speed over that of each other way, median of the rounds.
        usage: share of the places of packets that hold a ray.
        order_ms: milliseconds to put the rays into packets.
        steps, boxes, triangles, leaves: inner nodes, box tests, triangle tests and leaves a ray; a packet counts once.
        active: share of the lanes of triangle tests whose ray meets the triangle's box; 0 for single rays.
        same: whether the hits are those of single rays.
    """

    model: str
    way: str
    bounce: int
    rays: int
    megarays: float
    ratios: dict[str, float]
    usage: float
    order_ms: float
    steps: float
    boxes: float
    triangles: float
    leaves: float
    active: float
    same: bool


def compare_bounces(
    mesh: TriangleMesh,
    name: str,
    *,
    size: int = 256,
    bounces: int = BOUNCES,
    rounds: int = 3,
    threads: int | None = None,
    ways: Sequence[str] = tuple(WAYS),
    on_turn: Callable[[str], None] = lambda name: None,
) -> list[BounceFigures]:
    """Traces the rays of each bounce in each way.

    Args:
        mesh: the model, which is put into a room.
        name: its name in the figures.
        size: one path from each of size x size pixels.
        bounces: number of the last bounce.
        rounds: number of rounds per way.
        threads: on the CPU; None for all cores.
        ways: keys in `WAYS`.
        on_turn: told the name of each turn.
    """
    scene, generations = trace_paths(mesh, size, bounces, threads)
    scenes = {"bvh": scene, "kdtree": Scene(scene.meshes, KdTree(), num_threads=threads)}
    figures = []
    for rays in generations:
        prepared = {way: _Prepared(scenes, rays, WAYS[way]) for way in ways}
        contenders = [Contender(way, one.trace, len(rays.origins)) for way, one in prepared.items()]
        where = f"{name}, bounce {rays.bounce}"
        timings = take_turns(contenders, rounds, settle=0.2, on_turn=lambda way, where=where: on_turn(f"{where}: {way}"))
        expected = scenes["bvh"].intersect(rays.origins, rays.directions, traversal="single")
        figures += [_figures(name, rays, way, one, timings, expected) for way, one in prepared.items()]
    return figures


class _Prepared:
    """The rays of a bounce, arranged for one way, and the plan by which they are traced."""

    def __init__(self, scenes: dict[str, Scene], rays: BounceRays, way: Way) -> None:
        self.scene, given = scenes[way.tree], Rays(rays.origins, rays.directions)
        (self._order,) = take_turns([Contender("order", lambda: self._arrange(given, rays, way))], 1).values()
        self.arranged: ArrangedRays = self._order.result
        plan = self.scene.explain(self.arranged.rays, traversal=way.traversal, triangle_test="woop")
        packets = {"packet": PACKET, "culling": way.culling} if way.culling else {}
        self.plan = replace(plan, reorder=way.reorder, shared_origin=False, **packets)

    @staticmethod
    def _arrange(given: Rays, rays: BounceRays, way: Way) -> ArrangedRays:
        return arrange_rays(given, way.order, PACKET, kinds=rays.kinds, groups=rays.groups, sources=rays.sources)

    @property
    def order_seconds(self) -> float:
        """Time to put the rays into packets."""
        return self._order.median

    def trace(self, counters: bool = False) -> Any:
        """The hits of the arranged rays."""
        return self.scene.intersect(self.arranged.rays, traversal=self.plan, counters=counters)


def _figures(
    name: str, rays: BounceRays, way: str, prepared: _Prepared, timings: dict[str, Timing], expected: Any
) -> BounceFigures:
    found = prepared.trace(counters=True)
    count, timing, work = len(rays.origins), timings[way], found.counters
    sums = {key: float(np.asarray(values).sum()) for key, values in work.items()}
    same = all(
        np.array_equal(prepared.arranged.restore(getattr(found, field)), getattr(expected, field))
        for field in ("t", "primitive_id")
    )
    return BounceFigures(
        name,
        way,
        rays.bounce,
        count,
        count / timing.median / 1e6,
        {other: 1.0 / timing.ratio_to(reference) for other, reference in timings.items()},
        prepared.arranged.usage,
        1e3 * prepared.order_seconds,
        sums["nodes"] / count,
        sums["boxes"] / count,
        sums["triangles"] / count,
        sums["leaves"] / count,
        sums["active"] / sums["lanes"] if sums["lanes"] else 0.0,
        same,
    )

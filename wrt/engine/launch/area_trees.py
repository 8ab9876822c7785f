"""Tracing with influence areas: each ray in the tree of its area as far as that is valid, then in the whole scene's tree.

`wrt.kernels.influence.area_assignment` explains why hits are bit for bit those of any other tree. A batch is divided into parts
that are traced as batches, with the same plan, so that packets and streams keep their speed:

    assign   each ray finds its area and where it leaves it
    sort     rays are counted, scanned and listed by area (one round trip to the host: the number of rays of each area)
    local    each area's rays, limited to where they leave, are gathered, traced through the area's tree and scattered back
    rest     rays without an area, and those that left theirs without a hit, are gathered and traced through the scene's
    tree

If all rays belong to one area or to none, or most belong to the only area, as with the shadow rays of a light, the batch is
traced in place. An image then keeps its rows and columns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import radians, sin
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from wrt.builders.influence.area_top_level import (
    TopLevel,
    lookup_margin,
    region_of,
    renumber,
    select_boxes,
    triangle_margin,
    triangles_in,
)
from wrt.engine.device_hits import DeviceHits
from wrt.engine.launch.batch import trace_batch
from wrt.engine.memory import empty
from wrt.engine.plan.plan import Plan, traversal_of
from wrt.kernels.influence.area_assignment import assign_rays, mark_unassigned
from wrt.kernels.influence.area_lanes import AreaSplits
from wrt.kernels.layout.ray_batch import RayBatch
from wrt.kernels.query.ordering.ray_order import sort_buckets, sort_rays, unsort_hits
from wrt.kernels.runtime.launch import launch

if TYPE_CHECKING:
    from wrt.builders.influence.influence_area import InfluenceArea
    from wrt.builders.triangle_boxes import TriangleBoxes
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.launch.given_areas import GivenAreas


CHUNK, CUDA_CHUNK = 4096, 64
"""Rays per work item of the assignment, on the CPU and on CUDA."""

MAX_UNASSIGNED_SHARE = 0.3
"""Largest share of rays without an area at which a batch is traced in place through the only area."""


@dataclass(frozen=True)
class AreaTrees:
    """The influence areas of a scene that contain triangles, and a tree for each.

    Attributes:
        areas: the accelerator's areas that some triangle touches.
        scenes: for each area, the scene with the area's tree.
        numbers: for each area, its place among the accelerator's.
        triangles: for each area, the number of triangles in its tree.
        top: finds the area of a ray.
        low, high: corners, relative to the scene's centre, of a box that contains all hits of rays with an area, including
            rounding.
    """

    areas: tuple[InfluenceArea, ...]
    numbers: tuple[int, ...]
    scenes: tuple[SceneState, ...]
    triangles: tuple[int, ...]
    top: TopLevel
    low: wp.vec3
    high: wp.vec3

    def __len__(self) -> int:
        """Number of areas."""
        return len(self.areas)

    @property
    def bytes(self) -> int:
        """Bytes of the areas' trees and of the structure that finds them, without triangle records (`Scene.record_bytes`)."""
        return self.top.bytes + sum(scene.tree.bytes for scene in self.scenes)


def build_area_trees(scene: SceneState, triangles: TriangleBoxes) -> AreaTrees | None:
    """The trees of the accelerator's areas; None if no triangle touches any of them.

    Args:
        scene: the scene, with the tree over all triangles.
        triangles: bounding boxes of the triangles, on the CPU.
    """
    accelerator, (low, high) = scene.accelerator, scene.bounds
    touch = lookup_margin(accelerator.areas, scene.center)
    areas, numbers, regions, scenes, counts = [], [], [], [], []
    for number, area in enumerate(accelerator.areas):
        region = region_of(area, low, high)
        ids = triangles_in(region, touch, triangles)
        if len(ids):
            tree = accelerator.build_local(area, select_boxes(triangles, ids), scene.tree.width)
            scenes.append(scene.over(renumber(tree, ids, triangles).to(scene.device)))
            areas.append(area)
            numbers.append(number)
            regions.append(region)
            counts.append(len(ids))
    if not areas:
        return None
    depth, sine = accelerator.octree_depth, sin(radians(accelerator.tolerance))
    is_kdtree = accelerator.top_level == "kdtree"
    top = TopLevel(areas, regions, touch, depth, sine, scene.center, scene.device, is_kdtree)
    margin = max(triangle_margin(region, touch, low, high) for region in regions)
    corners = [wp.vec3(*corner) for corner in (low - scene.center - margin, high - scene.center + margin)]
    return AreaTrees(tuple(areas), tuple(numbers), tuple(scenes), tuple(counts), top, *corners)


def trace_by_area(
    scene: SceneState, plan: Plan, rays: RayBatch, query: str, counters: bool, given: GivenAreas | None = None
) -> tuple[DeviceHits, wp.array | None]:
    """Closest hits or occlusion, and each ray's work if it is counted, summed over the area's tree and the scene's.

    `given` are the areas of the rays, if they are known.
    """
    local, assigned = scene.area_trees, assign(scene, rays, given)
    if assigned.unassigned == rays.count:
        return trace_batch(scene, plan, rays, query, counters)
    batch = PartialBatch(plan, query, counters)
    cut = with_range(rays, "t_max", assigned.cut)
    order, begins = assigned.sort(len(local))
    for part, begin, end in zip(local.scenes, begins[:-2], begins[1:-1], strict=True):
        batch.trace(part, cut, order, begin, end)
    if assigned.left + assigned.unassigned > 0:
        found = batch.hits.struct()
        inputs = [len(local), assigned.area, assigned.rest, found.primitive, found.occluded, assigned.area]
        launch(mark_unassigned, rays.count, inputs, device=scene.device, chunk=4096)
        # the second round trip, only where a ray is left
        order = wp.array(np.flatnonzero(assigned.area.numpy() == 0).astype(np.int32), dtype=int, device=scene.device)
        batch.trace(scene, with_range(rays, "t_min", assigned.rest), order, 0, len(order))
    kind = traversal_of(plan).counters
    return batch.hits, None if batch.work is None else wp.array(batch.work, dtype=kind, device=scene.device)


@dataclass
class AreaAssignment:
    """For each ray of a batch: its area, where that ceases to be valid, and where the rest of the ray begins
    (`assign_rays`).

    Attributes:
        area, cut, rest: (rays,).
        left: number of rays that leave their areas before they end.
        unassigned: number of rays without an area.
        least_area, greatest_area: smallest and largest area index of all rays; the number of areas stands for none.
    """

    area: wp.array
    cut: wp.array
    rest: wp.array
    left: int
    unassigned: int
    min_area: int
    max_area: int

    def sort(self, areas: int) -> tuple[wp.array | None, list[int]]:
        """Sorts rays by area, those without one last, as `sort_buckets`. The order is None if most rays belong to the only
        area.

        Rays without an area are then traced with the others: limited to t <= -1, they miss.
        """
        count = len(self.area)
        if self.min_area == self.max_area or (areas == 1 and self.unassigned <= count * MAX_UNASSIGNED_SHARE):
            return None, [0] * (self.min_area + 1) + [count] * (areas + 1 - self.min_area)
        return sort_buckets(self.area, areas + 1)


def assign(scene: SceneState, rays: RayBatch, given: GivenAreas | None = None) -> AreaAssignment:
    """Finds the area of each ray, or where each ray leaves the area that it is given."""
    device, local = scene.device, scene.area_trees
    chunk = CUDA_CHUNK if device.is_cuda else CHUNK
    chunks = -(-rays.count // chunk)
    splits = AreaSplits()
    splits.area, splits.cut, splits.rest = (empty(rays.count, dtype, device) for dtype in (wp.uint16, wp.float32, wp.float32))
    sums = wp.empty(chunks, dtype=wp.vec4i, device=device)
    known = (wp.empty(0, dtype=int, device=device), 0) if given is None else (given.areas, given.stride)
    inputs = [rays, chunk, local.top.struct, *known, local.low, local.high, splits, sums]
    launch(assign_rays, chunks, inputs, device=device, chunk=1)
    left, greatest, fewest, unassigned = sums.numpy().reshape(-1, 4).T
    min_area = len(local) - int(fewest.max(initial=0))
    max_area = int(greatest.max(initial=0))
    arrays = splits.area, splits.cut, splits.rest
    return AreaAssignment(*arrays, int(left.sum()), int(unassigned.sum()), min_area, max_area)  # type: ignore[arg-type, call-arg]


@dataclass
class PartialBatch:
    """A batch whose rays are traced in several parts.

    Attributes:
        plan, query: how the batch is answered.
        counters: whether work is counted.
        hits: hits of all rays; None before the first part.
        work: (rays,) structured, summed over all parts; None before the first one, and if work is not counted.
    """

    plan: Plan
    query: str
    counters: bool
    hits: DeviceHits | None = None
    work: np.ndarray | None = None

    def trace(self, scene: SceneState, rays: RayBatch, order: wp.array | None, begin: int, end: int) -> None:
        """Traces the rays order[begin] .. order[end - 1] through the scene's tree. If they miss, they have no hit."""
        if begin == end:
            return
        if end - begin == rays.count:
            self.hits, work = trace_batch(scene, self.plan, rays, self.query, self.counters)
            chosen = slice(None)
        else:
            order = order[begin:end]
            plan = replace(self.plan, reorder="none") if self.plan.reorder == "tiles" else self.plan
            hits, work = trace_batch(scene, plan, sort_rays(rays, order, empty), self.query, self.counters)
            self.hits = self.hits or DeviceHits.new(self.query, rays.count, scene.device)
            unsort_hits(order, hits.struct(), self.hits.struct(), self.query)
            chosen = order.numpy()
        if work is not None:
            values = work.numpy()
            if self.work is None:
                self.work = np.zeros(rays.count, dtype=values.dtype)
            for name in values.dtype.names:
                self.work[name][chosen] += values[name]


def with_range(rays: RayBatch, bound: str, values: wp.array) -> RayBatch:
    """The same rays with a `t_min` or `t_max` for each ray."""
    other = RayBatch()
    for name in RayBatch.vars:  # type: ignore[attr-defined]
        setattr(other, name, getattr(rays, name))
    setattr(other, bound, values)
    setattr(other, f"{bound}_stride", 1)
    return other

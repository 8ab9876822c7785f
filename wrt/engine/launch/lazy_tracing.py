"""Tracing a tree that is built lazily, as rays visit its cells (`wrt.builders.kdtree.lazy.lazy_kdtree`).

Any traversal traces the rays through the part that is built. Each ray then requests the unbuilt cells that it reaches
before its hit (`wrt.kernels.traversal.single.lazy_requests`). These are built, all at once, and the rays that requested any are
traced again. A query that needs every hit requests all cells along its rays before it is traced.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from wrt.engine.device_hits import DeviceHits
from wrt.engine.memory import empty
from wrt.kernels.answers import ANSWERS
from wrt.kernels.runtime.launch import launch

if TYPE_CHECKING:
    from wrt.builders.kdtree.lazy.lazy_kdtree import LazyKdTree, Snapshot
    from wrt.kernels.layout.ray_batch import RayBatch

CELLS_PER_REQUEST = 2
"""Unbuilt cells that a ray requests at a time: more of them build cells hidden behind the first, fewer take more rounds."""

RUN_LENGTH = 64
"""Neighbouring rays of a sampled run: a few packets."""

SAMPLE_STRIDE = 33
"""One run in this many is traced first. It requests most of the cells that the others need, in rounds that cost little.
(Not a power of two, so that runs in the rows of an image are not in the same columns.)
"""

MIN_SAMPLED_RAYS = 1 << 14
"""Smallest batch of which a sample is traced first."""

ALL_CELLS = 1 << 30
"""More cells than any tree has: a ray then requests all that it reaches."""

Trace = Callable[["RayBatch", DeviceHits], None]
"""Traces rays through the present tree, and stores their hits."""


@dataclass
class LazyQuery:
    """Rays that are traced while their tree is built.

    Attributes:
        tree: the tree.
        rays: the batch.
        how: up to where a ray requests cells, see `wrt.kernels.traversal.single.lazy_requests`.
        trace: traces a batch, or a part of it.
        query: what they are.
    """

    tree: LazyKdTree
    rays: RayBatch
    query_range: int
    trace: Trace
    query: str

    def trace_until_built(self, hits: DeviceHits) -> None:
        """Traces all rays, and again those that request cells, until none does."""
        from wrt.kernels.query.ordering.ray_order import unsort_hits

        snapshot = self.tree.current  # from before the rays are traced: they have met whatever it says is built
        self.trace(self.rays, hits)
        numbers = request_cells(self.tree, snapshot, self.rays, hits, self.query_range, CELLS_PER_REQUEST)
        while len(numbers):
            order, found, requesting = self.trace_some(numbers)
            unsort_hits(order, found.struct(), hits.struct(), self.query)
            numbers = numbers[requesting]

    def explore(self, numbers: np.ndarray) -> None:
        """Traces some rays until none requests cells. The hits are discarded; only the cells are needed."""
        while len(numbers):
            numbers = numbers[self.trace_some(numbers)[2]]

    def trace_some(self, numbers: np.ndarray) -> tuple[wp.array, DeviceHits, np.ndarray]:
        """Traces some rays; returns their order, their hits, and whether each requested cells."""
        from wrt.kernels.query.ordering.ray_order import sort_rays

        order = wp.array(numbers.astype(np.int32), dtype=int, device=self.tree.device)
        few, found, snapshot = (
            sort_rays(self.rays, order, empty),
            DeviceHits.new(self.query, len(order), self.tree.device),
            self.tree.current,
        )
        self.trace(few, found)
        return order, found, request_cells(self.tree, snapshot, few, found, self.query_range, CELLS_PER_REQUEST)


def trace_lazily(tree: LazyKdTree, rays: RayBatch, hits: DeviceHits, query: str, trace: Trace) -> None:
    """Traces rays and builds the cells that they request, until each has its final answer; arguments as in `LazyQuery`.

    Args:
        hits: memory for the results of all rays.
    """
    from wrt.kernels.traversal.single.lazy_requests import TO_ANY, TO_HIT, UNTRACED

    answer = ANSWERS[query]
    query_range = TO_HIT if answer.rules.shortens else TO_ANY
    if not answer.nearest:
        while len(request_cells(tree, tree.current, rays, hits, int(UNTRACED), ALL_CELLS)):
            pass
        trace(rays, hits)
        return
    lazy_query = LazyQuery(tree, rays, int(query_range), trace, query)
    if rays.count >= MIN_SAMPLED_RAYS:
        lazy_query.explore(np.flatnonzero(np.arange(rays.count) // RUN_LENGTH % SAMPLE_STRIDE == 0))
    lazy_query.trace_until_built(hits)


def request_cells(
    tree: LazyKdTree, snapshot: Snapshot, rays: RayBatch, hits: DeviceHits, query_range: int, max_cells: int
) -> np.ndarray:
    """Builds up to `max_cells` unbuilt cells that each ray reaches first; returns the numbers of the rays that reach any."""
    from wrt.kernels.traversal.single.lazy_requests import mark_requested_cells

    if not snapshot.unbuilt:
        return np.zeros(0, dtype=int)
    requested = wp.zeros(snapshot.cells, dtype=wp.uint8, device=tree.device)
    unfinished = empty(rays.count, wp.bool, tree.device)
    inputs = [snapshot.struct(), rays, hits.struct(), query_range, max_cells, requested, unfinished]
    launch(mark_requested_cells, rays.count, inputs, device=tree.device, chunk=1024)
    numbers = np.flatnonzero(unfinished.numpy())
    if len(numbers):
        tree.build_cells(np.flatnonzero(requested.numpy()))
    return numbers

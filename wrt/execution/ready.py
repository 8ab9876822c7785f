"""Plans carried out with what earlier calls left ready: the way of most calls of many rays on the CPU.

Of a view of a million rays, which takes some milliseconds, Python had a tenth, before the first ray and after the last one,
whatever the number of threads. A call sweeps the caches, so that the next one's Python waits for memory: to make its structs
took 0.1 ms, a fifth of that with warm caches. So a scene keeps, for each plan, query and layout of rays, the kernel with its
launches recorded; a call writes the addresses of the rays, and of memory for the answer, into their arguments.

Not here: rays in another order than their own, work that is counted, scenes of instances, of influence areas and of trees that
grow, triangle tests whose records depend on the rays' origin, and graphs, whose launches Warp must see with all their arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import warp as wp

from wrt.execution.executor import HITS, RAYS, divide, kernel_and_inputs, no_work
from wrt.execution.launch_cache import take
from wrt.execution.plan import ANY, COUNT, traversal_config, way_of
from wrt.execution.wide_trees import saved, walked_tree
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime.launch import PreparedLaunch
from wrt.memory import empty
from wrt.rays.rays import RayArrays, new_batch

if TYPE_CHECKING:
    from wrt.execution.plan import Plan
    from wrt.rays.rays import Layout, RayBuffers
    from wrt.scene.scene import Scene


@dataclass
class HitArrays:
    """Results of N rays: those of a query's arrays that it asks for, as `HitBatch` explains them."""

    t: wp.array | None = None
    primitive: wp.array | None = None
    uv: wp.array | None = None
    occluded: wp.array | None = None
    counts: wp.array | None = None


class ReadyKernel:
    """The kernel that carries out a plan for rays of a layout, with its arguments packed, for one call at a time.

    Args:
        query: "closest", "any" or "count".
    """

    def __init__(self, scene: Scene, plan: Plan, query: str, layout: Layout) -> None:
        self.plan, self.query, self.config = plan, query, traversal_config(plan, scene, query, False)
        rays, hits = new_batch(layout, scene.center), HitBatch()
        work = no_work(way_of(plan).counters, scene.device.alias)
        kernel, inputs = kernel_and_inputs(scene, plan, self.config, rays, hits, work)
        self.tree, self.blocks = walked_tree(plan, scene), inputs[1]
        self.launch = PreparedLaunch(kernel, inputs, scene.device)
        self.rays, self.hits = self.launch.argument(RAYS), self.launch.argument(HITS)

    def suits(self, scene: Scene) -> bool:
        """Whether the scene still has what this was made for."""
        return self.tree is walked_tree(self.plan, scene) and self.blocks is scene.triangles(self.plan, None)

    def trace(self, scene: Scene, rays: RayArrays, columns: int) -> HitArrays:
        """The answer to rays, which may be the pixels of a picture of so many columns; all addresses are of this call."""
        rays.write_to(self.rays)
        self.rays.columns = columns
        self.rays.run, items, chunks = divide(scene, self.plan, self.config, rays.count)
        answer = self._answer(rays.count, scene.device)
        self.launch.run(items, chunks, (rays, answer))
        return answer

    def _answer(self, count: int, device: wp.Device) -> HitArrays:
        """Memory for the answer, where the launches write it."""
        hits = self.hits
        if self.query == ANY:
            answer = HitArrays(occluded=empty(count, wp.bool, device))
            hits.occluded = answer.occluded.__ctype__()
        elif self.query == COUNT:
            answer = HitArrays(counts=empty(count, wp.int32, device))
            hits.counts = answer.counts.__ctype__()
        else:
            answer = HitArrays(empty(count, wp.float32, device), empty(count, wp.int32, device), empty(count, wp.vec2, device))
            hits.t, hits.primitive, hits.uv = answer.t.__ctype__(), answer.primitive.__ctype__(), answer.uv.__ctype__()
        return answer


def can_be_ready(scene: Scene, plan: Plan, buffers: RayBuffers) -> bool:
    """Whether rays of a scene on the CPU, whose work is not counted, go this way."""
    from wrt.kernels.triangle import TRIANGLE_TESTS

    if scene.instances or scene.growing is not None or scene.local_trees is not None or scene.device.is_capturing:
        return False
    plain = plan.reorder != "cells" and not TRIANGLE_TESTS[plan.triangle_test].record.per_origin
    return plain and isinstance(buffers.laid_out, RayArrays)


def trace_ready(scene: Scene, plan: Plan, rays: RayArrays, query: str, columns: int) -> HitArrays:
    """Results of rays by a plan that is the query's own; `columns` as of `RayBatch`."""
    scene.missed += 0.0 if plan.is_wide else saved(rays.count, plan.coherent)
    ready, waiting = take(scene, (query, plan, rays.layout), lambda: ReadyKernel(scene, plan, query, rays.layout))
    answer = ready.trace(scene, rays, columns)
    waiting.append(ready)
    return answer

"""Rays in arrays on the device: a query of a warm scene is one launch that was recorded before.

A million rays take some tenths of a millisecond on a large GPU, and as long as Python makes a plan, structs and a launch, that
waits for its next work. So a scene keeps recorded launches, one for each query and layout of the rays: a call checks the
arrays, writes their addresses, and that of memory for the answer, into the arguments of a launch, and repeats it. What comes
after, such as cutting that memory into arrays, the GPU need not wait for.

**Who comes here.** On CUDA all rays whose plan is left to the scene; on the CPU few rays in Warp arrays
(`wrt.execution.few_rays` are NumPy's). Not here while a graph is captured: that takes the ordinary way, whose launches Warp
sees with all their arrays.

**The answer** to `intersect` is one allocation of 16 bytes a ray, cut into t, ids and weights when these are asked for. Each
of them keeps all of it.

**Threads and streams.** A launch belongs to one thread from before its arguments are written until it is on its way; as many
are made as threads ask at the same time. Arguments are copied when it is repeated, so that the next call may write others
while rays are still traced. It goes to the stream that is current, as the memory does.

**Measured** (a thread of a Zen 5, bunny, random rays in Warp arrays on the CPU, microseconds a call, tracing included: the
ordinary way / recorded):

                                1 ray         100
    intersect                142 / 26    244 / 58
    intersect, t, ids, uv    149 / 45    202 / 90
    occluded                 117 / 22    166 / 54
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.execution.executor import HITS, RAYS, kernel_and_inputs, no_work
from wrt.execution.launch_cache import take
from wrt.execution.plan import ANY, AUTO, CLOSEST, FEW_RAYS, choose_plan, plan_for, traversal_config, way_of
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch
from wrt.kernels.runtime.launch import record
from wrt.memory import empty, keep_alive
from wrt.query.hits import Hits, shaped
from wrt.rays.rays import Layout, RayArrays, RayBuffers, Rays, lay_out, new_batch

if TYPE_CHECKING:
    from wrt.scene.scene import Scene

NO_RAYS = RayBatch()
"""What hits hold in the place of rays on the device, which are their caller's."""


class HitBlock:
    """Closest hits of N rays in one allocation: what `HitBatch` holds of them, as arrays that are made when asked for."""

    UV, T, PRIMITIVE = 0, 8, 12
    """Where each begins, in bytes a ray."""

    def __init__(self, count: int, device: wp.Device) -> None:
        self.memory = empty(count, wp.vec4, device)

    @cached_property
    def uv(self) -> wp.array:
        """(N,) vec2."""
        return self._cut(self.UV, wp.vec2)

    @cached_property
    def t(self) -> wp.array:
        """(N,) float32."""
        return self._cut(self.T, wp.float32)

    @cached_property
    def primitive(self) -> wp.array:
        """(N,) int32."""
        return self._cut(self.PRIMITIVE, wp.int32)

    def _cut(self, begin: int, dtype: type) -> wp.array:
        memory, count = self.memory, self.memory.size
        part = wp.array(ptr=memory.ptr + begin * count, dtype=dtype, shape=count, device=memory.device)
        return keep_alive(part, memory)


class Recording:
    """A recorded launch that answers rays of one layout, for one thread at a time.

    Args:
        query: "closest", "any" or "count".
        layout: of the rays.
    """

    def __init__(self, scene: Scene, query: str, layout: Layout) -> None:
        self.query, self.device, self.tree, self.mesh = query, scene.device, scene.tree, scene.device_mesh
        rays, hits = new_batch(layout, scene.center), HitBatch()
        sample = RayBuffers(rays, (1,), True, np.float32, True, False, [])
        self.plan = choose_plan(scene, sample, AUTO, AUTO, query, False)
        plan = plan_for(self.plan, query)
        config, work = traversal_config(plan, scene, query, False), no_work(way_of(plan).counters, self.device.alias)
        kernel, inputs = kernel_and_inputs(scene, plan, config, rays, hits, work)
        self.launch = record(kernel, inputs, self.device)
        self.rays, self.hits = rays.__ctype__(), hits.__ctype__()
        self.launch.set_param_at_index_from_ctype(RAYS, self.rays)
        self.launch.set_param_at_index_from_ctype(HITS, self.hits)
        self.count = 0

    def suits(self, scene: Scene) -> bool:
        """Whether the scene still has what this was made for."""
        return self.tree is scene.tree and self.mesh is scene.device_mesh

    def trace(self, rays: RayArrays) -> HitBlock | wp.array:
        """The answer to rays of the layout: flat, and on CUDA still to be computed.

        Only here are the launch's addresses those of memory that is there.
        """
        count = rays.count
        rays.write_to(self.rays)
        resized, self.count = count != self.count, count
        if resized:
            self.launch.set_dim(count)
        answer = self._closest(count, resized) if self.query == CLOSEST else self._numbers(count)
        self.launch.launch()
        return answer

    def _closest(self, count: int, resized: bool) -> HitBlock:
        """Memory for closest hits, where the launch writes them."""
        hits, block = self.hits, HitBlock(count, self.device)
        if resized:
            hits.uv, hits.t, hits.primitive = block.uv.__ctype__(), block.t.__ctype__(), block.primitive.__ctype__()
        else:  # as long as before: all but the addresses holds
            start = block.memory.ptr
            hits.uv.data, hits.t.data = start + block.UV * count, start + block.T * count
            hits.primitive.data = start + block.PRIMITIVE * count
        return block

    def _numbers(self, count: int) -> wp.array:
        """Memory for a number of each ray, where the launch writes it."""
        if self.query == ANY:
            values = empty(count, wp.bool, self.device)
            self.hits.occluded = values.__ctype__()
        else:
            values = empty(count, wp.int32, self.device)
            self.hits.counts = values.__ctype__()
        return values


def trace_recorded(scene: Scene, rays: Rays, query: str) -> Any:
    """The answer by a recorded launch; None for rays that go another way.

    Raises:
        TypeError, ValueError: as `Scene.intersect`.
    """
    device = scene.device
    if scene.local_trees is not None or not (device.is_cuda or _few_on_device(rays)):
        return None
    arrays = lay_out(rays, device, scene.center)
    if arrays.count == 0 or (device.is_cpu and arrays.count > FEW_RAYS):
        return None
    key = query, arrays.layout
    recording, waiting = take(scene, key, lambda: Recording(scene, *key))
    answer = recording.trace(arrays)
    waiting.append(recording)
    if query != CLOSEST:
        return shaped(answer, arrays)
    buffers = RayBuffers(NO_RAYS, arrays.shape, arrays.is_warp, arrays.dtype, True, False, [])
    return Hits(answer, buffers, scene, recording.plan)


def _few_on_device(rays: Rays) -> bool:
    given = rays.origins, rays.directions
    return all(isinstance(values, wp.array) and values.size <= 3 * FEW_RAYS for values in given)

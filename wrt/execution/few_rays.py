"""Few rays on the CPU: everything but the rays themselves is made beforehand.

A query of one ray costs 0.1 ms of Python, most of it for arrays, structs and arguments of the launch, and next to nothing for
tracing. So a scene keeps desks: memory for few rays and for their answers, with the launch that leads from the one to the
other recorded. A query takes a desk that is free, copies its rays there, launches, copies the answers away and puts the desk
back; as many desks are made as threads ask at the same time.

**Measured** (a thread of a Zen 5, bunny, random rays, microseconds a call: as many rays are traced / with a desk):

                      1 ray         100        1000 rays
    intersect      126 / 22    137 / 34    443 / 154
    occluded       115 / 19    127 / 31    412 / 138

Of a call of one ray, 3 us are the launch; of 1000 rays, 120 are tracing where one thread does it.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.execution.executor import kernel_and_inputs, new_hits, no_work
from wrt.execution.launch_cache import take
from wrt.execution.plan import ANY, AUTO, CLOSEST, FEW_RAYS, make_plan, plan_for, traversal_config, way_of
from wrt.execution.recorded import NO_RAYS
from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.runtime.launch import Chunks, PreparedLaunch
from wrt.memory import new_rays
from wrt.query.hits import Hits
from wrt.rays.rays import RayBuffers, Rays, as_range, as_vectors, common_shape

if TYPE_CHECKING:
    from wrt.scene.scene import Scene


CHUNKS = Chunks(chunk=64)
"""Some 20 us of work: a helper that waits awake joins in less than one, and nobody waits for one that sleeps."""


class Desk:
    """Memory for few rays and their answers, and the launch between them, for one thread at a time.

    Args:
        scene: on the CPU.
        query: "closest", "any" or "count".
    """

    def __init__(self, scene: Scene, query: str) -> None:
        device = scene.device
        self.rays, self.center, self.tree = new_rays(FEW_RAYS, device), scene.center, scene.tree
        self.plan = make_plan(scene, RayBuffers(self.rays, (FEW_RAYS,), False, np.float32, True, False, []), AUTO, AUTO, query)
        self.carried_out = plan_for(self.plan, query)
        way, config = way_of(self.carried_out), traversal_config(self.carried_out, scene, query, False)
        self.blocks = scene.triangles(self.carried_out, self.rays)
        hits, work = new_hits(FEW_RAYS, query, device), no_work(way.counters, device.alias)
        self.launch = PreparedLaunch(*kernel_and_inputs(scene, self.carried_out, config, self.rays, hits, work), device)
        self.inputs = [a.numpy() for a in (self.rays.origins, self.rays.directions, self.rays.t_min, self.rays.t_max)]
        if query == CLOSEST:
            self.answers = [a.numpy() for a in (hits.t, hits.primitive, hits.uv)]
        else:
            self.answers = [(hits.occluded if query == ANY else hits.counts).numpy()]

    def suits(self, scene: Scene) -> bool:
        """Whether the scene still has what this desk was made for."""
        return self.tree is scene.tree and self.blocks is scene.triangles(self.carried_out, self.rays)

    def trace(self, rays: tuple[Any, ...], shape: tuple[int, ...]) -> list[np.ndarray]:
        """Answers to rays that have this shape when broadcast."""
        count = math.prod(shape)
        origins, directions, t_min, t_max = (a[:count].reshape(shape + a.shape[1:]) for a in self.inputs)
        with np.errstate(all="ignore"):  # what float32 does not hold misses
            np.subtract(rays[0], self.center, out=origins, dtype=np.float64, casting="unsafe")
            directions[...] = rays[1]
            t_min[...], t_max[...] = rays[2:]
        self.launch.run(count, CHUNKS)
        return [a[:count].reshape(shape + a.shape[1:]).copy() for a in self.answers]


class FewHits(Hits):
    """Hits that are NumPy's from the start; kernels see them when something is computed from them."""

    def __init__(self, arrays: list[np.ndarray], rays: RayBuffers, scene: Scene, desk: Desk) -> None:
        super().__init__(None, rays, scene, desk.plan)
        del self.batch
        self.t, self._primitive, self.uv = arrays
        if len(scene.meshes) == 1:
            self.primitive_id = self._primitive

    @cached_property
    def batch(self) -> HitBatch:
        """As of `Hits`."""
        hits, device = HitBatch(), self._mesh.vertices.device
        hits.t = wp.array(self.t.reshape(-1), dtype=float, device=device, copy=False)
        hits.primitive = wp.array(self._primitive.reshape(-1), dtype=int, device=device, copy=False)
        hits.uv = wp.array(self.uv.reshape(-1, 2), dtype=wp.vec2, device=device, copy=False)
        return hits


def trace_few(scene: Scene, rays: Rays, query: str) -> Any:
    """The answer for few rays given as NumPy arrays, lists or numbers; None for others.

    Raises:
        TypeError, ValueError: as `Scene.intersect`.
    """
    given = (rays.origins, rays.directions, rays.t_min, rays.t_max)
    if not scene.device.is_cpu or not all(map(_is_small, given)):
        return None
    origins, directions = as_vectors(given[0], "origins", scene.device), as_vectors(given[1], "directions", scene.device)
    given = (origins, directions, as_range(given[2], "t_min", scene.device), as_range(given[3], "t_max", scene.device))
    shape = common_shape(*given)
    if not 0 < math.prod(shape) <= FEW_RAYS:
        return None
    desk, desks = take(scene, query, lambda: Desk(scene, query))
    answers = desk.trace(given, shape)
    desks.append(desk)
    if query != CLOSEST:
        return answers[0]
    dtype = np.float64 if np.float64 in (origins.dtype, directions.dtype) else np.float32
    return FewHits(answers, RayBuffers(NO_RAYS, shape, False, dtype, True, False, []), scene, desk)


def _is_small(values: Any) -> bool:
    if isinstance(values, np.ndarray):
        return values.size <= 3 * FEW_RAYS
    return isinstance(values, (float, int, np.generic)) or (isinstance(values, (list, tuple)) and len(values) <= FEW_RAYS)

"""Prepared queries: a plan's kernel with its arguments packed, so that a call only writes what differs from call to call.

Of a query of few rays, and of one of many rays on fast hardware, most of the time would be Python's: for a plan, structs, and
the arguments of a launch. So a scene's cache keeps a prepared query for each plan, kind of query, and layout of rays. A call
writes the addresses of its rays and of memory for its answers, and launches. (What that saves:
notebooks/records/2026-11-22-one-way-through-a-query.md.)

**Launch policies.** On the CPU the launch goes to the thread pool, or stays on the caller's thread where there is too little
work to share. On CUDA it was recorded once and is repeated on the current stream.

**Staged rays.** Few rays in NumPy arrays are copied to memory of the prepared query, and their answers from it, because
making Warp arrays of them takes longer than tracing them (notebooks/records/2026-11-22-small-calls.md).

**Threads.** A prepared query serves one caller at a time (`wrt.engine.facts.query_cache`).
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace
from typing import TYPE_CHECKING, Any
from weakref import finalize

import numpy as np
import warp as wp

from wrt.engine.device_hits import DeviceHits
from wrt.engine.facts.query_kinds import FEW_RAYS
from wrt.engine.free_list import FreeList
from wrt.engine.host_arrays import point_at
from wrt.engine.launch.traversal_launch import (
    HITS,
    NEXT,
    RAYS,
    RECORDS,
    TREE,
    config_for_rays,
    divide,
    kernel_and_inputs,
    no_work,
)
from wrt.engine.launch.triangle_records import records_of
from wrt.engine.memory import new_rays
from wrt.engine.plan.plan import stack_levels, traversal_of
from wrt.engine.rays.device_rays import empty_batch, prepare_arguments
from wrt.engine.rays.staged_rays import STAGED, STAGED_CENTERED
from wrt.kernels.answers import ANSWERS
from wrt.kernels.runtime.launch import Chunks, PreparedLaunch, get_num_threads
from wrt.kernels.runtime.recorded_launch import RecordedLaunch
from wrt.kernels.traversal.capabilities import Capabilities
from wrt.kernels.traversal.persistent.next_ray import kept_counter
from wrt.kernels.traversal.traversal_config import PersistentConfig

if TYPE_CHECKING:
    from wrt.engine.facts.scene_state import SceneState
    from wrt.engine.plan.plan import Plan
    from wrt.engine.rays.device_rays import DeviceRays, Layout
    from wrt.engine.rays.staged_rays import StagedRays

FEW_CHUNKS = Chunks(chunk=64)
"""Chunks of few rays: large enough for a spinning helper to join; sleeping helpers are not woken."""


class PreparedQuery:
    """The kernel of a plan for rays of a layout, with its arguments packed, for one caller at a time.

    Args:
        scene: whose rays these are; not kept.
        plan: the query's own (`wrt.engine.plan.plan.plan_for_query`).
        kind: "closest", "any" or "count".
        layout: of the rays, or `STAGED` or `STAGED_CENTERED`.
    """

    def __init__(self, scene: SceneState, plan: Plan, kind: str, layout: Layout | str) -> None:
        self.kind, self._plan, self._mesh = kind, plan, scene.device_mesh
        self._walks_single_rays = traversal_of(plan).walks_single_rays
        self._config = config_for_rays(plan, scene, kind, layout not in (STAGED, STAGED_CENTERED) and layout.origins == 0)
        device = scene.device
        self._takes_next = device.is_cuda and Capabilities.PERSISTENT in traversal_of(plan).capabilities
        if self._takes_next and layout.from_zero:  # type: ignore[union-attr]
            self._config = replace(self._config, persistent=PersistentConfig(from_zero=True))
        self._forest = scene.tree.forest if scene.instances else None
        self._used: Any = None  # keeps the arrays of the scene alive that this was made to fit
        self._of = kind_of_scene(scene, plan, kind, layout)
        self._staging = None
        self._relative = layout == STAGED if isinstance(layout, str) else not layout.centered
        if layout in (STAGED, STAGED_CENTERED):
            center = scene.center if layout == STAGED else np.zeros(3)
            self._staging, self._lease = borrow_staging(self, kind, device, center)
        rays = empty_batch(layout, scene.center) if self._staging is None else self._staging.rays  # type: ignore[arg-type]
        hits = DeviceHits.new(kind, 1, device) if self._staging is None else self._staging.hits
        work = no_work(traversal_of(self._plan).counters, device.alias)
        kernel, inputs = kernel_and_inputs(scene, self._plan, self._config, rays, hits.struct(), work)
        self._is_cpu = device.is_cpu
        if self._is_cpu:
            self._launch: PreparedLaunch | RecordedLaunch = PreparedLaunch(kernel, inputs, device)
        else:
            self._launch = RecordedLaunch(kernel, inputs, device, (TREE, RAYS, HITS, *([NEXT] if self._takes_next else ())))
        self._rays, self._hits = self._launch.argument(RAYS), self._launch.argument(HITS)
        if self._staging is None:
            prepare_arguments(self._rays)
        self._divided: tuple[tuple[int, int], tuple[int, int, Chunks]] | None = None  # of the last call, by rays and threads

    def fit(self, scene: SceneState) -> None:
        """Makes this serve another state than it was prepared for: one whose instances are elsewhere, or one of its kind
        (`kind_of_scene`)."""
        if scene.instances:
            self._fit_instances(scene)
        else:
            tree, blocks = scene.tree, records_of(scene, self._plan, None)
            nodes, records = self._launch.argument(TREE), self._launch.argument(RECORDS)
            point_at(nodes.bounds, tree.bounds)
            point_at(nodes.child, tree.child)
            nodes.low, nodes.high = tree.low, tree.high
            point_at(records.records, blocks.records)
            point_at(records.primitive, blocks.primitive)
            self._used = tree, blocks
        if self._relative:
            self._rays.center[:] = scene.center.tolist()
            if self._staging is not None:
                self._staging.rays.center = wp.vec3d(*map(float, scene.center))
        self._mesh = scene.device_mesh

    def _fit_instances(self, scene: SceneState) -> None:
        """As `fit`, for instances: where only boxes and placements are others, their addresses are all that is written."""
        if self._forest is scene.tree.forest:
            upper = self._launch.argument(TREE)
            point_at(upper.tree.bounds, scene.tree.bounds)
            upper.tree.low[:], upper.tree.high[:] = scene.tree.low[:], scene.tree.high[:]
            point_at(upper.placements, scene.device_mesh.placements)
            extent = scene.tree.extent
            upper.extent.data, upper.extent.shape[0] = (0, 0) if extent is None else (extent.ptr, extent.size)
            upper.slack_scale, self._used = scene.boxes.slack_scale, (scene.tree, scene.device_mesh)
        else:
            self._launch.replace(TREE, scene.upper())
            self._forest = scene.tree.forest

    def retire(self) -> None:
        """Leaves this to the scenes to come, if there are others of its kind; the last one is gone.

        The garbage collector gives back the staging of a query in a cycle before it deletes the plan that calls this; such a
        query must not come back, as another one may have its staging by then.
        """
        if self._of is not None and self._lease.alive:
            self.let_go()
            _retired.give_back(self, self._of)

    def let_go(self) -> None:
        """Keeps no arrays of a scene alive any more; before the next call, `fit` must be called."""
        self._mesh = self._used = None
        self._launch.forget(())

    def run(self, scene: SceneState, rays: DeviceRays | StagedRays, columns: int, hits: DeviceHits | None = None) -> DeviceHits:
        """Answers rays of the layout; on CUDA the answers are still to be computed.

        Args:
            scene: the state, which this is made to fit if it was prepared for another.
            rays: the rays; those of staged layouts go one by one.
            columns: of the picture whose pixels they are, if the plan takes them tile by tile; else 0.
            hits: where answers on the CPU go, of rays that are not staged; None for new memory.
        """
        if scene.device_mesh is not self._mesh:
            self.fit(scene)
        if self._staging is not None:
            return self._run_staged(rays, self._staging)  # type: ignore[arg-type]
        count = rays.facts.count
        rays.write_to(self._rays)  # type: ignore[union-attr]
        self._rays.columns = columns
        threads = None
        if self._walks_single_rays and count <= FEW_RAYS:
            items, chunks = count, FEW_CHUNKS
        else:
            threads = get_num_threads()
            key = count, threads
            if self._divided is None or self._divided[0] != key:
                self._divided = key, divide(scene, self._plan, self._config, count)
            self._rays.run, items, chunks = self._divided[1]
        if hits is None:
            on_host = DeviceHits.new_on_host if count > FEW_RAYS else DeviceHits.new
            hits = (on_host if self._is_cpu else DeviceHits.new_on_cuda)(self.kind, count, scene.device)  # not during a capture
        hits.write_to(self._hits, self.kind)
        if self._takes_next:
            next_ = self._launch.argument(NEXT)
            next_.number.data, next_.threads = kept_counter(scene.device).ptr, items
        self._launch.run(items, chunks, (rays, hits), threads)
        return hits

    def _run_staged(self, rays: StagedRays, staging: Staging) -> DeviceHits:
        """Answers staged rays, one by one."""
        count, shape = rays.facts.count, rays.form.shape
        if shape != staging.shape:
            staging.fit(shape, count)
        rays.copy_to(*staging.inputs)
        self._launch.run(count, FEW_CHUNKS, self)  # until the last helper is done, nobody else gets the staging
        return DeviceHits.of_host(count, staging.hits.device, {name: values.copy() for name, values in staging.outputs})


def kind_of_scene(scene: SceneState, plan: Plan, kind: str, layout: Layout | str) -> Hashable | None:
    """What scenes have in common that one prepared query of few rays can serve; None if it cannot serve another."""
    if not (scene.shares_few_rays and plan.accelerator == "bvh" and layout in (STAGED, STAGED_CENTERED)):
        return None
    return plan, kind, layout, stack_levels(scene.depth)


def prepare(scene: SceneState, plan: Plan, kind: str, layout: Layout | str) -> PreparedQuery:
    """A prepared query for the caller alone, new or retired; arguments as in the class."""
    of = kind_of_scene(scene, plan, kind, layout)
    retired = None if of is None else _retired.take(of)
    return retired or PreparedQuery(scene, plan, kind, layout)  # `run` fits it


MAX_FREE = 16
"""Free stagings and retired queries of a kind that are kept. Making one takes 0.1 ms, much of the time to a small scene's first
answer."""

_retired: FreeList[PreparedQuery] = FreeList(MAX_FREE)
"""Prepared queries whose scenes are gone, by `kind_of_scene`: to make one takes as long as some rays."""


class Staging:
    """Memory of a prepared query for few rays and their answers; the query's as long as that lives.

    NumPy takes as long to make a view as to copy a ray, so the views for one shape are kept: most callers repeat it.

    Attributes:
        rays, hits: as kernels see them.
        shape: leading shape for which `inputs` and `outputs` were cut; None at first.
        inputs: of the same memory as NumPy arrays: origins, directions, t_min and t_max, in the leading shape.
        outputs: the same for answers, flat, each with its name.
    """

    def __init__(self, kind: str, device: wp.Device) -> None:
        self.rays, self.hits = new_rays(FEW_RAYS, device), DeviceHits.new(kind, FEW_RAYS, device)
        arrays = self.rays.origins, self.rays.directions, self.rays.t_min, self.rays.t_max
        self._inputs = [array.numpy() for array in arrays]
        self._outputs = [(name, getattr(self.hits, name).numpy()) for name in ANSWERS[kind].stored.columns]
        self.shape: tuple[int, ...] | None = None
        self.inputs: list[np.ndarray] = []
        self.outputs: list[tuple[str, np.ndarray]] = []

    def fit(self, shape: tuple[int, ...], count: int) -> None:
        """Cuts `inputs` and `outputs` for `count` rays of a leading shape."""
        self.inputs = [array[:count].reshape(shape + array.shape[1:]) for array in self._inputs]
        self.outputs = [(name, array[:count]) for name, array in self._outputs]
        self.shape = shape


_stagings: FreeList[Staging] = FreeList(MAX_FREE)


def borrow_staging(owner: PreparedQuery, kind: str, device: wp.Device, center: np.ndarray) -> tuple[Staging, finalize]:
    """A staging for a kind of query, and what makes it free again when its owner is gone; safe to call from several threads."""
    key = kind, device.alias
    staging = _stagings.take(key) or Staging(kind, device)
    staging.rays.center = wp.vec3d(*map(float, center))
    return staging, finalize(owner, _stagings.give_back, staging, key)

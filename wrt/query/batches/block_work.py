"""The work on a block: cut its rays, answer them, reduce the answers, and put the result where it belongs.

The same object does it in this process, in threads and, pickled once for all tasks, in other processes. A task is then a range
of rows, and those rows of the rays that a worker cannot read itself.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from wrt.atomic_files import replaced
from wrt.engine.rays.rays import Rays, leading_shape
from wrt.kernels.runtime.launch import use_threads
from wrt.query.batches.array_files import SMALL, opened, opened_by_workers
from wrt.query.batches.block_rows import GeneratedRays, SkippedTriangles, cut_rows, is_cut
from wrt.query.batches.outer_batches import places_last
from wrt.query.batches.reductions import BlockReduction, as_array
from wrt.query.batches.shared_files import SharedScene, deliver_scene, dumps, kept, share_scene
from wrt.query.batches.workers import Workers, task_threads

Deliver = Callable[[slice, Any], Any]
"""What is done with the answer to some rows; its result is what the client gets."""

Examine = Callable[["BlockWork", slice, Rays, Mapping[str, Any], Mapping[str, Any]], Deliver]
"""Called with the work, some rows, their rays, their mask, environment and skip, and what came with the task, before they are
answered. Returns what is done with the answer."""


HIT_QUERIES = ("intersect", "closest_point")
"""Methods whose answers have attributes, as `wrt.Hits`; others answer with an array."""


@dataclass(frozen=True)
class BlockQuery:
    """A query with its options and reductions.

    Attributes:
        method: name of the scene's method: "intersect", "occluded", "count", or "closest_point", whose points are the origins
            of rays, and whose greatest distances are their t_max.
        options: its options, but those that each ray may have of its own.
        reduction: what is made of the answers; None to keep them.
    """

    method: str
    options: Mapping[str, Any]
    reduction: BlockReduction | None

    def answer(self, scene: Any, rays: Rays, columns: Mapping[str, Any], first: int = 0) -> Any:
        """The answer to the rays of a block, whose first row has the number `first`: hits, an array, states of reductions, or
        reduced rows."""
        turned = None if self.reduction is None or self.gives_hits else places_last(scene, rays, columns, self.reduction)
        rays, columns = turned or (rays, columns)
        given = {
            name: values.on(scene.device) if isinstance(values, SkippedTriangles) else values
            for name, values in columns.items()
        }
        if self.method == "closest_point":
            found = scene.closest_point(rays.origins, max_distance=rays.t_max, **self.options, **given)
        else:
            found = getattr(scene, self.method)(rays, **self.options, **given)
        found = np.swapaxes(as_array(found), 0, 1) if turned else found
        if self.reduction is None:
            return found
        dimensions = len(rays.shape)
        with use_threads(scene.num_threads):
            states = self.reduction.part(found, dimensions, first)
        return states if self.merges_rows(dimensions) else self.reduction.finish(states)

    @property
    def gives_hits(self) -> bool:
        """Whether answers have attributes."""
        return self.method in HIT_QUERIES

    def merges_rows(self, dimensions: int) -> bool:
        """Whether axis 0 of an N-dimensional batch is reduced, so that blocks must be merged."""
        return self.reduction is not None and self.reduction.axes(dimensions)[0] == 0


@dataclass(frozen=True)
class BlockWork:
    """All that the work on any block needs.

    Attributes:
        scene: a scene, or in a pickle the `SharedScene`.
        query: what is asked.
        rays: the whole batch; None if each task brings its rays.
        columns: mask, environment and skip, as numbers or for the whole batch.
        axes: number of leading axes of the batch.
        deliver: what is done with an answer; None to return it.
        threads, device: as in `Workers`.
        examine: what looks at the rays of a block first, and says what is done with their answer in place of `deliver`.
    """

    scene: Any
    query: BlockQuery
    rays: Rays | GeneratedRays | None
    columns: Mapping[str, Any]
    axes: int
    deliver: Deliver | None = None
    threads: int | None = None
    device: str | None = None
    examine: Examine | None = None

    def run(self, rows: slice, sent: Mapping[str, Any]) -> Any:
        """The answer for some rows, delivered.

        Args:
            rows: the rows.
            sent: of the rays, the mask and the triangles to skip, what came with the task: these rows, cut.
        """
        columns = {name: sent.get(name, values) for name, values in self.columns.items()}
        cut = {name: self._cut(name, opened(values), rows, sent) for name, values in columns.items()}
        if "rays" in sent:
            rays = sent["rays"]
        elif isinstance(self.rays, GeneratedRays):
            rays = self.rays.rows(rows.start, rows.stop)
        else:
            whole = {name: opened(values) for name, values in vars(self.rays).items() if name not in sent}
            rays = Rays(**{**{name: self._cut(name, values, rows, sent) for name, values in whole.items()}, **rays_of(sent)})
        deliver = self.deliver if self.examine is None else self.examine(self, rows, rays, cut, sent)
        answer = self.query.answer(self.scene, rays, cut, rows.start)
        return answer if deliver is None else deliver(rows, answer)

    def _cut(self, name: str, values: Any, rows: slice, sent: Mapping[str, Any]) -> Any:
        if name in sent or values is None:
            return values
        shape = leading_shape(values) if name in ("origins", "directions") else np.shape(values)
        return cut_rows(values, shape, self.axes, rows.start, rows.stop)


def rays_of(sent: Mapping[str, Any]) -> dict[str, Any]:
    """What came with a task of the rays."""
    return {name: sent[name] for name in ("origins", "directions", "t_min", "t_max") if name in sent}


@dataclass(frozen=True)
class PickledWork:
    """Work in a pickle, which each process unpickles once.

    Attributes:
        data: the pickle; None if it is large and in a file.
        path: of the file, beside that of the scene.
        hash: SHA-256 of the pickle.
    """

    data: bytes | None
    path: Path
    hash: str

    @staticmethod
    def of(work: BlockWork, shared: SharedScene, is_seen: bool) -> PickledWork:
        """The pickle of some work.

        Args:
            work: the work, with the shared scene.
            shared: where the scene is.
            is_seen: whether workers see the scene's folder.

        Raises:
            TypeError: a part of it cannot be pickled.
        """
        data = dumps(work)
        data_hash = hashlib.sha256(data).hexdigest()
        path = Path(shared.path).with_name(f"work-{data_hash}.pickle")
        if len(data) <= SMALL or not is_seen:
            return PickledWork(data, path, data_hash)
        with replaced(path) as file:
            file.write(data)
        return PickledWork(None, path, data_hash)

    def get(self) -> BlockWork:
        """The work in this process, with the scene."""
        return kept(self.hash, self._read)

    def _read(self) -> BlockWork:
        data = self.path.read_bytes() if self.data is None else self.data
        if hashlib.sha256(data).hexdigest() != self.hash:
            raise ValueError(f"'{self.path}' is not what the client wrote; another program wrote there")
        return pickle.loads(data)


def run_block(pickled: PickledWork, rows: slice, sent: Mapping[str, Any]) -> Any:
    """A task in another process."""
    work = pickled.get()
    with task_threads(work.threads):
        return replace(work, scene=work.scene.get(work.device)).run(rows, sent)


def run_here(work: BlockWork, rows: slice, sent: Mapping[str, Any]) -> Any:
    """A task in a thread of this process."""
    with task_threads(work.threads):
        return work.run(rows, sent)


class Submitter:
    """Submits the tasks of a batch.

    Args:
        work: the work, with the scene of this process.
        workers: who does it.
    """

    def __init__(self, work: BlockWork, workers: Workers) -> None:
        self._submit = workers.submit
        self._work = replace(work, threads=workers.threads_each(), device=workers.device)
        self._cut: dict[str, Any] = {}
        if workers.in_this_process:
            self._run: Any = run_here
            self._common: BlockWork | PickledWork = self._work
            return
        if workers.threads is None and self._work.threads is not None and hasattr(workers.executor, "_threads"):
            self._work = replace(self._work, threads=None)  # its processes were told
        shared = share_scene(work.scene, workers.folder)
        is_seen = deliver_scene(workers, shared)
        self._run, self._common = run_block, PickledWork.of(self._for_others(shared), shared, is_seen)

    def _for_others(self, shared: SharedScene) -> BlockWork:
        """The work with all that workers open themselves or that is small; what is cut for each task is kept here."""
        work = self._work
        columns = {name: self._to_send(name, values) for name, values in work.columns.items()}
        rays = work.rays
        if isinstance(rays, Rays):
            rays = Rays(**{name: self._to_send(name, values) for name, values in vars(rays).items()})
        return replace(work, scene=shared, columns=columns, rays=rays)

    def _to_send(self, name: str, values: Any) -> Any:
        if values is None or np.isscalar(values):
            return values
        if (reference := opened_by_workers(values)) is not None:
            return reference
        values = values.numpy() if isinstance(values, wp.array) else values
        shape = leading_shape(values) if name in ("origins", "directions") else np.shape(values)
        if not is_cut(shape, self._work.axes) or getattr(values, "nbytes", SMALL + 1) <= SMALL:
            return values
        self._cut[name] = (values, shape)
        return None

    def submit(self, piece: Any) -> Future:
        """Submits the work on a block (`wrt.query.blocks.Piece`)."""
        rows, sent = piece.rows, dict(piece.sent)
        for name, (values, shape) in self._cut.items():
            part = cut_rows(values, shape, self._work.axes, rows.start, rows.stop)
            sent[name] = part if isinstance(part, SkippedTriangles) else np.asarray(part)
        return self._submit(self._run, self._common, rows, sent)

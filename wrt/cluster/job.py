"""Jobs: batches in a folder, which go on where they ended, whatever ended them.

Workers write the answer of each block into the folder, if they see it; else they send it, and the client writes. What is there
is never computed again. A job whose scene, rays or options differ from those that the folder began with is refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wrt.cluster.fingerprints import options_text, rays_hash, scene_hash
from wrt.cluster.job_folder import JobFolder
from wrt.cluster.stored_answers import pack_answer, unpack_answer
from wrt.kernels.validation import as_int
from wrt.query.batches.block_limits import finished_before_interrupt, progress_bar
from wrt.query.batches.block_outputs import ATTRIBUTES, check_out, store, value_of
from wrt.query.batches.block_work import BlockQuery
from wrt.query.blocks import Blocks, Piece, joined

KEPT_ATTRIBUTES = ("t", "primitive_id", "geometry_id")
"""Attributes of closest hits that a job keeps if it is not told."""


@dataclass(frozen=True)
class WriteChunk:
    """Writes answers of blocks into a job's folder, on workers that see it; else returns them as named arrays.

    Attributes:
        folder: path of the folder.
        id: of the job.
        rows: rows of a block.
        attributes: of closest hits, those to keep; None for answers of another kind.
    """

    folder: str
    id: str
    rows: int
    attributes: tuple[str, ...] | None

    def __call__(self, rows: slice, answer: Any) -> dict[str, np.ndarray] | None:
        kept = answer if self.attributes is None else {name: value_of(answer, name) for name in self.attributes}
        arrays, folder = pack_answer(kept), JobFolder(self.folder)
        if not folder.manifest_path.is_file() or folder.manifest()["id"] != self.id:
            return arrays
        folder.write_chunk(rows.start // self.rows, self.id, arrays)
        return None


@dataclass(frozen=True)
class JobStatus:
    """How far a job is.

    Attributes:
        folder: path of its folder.
        query: "intersect", "occluded" or "count".
        blocks, done: number of blocks, and of those that are done.
        rays, rays_done: number of rays, and of those that are answered.
        bytes: of the answers so far.
        is_running: whether a client runs it now.
        seconds: between the first and the last answer that was written.
    """

    folder: Path
    query: str
    blocks: int
    done: int
    rays: int
    rays_done: int
    bytes: int
    is_running: bool
    seconds: float

    @property
    def is_complete(self) -> bool:
        """Whether all blocks are done."""
        return self.done == self.blocks


class Job:
    """A batch in a folder. Run it again after whatever ended it; blocks that are done are not computed again.

        blocks = scene.occluded_blocks(points[:, None], suns, reduce="sum", axis=1, executor=pool, progress=True)
        shaded = wrt.cluster.Job("sun_hours", blocks).run().result()

    Blocks have as many rows as in the first run, whatever `memory` is now. Any executor may go on with a job of another one.

    Args:
        folder: path of the folder, which is made; best on a file system that workers see at the same path.
        blocks: what `intersect_blocks`, `occluded_blocks` or `count_blocks` returned, with an executor or without.
        attributes: of closest hits without `reduce`, the attributes to keep; None for t, primitive_id and geometry_id.

    Raises:
        OSError: the folder cannot be made.
        ValueError: rays from an iterator (pass `wrt.GeneratedRays`), an unknown attribute, or a folder with a job of another
            scene, other rays or other options.
    """

    def __init__(self, folder: str | Path, blocks: Blocks, *, attributes: Sequence[str] | None = None) -> None:
        if blocks.shape is None:
            raise ValueError("rays from an iterator cannot be read again; pass arrays or wrt.GeneratedRays to a job")
        self.folder, self.blocks = JobFolder(folder), blocks
        query = blocks.work.query
        self._attributes = None
        if query.method == "intersect" and query.reduction is None:
            self._attributes = tuple(KEPT_ATTRIBUTES if attributes is None else attributes)
            if unknown := [name for name in self._attributes if name not in ATTRIBUTES]:
                raise ValueError(f"attributes holds {unknown[0]!r}; choose from {', '.join(ATTRIBUTES)}")
        elif attributes is not None:
            raise ValueError("attributes is for closest hits without reduce; leave it out")
        wanted = self._wanted(query)
        if not self.folder.manifest_path.exists():
            with self.folder.locked():
                if not self.folder.manifest_path.exists():
                    self.folder.create({**wanted, "rows": blocks.ranges(blocks.shape).step})
        self.manifest = self.folder.manifest()
        self._refuse_changed(wanted)

    def _wanted(self, query: BlockQuery) -> dict[str, Any]:
        """What the manifest says of a job, but its rows."""
        work = self.blocks.work
        return {
            "scene": scene_hash(work.scene),
            "rays": rays_hash(work.rays, work.columns),
            "query": query.method,
            "options": options_text([query.options, query.reduction, self._attributes]),
            "shape": list(self.blocks.shape),
        }

    def _refuse_changed(self, wanted: dict[str, Any]) -> None:
        for name, value in wanted.items():
            if self.manifest[name] != value:
                shown = f": {self.manifest[name]} before, {value} now" if name != "scene" and name != "rays" else ""
                raise ValueError(
                    f"the job in '{self.folder.path}' was begun with another {name}{shown}; choose another folder, or remove it"
                )

    @property
    def status(self) -> JobStatus:
        """How far the job is."""
        return job_status(self.folder.path)

    def run(self, most: int | None = None) -> Job:
        """Computes the blocks that are not done yet; returns the job. Ctrl-C ends it after the blocks under way.

        Args:
            most: largest number of blocks to compute in this run, for a machine that is there for some time only; None for all.

        Raises:
            TypeError, ValueError: `most` is no whole number, or negative.
            RuntimeError: another client runs the job, or the workers that took a block died each time.
            OSError: an answer cannot be written.
        """
        most = None if most is None else as_int("most", most, 0)
        with self.folder.locked():
            self.folder.remove_leftovers()
            done = self.folder.done()
            self._compute([number for number in range(block_count(self.manifest)) if number not in done][:most])
        return self

    def _compute(self, numbers: Sequence[int]) -> None:
        each = math.prod(self.blocks.shape[1:])
        rows, id = self.manifest["rows"], self.manifest["id"]
        pieces = [Piece(part, (part.stop - part.start) * each, {}) for part in map(self._rows, numbers)]
        done = sum(part.stop - part.start for part in map(self._rows, self.folder.done())) * each
        deliver = WriteChunk(str(self.folder.path), id, rows, self._attributes)
        with progress_bar(self.blocks.progress, math.prod(self.blocks.shape), done) as advance:
            for piece, arrays in self.blocks.run_pieces(iter(pieces), deliver, ordered=False):
                if arrays is not None:
                    with finished_before_interrupt():
                        self.folder.write_chunk(piece.rows.start // rows, id, arrays)
                advance(piece.count)

    def _rows(self, number: int) -> slice:
        rows = self.manifest["rows"]
        return slice(number * rows, min((number + 1) * rows, self.blocks.shape[0]))

    def answers(self) -> Iterator[tuple[slice, Any]]:
        """The rows and answer of each block, from the files; those of damaged ones are computed again.

        Raises:
            RuntimeError: the job is not complete, or another client runs it.
        """
        missing = block_count(self.manifest) - len(self.folder.done())
        if missing:
            raise RuntimeError(f"{missing} blocks of the job in '{self.folder.path}' are not done; call run()")
        for number in range(block_count(self.manifest)):
            arrays = self.folder.read_chunk(number, self.manifest["id"])
            if arrays is None:
                with self.folder.locked():
                    self.folder.chunk_path(number).unlink(missing_ok=True)
                    self._compute([number])
                arrays = self.folder.read_chunk(number, self.manifest["id"])
            yield self._rows(number), unpack_answer(arrays)

    def result(self) -> Any:
        """The whole answer: an array, a dict of arrays by attribute, or what `reduce` makes of all blocks.

        Raises:
            RuntimeError: as `answers`.
        """
        reduction = self.blocks.work.query.reduction
        if not self._merges():
            return joined([answer for _, answer in self.answers()] or [self._empty()])
        merged = None
        for _, states in self.answers():
            merged = states if merged is None else reduction.merge(merged, states)
        return reduction.finish(self._empty() if merged is None else merged)

    def write(self, out: Any) -> int:
        """Writes the answer to arrays, block by block; arguments, result and errors as of `Blocks.write`, and as `answers`."""
        if self._merges():
            raise ValueError("reduce along the first axis leaves no rows; call result()")
        check_out(out, self._empty(), self.blocks.shape[0], exact=True)
        for rows, answer in self.answers():
            store(out, rows, answer)
        return self.blocks.shape[0]

    def _empty(self) -> Any:
        answer = self.blocks.answer_rows(slice(0, 0))
        return answer if self._attributes is None else {name: getattr(answer, name) for name in self._attributes}

    def _merges(self) -> bool:
        return self.blocks.work.query.merges_rows(len(self.blocks.shape))


def block_count(manifest: dict[str, Any]) -> int:
    """Number of blocks of a job."""
    return -(-manifest["shape"][0] // manifest["rows"])


def job_status(folder: str | Path) -> JobStatus:
    """How far the job in a folder is, from its files alone.

    Args:
        folder: path of the folder.

    Raises:
        FileNotFoundError: there is no job.
        ValueError: its manifest cannot be read.
    """
    place = JobFolder(folder)
    manifest = place.manifest()
    blocks, rows, shape = block_count(manifest), manifest["rows"], manifest["shape"]
    done = {number for number in place.done() if number < blocks}
    found = [place.chunk_path(number).stat() for number in done]
    last = shape[0] - (blocks - 1) * rows if blocks else 0
    rows_done = len(done) * rows - (rows - last if blocks - 1 in done else 0)
    times = [one.st_mtime for one in found] or [0.0]
    return JobStatus(
        folder=place.path,
        query=manifest["query"],
        blocks=blocks,
        done=len(done),
        rays=math.prod(shape),
        rays_done=rows_done * math.prod(shape[1:]),
        bytes=sum(one.st_size for one in found),
        is_running=place.is_running(),
        seconds=max(times) - min(times),
    )

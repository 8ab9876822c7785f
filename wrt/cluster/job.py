"""Jobs: resumable batches in a folder.

Workers write the answer of each block into the folder, if they see it; else they send it, and the client writes. What is there
is never computed again. A job whose scene, rays or options differ from those that the folder began with is refused, when it is
made and whenever it runs: the scene may be updated meanwhile, and arrays of rays may be written to. Blocks are computed from a
copy of the scene that was compared, so that none is of another one (`wrt.cluster.job_blocks`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from wrt.cluster.identity.described import options_text
from wrt.cluster.identity.ray_hashes import hashes_of_blocks, is_whole, rays_hash
from wrt.cluster.identity.scene_hashes import scene_hash
from wrt.cluster.job_blocks import BLOCK_HASH, ExamineBlock, block_count, chunk_label, has_rows, rows_of_block
from wrt.cluster.job_folder import JobFolder
from wrt.cluster.stored_answers import unpack_answer
from wrt.engine.rays.rays import Rays
from wrt.kernels.validation import as_int
from wrt.query.batches.block_limits import finished_before_interrupt, progress_bar
from wrt.query.batches.block_outputs import ATTRIBUTES, check_out, store
from wrt.query.batches.block_work import BlockQuery
from wrt.query.blocks import Blocks, Piece, joined
from wrt.revisions import ANSWER_REVISION
from wrt.scene.archives import UNREADABLE

OTHER = {
    "shape": "rays of another shape",
    "answers": "a version of wrt that may give other answers (wrt.revisions.ANSWER_REVISION)",
    "scene": "another scene",
    "query": "another query",
    "rays": "other rays",
    "options": "other options",
}
"""What differs, in words, by the manifest's field."""

KEPT_ATTRIBUTES = ("t", "primitive_id", "geometry_id")
"""Attributes of closest hits that a job keeps if it is not told."""


@dataclass(frozen=True)
class JobStatus:
    """How far a job is.

    Attributes:
        folder: path of its folder.
        query: "intersect", "occluded", "count" or "closest_point".
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
    """A batch in a folder. Run it again to resume; blocks that are done are not computed again.

        blocks = scene.occluded_blocks(points[:, None], suns, reduce="sum", axis=1, executor=pool, progress=True)
        shaded = wrt.cluster.Job("sun_hours", blocks).run().result()

    Blocks have as many rows as in the first run, whatever `memory` is now. Any executor may go on with a job of another one.

    A job is of one scene, one batch of rays and one set of options. Scenes are compared whole, also by every worker. Arrays of
    up to 256 MB are compared whole, block by block, when blocks are computed. Of larger arrays, 64 pieces of 1 MB are compared,
    and of `wrt.batches.GeneratedRays` the code of the function and a million rays (2^20) in 64 pieces, when the job is made and
    before and after each run. **What differs between these pieces only is not noticed.**

    Args:
        folder: path of the folder, which is made; best on a file system that workers see at the same path.
        blocks: what `intersect_blocks`, `occluded_blocks`, `count_blocks` or `closest_point_blocks` returned, with an executor
            or without.
        attributes: of closest hits without `reduce`, the attributes to keep; None for t, primitive_id and geometry_id.

    Raises:
        OSError: the folder cannot be made.
        ValueError: rays from an iterator (pass `wrt.batches.GeneratedRays`), an unknown attribute, a folder with a job of
            another scene, other rays or other options, or one whose manifest or lock is damaged or a link.
    """

    def __init__(self, folder: str | Path, blocks: Blocks, *, attributes: Sequence[str] | None = None) -> None:
        if blocks.shape is None:
            raise ValueError("rays from an iterator cannot be read again; pass arrays or wrt.batches.GeneratedRays to a job")
        self.folder, self.blocks = JobFolder(folder), blocks
        query = blocks.work.query
        self._attributes = None
        if query.gives_hits and query.reduction is None:
            self._attributes = tuple(KEPT_ATTRIBUTES if attributes is None else attributes)
            if unknown := [name for name in self._attributes if name not in ATTRIBUTES]:
                raise ValueError(f"attributes holds {unknown[0]!r}; choose from {', '.join(ATTRIBUTES)}")
        elif attributes is not None:
            raise ValueError("attributes is for closest hits without reduce; leave it out")
        if not self.folder.has_manifest():
            self._try_query()
            rows = blocks.ranges(blocks.shape).step
            wanted = self._wanted(query, rows)
            with self.folder.locked():
                if not self.folder.has_manifest():
                    self.folder.create({**wanted, "rows": rows})
        self.manifest = self.folder.manifest()
        self._refuse_other(self._wanted(query, self.manifest["rows"]))

    def _try_query(self) -> None:
        """Asks the query with no rays, so that options which it refuses leave no folder behind. Functions are not called."""
        work = self.blocks.work
        if isinstance(work.rays, Rays):
            replace(work, query=replace(work.query, reduction=None)).run(slice(0, 0), {})

    def _wanted(self, query: BlockQuery, rows: int) -> dict[str, Any]:
        """What the manifest says of a job, but its rows; notes the hashes of the blocks, if the rays are hashed whole."""
        work, shape = self.blocks.work, self.blocks.shape
        self._hashes = hashes_of_blocks(work, shape[0], rows) if is_whole(work) else None
        return {
            "shape": list(shape),
            "answers": ANSWER_REVISION,
            "scene": scene_hash(work.scene),
            "query": query.method,
            "rays": rays_hash(work, self._hashes),
            "options": options_text([query.options, query.reduction, self._attributes]),
        }

    def _refuse_other(self, wanted: dict[str, Any]) -> None:
        for name, value in wanted.items():
            if self.manifest[name] != value:
                shown = "" if name in ("scene", "rays") else f": {self.manifest[name]} before, {value} now"
                raise ValueError(
                    f"the job in '{self.folder.path}' was begun with {OTHER[name]}{shown}; choose another folder, or remove it"
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
            OSError: an answer cannot be written.
            RuntimeError: another client runs the job, or the workers that took a block died each time.
            TypeError: `most` is no whole number.
            ValueError: `most` is negative; or the scene, the rays or the manifest have changed since the job was made, on a
                worker or here; or the folder holds an archive that is not the answer of a block. What was computed before
                stays as it is.
        """
        most = None if most is None else as_int("most", most, 0)
        with self.folder.locked():
            self.folder.remove_leftovers()
            blocks = block_count(self.manifest)
            done = self.folder.done(blocks)
            self._compute([number for number in range(blocks) if number not in done][:most])
        return self

    def _compute(self, numbers: Sequence[int]) -> None:
        if not numbers:
            return
        if self.folder.manifest() != self.manifest:
            raise ValueError(f"'{self.folder.path}' holds another job than before; make the job again")
        each = math.prod(self.blocks.shape[1:])
        blocks, rows = copy(self.blocks), [rows_of_block(self.manifest, number) for number in numbers]
        blocks.work = replace(blocks.work, scene=copy(blocks.work.scene))
        self._refuse_other_scene(blocks.work.scene)
        sent = [{} if self._hashes is None else {BLOCK_HASH: self._hashes[number]} for number in numbers]
        pieces = [Piece(part, (part.stop - part.start) * each, options) for part, options in zip(rows, sent, strict=True)]
        before = [rows_of_block(self.manifest, number) for number in self.folder.done()]
        done = sum(part.stop - part.start for part in before) * each
        examine = ExamineBlock.of(str(self.folder.path), self.manifest, self._attributes, blocks)
        with self._sampled_rays(numbers), progress_bar(self.blocks.progress, math.prod(self.blocks.shape), done) as advance:
            for piece, arrays in blocks.run_pieces(iter(pieces), None, ordered=False, examine=examine):
                if arrays is not None:
                    with finished_before_interrupt():
                        number = piece.rows.start // self.manifest["rows"]
                        self.folder.write_chunk(number, chunk_label(self.manifest, number), arrays)
                self._refuse_other_scene(self.blocks.work.scene)
                advance(piece.count)

    def _refuse_other_scene(self, scene: Any) -> None:
        if scene_hash(scene) != self.manifest["scene"]:
            raise ValueError(
                f"the scene has changed since the job in '{self.folder.path}' began; the blocks that are done are of the scene "
                "as it was: change it back, or make another job in another folder"
            )

    @contextmanager
    def _sampled_rays(self, numbers: Sequence[int]) -> Iterator[None]:
        """Compares rays that are not hashed whole before and after some blocks; removes these if the rays have changed."""
        if self._hashes is not None:
            yield
            return
        changed = f"the rays have changed since the job in '{self.folder.path}' began; change them back, or take another folder"
        if rays_hash(self.blocks.work, None) != self.manifest["rays"]:
            raise ValueError(changed)
        try:
            yield
        finally:
            if rays_hash(self.blocks.work, None) != self.manifest["rays"]:
                self.folder.remove_chunks(numbers)
                raise ValueError(f"{changed}; the answers of this run were removed")

    def answers(self) -> Iterator[tuple[slice, Any]]:
        """The rows and answer of each block, from the files; those of damaged ones are computed again.

        Raises:
            RuntimeError: the job is not complete, or another client runs it.
            ValueError: as `run`; or a block is of other rays, and cannot be computed again, because these have changed.
        """
        blocks = block_count(self.manifest)
        missing = blocks - len(self.folder.done(blocks))
        if missing:
            raise RuntimeError(f"{missing} blocks of the job in '{self.folder.path}' are not done; call run()")
        for number in range(blocks):
            answer = self._read(number)
            if answer is None:
                with self.folder.locked():
                    self.folder.remove_chunks({number})
                    self._compute([number])
                answer = self._read(number)
                if answer is None:
                    raise RuntimeError(f"'{self.folder.chunk_path(number)}' cannot be read again after it was written")
            yield rows_of_block(self.manifest, number), answer

    def _read(self, number: int) -> Any:
        """The answer of a block from its file; None if that is damaged, of another block or of other rays."""
        arrays = self.folder.read_chunk(number, chunk_label(self.manifest, number))
        if arrays is None:
            return None
        expected = "" if self._hashes is None else self._hashes[number]
        if str(arrays.pop(BLOCK_HASH, "")) != expected:
            return None
        try:
            answer = unpack_answer(arrays)
        except UNREADABLE:
            return None
        rows = rows_of_block(self.manifest, number)
        return answer if self._merges() or has_rows(answer, rows.stop - rows.start) else None

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
        """Writes the answer to arrays, block by block; arguments, result and errors as in `Blocks.write` and `answers`."""
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


def job_status(folder: str | Path) -> JobStatus:
    """How far the job in a folder is, from its files alone.

    Args:
        folder: path of the folder.

    Raises:
        FileNotFoundError: there is no job.
        ValueError: its manifest cannot be read, or it holds an archive that is not the answer of a block.
    """
    place = JobFolder(folder)
    manifest = place.manifest()
    blocks, rows, shape = block_count(manifest), manifest["rows"], manifest["shape"]
    done = place.done(blocks)
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

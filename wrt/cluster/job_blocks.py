"""The blocks of a job: what a worker compares before it computes one, and how it writes the answer.

A worker may have read another file of a scene, or imported another version of a function that makes rays, than the client. So
each process compares its scene with the manifest, whole, and a sample of the rays of a function, once; and the rays of each
block, if the batch is hashed whole, whenever it computes one.
"""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from wrt.cluster.identity.ray_hashes import block_hash, generated_hash
from wrt.cluster.identity.scene_hashes import scene_hash
from wrt.cluster.job_folder import JobFolder
from wrt.cluster.stored_answers import pack_answer
from wrt.engine.rays.rays import Rays
from wrt.query.batches.block_outputs import value_of
from wrt.query.batches.block_rows import GeneratedRays
from wrt.query.batches.block_work import BlockWork
from wrt.query.batches.shared_files import kept
from wrt.query.blocks import Blocks
from wrt.revisions import ANSWER_REVISION

BLOCK_HASH = "rays_hash"
"""Name under which a task brings the hash of its block's rays, and under which the file of an answer keeps it."""

PROCESS = secrets.token_hex(8)
"""Names this process."""


@dataclass(frozen=True)
class WriteChunk:
    """Writes the answer of a block into a job's folder, if this process sees it; else returns it as named arrays.

    Attributes:
        folder: path of the folder.
        id: of the job.
        number: of the block.
        label: of the block.
        hash: of its rays; empty if the batch is not hashed whole.
        attributes: of closest hits, those to keep; None for answers of another kind.
        rays, columns: of the block; they are compared again, because another thread may write to them.
    """

    folder: str
    id: str
    number: int
    label: str
    hash: str
    attributes: tuple[str, ...] | None
    rays: Rays
    columns: Mapping[str, Any]

    def __call__(self, rows: slice, answer: Any) -> dict[str, np.ndarray] | None:
        refuse_other_rays(rows, self.rays, self.columns, self.hash)
        values = answer if self.attributes is None else {name: value_of(answer, name) for name in self.attributes}
        arrays, folder = {**pack_answer(values), BLOCK_HASH: np.array(self.hash)}, JobFolder(self.folder)
        if not folder.has_manifest() or folder.manifest()["id"] != self.id:
            return arrays
        folder.write_chunk(self.number, self.label, arrays)
        return None


@dataclass(frozen=True)
class ExamineBlock:
    """Compares what a block is computed from with a job's manifest; see `wrt.query.batches.block_work.Examine`.

    Attributes:
        folder: path of the job's folder.
        manifest: of the job.
        attributes: of closest hits, those to keep; None for answers of another kind.
        generated: hash of the rays that a function makes; empty if none does.
        client: names the process that runs the job, which compares these itself.
    """

    folder: str
    manifest: Mapping[str, Any]
    attributes: tuple[str, ...] | None
    generated: str
    client: str

    @classmethod
    def of(cls, folder: str, manifest: Mapping[str, Any], attributes: tuple[str, ...] | None, blocks: Blocks) -> ExamineBlock:
        """What compares the blocks of a job that this process runs."""
        is_sent = blocks.workers is not None and not blocks.workers.in_this_process
        generated = is_sent and isinstance(blocks.work.rays, GeneratedRays)
        return cls(folder, manifest, attributes, generated_hash(blocks.work.rays) if generated else "", PROCESS)

    def __call__(
        self, work: BlockWork, rows: slice, rays: Rays, columns: Mapping[str, Any], sent: Mapping[str, Any]
    ) -> WriteChunk:
        """Compares scene and rays; returns what writes the answer.

        Raises:
            ValueError: they differ from those that the job began with.
        """
        job_id, number = self.manifest["id"], rows.start // self.manifest["rows"]
        if (began := self.manifest["answers"]) != ANSWER_REVISION:
            raise ValueError(
                f"a worker has another version of wrt, whose answers have revision {ANSWER_REVISION}, and the job began with "
                f"revision {began}; install the client's version there"
            )
        if scene_hash(work.scene) != self.manifest["scene"]:
            raise ValueError("a worker has another scene than the job began with; start it again")
        is_elsewhere = self.generated and self.client != PROCESS
        if is_elsewhere and kept((id, self.generated), lambda: generated_hash(work.rays)) != self.generated:
            raise ValueError("the function makes other rays on a worker than here; give both the same code and data")
        expected = sent.get(BLOCK_HASH, "")
        refuse_other_rays(rows, rays, columns, expected)
        label = chunk_label(self.manifest, number)
        return WriteChunk(self.folder, job_id, number, label, expected, self.attributes, rays, columns)


def refuse_other_rays(rows: slice, rays: Rays, columns: Mapping[str, Any], expected: str) -> None:
    """Refuses rays of a block with another hash than expected; any, if that is empty.

    Raises:
        ValueError: the hash differs.
    """
    if expected and block_hash(rays, columns) != expected:
        raise ValueError(
            f"the rays of rows {rows.start} to {rows.stop - 1} have changed since the job was made; change them back, or make "
            "another job in another folder"
        )


def block_count(manifest: Mapping[str, Any]) -> int:
    """Number of blocks of a job."""
    return -(-manifest["shape"][0] // manifest["rows"])


def rows_of_block(manifest: Mapping[str, Any], number: int) -> slice:
    """The rows of a block."""
    rows = manifest["rows"]
    return slice(number * rows, min((number + 1) * rows, manifest["shape"][0]))


def chunk_label(manifest: Mapping[str, Any], number: int) -> str:
    """What identifies the answer of a block: the job, the number, and the rows."""
    rows = rows_of_block(manifest, number)
    return f"{manifest['id']} {number} {rows.start} {rows.stop}"


def has_rows(answer: Any, rows: int) -> bool:
    """Whether an answer, an array or arrays by name, has this many rows."""
    if isinstance(answer, Mapping):
        return all(has_rows(one, rows) for one in answer.values())
    return isinstance(answer, np.ndarray) and answer.shape[:1] == (rows,)

"""The folder of a job: what is computed there, which blocks are done, and who works on it.

    manifest.json           hashes of scene and rays, options, the number of rows of a block; written once
    chunks/0000/0000000.npz the answer of block 0, in folders of 1,000; a file is there whole or not at all
    lock                    held by the client that runs the job

A block is done if its file is there, so nothing has to be kept in step: a client or a worker may be killed at any moment. A
file's checksum is compared when it is read. The lock is one of the operating system (`flock`), which a killed process leaves by
itself; on network file systems that have locks it holds between machines, too.

No link in the folder is followed (`wrt.cluster.own_files`), and an archive in it that is not the file of a block is an error.
"""

from __future__ import annotations

import json
import os
import secrets
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import time
from typing import Any, BinaryIO

import numpy as np

from wrt.atomic_files import replaced
from wrt.cluster.job_manifest import parse_manifest, signed
from wrt.cluster.own_files import open_own, own_folder, refuse_link
from wrt.scene.archives import UNREADABLE, read_archive, write_archive

IN_A_FOLDER = 1000
"""Chunks in a folder: directories of millions of files are slow."""

LARGEST_MANIFEST = 1 << 26
"""Bytes of a manifest at most."""


class JobFolder:
    """A folder with a job.

    Args:
        path: path of the folder.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path).absolute()

    @property
    def manifest_path(self) -> Path:
        """Path of the manifest."""
        return self.path / "manifest.json"

    def has_manifest(self) -> bool:
        """Whether something is there under the manifest's name, which may be a link to nothing."""
        return os.path.lexists(self.manifest_path)

    def manifest(self) -> dict[str, Any]:
        """What the job is.

        Raises:
            FileNotFoundError: there is no job.
            ValueError: the manifest cannot be read, is a link, was changed, or is of another format.
        """
        if not self.has_manifest():
            raise FileNotFoundError(f"'{self.path}' has no job: there is no manifest.json in it")
        try:
            with open_own(self.manifest_path) as file:
                text = file.read(LARGEST_MANIFEST + 1)
            if len(text) > LARGEST_MANIFEST:
                raise ValueError(f"it has more than {LARGEST_MANIFEST:,} bytes")
            return parse_manifest(text)
        except (ValueError, RecursionError) as error:
            reason = f"the manifest of the job '{self.path}' cannot be read ({error})"
            raise ValueError(f"{reason}; restore it, or choose another folder") from error

    def create(self, manifest: dict[str, Any]) -> None:
        """Writes the manifest of a new job, to which it gives an id.

        Raises:
            OSError: the folder cannot be made.
            ValueError: the folder holds other files.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        if others := [one.name for one in self.path.iterdir() if one.name != "lock" and not one.name.startswith(".")]:
            raise ValueError(f"'{self.path}' holds {others[0]} and no job; choose an empty folder")
        whole = signed({"id": secrets.token_hex(8), **manifest})
        with replaced(self.manifest_path) as file:
            file.write(json.dumps(whole, indent=1).encode())

    def chunk_path(self, number: int) -> Path:
        """Path of the answer of a block."""
        return self.path / "chunks" / f"{number // IN_A_FOLDER:04d}" / f"{number:07d}.npz"

    def chunk_folders(self) -> list[Path]:
        """The folders of answers.

        Raises:
            ValueError: one of them is a link.
        """
        chunks = self.path / "chunks"
        if not own_folder(chunks):
            return []
        return [path for path in sorted(chunks.iterdir()) if not path.name.startswith(".") and own_folder(path)]

    def done(self, blocks: int | None = None) -> set[int]:
        """Numbers of the blocks that are done.

        Args:
            blocks: number of blocks of the job; None if it is not known.

        Raises:
            ValueError: an archive is not that of a block of the job, such as a copy of one, or is a link.
        """
        found = set()
        for folder in self.chunk_folders():
            with os.scandir(folder) as entries:
                for entry in entries:
                    if entry.name.startswith(".") or not entry.name.endswith(".npz"):
                        continue
                    number = int(entry.name[:-4]) if entry.name[:-4].isdecimal() else -1
                    path = Path(entry.path)
                    if number < 0 or path != self.chunk_path(number) or not (blocks is None or number < blocks):
                        whole = "" if blocks is None else f", which has blocks 0 to {blocks - 1}"
                        raise ValueError(f"'{path}' is not the answer of a block of this job{whole}; move it elsewhere")
                    if not entry.is_file(follow_symlinks=False):
                        raise ValueError(f"'{path}' is a link or no regular file; remove it, and its block is computed again")
                    found.add(number)
        return found

    def write_chunk(self, number: int, label: str, arrays: dict[str, np.ndarray]) -> None:
        """Writes the answer of a block, whole or not at all.

        Args:
            number: of the block.
            label: what identifies the block: of which job it is, and which rows.
            arrays: the answer.

        Raises:
            OSError: it cannot be written.
            ValueError: the path leads through a link.
        """
        path = self.chunk_path(number)
        for folder in (path.parent.parent, path.parent):
            own_folder(folder)
            folder.mkdir(parents=True, exist_ok=True)
        refuse_link(path)
        write_archive(path, {"job": np.array(label), **arrays})

    def read_chunk(self, number: int, label: str) -> dict[str, np.ndarray] | None:
        """The answer of a block; None if its file is missing, damaged or of another block, whose label differs.

        Raises:
            ValueError: the path leads through a link.
        """
        path = self.chunk_path(number)
        for one in (path.parent.parent, path.parent, path):
            refuse_link(one)
        with suppress(*UNREADABLE), open_own(path) as file:
            arrays = read_archive(file)
            if str(arrays.pop("job")) == label:
                return arrays
        return None

    def remove_chunks(self, numbers: Iterable[int]) -> None:
        """Removes the answers of some blocks."""
        for number in numbers:
            self.chunk_path(number).unlink(missing_ok=True)

    def remove_leftovers(self) -> None:
        """Removes files that a killed process had begun to write."""
        for folder in self.chunk_folders():
            for path in folder.glob(".*.npz.*"):
                path.unlink(missing_ok=True)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Holds the job's lock.

        Raises:
            OSError: the lock cannot be opened.
            RuntimeError: another client holds it.
            ValueError: `lock` is a link, or a file that no job has written.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        path = self.path / "lock"
        with open_own(path, os.O_RDWR | os.O_CREAT) as file:
            refuse_foreign(path, file)
            if not try_lock(file):
                raise RuntimeError(f"the job '{self.path}' is being run by {self.holder()}; wait for it, or end it")
            file.seek(0)
            file.truncate(0)
            file.write(json.dumps({"pid": os.getpid(), "host": socket.gethostname(), "since": time()}).encode())
            file.flush()
            yield

    def holder(self) -> str:
        """Who holds the lock, in words."""
        try:
            with open_own(self.path / "lock") as file:
                holder = json.loads(file.read(1 << 12))
            return f"process {holder['pid']} on {holder['host']}"
        except (OSError, ValueError, KeyError, TypeError):
            return "another process"

    def is_running(self) -> bool:
        """Whether a client holds the lock now.

        Raises:
            OSError, ValueError: the lock cannot be opened, or is a link.
        """
        try:
            with open_own(self.path / "lock", os.O_RDWR) as file:
                return not try_lock(file)
        except FileNotFoundError:
            return False


def refuse_foreign(path: Path, file: BinaryIO) -> None:
    """Refuses a file that a job did not write, before it is emptied: one with other contents, or with another name elsewhere.

    Raises:
        ValueError: it is such a file.
    """
    content = file.read(1 << 12)
    if os.fstat(file.fileno()).st_nlink > 1 or not (content == b"" or content.startswith(b'{"pid": ')):
        raise ValueError(f"'{path}' is not the lock of a job; choose another folder")


def try_lock(file: Any) -> bool:
    """Whether this process has got the exclusive lock of an open file; closing the file releases it."""
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        file.seek(1 << 20)
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
        except OSError:
            return False
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True

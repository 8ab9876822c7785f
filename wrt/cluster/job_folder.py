"""The folder of a job: what is computed there, which blocks are done, and who works on it.

    manifest.json           hashes of scene and rays, options, the number of rows of a block; written once
    chunks/0000/0000000.npz the answer of block 0, in folders of 1,000; a file is there whole or not at all
    lock                    held by the client that runs the job

A block is done if its file is there, so nothing has to be kept in step: a client or a worker may be killed at any moment. A
file's checksum is compared when it is read. The lock is one of the operating system (`flock`), which a killed process leaves by
itself; on network file systems that have locks it holds between machines, too.
"""

from __future__ import annotations

import json
import os
import secrets
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import time
from typing import Any

import numpy as np

from wrt.atomic_files import replaced
from wrt.scene.archives import read_archive, write_archive
from wrt.scene.storage import UNREADABLE

FORMAT = 1
"""Version of the folder's format."""

IN_A_FOLDER = 1000
"""Chunks in a folder: directories of millions of files are slow."""


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

    def manifest(self) -> dict[str, Any]:
        """What the job is.

        Raises:
            FileNotFoundError: there is no job.
            ValueError: the manifest cannot be read, or is of another format.
        """
        if not self.manifest_path.is_file():
            raise FileNotFoundError(f"'{self.path}' has no job: there is no manifest.json in it")
        try:
            manifest = json.loads(self.manifest_path.read_text(encoding="utf-8"))
            if manifest["format"] == FORMAT:
                return manifest
            reason = f"it has format {manifest['format']}, and this version of wrt reads format {FORMAT}"
        except (ValueError, KeyError, TypeError) as error:
            reason = f"{type(error).__name__}: {error}"
        raise ValueError(f"the manifest of the job '{self.path}' cannot be read ({reason}); choose another folder")

    def create(self, manifest: dict[str, Any]) -> dict[str, Any]:
        """Writes the manifest of a new job; returns it with the job's id.

        Raises:
            OSError: the folder cannot be made.
            ValueError: the folder holds other files.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        if others := [one.name for one in self.path.iterdir() if one.name != "lock" and not one.name.startswith(".")]:
            raise ValueError(f"'{self.path}' holds {others[0]} and no job; choose an empty folder")
        whole = {"format": FORMAT, "id": secrets.token_hex(8), **manifest}
        with replaced(self.manifest_path) as file:
            file.write(json.dumps(whole, indent=1).encode())
        return whole

    def chunk_path(self, number: int) -> Path:
        """Path of the answer of a block."""
        return self.path / "chunks" / f"{number // IN_A_FOLDER:04d}" / f"{number:07d}.npz"

    def done(self) -> set[int]:
        """Numbers of the blocks that are done."""
        return {int(path.stem) for path in self.path.glob("chunks/*/[0-9]*.npz")}

    def write_chunk(self, number: int, id: str, arrays: dict[str, np.ndarray]) -> None:
        """Writes the answer of a block, whole or not at all.

        Raises:
            OSError: it cannot be written.
        """
        path = self.chunk_path(number)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_archive(path, {"job": np.array(f"{id} {number}"), **arrays})

    def read_chunk(self, number: int, id: str) -> dict[str, np.ndarray] | None:
        """The answer of a block; None if its file is missing, damaged or of another job."""
        with suppress(*UNREADABLE):
            arrays = read_archive(self.chunk_path(number))
            if str(arrays.pop("job")) == f"{id} {number}":
                return arrays
        return None

    def remove_leftovers(self) -> None:
        """Removes files that a killed process had begun to write."""
        for path in self.path.glob("chunks/*/.*.npz.*"):
            path.unlink(missing_ok=True)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Holds the job's lock.

        Raises:
            RuntimeError: another client holds it.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        with open(self.path / "lock", "a+b") as file:
            if not try_lock(file):
                raise RuntimeError(f"the job '{self.path}' is being run by {self.holder()}; wait for it, or end it")
            file.truncate(0)
            file.write(json.dumps({"pid": os.getpid(), "host": socket.gethostname(), "since": time()}).encode())
            file.flush()
            yield

    def holder(self) -> str:
        """Who holds the lock, in words."""
        try:
            holder = json.loads((self.path / "lock").read_bytes())
            return f"process {holder['pid']} on {holder['host']}"
        except (OSError, ValueError, KeyError, TypeError):
            return "another process"

    def is_running(self) -> bool:
        """Whether a client holds the lock now."""
        try:
            with open(self.path / "lock", "r+b") as file:
                return not try_lock(file)
        except FileNotFoundError:
            return False


def try_lock(file: Any) -> bool:
    """Whether this process has got the exclusive lock of an open file; closing the file releases it."""
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        file.seek(1 << 20)
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True

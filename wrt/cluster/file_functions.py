"""Functions in Python files that make the rays of a job file."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from wrt.cluster.identity.described import code_hash
from wrt.query.batches.shared_files import kept


class FileFunction:
    """A function in a Python file, which each process runs when it first calls it. Every process must read the same file.

    Args:
        path: of the file.
        name: of the function.

    Attributes:
        hash: SHA-256 of the file.
        code_hash: of its code, without comments and the place of lines.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is not Python.
    """

    def __init__(self, path: str, name: str) -> None:
        self.path, self.name = path, name
        source = Path(path).read_bytes()
        self.hash = hashlib.sha256(source).hexdigest()
        try:
            self.code_hash = code_hash(compile(source, path, "exec"))
        except (SyntaxError, ValueError) as error:
            raise ValueError(f"[rays] function: '{path}' is not Python ({error})") from error

    @classmethod
    def of(cls, text: str, base: Path) -> FileFunction:
        """The function that "file.py:function" names.

        Args:
            text: the file and the function.
            base: the folder to which the path of the file is relative.

        Raises:
            OSError, ValueError: as the class; no such file.
        """
        file, colon, name = text.rpartition(":")
        if not colon or not name.isidentifier() or not (base / file).is_file():
            raise ValueError(f"[rays] function is {text!r}; give a file and a function in it, such as 'rays.py:rays'")
        return cls(str(base / file), name)

    def __call__(self, first: int, count: int) -> Any:
        """The rays of some rows.

        Raises:
            RuntimeError: the file or its function fails.
            ValueError: the file has changed, or has no such function.
        """
        names = kept(("functions of a file", self.path, self.hash), self._run)
        if not callable(names.get(self.name)):
            raise ValueError(f"[rays] function: '{self.path}' has no function {self.name!r}")
        try:
            return names[self.name](first, count)
        except MemoryError:
            raise
        except Exception as error:
            raise RuntimeError(f"[rays] function: {self.name}({first}, {count}) failed: {shown(error)}") from error

    def _run(self) -> dict[str, Any]:
        source = Path(self.path).read_bytes()
        if hashlib.sha256(source).hexdigest() != self.hash:
            raise ValueError(f"[rays] function: '{self.path}' has changed since the job began, or is another file on a worker")
        names: dict[str, Any] = {"__name__": f"wrt_job_{self.hash[:16]}", "__file__": self.path}
        try:
            exec(compile(source, self.path, "exec"), names)  # a job file with a function runs its code, as its guide says
        except Exception as error:
            raise RuntimeError(f"[rays] function: '{self.path}' failed: {shown(error)}") from error
        return names


def shown(error: Exception) -> str:
    """An error in words."""
    return f"{type(error).__name__}: {error}"

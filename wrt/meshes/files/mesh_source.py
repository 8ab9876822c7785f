"""What readers of mesh files are given and what they return; reading of files, and which files a mesh may refer to.

References (buffers and images of glTF, material libraries of OBJ, images of these and of PLY) are relative paths that must stay
below the folder of the mesh, symbolic links followed, unless the caller allows others. Only regular files are read: opening a
pipe would wait for a writer.
"""

from __future__ import annotations

import os
import stat
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wrt.materials.mesh_materials import MeshMaterials

__all__ = ["FileMesh", "MeshSource", "read_regular_file"]


@dataclass
class FileMesh:
    """A mesh as a file has it.

    Attributes:
        vertices: (V, 3) float64.
        faces: (F, 3) integers.
        materials: of the triangles; None for none.
        up: upward direction that the file states; None for that of its format.
    """

    vertices: np.ndarray
    faces: np.ndarray
    materials: MeshMaterials | None = None
    up: tuple[float, ...] | None = None


@dataclass
class MeshSource:
    """Where a mesh comes from, and what is wanted of it.

    Attributes:
        path: of the file.
        materials: whether to read materials, texture coordinates and colours; None: as `wrt.TriangleMesh.load` says.
        outside: whether the file may refer to files that are not below its folder.
    """

    path: Path
    materials: bool | None = None
    outside: bool = False
    _told: set[str] = field(default_factory=set)

    def warn(self, message: str) -> None:
        """Warns that something of this file is left out, once."""
        if message not in self._told:
            self._told.add(message)
            warnings.warn(f"'{self.path}': {message}", stacklevel=2)

    def referenced(self, name: str, what: str) -> bytes:
        """The bytes of a file that the mesh refers to.

        Args:
            name: as the file has it, with slashes or backslashes.
            what: to call it in messages.

        Raises:
            FileNotFoundError: there is none.
            ValueError: it may not be read, or is no regular file.
        """
        name = name.replace("\\", "/")
        folder = self.path.parent
        if "\0" in name or "://" in name:
            raise ValueError(f"{what} is {name!r}, which is no path of a file; only files beside the mesh are read")
        target = folder / name
        if not self.outside:
            base, real = os.path.realpath(folder), os.path.realpath(target)
            if os.path.isabs(name) or os.path.commonpath([base, real]) != base:
                raise ValueError(
                    f"{what} is '{name}', outside of the mesh's folder, and is not read; if you trust the "
                    "file, pass outside=True, "
                    "or copy what it refers to beside it"
                )
        return read_regular_file(target, what)


def read_regular_file(path: Path, what: str) -> bytes:
    """The bytes of a file.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is a folder, a pipe, a device or a socket.
    """
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except FileNotFoundError:
        raise FileNotFoundError(f"there is no file '{path}' ({what})") from None
    except IsADirectoryError:
        raise ValueError(f"'{path}' ({what}) is a folder, not a file") from None
    except OSError as error:
        if isinstance(error, PermissionError):
            raise
        raise ValueError(f"'{path}' ({what}) cannot be opened: {error}") from None
    with open(handle, "rb") as file:
        mode = os.fstat(file.fileno()).st_mode
        if not stat.S_ISREG(mode):
            kind = "pipe" if stat.S_ISFIFO(mode) else "folder" if stat.S_ISDIR(mode) else "device or socket"
            raise ValueError(f"'{path}' ({what}) is a {kind}, not a regular file; copy its content to a file first")
        return file.read()

"""Files in a job's folder, which may come from a stranger: no link in it is followed, and only regular files are opened.

A link named `lock` or `chunks` would have a job write to wherever it points. A pipe in place of a file would make it wait for
ever. The path of the folder itself may lead through links: whoever runs the job chose it.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import BinaryIO

AT_ONCE = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
"""Flags to open a file without following a link and without waiting for the other end of a pipe."""


def open_own(path: Path, flags: int = os.O_RDONLY) -> BinaryIO:
    """Opens a file of a job's folder.

    Args:
        path: of the file.
        flags: `os.O_RDONLY` or `os.O_RDWR`, with `os.O_CREAT` to make it.

    Raises:
        OSError: it cannot be opened.
        ValueError: it is a link, or no regular file.
    """
    refuse_link(path)
    descriptor = os.open(path, flags | AT_ONCE, 0o666)
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise ValueError(f"'{path}' is not a regular file; remove it, or choose another folder")
        return os.fdopen(descriptor, "r+b" if flags & os.O_RDWR else "rb")
    except BaseException:
        os.close(descriptor)
        raise


def refuse_link(path: Path) -> None:
    """Refuses a symbolic link.

    Raises:
        ValueError: there is one at the path.
    """
    if path.is_symlink():
        raise ValueError(f"'{path}' is a symbolic link, and links in a job's folder are not followed; choose another folder")


def own_folder(path: Path) -> bool:
    """Whether there is a folder in a job's folder.

    Raises:
        ValueError: there is a link, or a file.
    """
    refuse_link(path)
    if path.exists() and not path.is_dir():
        raise ValueError(f"'{path}' is not a folder; remove it, or choose another folder for the job")
    return path.is_dir()

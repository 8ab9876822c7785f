"""A full disk: files of this process may not grow beyond a few bytes."""

from __future__ import annotations

import resource
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def small_files(room: int) -> Iterator[None]:
    """Writes beyond `room` bytes of a file raise OSError.

    Meanwhile Python writes no bytecode: it does not look how much of a file was written, and each later import of the module
    would fail in every process with the same cache.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    kept, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        sys.dont_write_bytecode = kept
        signal.signal(signal.SIGXFSZ, handler)

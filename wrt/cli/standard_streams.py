"""Standard streams that a caller has closed, as `wrt info >&-` does.

Python then has no `sys.stdout`, and the next file that is opened gets its number: whatever a library writes to its standard
output would go into that file. So each number is taken by the null device, and text for a closed stdout is an error, not lost.
"""

from __future__ import annotations

import io
import os
import sys
from contextlib import suppress


class ClosedStream(io.TextIOBase):
    """Takes the place of a closed stdout: writing to it is an error that says so."""

    def writable(self) -> bool:
        """True: callers are told of the error when they write."""
        return True

    def write(self, text: str) -> int:
        """Refuses the text.

        Raises:
            OSError: always, but for no text.
        """
        if text:
            raise OSError("stdout is closed; redirect it to a file, or to /dev/null")
        return 0


def replace_closed_streams() -> None:
    """Makes `sys.stdout` and `sys.stderr` streams whatever the caller has closed. Text for a closed stderr is dropped."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            taken = os.open(os.devnull, os.O_RDWR)
            if taken != number:  # a file has its number already: it stays
                os.close(taken)
    if sys.stdout is None:
        sys.stdout = ClosedStream()
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115 - for the rest of the process


def say(line: str) -> None:
    """Writes a line to stderr, if anybody reads it."""
    with suppress(OSError, ValueError):
        print(line, file=sys.stderr, flush=True)


def drop_unwritten() -> None:
    """Writes what stdout and stderr still hold. What cannot be written is dropped: Python would try again when the process
    ends, write a traceback, and end with the status 120."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            with suppress(OSError, ValueError), open(os.devnull, "w") as null:
                os.dup2(null.fileno(), stream.fileno())

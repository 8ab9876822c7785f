"""What holds for every batch: a bound on memory, a progress bar, and interrupts between two blocks."""

from __future__ import annotations

import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter, strftime
from typing import Any

from wrt.kernels.validation import as_int

UNITS = {"": 1, "B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "KIB": 1 << 10, "MIB": 1 << 20, "GIB": 1 << 30}
"""Units of memory, in bytes."""

LOG_SECONDS = 60.0
"""Between two lines of progress where stderr is no terminal."""


def parse_memory(memory: int | str) -> int:
    """An amount of memory in bytes, from a number or a text such as "256 MB" or "1.5 GiB".

    Raises:
        TypeError: neither a whole number nor a str.
        ValueError: not positive, or not an amount of memory.
    """
    if not isinstance(memory, str):
        memory = as_int("memory", memory)  # bytes
    match = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*([KMG]?I?B|)\s*", str(memory).upper())
    if match is None or match[2] not in UNITS or not float(match[1]) > 0:
        raise ValueError(f"memory is {memory!r}; give a number of bytes from 1 up, or a text such as '256 MB' or '1.5 GiB'")
    return max(1, int(float(match[1]) * UNITS[match[2]]))


@contextmanager
def finished_before_interrupt() -> Iterator[None]:
    """Delays a Ctrl-C to the end of the `with` block; a second one is not delayed. Has an effect only in the main thread."""
    python_s = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not python_s or threading.current_thread() is not threading.main_thread():
        yield
        return
    interrupted = False

    def note(number: int, frame: Any) -> None:
        nonlocal interrupted
        if interrupted:
            raise KeyboardInterrupt
        interrupted = True

    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if interrupted:
        raise KeyboardInterrupt


class LogLines:
    """Progress as lines of a log: after the first block, once a minute, and at the end. Arguments as in `progress_bar`."""

    def __init__(self, total: int | None, start: int, what: str) -> None:
        self._total, self._start, self._what = total, start, what
        self._done, self._begun, self._told = 0, perf_counter(), -LOG_SECONDS

    def advance(self, rays: int) -> None:
        """Counts the rays of a block, and says so if it is time to."""
        self._done += rays
        seconds, now = perf_counter() - self._begun, self._start + self._done
        if seconds - self._told < LOG_SECONDS and now != self._total:
            return
        self._told, rate = seconds, self._done / max(seconds, 1e-9)
        share = left = ""
        if self._total:
            share = f" of {self._total:,} ({now / self._total:.1%})"
            left = f", {(self._total - now) / max(rate, 1e-9) / 60:.1f} min left"
        line = f"{strftime('%Y-%m-%d %H:%M:%S')} {now:,} {self._what}{share}, {rate / 1e6:.1f} M/s{left}"
        print(line, file=sys.stderr, flush=True)


@contextmanager
def progress_bar(shown: bool, total: int | None, start: int = 0, what: str = "rays") -> Iterator[Callable[[int], None]]:
    """Progress on stderr, if `shown`: a bar in a terminal or a notebook, and else, as in a log file, a line a minute.

    The yielded function takes the number of rays that a block adds.

    Args:
        shown: whether there is any.
        total: rays in all; None if that is not known.
        start: rays that were answered before.
        what: the word for what is counted.
    """
    if not shown:
        yield lambda rays: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if not (console.is_terminal or console.is_jupyter):
        yield LogLines(total, start, what).advance
        return
    columns = (BarColumn(), TextColumn(f"{{task.completed:,}} {what}"), TimeRemainingColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=console) as bar:
        task, begun, done = bar.add_task("", total=total, completed=start), perf_counter(), 0

        def advance(rays: int) -> None:
            nonlocal done
            done += rays
            bar.update(task, advance=rays, description=f"{done / (perf_counter() - begun) / 1e6:.1f} M{what}/s")

        yield advance

"""What a user sees of compiling: progress on stderr, and nothing where all kernels are cached.

    wrt: compiling kernels for this CPU, once: 7 of 20

At a terminal the line counts. Elsewhere, in a file, a pipe or a notebook, a process says once that it compiles: without that, a
first call is silent for as long as compiling takes. Kernels are counted as calls come to need them, so the second number can
grow. `show_compiling` and the variable WRT_SHOW_COMPILING choose otherwise; stdout is never written to.
"""

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from wrt.kernels.validation import as_bool

VARIABLE = "WRT_SHOW_COMPILING"

TITLE = "compiling kernels for this CPU, once"

NOTICE = f"wrt: {TITLE}; this takes seconds to minutes (WRT_SHOW_COMPILING=0 silences it, 1 counts)"
"""What is said where no line can be overwritten."""

_lock = threading.RLock()
_show: bool | None = None
_sink: Callable[[str | None], None] | None = None
_expected = _done = 0
_noticed = False  # whether the notice has been given


def show_compiling(show: bool | None = None) -> None:
    """Sets whether progress is shown on stderr while kernels are compiled.

    Args:
        show: True: always, first and last counts as lines where stderr is no terminal; False: never; None: what the variable
            WRT_SHOW_COMPILING says (1 or 0), or else counts at a terminal, and one line in each process elsewhere.

    Raises:
        TypeError: `show` is not a bool or None.
    """
    global _show
    _show = None if show is None else as_bool("show", show)


def chosen() -> bool | None:
    """Whether progress is to be shown, as the program or the environment says; None if neither says anything.

    Raises:
        ValueError: WRT_SHOW_COMPILING is neither 0 nor 1.
    """
    if _show is not None:
        return _show
    text = os.environ.get(VARIABLE, "").strip()
    if text not in ("", "0", "1"):
        raise ValueError(f"{VARIABLE} is {text!r}; set it to 0 (never show progress) or 1 (always)")
    return text == "1" if text else None


def is_shown() -> bool:
    """Whether progress is counted; errors as in `chosen`."""
    choice = chosen()
    return is_terminal() if choice is None else choice


def is_terminal() -> bool:
    """Whether stderr is a terminal."""
    return sys.stderr is not None and sys.stderr.isatty()


@contextmanager
def report_to(sink: Callable[[str | None], None]) -> Iterator[None]:
    """Gives progress to a function inside the `with` block, in place of stderr: a line of text, or None when all is compiled.

    The function is called from the threads that compile.
    """
    global _sink
    with _lock:
        if _sink is None and _done < _expected and is_shown() and is_terminal():
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)  # the function's reports take the place of the line
        before, _sink = _sink, sink
    try:
        yield
    finally:
        _sink = before


def add(count: int) -> None:
    """Tells of kernels that are to be compiled."""
    global _expected
    with _lock:
        begins = _done == _expected
        _expected += count
        _report(begins)


def finish(count: int = 1) -> None:
    """Tells of kernels that are compiled, or that no longer need to be."""
    global _done
    with _lock:
        _done += count
        _report(False)


def counts() -> tuple[int, int]:
    """Kernels that this process has compiled, and those that it was to compile until now."""
    with _lock:
        return _done, _expected


def _report(begins: bool) -> None:
    ends = _done >= _expected
    text = f"{TITLE}: {_done} of {_expected}"
    if not is_shown():
        if chosen() is None and begins and not ends:
            _notice()
        return
    if _sink is not None:
        _sink(None if ends else text)
    elif is_terminal():
        print(f"\rwrt: {text}", end="\n" if ends else "", file=sys.stderr, flush=True)
    elif begins or ends:  # lines of a file
        _write(f"wrt: {text}")


def _notice() -> None:
    """Says that kernels are compiled, once in a process."""
    global _noticed
    if not _noticed:
        _noticed = True
        _write(NOTICE)


def _write(line: str) -> None:
    """Writes a line to stderr. One that nobody can read must not end what a user has asked for."""
    if sys.stderr is not None:
        with suppress(OSError, ValueError):
            print(line, file=sys.stderr, flush=True)


def _forget() -> None:
    """A forked child counts anew, and has no thread that could hold the lock."""
    global _lock, _expected, _done
    _lock, _expected, _done = threading.RLock(), 0, 0


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)

"""The loop that makes the pictures of one client: coarse while something changes, whole once it rests, then refined.

One thread makes pictures and knows only the newest request: a new one replaces the one before, and ends the whole picture that
is being made for it. `show` returns only when the client has room for another picture, so none wait in a queue.

    moving   a request is younger than `SETTLE` seconds: one coarse picture. Its scale follows the time that pictures take.
    resting  the same request for longer: the whole picture, then more samples, until it is complete.
    idle     nothing is wanted but what is shown: the thread sleeps, without a timeout.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any, Protocol

SCALES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.18)
"""Sides of coarse pictures, relative to whole ones. Few, because kernels for streams of rays depend on how many there are."""

BUDGET = 0.028
"""Seconds that a coarse picture may take."""

PATIENCE, TRY_AGAIN = 3, 60
"""Coarse pictures after which a finer scale is tried, and after which one that was too slow is tried again."""

SETTLE = 0.15
"""Seconds after which a request rests."""

SHOW_EVERY = 0.3
"""Seconds between pictures to which samples are added."""


class Superseded(Exception):
    """Superseded by a newer request."""


class Picture(Protocol):
    """A picture to which samples are added."""

    rays: int
    """Rays traced so far."""

    @property
    def is_complete(self) -> bool:
        """Whether all samples are there."""

    def advance(self, check: Callable[..., None]) -> None:
        """Adds a sample to all pixels; calls `check` every few milliseconds, which may raise `Superseded`."""

    def pixels(self) -> Any:
        """(H, W, 3) uint8."""


@dataclass(frozen=True)
class FrameTimes:
    """What a picture took.

    Attributes:
        is_coarse: whether something moved.
        scale: side of the picture relative to a whole one.
        seconds: to make it, or to add the samples since the last picture that was shown.
        rays: traced in that time.
        is_complete: whether all samples are there.
    """

    is_coarse: bool
    scale: float
    seconds: float
    rays: int
    is_complete: bool


class FrameLoop:
    """A thread that makes the pictures of a client.

    Args:
        make: make(request, scale, is_coarse) -> `Picture`.
        show: show(pixels, times): sends a picture; waits until the client has received the one before.
        fail: fail(error): reports that a request could not be served; the loop then waits for another.
        ended: ended(error): the thread's last call; `error` is what `fail` raised, and None after `stop`.
    """

    def __init__(
        self,
        make: Callable[[Any, float, bool], Picture],
        show: Callable[[Any, FrameTimes], None],
        fail: Callable[[Exception], None],
        ended: Callable[[Exception | None], None] = lambda error: None,
    ) -> None:
        self._make, self._show, self._fail, self._ended = make, show, fail, ended
        self._changed = threading.Condition()
        self._request: Any = None
        self._requested_at = 0.0
        self._done: Any = None
        self._closed = False
        self._scale, self._count, self._last = 2, 0, 0.0
        self._too_slow, self._wait = -1, 0
        self._thread = threading.Thread(target=self._run, name="wrt-frames", daemon=True)

    def start(self) -> FrameLoop:
        """Starts the thread."""
        self._thread.start()
        return self

    def want(self, request: Any) -> None:
        """Replaces the request; an equal one changes nothing."""
        with self._changed:
            if request != self._request:
                self._request, self._requested_at = request, perf_counter()
                self._changed.notify_all()

    def stop(self) -> None:
        """Ends the picture under way and the thread, without waiting for them. `show` must not wait any more then."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def close(self, timeout: float = 5.0) -> None:
        """As `stop`, and waits for the thread, at most this many seconds."""
        self.stop()
        if self._thread.is_alive() and not self.is_own_thread:
            self._thread.join(timeout)

    @property
    def is_own_thread(self) -> bool:
        """Whether the loop's thread asks."""
        return self._thread is threading.current_thread()

    @property
    def is_alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    @property
    def is_idle(self) -> bool:
        """Whether all that is wanted is shown."""
        with self._changed:
            return self._request is None or self._request is self._done

    def _run(self) -> None:
        failed = None
        try:
            self._serve_requests()
        except Exception as error:  # of `fail`: no other request would mend it
            failed = error
        finally:
            with self._changed:
                self._closed = True
            self._ended(failed)

    def _serve_requests(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._request is not self._done)
                if self._closed:
                    return
                request, age = self._request, perf_counter() - self._requested_at
            try:
                if age < SETTLE:
                    self._move(request)
                else:
                    self._refine(request)
            except Superseded:
                continue
            except Exception as error:  # whatever a request leads to, the next one must be answered
                self._done = request
                if not self._closed:
                    self._fail(error)

    def _check(self, request: Any) -> None:
        if self._closed or self._request is not request:
            raise Superseded

    def _move(self, request: Any) -> None:
        """A coarse picture; then sleeps until something moves on, or rests."""
        scale, start = SCALES[self._scale], perf_counter()
        picture = self._make(request, scale, True)
        picture.advance(lambda *_: None)  # a coarse picture is finished, or none would be seen while the mouse moves
        pixels, seconds = picture.pixels(), perf_counter() - start
        self._adapt(seconds)
        if not self._closed:
            self._show(pixels, FrameTimes(True, scale, seconds, picture.rays, False))
        with self._changed:
            left = self._requested_at + SETTLE - perf_counter()
            if left > 0.0:
                self._changed.wait_for(lambda: self._closed or self._request is not request, left)

    def _adapt(self, seconds: float) -> None:
        """Coarser after two pictures in a row that took too long; finer after some that did not.

        Small pictures take a time that hardly depends on their size, above all where the browser uses the same cores. So
        nothing is predicted: the next scale is tried, but not soon again if it was too slow.
        """
        slower = min(self._last, seconds)
        self._last = seconds
        self._count += 1
        if self._count > 1 and slower > BUDGET and self._scale + 1 < len(SCALES):
            self._too_slow, self._wait = self._scale, TRY_AGAIN
            self._scale, self._count = self._scale + 1, 0
        elif self._scale > 0 and slower < 0.8 * BUDGET:
            self._wait = max(0, self._wait - 1)
            if self._count >= PATIENCE and not (self._wait and self._scale - 1 == self._too_slow):
                self._scale, self._count = self._scale - 1, 0

    def _refine(self, request: Any) -> None:
        """The whole picture, then more samples."""
        start = shown = perf_counter()
        rays, picture = 0, self._make(request, 1.0, False)
        first = True
        while not picture.is_complete:
            self._check(request)
            picture.advance(lambda *_: self._check(request))
            now = perf_counter()
            if first or picture.is_complete or now - shown >= SHOW_EVERY:
                times = FrameTimes(False, 1.0, now - start, picture.rays - rays, picture.is_complete)
                pixels = picture.pixels()
                self._check(request)
                self._show(pixels, times)
                first, rays = False, picture.rays
                start = shown = perf_counter()
        with self._changed:
            self._done = request

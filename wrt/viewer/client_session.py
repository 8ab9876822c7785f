"""One client: the thread that makes its pictures, its camera, and its part of the control panel.

Its life is in `wrt.viewer.session_life`. Whoever ends it (the browser that leaves, the viewer that closes, an error that
nobody foresaw) calls `leave`, from any thread and in any state; it returns at once. What runs for the session ends by
itself then, and the thread that makes pictures frees what it held as its last act.

A picture is sent once the browser has answered for the one before, so a slow connection gets fewer pictures, not late ones.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from time import monotonic
from typing import Any

import numpy as np

from wrt.kernels.runtime.launch import use_threads
from wrt.viewer.browser import Browser, Pose
from wrt.viewer.frame_loop import FrameLoop, FrameTimes, Superseded
from wrt.viewer.pictures.looks import make_picture
from wrt.viewer.pictures.view_request import ViewRequest
from wrt.viewer.session_life import Life, SessionState
from wrt.viewer.shared_scene import SharedScene

__all__ = ["ClientSession"]

PANELS_AFTER = 1.0
"""Seconds after which a client gets its panels if it has no picture yet; else it gets them with the first one."""

SETTLED_AFTER = 1.0
"""Seconds after which the camera with which a browser came counts. A page that loads tells of a camera of its own before it
takes the first view; one that connects again keeps its view, and tells of it once."""

FAILED = "The pictures of this page have ended: {error}. Load the page again."

_log = logging.getLogger(__name__)


class ClientSession:
    """A client and its threads.

    Args:
        browser: the client's.
        shared: the scene.
        first: what the client sees at first, until its camera moves or has settled; the size is that of the client.
        options: of the integrator "ambient", as in `wrt.render`; and of the others.
        furnish: furnish(session) makes the panels, on a thread of the session, after the first picture.
        left: left(session) is told when nothing runs and nothing is held any more.

    Attributes:
        life: where the session is.
        request: what the client wants to see.
        picture: the picture that was made last.
        times: what it took.
        error: why there is none; None for no reason.
    """

    def __init__(
        self,
        browser: Browser,
        shared: SharedScene,
        first: ViewRequest,
        options: dict[str, Any],
        furnish: Callable[[ClientSession], None] = lambda session: None,
        left: Callable[[ClientSession], None] = lambda session: None,
    ) -> None:
        self.browser, self.shared = browser, shared
        self.life = Life()
        self.picture: Any = None
        self.times: FrameTimes | None = None
        self.error: Exception | None = None
        self.on_shown: Callable[[FrameTimes], None] = lambda times: None
        self.on_error: Callable[[Exception | None], None] = lambda error: None
        self._options, self._furnish, self._left = options, furnish, left
        self._begun, self._room, self._over, self._moved = (threading.Event() for _ in range(4))
        self._room.set()
        self._requesting = threading.Lock()
        self.request = replace(first, version=shared.current[0], size=browser.view()[1])
        self._loop = FrameLoop(self._make, self._show, self._tell, self._ended)
        self._furnisher = threading.Thread(target=self._make_panels, name="wrt-panels", daemon=True)

    @property
    def client(self) -> Any:
        """viser's handle of the client."""
        return self.browser.client

    def start(self) -> None:
        """Begins to make pictures; does nothing if the client has left.

        Raises:
            RuntimeError: the system has no more threads. The session is over then.
        """
        if not self.life.move(SessionState.ARRIVED, SessionState.WATCHING):
            return
        self.shared.listen(self._follow)
        self.browser.on_look(self._look)
        self._loop.want(self.request)
        try:
            self._furnisher.start()
            self._loop.start()
        except RuntimeError:
            self.leave()
            self._free()
            raise

    def leave(self) -> None:
        """Ends the session, whatever its state; returns at once, and may be called any number of times."""
        if self.life.move(SessionState.WATCHING, SessionState.LEAVING):
            self._over.set()
            self._loop.stop()
            self._begun.set()
            self._room.set()
        elif self.life.move(SessionState.ARRIVED, SessionState.LEFT):  # nothing has begun
            self._left(self)

    def close(self, timeout: float = 5.0) -> bool:
        """As `leave`, and waits until nothing runs any more, at most this many seconds; returns whether that is so."""
        until = monotonic() + timeout
        self.leave()
        if self._loop.is_own_thread or threading.current_thread() is self._furnisher:  # it cannot wait for itself
            return False
        self.life.wait(SessionState.LEFT, timeout)
        self._loop.close(max(0.0, until - monotonic()))
        return not self.is_alive

    @property
    def is_idle(self) -> bool:
        """Whether the client sees all that it wants."""
        return self._loop.is_idle

    @property
    def is_alive(self) -> bool:
        """Whether a thread runs."""
        return self._loop.is_alive or self._furnisher.is_alive()

    def change(self, **values: Any) -> None:
        """Changes fields of the request."""
        self._tell(None)
        self._want(**values)

    def _want(self, **values: Any) -> None:
        with self._requesting:
            self.request = replace(self.request, **values)
            self._loop.want(self.request)

    def _look(self, pose: Pose, size: tuple[int, int]) -> None:
        """The camera has moved."""
        self._moved.set()
        self._want(camera=pose, size=size)

    def _follow(self) -> None:
        """The scene has changed."""
        self._want(version=self.shared.current[0])

    def _make(self, request: ViewRequest, scale: float, is_coarse: bool) -> Any:
        with use_threads(self.shared.threads):
            self.picture = make_picture(
                self.shared.current[1], request, scale, is_coarse, self._options.get(request.integrator)
            )
        return self.picture

    def _show(self, pixels: np.ndarray, times: FrameTimes) -> None:
        self._room.wait()
        if self.life.is_over:
            raise Superseded
        self._room.clear()
        self.browser.show(pixels, times.is_coarse, self._room.set)
        if self.life.is_over:  # it has left in between: nobody will answer
            raise Superseded
        self.times = times
        self._begun.set()
        self.on_shown(times)

    def _tell(self, error: Exception | None) -> None:
        """Says why there is no picture; None for no reason any more."""
        self.error = error
        self._begun.set()
        self.on_error(error)

    def _make_panels(self) -> None:
        self._begun.wait(PANELS_AFTER)
        if self.life.is_over:
            return
        try:
            self._furnish(self)
            self._settle()
        except Exception as error:
            self._fail(error)

    def _settle(self) -> None:
        """Takes the camera with which the browser came, if it has not told of another one."""
        if self._over.wait(SETTLED_AFTER) or self._moved.is_set():
            return
        pose, size = self.browser.view()
        if pose is not None and not np.allclose(np.hstack(pose), np.hstack(self.request.camera), atol=1e-4):
            self._want(camera=pose, size=size)

    def _ended(self, error: Exception | None) -> None:
        """The last act of the thread that makes pictures."""
        if error is not None:
            self._fail(error)
        self.leave()
        if self._furnisher.ident is not None:
            self._furnisher.join()
        self._free()

    def _fail(self, error: Exception) -> None:
        """Ends the session for an error that no other request would mend, and says so."""
        if self.life.is_over:
            return
        self.error = error
        _log.error("a browser gets no more pictures", exc_info=error)
        with suppress(Exception):  # the browser may be what has failed
            self.browser.notify("No more pictures", FAILED.format(error=f"{type(error).__name__}: {error}"))
        self.leave()

    def _free(self) -> None:
        self.shared.forget(self._follow)
        self.browser.on_look(lambda pose, size: None)
        self.on_shown, self.on_error = (lambda times: None), (lambda error: None)
        self.picture = None
        self.life.move(SessionState.LEAVING, SessionState.LEFT)
        self._left(self)

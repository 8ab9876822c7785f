"""Connections of browsers: limits on them, and the moment at which each of them ends.

viser tells that a browser has come when its first camera arrives, and that it has gone when its connection ends; but a
browser that leaves at once may be told of in the wrong order, or be told of as gone never. So the connection itself is
watched: the function that viser gives to the websocket server runs from the handshake to the end, and is put into
`Connections.serving` here. Whatever is called for a message of this connection finds it in a context variable.

    handshake     at most `HANDSHAKE_SECONDS`, by the websocket server.
    first camera  at most `CAMERA_SECONDS` after it: who says nothing is dismissed.
    messages      at most `MESSAGE_BYTES`; one that cannot be read ends the connection.
    at a time     at most `MAX_CONNECTIONS`.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from contextvars import ContextVar
from typing import Any

__all__ = ["OPTIONS", "Connection", "Connections"]

HANDSHAKE_SECONDS, CAMERA_SECONDS, GOODBYE_SECONDS = 10.0, 20.0, 1.0
MESSAGE_BYTES = 1 << 20
"""Pages send cameras, clicks and values of controls: some hundred bytes each."""

MAX_CONNECTIONS = 64
"""At a time, with those that get no pictures."""

QUIET = logging.getLogger(f"{__name__}.protocol")
"""Of the websocket server, which writes a traceback for every handshake that somebody breaks off."""
QUIET.setLevel(logging.CRITICAL)

OPTIONS = {
    "open_timeout": HANDSHAKE_SECONDS,
    "close_timeout": GOODBYE_SECONDS,
    "max_size": MESSAGE_BYTES,
    "logger": QUIET,
}
"""Of the websocket server."""

TRY_AGAIN, UNREADABLE, TOO_LATE = 1013, 1007, 1008
"""Reasons for which a connection is ended (RFC 6455, and the registry of its codes)."""

_log = logging.getLogger(__name__)
_current: ContextVar[Connection | None] = ContextVar("connection", default=None)


class Connection:
    """A connection. All methods are called on the server's event loop.

    Attributes:
        is_open: whether it has not ended.
        has_spoken: whether the browser has sent a camera.
    """

    def __init__(self) -> None:
        self.is_open, self.has_spoken = True, False
        self._at_end: list[Callable[[], None]] = []

    @staticmethod
    def current() -> Connection | None:
        """The connection whose message is being answered; None for none."""
        return _current.get()

    def at_end(self, action: Callable[[], None]) -> None:
        """Calls `action` when the connection ends; at once if it has."""
        if self.is_open:
            self._at_end.append(action)
        else:
            action()

    def end(self) -> None:
        """Calls what waits for the end, newest first; a second call does nothing."""
        self.is_open = False
        while self._at_end:
            action = self._at_end.pop()
            try:
                action()
            except Exception:  # the others must be told all the same
                _log.exception("an error while a browser left")


class Connections:
    """The open connections of a server.

    Attributes:
        is_ready: whether browsers are let in; before, they are asked to come again.
        open: the open ones.
    """

    def __init__(self) -> None:
        self.is_ready = False
        self.open: set[Connection] = set()

    def serving(self, handler: Callable[[Any], Awaitable[None]]) -> Callable[[Any], Awaitable[None]]:
        """A handler of connections that watches over those of `handler`."""

        async def serve(socket: Any) -> None:
            if not self.is_ready or len(self.open) >= MAX_CONNECTIONS:
                await socket.close(TRY_AGAIN, "too many connections" if self.is_ready else "not ready yet")
                return
            connection = Connection()
            self.open.add(connection)
            _current.set(connection)  # tasks that the handler starts inherit it
            silent = asyncio.create_task(_dismiss_the_silent(socket, connection))
            try:
                await handler(socket)
            except Exception as error:  # viser reads messages here
                _log.warning("a browser is dismissed: its message cannot be read (%s)", type(error).__name__)
                await socket.close(UNREADABLE, "a message that cannot be read")
            finally:
                silent.cancel()
                self.open.discard(connection)
                connection.end()

        return serve


async def _dismiss_the_silent(socket: Any, connection: Connection) -> None:
    """Ends a connection whose browser sends no camera."""
    await asyncio.sleep(CAMERA_SECONDS)
    if not connection.has_spoken:
        await socket.close(TOO_LATE, "no camera was sent")

"""The server of a viewer: who may speak to it (`wrt.viewer.addresses`), on which connections (`wrt.viewer.connections`).

Requests are refused before a connection is made, so nobody gets a picture or moves a control first. viser has no option for
this; while it starts to listen, the functions that answer requests and serve connections are put around its own (`_guarded`).
`_check` then refuses clients without permission, whatever the version of viser.

A browser is told of when its first camera has come, if it is there still (`WebServer.welcome`).
"""

from __future__ import annotations

import errno
import io
import operator
import os
import secrets
import socket
import threading
import warnings
from base64 import b64encode
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import replace
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

from wrt.viewer.addresses import Gate, is_local
from wrt.viewer.browser import Browser
from wrt.viewer.connections import OPTIONS, Connection, Connections

if TYPE_CHECKING:
    import viser

__all__ = ["EXPOSED", "WebServer", "check_viser"]

EXPOSED = (
    "the viewer listens on {host}: whoever reaches this computer sees the scene and can change it, without a password. "
    "Leave host out, and reach it through ssh: ssh -L 8080:localhost:8080 HOST"
)

REFUSED = {
    True: "The address lacks the token: open the one that the viewer gave.\n",
    False: "The viewer does not answer under this name, or to pages of other sites: open the address that it gave.\n",
}
"""By whether there is a token."""

HIGHER = 100
"""Ports that are tried from the given one on."""

MIN_TOKEN = 8
"""Characters of a token that is given."""

_starting = threading.Lock()


class WebServer:
    """A server without a scene.

    Args:
        host, port, token: as in `wrt.view`.

    Attributes:
        viser: the server itself.
        url: the address to open.
        browsers: those that look, by their numbers, in the order in which they came.

    Raises:
        ImportError: viser is missing.
        TypeError, ValueError: an argument has a wrong type or value.
        OSError: nothing can listen there.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 8080, token: bool | str | None = None) -> None:
        check_viser()
        self.gate = Gate(_token_of(token, host), is_local(host), host or None)
        if self.gate.token is None and not self.gate.only_here:
            warnings.warn(EXPOSED.format(host=host), stacklevel=3)
        port = _free_port(host, check_port(port))
        self.host = host
        self.browsers: dict[int, Browser] = {}
        self._welcome: Callable[[Browser], None] | None = None
        self._connections = Connections()
        with _guarded(self.gate, self._connections):
            self.viser = _start(host, port)
        self.viser.on_client_connect(self._arrived)
        self._connections.is_ready = True
        self.port = self.viser.get_port()
        _check(self)

    def welcome(self, welcome: Callable[[Browser], None]) -> None:
        """Calls welcome(browser), on the server's event loop, for those that look already and for all that come."""

        def begin() -> None:
            self._welcome = welcome
            for browser in [*self.browsers.values()]:
                welcome(browser)

        self.on_loop(begin)

    def on_loop(self, action: Callable[[], None]) -> None:
        """Calls `action` on the server's event loop, soon; not if the server is closed."""
        with suppress(RuntimeError):  # the loop is closed
            self.viser.get_event_loop().call_soon_threadsafe(action)

    async def _arrived(self, client: viser.ClientHandle) -> None:
        """A browser has sent its first camera; it may have left already. A coroutine, so it runs on the event loop."""
        connection = Connection.current()
        if connection is None:  # no message is being answered, so nobody would tell of its end
            raise RuntimeError("this version of viser tells of browsers in another way; install viser 1.1")
        connection.has_spoken = True
        connection.at_end(lambda: self._gone(client.client_id))
        if connection.is_open:
            self.browsers[client.client_id] = browser = Browser(client, connection)
            if self._welcome is not None:
                self._welcome(browser)

    def _gone(self, number: int) -> None:
        """A browser's connection has ended. viser keeps those whose first camera it read after that."""
        self.browsers.pop(number, None)
        with self.viser._client_lock:
            self.viser._connected_clients.pop(number, None)

    @property
    def url(self) -> str:
        """The address to open in a browser of this computer."""
        return self.url_of("localhost" if self.host in ("0.0.0.0", "::", "") else self.host)

    def url_of(self, host: str) -> str:
        """The address to open where this computer is called `host`."""
        name = f"[{host}]" if ":" in host else host
        return f"http://{name}:{self.port}" + (f"/{self.gate.token}/" if self.gate.token else "")

    def open_browser(self) -> None:
        """Opens the address in a browser of this computer, if it has one."""
        import webbrowser

        with suppress(webbrowser.Error):
            webbrowser.open(self.url)

    def close(self) -> None:
        """Ends all connections."""
        with _silent():
            self.viser.stop()


def check_viser() -> None:
    """Raises an ImportError that says what to do if viser is missing."""
    try:
        import viser  # noqa: F401
    except ImportError as error:
        raise ImportError("the viewer needs the package viser; install it with pip install 'wrt[view]'") from error


def _token_of(token: bool | str | None, host: str) -> str | None:
    if token is None:
        token = not is_local(host)
    if isinstance(token, bool):
        return secrets.token_urlsafe(16) if token else None
    if not isinstance(token, str):
        raise TypeError(f"token must be True, False, None or a string, not {type(token).__name__}")
    if len(token) < MIN_TOKEN or not (token.isascii() and token.replace("-", "").replace("_", "").isalnum()):
        raise ValueError(f"token must have at least {MIN_TOKEN} letters, digits, - and _; True makes one")
    return token


def check_port(port: Any) -> int:
    """Returns a port, 0 to 65535; raises an error that names the argument otherwise."""
    try:
        number = operator.index(port)
    except TypeError:
        raise TypeError(f"port must be a whole number, not {port!r}") from None
    if isinstance(port, bool) or not 0 <= number <= 65535:
        raise ValueError(f"port is {port}; ports are 0 (any that is free) to 65535")
    return number


def _free_port(host: str, port: int) -> int:
    """The first port from `port` on at which a server can listen; 0 stays 0.

    viser would try a thousand ports, whatever the reason, and then wait for ever.

    Raises:
        ValueError: this computer has no such interface.
        OSError: no port is free, or the system allows none.
    """
    try:
        found = socket.getaddrinfo(host or None, 0, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (OSError, UnicodeError) as error:
        raise ValueError(f"host is {host!r}, which is no network interface of this computer ({error})") from error
    end = min(port + HIGHER, 65536) if port else 1
    for tried in range(port, end):
        try:
            for family, kind, protocol, _, address in found:
                _probe(family, kind, protocol, (address[0], tried, *address[2:]))
            return tried
        except OSError as error:
            if error.errno == errno.EADDRNOTAVAIL:
                reason = f"host is {host!r}, which is no network interface of this computer ({error.strerror})"
                raise ValueError(reason) from error
            if error.errno != errno.EADDRINUSE:
                reason = f"port {tried} of {host!r} cannot be listened on ({error.strerror}); port=0 takes any that is free"
                raise OSError(error.errno, reason) from error
    reason = f"ports {port} to {end - 1} of {host!r} are taken; port=0 takes any that is free"
    raise OSError(errno.EADDRINUSE, reason)


def _probe(family: int, kind: int, protocol: int, address: Any) -> None:
    """Raises an OSError if nothing can listen at an address."""
    with socket.socket(family, kind, protocol) as probe:
        if os.name == "posix":  # as asyncio does: the last server's connections may linger
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        probe.bind(address)
        probe.listen(1)


@contextmanager
def _silent() -> Iterator[None]:
    """Without viser's greeting and farewell, which rich writes to stdout, and in a notebook past it."""
    import rich

    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        with redirect_stdout(io.StringIO()):
            yield
    finally:
        console.quiet = before


def _start(host: str, port: int) -> viser.ViserServer:
    """A server without what the viewer does not need: its greeting, and sharing through a server elsewhere."""
    import viser

    class Server(viser.ViserServer):
        """A server that refuses to share itself: any client could ask it to."""

        def request_share_url(self, verbose: bool = True) -> None:
            """Does nothing."""

    with _silent():
        server = Server(host=host, port=port, label="wrt", verbose=False)
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    return server


@contextmanager
def _guarded(gate: Gate, connections: Connections) -> Iterator[None]:
    """Puts the gate before the server that viser starts in this block, and watches over its connections."""
    from websockets.asyncio import server as websockets

    serve = websockets.serve

    def serve_guarded(handler: Any, *arguments: Any, **options: Any) -> Any:
        answer = options.get("process_request")
        if getattr(answer, "__module__", "").startswith("viser."):
            options |= OPTIONS | {"process_request": _around(answer, gate)}
            handler = connections.serving(handler)
        return serve(handler, *arguments, **options)

    with _starting:
        websockets.serve = serve_guarded  # type: ignore[assignment, misc]
        try:
            yield
        finally:
            websockets.serve = serve  # type: ignore[misc]


def _around(answer: Callable[[Any, Any], Any], gate: Gate) -> Callable[[Any, Any], Any]:
    """Answers requests that the gate admits as `answer` does, and refuses others."""

    def guard(connection: Any, request: Any) -> Any:
        path = gate.admit(request.path, request.headers)
        if path is None:
            return connection.respond(HTTPStatus.FORBIDDEN, REFUSED[gate.token is not None])
        return answer(connection, replace(request, path=path))

    return guard


def _check(server: WebServer) -> None:
    """Closes a server that answers a stranger, and raises a RuntimeError."""
    from http.client import HTTPConnection, HTTPException

    here = {"0.0.0.0": "127.0.0.1", "::": "::1", "": "localhost"}.get(server.host, server.host)
    asks = {"Host": "stranger.invalid", "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
    asks["Sec-WebSocket-Key"] = b64encode(bytes(16)).decode()
    connection = HTTPConnection(here, server.port, timeout=10.0)
    try:
        connection.request("GET", "/", headers=asks)
        refused = connection.getresponse().status == HTTPStatus.FORBIDDEN
    except (OSError, HTTPException):
        refused = False
    finally:
        connection.close()
    if not refused:
        server.close()
        raise RuntimeError("this version of viser lets everybody in: install viser 1.1, which wrt is tested with")

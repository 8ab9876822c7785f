"""The server of a viewer, and who may speak to it.

    token given   the address holds it as its path: http://HOST:8080/TOKEN/. All other requests are refused.
    none          pages of other sites are refused: a browser says from which page a connection comes. If only this computer
                  can reach the server, so is an address that does not name this computer.

Requests are refused before a connection is made, so nobody gets a picture or moves a control first. viser has no option for
this; while it starts to listen, the function that answers requests is put around its own (`_guarded`). `_check` then sees to it
that a server with a token refuses those who lack it, whatever the version of viser.
"""

from __future__ import annotations

import io
import secrets
import socket
import threading
import warnings
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass, replace
from http import HTTPStatus
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

if TYPE_CHECKING:
    import viser

__all__ = ["EXPOSED", "Gate", "WebServer", "check_viser", "is_local"]

EXPOSED = (
    "the viewer listens on {host}: whoever reaches this computer sees the scene and can change it, without a password. "
    "Leave host out, and reach it through ssh: ssh -L 8080:localhost:8080 HOST"
)

REFUSED = "The address lacks the token: open the one that the viewer gave.\n"

LEAST_TOKEN = 8
"""Characters of a token that is given."""

_starting = threading.Lock()


@dataclass(frozen=True)
class Gate:
    """Which requests are answered.

    Attributes:
        token: that the path of an address must begin with; None for none.
        only_here: whether only this computer can reach the server.
    """

    token: str | None
    only_here: bool

    def admit(self, path: str, headers: Mapping[str, str]) -> str | None:
        """The path without the token; None to refuse the request."""
        if self.token is not None:
            first, slash, rest = path.partition("?")[0].removeprefix("/").partition("/")
            return slash + rest or "/" if secrets.compare_digest(first.encode(), self.token.encode()) else None
        host, origin = headers.get("Host", ""), headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return None
        return path if not self.only_here or is_local(urlsplit(f"//{host}").hostname or "localhost") else None


class WebServer:
    """A server without a scene.

    Args:
        host, port, token: as in `wrt.view`.

    Attributes:
        viser: the server itself.
        url: the address to open.

    Raises:
        ImportError: viser is missing.
        TypeError, ValueError: an argument has a wrong type or value.
        OSError: nothing can listen there.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 8080, token: bool | str | None = None) -> None:
        check_viser()
        self.gate = Gate(_token_of(token, host), is_local(host))
        if self.gate.token is None and not self.gate.only_here:
            warnings.warn(EXPOSED.format(host=host), stacklevel=3)
        _check_host(host)
        self.host = host
        with _guarded(self.gate):
            self.viser = _start(host, port)
        self.port = self.viser.get_port()
        if self.gate.token is not None:
            _check(self)

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


def is_local(host: str) -> bool:
    """Whether only this computer reaches a network interface."""
    return host == "localhost" or host.startswith("127.") or host == "::1"


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
    if len(token) < LEAST_TOKEN or not (token.isascii() and token.replace("-", "").replace("_", "").isalnum()):
        raise ValueError(f"token must have at least {LEAST_TOKEN} letters, digits, - and _; True makes one")
    return token


def _check_host(host: str) -> None:
    """Raises a ValueError if this computer has no such interface: viser would try a thousand ports, and then wait for ever."""
    try:
        found = socket.getaddrinfo(host or None, 0, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, kind, protocol, _, address = found[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.bind(address)
    except OSError as error:
        raise ValueError(f"host is {host!r}, which is no network interface of this computer ({error.strerror})") from error


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
def _guarded(gate: Gate) -> Iterator[None]:
    """Puts the gate before the server that viser starts in this block."""
    from websockets.asyncio import server as websockets

    serve = websockets.serve

    def serve_guarded(*arguments: Any, **options: Any) -> Any:
        answer = options.get("process_request")
        if getattr(answer, "__module__", "").startswith("viser."):
            options["process_request"] = _around(answer, gate)
        return serve(*arguments, **options)

    with _starting:
        websockets.serve = serve_guarded
        try:
            yield
        finally:
            websockets.serve = serve


def _around(answer: Callable[[Any, Any], Any], gate: Gate) -> Callable[[Any, Any], Any]:
    """Answers requests that the gate admits as `answer` does, and refuses others."""

    def guard(connection: Any, request: Any) -> Any:
        path = gate.admit(request.path, request.headers)
        if path is None:
            return connection.respond(HTTPStatus.FORBIDDEN, REFUSED)
        return answer(connection, replace(request, path=path))

    return guard


def _check(server: WebServer) -> None:
    """Closes a server that answers without the token, and raises a RuntimeError."""
    from http.client import HTTPConnection, HTTPException

    here = {"0.0.0.0": "127.0.0.1", "::": "::1", "": "localhost"}.get(server.host, server.host)
    asks = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
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
        raise RuntimeError("this version of viser lets everybody in: leave host out, and reach the viewer through ssh")

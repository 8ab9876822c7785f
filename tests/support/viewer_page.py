"""A page of the viewer without a browser: a websocket client that speaks as viser's page does."""

from __future__ import annotations

import logging
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import viser
import zstandard
from websockets.sync import client

import wrt

PROTOCOL = f"viser-v{viser.__version__}"

STAGES = (
    "before the handshake",
    "within the handshake",
    "without waiting for its end",
    "before the first camera",
    "with the first camera",
    "while pictures are made",
    "without an answer for a picture",
    "without a word",
)
"""At which browsers leave, in the order in which they come to them."""

REQUEST = (
    "GET / HTTP/1.1\r\nHost: localhost:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Protocol: {protocol}\r\n\r\n"
)


class Page:
    """A client that moves its camera, counts the messages that come, and answers for each picture as a browser does.

    Args:
        address: of the viewer, ws://...
        answers: whether it says that it has got a picture, which a page in the background does not.
        reads: whether it reads at all.
    """

    def __init__(self, address: str, answers: bool = True, reads: bool = True) -> None:
        quiet = logging.getLogger("viewer_page")
        quiet.setLevel(logging.CRITICAL)  # websockets writes a traceback when `drop` closes a connection under it
        options = {"subprotocols": [PROTOCOL], "max_size": None, "logger": quiet}
        self.socket = client.connect(address, origin=address.replace("ws", "http", 1), **options)
        self.seen: Counter[str] = Counter()
        self.texts: list[Any] = []
        self.answers, self.pictures, self.asked = answers, 0, 0
        self.reader = threading.Thread(target=self._read, daemon=True)
        if reads:
            self.reader.start()

    def _read(self) -> None:
        try:
            for data in self.socket:
                length, packed = (int.from_bytes(data[begin : begin + 8], "little") for begin in (0, 8))
                inner = zstandard.ZstdDecompressor().decompress(data[16 : 16 + packed], max_output_size=length)
                for message in msgspec.msgpack.decode(inner)["messages"]:
                    self._take(message)
        except Exception:  # the test closes the socket
            return

    def _take(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        self.seen[kind] += 1
        self.pictures += kind == "BackgroundImageMessage" and message["rgb_data"] is not None
        if "Notification" in kind:
            self.texts.append(message)
        if kind == "LocalStorageGetItemRequestMessage" and self.answers:
            self.send("LocalStorageGetItemResponseMessage", value=None, error=None, request_uuid=message["request_uuid"])

    def send(self, kind: str, **fields: Any) -> None:
        """Sends a message of a kind."""
        self.socket.send(msgspec.msgpack.encode({"type": kind, **fields}))

    def look(self, camera: wrt.PinholeCamera, **other: Any) -> None:
        """Sends a camera; `other` replaces fields of the message."""
        self.send("ViewerCameraMessage", **(camera_fields(camera) | other))

    def close(self) -> None:
        """Leaves as a browser does."""
        self.socket.close()
        if self.reader.ident is not None:
            self.reader.join(10.0)

    def drop(self) -> None:
        """Leaves without a word, as a browser that is killed."""
        self.socket.socket.shutdown(socket.SHUT_RDWR)


def camera_fields(camera: wrt.PinholeCamera) -> dict[str, Any]:
    """What a page sends of its camera."""
    right = np.cross(camera.forward, camera.up)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(camera.forward, right), camera.forward], axis=1)
    return {
        "wxyz": tuple(map(float, viser.transforms.SO3.from_matrix(axes).wxyz)),
        "position": tuple(map(float, camera.position)),
        "look_at": tuple(map(float, camera.look_at)),
        "up_direction": tuple(map(float, camera.up)),
        "fov": float(np.radians(camera.fov)),
        "near": 0.01,
        "far": 1e3,
        "image_height": 60,
        "image_width": 80,
    }


def left_over(viewer: wrt.pictures.Viewer) -> dict[str, int]:
    """How much of browsers is still there, by where."""
    web, server = viewer._web, viewer._server
    held: dict[str, Any] = {
        "sessions": viewer.sessions,
        "panels": viewer.panels,
        "browsers that wait": viewer._waiting,
        "sessions that end": viewer._leaving,
        "listeners of the scene": viewer.shared._listeners,
        "browsers": web.browsers,
        "connections": web._connections.open,
        "clients of viser": server.get_clients(),
        "connections of viser": server._websock_server._client_state_from_id,
        "threads": [one for one in threading.enumerate() if one.name in ("wrt-frames", "wrt-panels")],
    }
    return {name: len(what) for name, what in held.items() if len(what)}


def leave_at(viewer: wrt.pictures.Viewer, camera: wrt.PinholeCamera, stage: int, pause: float = 0.0) -> None:
    """Comes as far as a stage, stays there for `pause` seconds, and leaves."""
    port = viewer._web.port
    if stage < 3:
        with socket.create_connection(("127.0.0.1", port), timeout=30.0) as opened:
            opened.sendall(("", REQUEST[:60], REQUEST)[stage].format(port=port, protocol=PROTOCOL).encode())
        return
    page = Page(viewer.url.replace("http", "ws"), answers=stage != 6)
    if stage >= 4:
        page.look(camera)
    if stage >= 5:
        end = time.monotonic() + 60.0
        while not page.pictures and page.reader.is_alive() and time.monotonic() < end:
            time.sleep(0.002)
    if stage >= 4:
        time.sleep(pause)
    if stage == 7:
        page.drop()
    page.close()


def until(true: Callable[[], Any], seconds: float = 60.0) -> None:
    """Waits until something is true; an error if it is not in time."""
    end = time.perf_counter() + seconds
    while not true() and time.perf_counter() < end:
        time.sleep(0.01)
    assert true()

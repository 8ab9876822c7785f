"""One client: the thread that makes its pictures, its camera, and its part of the control panel.

A picture is sent once the browser has answered for the one before, so a slow connection gets fewer pictures, not late ones. The
answer is that to a read of the browser's storage, which it gives in the order of messages.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYet
from dataclasses import replace
from math import degrees, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.kernels.runtime.launch import use_threads
from wrt.viewer.frame_loop import FrameLoop, FrameTimes, Superseded
from wrt.viewer.pictures.looks import make_picture
from wrt.viewer.pictures.wish import Wish
from wrt.viewer.shared_scene import SharedScene

if TYPE_CHECKING:
    import viser

__all__ = ["ClientSession"]

MOST_PIXELS = 1920 * 1200
"""Largest picture; a larger window shows it enlarged. It bounds the memory and the time of a client."""

COARSE_QUALITY, QUALITY = 75, 92
"""Of JPEG pictures while something moves, and at rest."""


class ClientSession:
    """A client and its thread.

    Args:
        client: the client.
        shared: the scene.
        first: what the client sees at first; its camera and size are those of the client.
        options: of the integrator "ambient", as of `wrt.render`; and of the others.

    Attributes:
        wish: what the client wants to see.
        picture: the picture that was made last.
        times: what it took.
        error: why there is none; None for no reason.
    """

    def __init__(self, client: viser.ClientHandle, shared: SharedScene, first: Wish, options: dict[str, Any]) -> None:
        self.client, self.shared = client, shared
        self.picture: Any = None
        self.times: FrameTimes | None = None
        self.error: Exception | None = None
        self.on_shown: Callable[[FrameTimes], None] = lambda times: None
        self.on_error: Callable[[Exception | None], None] = lambda error: None
        self._options = options
        self._received: Future | None = None
        self._asking = ThreadPoolExecutor(max_workers=1, thread_name_prefix="wrt-received")
        self._closed = False
        self._begun = threading.Event()
        self.wish = replace(first, version=shared.current[0], camera=pose_of(client.camera), size=size_of(client.camera))
        self._loop = FrameLoop(self._make, self._show, self._report)

    def start(self) -> None:
        """Begins to make pictures."""
        self.shared.listen(self._follow)
        self.client.camera.on_update(self._look)
        self._loop.start()
        self._loop.want(self.wish)

    def close(self) -> None:
        """Ends the thread and frees all that the client held."""
        if self._closed:
            return
        self._closed = True
        self._begun.set()
        self.shared.forget(self._follow)
        self._loop.close()
        self._asking.shutdown(wait=False, cancel_futures=True)
        self.picture = self._received = None

    def wait_for_picture(self, timeout: float) -> None:
        """Waits until the first picture is sent, an error has come instead, or so many seconds have passed."""
        self._begun.wait(timeout)

    @property
    def is_idle(self) -> bool:
        """Whether the client sees all that it wants."""
        return self._loop.is_idle

    @property
    def is_alive(self) -> bool:
        """Whether the thread runs."""
        return self._loop.is_alive

    def change(self, **values: Any) -> None:
        """Changes fields of the wish."""
        self._tell(None)
        self.wish = replace(self.wish, **values)
        self._loop.want(self.wish)

    async def _look(self, camera: viser.CameraHandle) -> None:
        """The camera has moved. A coroutine, so that moves stay in their order."""
        self.wish = replace(self.wish, camera=pose_of(camera), size=size_of(camera))
        self._loop.want(self.wish)

    def _follow(self) -> None:
        """The scene has changed."""
        self.wish = replace(self.wish, version=self.shared.current[0])
        self._loop.want(self.wish)

    def _make(self, wish: Wish, scale: float, is_coarse: bool) -> Any:
        with use_threads(self.shared.threads):
            self.picture = make_picture(self.shared.current[1], wish, scale, is_coarse, self._options.get(wish.integrator))
        return self.picture

    def _show(self, pixels: np.ndarray, times: FrameTimes) -> None:
        self._wait_for_client()
        quality = COARSE_QUALITY if times.is_coarse else QUALITY
        self.client.scene.set_background_image(pixels, format="jpeg", jpeg_quality=quality)
        self.client.flush()
        self._received = self._asking.submit(self.client.local_storage.get_item, "received")
        self.times = times
        self._begun.set()
        self.on_shown(times)

    def _wait_for_client(self) -> None:
        """Returns when the client has the picture before.

        Raises:
            Superseded: the client has left.
        """
        while self._received is not None:
            try:
                self._received.result(timeout=0.5)
                return
            except NotYet:
                if self._closed:
                    raise Superseded from None
            except RuntimeError:
                if self._closed or not self._is_connected():
                    self._closed = True
                    raise Superseded from None
                return  # the browser has no storage; it has answered all the same

    def _is_connected(self) -> bool:
        return self.client.client_id in self.client._viser_server.get_clients()

    def _report(self, error: Exception) -> None:
        self._begun.set()
        self._tell(error)

    def _tell(self, error: Exception | None) -> None:
        self.error = error
        self.on_error(error)


def pose_of(camera: viser.CameraHandle) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...], float]:
    """Position, look_at, up and field of view in degrees of a client's camera."""
    w, x, y, z = (float(value) for value in camera.wxyz)
    forward = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])  # +z of the camera
    down = np.array([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)])  # +y
    position = np.asarray(camera.position, dtype=np.float64)
    distance = float(np.linalg.norm(np.asarray(camera.look_at) - position)) or 1.0
    point = position + distance * forward
    return tuple(map(float, position)), tuple(map(float, point)), tuple(map(float, -down)), degrees(camera.fov)


def size_of(camera: viser.CameraHandle) -> tuple[int, int]:
    """Width and height of the picture for a client's window, at most `MOST_PIXELS` together."""
    width, height = max(int(camera.image_width), 1), max(int(camera.image_height), 1)
    shrink = min(1.0, sqrt(MOST_PIXELS / (width * height)))
    return max(1, int(width * shrink)), max(1, int(height * shrink))

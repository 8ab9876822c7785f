"""A browser that looks at the scene: all that a session asks of viser, its private parts included.

A picture is acknowledged by the answer to a read of the browser's storage, which it gives in the order of messages: whoever
reads it has got the picture before. The value does not matter.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from math import degrees, isfinite, pi, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import viser

    from wrt.viewer.connections import Connection

__all__ = ["MAX_PIXELS", "Browser", "Pose", "pose_of", "size_of"]

Pose = tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...], float]
"""Position, look_at, up, and vertical field of view in degrees."""

MAX_PIXELS = 1920 * 1200
"""Largest picture; a larger window shows it enlarged. It bounds the memory and the time of a client."""

LONGEST_SIDE = 16384
"""Largest width and height that a browser is believed."""

COARSE_QUALITY, QUALITY = 75, 92
"""Of JPEG pictures while something moves, and at rest."""

Look = Callable[[Pose, tuple[int, int]], None]


class Browser:
    """A browser.

    Args:
        client: viser's handle.
        connection: on which it came.

    Attributes:
        client: as given; panels use it.
        number: of the browser; no other of this server has it.
    """

    def __init__(self, client: viser.ClientHandle, connection: Connection) -> None:
        from viser import _messages

        self.client, self.number = client, client.client_id
        self._connection, self._wire = connection, client._websock_connection
        self._asked, self._received = 0, lambda: None
        self._look: Look = lambda pose, size: None
        self._ask = _messages.LocalStorageGetItemRequestMessage
        self._wire.register_handler(_messages.LocalStorageGetItemResponseMessage, self._answered)
        client.camera.on_update(self._moved)
        self._silence = ExitStack()
        quiet = getattr(self._wire.get_message_buffer(), "sanctioned_dead_writes", None)
        if quiet is not None:  # what is sent to a browser that has just left is lost, and nobody needs to know
            self._silence.enter_context(quiet())

    @property
    def is_connected(self) -> bool:
        """Whether it is there."""
        return self._connection.is_open

    def at_end(self, action: Callable[[], None]) -> None:
        """Calls `action`, on the server's event loop, when the browser leaves; at once if it has."""
        self._connection.at_end(action)

    def view(self) -> tuple[Pose | None, tuple[int, int]]:
        """The camera, None if it makes no sense, and the size of the picture for the window."""
        camera = self.client.camera
        return pose_of(camera), size_of(camera)

    def on_look(self, look: Look) -> None:
        """Calls look(pose, size) when the camera or the window has changed; what makes no sense is left out."""
        self._look = look

    def show(self, pixels: np.ndarray, is_coarse: bool, received: Callable[[], None]) -> None:
        """Sends a picture; calls `received`, on the server's event loop, when the browser has it.

        Args:
            pixels: (H, W, 3) uint8.
            is_coarse: whether something moves.
            received: called at most once, and not if the browser leaves before.
        """
        quality = COARSE_QUALITY if is_coarse else QUALITY
        self.client.scene.set_background_image(pixels, format="jpeg", jpeg_quality=quality)
        self._received, self._asked = received, self._asked + 1
        self._wire.queue_message(self._ask(key="received", request_uuid=str(self._asked)))
        self.client.flush()

    def notify(self, title: str, text: str) -> Callable[[], None]:
        """Shows a message, which stays until it is closed; returns a function that takes it away."""
        return self.client.add_notification(title, text).remove

    def _answered(self, number: int, message: Any) -> None:
        if message.request_uuid == str(self._asked):
            received, self._received = self._received, lambda: None
            received()

    async def _moved(self, camera: viser.CameraHandle) -> None:
        """The camera has moved. A coroutine, so that moves stay in their order."""
        pose = pose_of(camera)
        if pose is not None:
            self._look(pose, size_of(camera))


def pose_of(camera: Any) -> Pose | None:
    """The pose of a client's camera; None if its numbers are none, not finite, or make no camera."""
    try:
        turn, position, target = (
            np.asarray(values, dtype=np.float64).reshape(size)
            for values, size in ((camera.wxyz, 4), (camera.position, 3), (camera.look_at, 3))
        )
        fov = float(camera.fov)
    except (TypeError, ValueError):
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        length, distance = float(np.linalg.norm(turn)), float(np.linalg.norm(target - position)) or 1.0
        if not (0.1 < length < 10.0 and 0.0 < fov < pi):
            return None
        w, x, y, z = (float(value) for value in turn / length)
        forward = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])  # +z of the camera
        down = np.array([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)])  # +y
        point = position + distance * forward  # not finite if position or target is not
    if not (np.isfinite(point).all() and (point != position).any()):
        return None
    return tuple(map(float, position)), tuple(map(float, point)), tuple(map(float, -down)), degrees(fov)


def size_of(camera: Any) -> tuple[int, int]:
    """Width and height of the picture for a client's window, at most `MAX_PIXELS` together; at least 1 each."""
    width, height = _side(camera.image_width), _side(camera.image_height)
    shrink = min(1.0, sqrt(MAX_PIXELS / (width * height)))
    return max(1, int(width * shrink)), max(1, int(height * shrink))


def _side(value: Any) -> int:
    """A number of pixels, within bounds whatever the browser says."""
    try:
        value = float(value)
    except (TypeError, ValueError):
        return 1
    return int(min(max(value, 1.0), LONGEST_SIDE)) if isfinite(value) else 1

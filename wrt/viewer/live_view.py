"""`wrt.view`: shows a scene in web browsers."""

from __future__ import annotations

import atexit
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.imaging.cameras import PinholeCamera
from wrt.imaging.integrators import INTEGRATORS
from wrt.kernels.validation import as_bool, as_float, as_int, as_numbers, as_point
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.up_axis import default_up
from wrt.scene.scene import Scene
from wrt.viewer.browser import Browser
from wrt.viewer.client_session import ClientSession
from wrt.viewer.frame_loop import Superseded
from wrt.viewer.panels.control_panel import ControlPanel
from wrt.viewer.panels.pick_panel import PickPanel
from wrt.viewer.panels.scene_panel import ScenePanel
from wrt.viewer.panels.tree_panel import TreePanel
from wrt.viewer.pictures.looks import make_picture
from wrt.viewer.pictures.view_request import ViewRequest
from wrt.viewer.shared_scene import SharedScene
from wrt.viewer.trees.box_lines import heat_colors
from wrt.viewer.web_server import WebServer, check_viser

if TYPE_CHECKING:
    import viser

    from wrt.array_types import ArrayLike

__all__ = ["Viewer", "view"]

MAX_CLIENTS = 16
"""Clients at a time that get pictures."""

MAX_LEAVING = 48
"""Clients that have left while a thread still waits for something on their behalf, such as a kernel to be compiled. If
there are more, new ones wait."""

STOP_SECONDS = 5.0
"""Longest wait of `Viewer.close` for pictures under way; one that waits for its kernels to be compiled takes longer, and
ends then."""

TOO_MANY = "{count} browsers look at this scene. This page shows it as soon as one of them leaves."

NO_THREAD = "The system has no more threads for pictures ({error}). Load this page again later."

MAX_PORT = 65535

MAX_POINTS = 2_000_000
"""Points of a name."""


class Viewer:
    """A scene shown in web browsers, until `close`. Made by `wrt.view`. In a notebook, it shows itself in the cell.

    Args:
        scene, animate, frames: as in `wrt.view`.
        server: that shows it. It may have clients already.
        camera, up: the camera of a new client, and its axis that points up.
        first: what a new client is shown.
        options: of each integrator, by its name, as `wrt.render` takes them.

    Attributes:
        url: the address to open.
        sessions: of the clients that are connected, by their numbers.
        panels: of the sessions: controls, picking, tree inspector.
        shared: the scene, with its versions (`wrt.viewer.shared_scene.SharedScene`).
    """

    def __init__(
        self,
        scene: Scene,
        server: WebServer,
        *,
        camera: PinholeCamera,
        up: ArrayLike,
        first: ViewRequest,
        options: Mapping[str, Mapping[str, Any]],
        animate: Callable[[Scene, int], object] | None = None,
        frames: int = 0,
    ) -> None:
        self.shared = SharedScene(scene, animate, frames)
        self.sessions: dict[int, ClientSession] = {}
        self.panels: dict[int, tuple[ControlPanel, PickPanel, TreePanel]] = {}
        self._lock = threading.Lock()
        self._waiting: dict[int, Callable[[], None]] = {}
        self._leaving: set[ClientSession] = set()
        self._first, self._options = first, dict(options)
        self._ended = threading.Event()
        self._web, self._server = server, server.viser
        set_camera(self._server, camera, up, scene)
        self._panel = ScenePanel(self._server, self.shared)
        self._preparing = threading.Thread(target=self._prepare, name="wrt-prepare", daemon=True)
        self._preparing.start()
        self._first_view = camera, up
        atexit.register(self.close)
        server.welcome(self._welcome)

    @property
    def url(self) -> str:
        """The address to open in a browser."""
        return self._web.url

    def refresh(self) -> None:
        """Shows the scene as it is now, after `scene.update` and the like."""
        self.shared.refresh()

    def play(self, fps: float = 24.0) -> None:
        """Plays the animation, from its first frame again after the last.

        Args:
            fps: most frames a second, above 0 and at most 60.

        Raises:
            ValueError: there is no animation, or fps is out of range.
        """
        if not 0.0 < (fps := as_float("fps", fps)) <= 60.0:
            raise ValueError(f"fps is {fps}; it must be above 0 and at most 60")
        self._panel.play(fps)

    def pause(self) -> None:
        """Stops the animation at the frame that is shown; without one, does nothing."""
        self._panel.pause()

    def add_points(
        self, points: ArrayLike, values: ArrayLike | None = None, *, name: str = "points", size: float = 2.0
    ) -> None:
        """Draws points over the picture, such as those of a scan, until others are drawn under the same name.

            scan = lidar.scan(scene, pose)
            viewer.add_points(scan.position, scan.intensity)

        Args:
            points: (..., 3) in the coordinates of the scene; those with a NaN are left out.
            values: (...) numbers that colour them from blue for the least to red for the largest; None for one colour.
            name: of the points.
            size: of a point, in thousandths of the scene's diagonal.

        Raises:
            ValueError: wrong shapes, or more than 2 million points.
        """
        points, size = as_numbers("points", points, finite=False), as_float("size", size, finite=True)
        if points.ndim < 1 or points.shape[-1] != 3:
            raise ValueError(f"points must have shape (..., 3), not {points.shape}")
        values = np.zeros(points.shape[:-1]) if values is None else as_numbers("values", values, finite=False)
        if values.shape != points.shape[:-1]:
            raise ValueError(f"values have shape {values.shape}, but points have shape {points.shape}")
        points, values = points.reshape(-1, 3), values.ravel()
        shown = np.isfinite(points).all(axis=1)
        points, values = points[shown], values[shown]
        if len(points) > MAX_POINTS:
            raise ValueError(f"there are {len(points)} points; at most {MAX_POINTS} can be drawn: leave some out")
        if len(points) == 0:
            self._server.scene.remove_by_name(f"/wrt/{name}")
            return
        center, low, high = self.shared.scene.center, np.nanmin(values), np.nanmax(values)
        extent = float(np.linalg.norm(np.ptp(self.shared.scene.bounds, axis=0)))
        self._server.scene.add_point_cloud(
            f"/wrt/{name}",
            (points - center).astype(np.float32),
            heat_colors((values - low) / ((high - low) or 1.0)),
            point_size=1e-3 * size * extent,
            point_shape="circle",
            precision="float32",
            position=tuple(map(float, center)),  # type: ignore[arg-type]
        )

    def remove_points(self, name: str = "points") -> None:
        """Removes the points that `add_points` drew by this name."""
        self._server.scene.remove_by_name(f"/wrt/{name}")

    def wait(self) -> None:
        """Returns when the viewer is closed, or at a Ctrl-C, which closes it."""
        try:
            while not self._ended.wait(3600.0):
                pass
        except KeyboardInterrupt:
            self.close()
            raise

    def close(self) -> None:
        """Ends the server, all threads and all connections; a second call does nothing.

        It waits for pictures and frames under way at most 5 seconds, and for connections about as long.
        """
        with self._lock:
            if self._ended.is_set():
                return
            self._ended.set()
            sessions = [*self.sessions.values(), *self._leaving]
            self._waiting.clear()
        atexit.unregister(self.close)
        until = monotonic() + STOP_SECONDS
        for session in sessions:
            session.leave()
        self.shared.stop(STOP_SECONDS)
        self._web.close()
        for session in sessions:
            session.close(max(0.0, until - monotonic()))
        if self._preparing is not threading.current_thread():
            self._preparing.join(max(0.0, until - monotonic()))

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *error: Any) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Viewer({self.url!r}, {len(self.sessions)} clients)"

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.url}" width="100%" height="600" frameborder="0" allowfullscreen></iframe>'

    def _prepare(self) -> None:
        """Makes a small picture, so that kernels are loaded and normals computed while the browser loads the page."""
        with suppress(ValueError, TypeError, RuntimeError, Superseded):  # the client is told
            if self._web.browsers or self._ended.is_set():  # one waits: its picture is made already
                return
            version, scene = self.shared.current
            request = replace(self._first, version=version, size=(160, 120))
            make_picture(scene, request, 1.0, True, self._options.get(request.integrator)).advance(self._check)

    def _check(self, *_: Any) -> None:
        if self._ended.is_set():
            raise Superseded

    def _welcome(self, browser: Browser) -> None:
        """A browser has come. Called on the server's event loop, as `_leave` is, so none leaves before it is here."""
        browser.at_end(lambda: self._leave(browser.number))
        self._admit(browser)

    def _admit(self, browser: Browser) -> None:
        """Begins a session, or asks the browser to wait for a place."""
        with self._lock:
            if self._ended.is_set():
                return
            if self._is_full:
                self._waiting[browser.number] = browser.notify("Too many viewers", TOO_MANY.format(count=MAX_CLIENTS))
                return
            session = ClientSession(browser, self.shared, self._first, self._options, self._furnish, self._session_left)
            self.sessions[browser.number] = session
        self._place_camera(browser)
        try:
            session.start()
        except RuntimeError as error:
            browser.notify("No pictures", NO_THREAD.format(error=error))

    def _place_camera(self, browser: Browser) -> None:
        """A browser that came before the scene, or was slow, looks from elsewhere: its camera is moved to the first view."""
        camera, up = self._first_view
        pose, _ = browser.view()
        if pose is None or not np.allclose(pose[0], camera.position, rtol=1e-4):
            with suppress(ValueError, AssertionError):  # what the browser said makes no sense to viser either
                place_camera(browser.client, camera, up)

    def _furnish(self, session: ClientSession) -> None:
        """Makes the panels of a session."""
        panels = ControlPanel(session), PickPanel(session), TreePanel(session)
        with self._lock:
            if self.sessions.get(session.browser.number) is session:
                self.panels[session.browser.number] = panels

    @property
    def _is_full(self) -> bool:
        return len(self.sessions) >= MAX_CLIENTS or len(self._leaving) >= MAX_LEAVING

    def _leave(self, number: int) -> None:
        """A browser has gone, perhaps in the middle of a picture. Another one gets its place at once."""
        with self._lock:
            self._waiting.pop(number, None)
            self.panels.pop(number, None)
            session = self.sessions.pop(number, None)
            if session is None:
                return
            self._leaving.add(session)
        session.leave()
        self._admit_next()

    def _session_left(self, session: ClientSession) -> None:
        """Nothing runs for a session any more: its browser has gone, or its thread has failed."""
        number = session.browser.number
        with self._lock:
            self._leaving.discard(session)
            if self.sessions.get(number) is session:
                del self.sessions[number]
                self.panels.pop(number, None)
        self._web.on_loop(self._admit_next)

    def _admit_next(self) -> None:
        """Gives free places to browsers that wait."""
        while True:
            with self._lock:
                if not self._waiting or self._is_full:
                    return
                number, tell_no_more = next(iter(self._waiting.items()))
                del self._waiting[number]
            browser = self._web.browsers.get(number)
            if browser is not None and browser.is_connected:
                tell_no_more()
                self._admit(browser)


def view(
    scene: Scene | TriangleMesh,
    *,
    block: bool | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    token: bool | str | None = None,
    camera: PinholeCamera | None = None,
    up: ArrayLike | None = None,
    integrator: str = "ambient",
    samples: int = 4,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    animate: Callable[[Scene, int], object] | None = None,
    frames: int = 0,
    open_browser: bool = False,
) -> Viewer:
    """Shows a scene in a web browser: ray-traced, with the mouse as camera, while the program runs on.

        viewer = wrt.view(scene, block=False)       # open viewer.url; a notebook shows it
        scene.update(0, vertices=moved)
        viewer.refresh()
        viewer.close()

    It needs the package viser: `pip install 'wrt[view]'`.

    Args:
        scene: a `wrt.Scene` of any kind, or a `wrt.TriangleMesh`.
        block: whether to return only at the end, that is at a Ctrl-C. None: in scripts, but not in a notebook.
        host: network interface to listen on. Other computers cannot reach the default.
        port: to listen on; if it is taken, the next of the 99 above it that is not. 0 for any that is free. `Viewer.url` names
            it.
        token: whether the address must hold a secret, which `Viewer.url` then does: whoever lacks it gets no picture and moves
            no control. True makes one at random; a string of at least 8 letters, digits, - and _ is one. None: if other
            computers can reach `host`. False lets everybody in, with a warning. Nothing is encrypted.
        camera: the view at first; None for one that shows the whole scene. Its size does not matter.
        up: (3,) direction that stays upright when the camera turns; None for that of the meshes (`wrt.TriangleMesh.up`).
        integrator: at first, as in `wrt.render`.
        samples: of each pixel, at rest.
        options: of each integrator, as in `wrt.render`: `{"ambient": {"light": (0, 0, 9)}}`.
        animate: animate(scene, frame) moves the scene to a frame: the viewer can then play. None for `show` of a
            `wrt.moving.FuzzyScene`, and no animation of others.
        frames: number of frames of the animation.
        open_browser: whether to open a browser of this computer.

    Returns:
        The viewer. As the last line of a notebook's cell, it shows itself there.

    Raises:
        ImportError: viser is missing.
        TypeError, ValueError: an argument has a wrong type or value.
        OSError: no port is free, or the system lets nobody listen there.
    """
    check_viser()
    scene = Scene(scene) if isinstance(scene, TriangleMesh) else scene
    if not isinstance(scene, Scene):
        raise TypeError(f"scene must be a wrt.Scene or a wrt.TriangleMesh, not {type(scene).__name__}")
    port, samples, frames = as_int("port", port, 0, MAX_PORT), as_int("samples", samples, 1), as_int("frames", frames, 0)
    block, open_browser = None if block is None else as_bool("block", block), as_bool("open_browser", open_browser)
    if animate is not None and frames < 1:
        raise ValueError(f"frames is {frames}; an animation needs the number of its frames")
    up = tuple(map(float, as_point("up", default_up(scene) if up is None else up)))
    camera = PinholeCamera.framing(scene, 800, 600, up=up) if camera is None else camera
    first, options = first_request(camera, integrator, samples), dict(options or {})
    for name in options:
        check_integrator(name, "options has")
    server = WebServer(host, port, token)
    try:
        viewer = Viewer(scene, server, camera=camera, up=up, first=first, options=options, animate=animate, frames=frames)
    except BaseException:
        server.close()
        raise
    if open_browser:
        server.open_browser()
    if not in_notebook() if block is None else block:
        viewer.wait()
    return viewer


def in_notebook() -> bool:
    """Whether a kernel of Jupyter runs this, which shows what a cell returns."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return hasattr(shell, "kernel")


def first_request(camera: Any, integrator: str, samples: int) -> ViewRequest:
    """What a browser shows at first.

    Raises:
        TypeError, ValueError: no camera, or no integrator.
    """
    check_integrator(integrator, "integrator is")
    if not isinstance(camera, PinholeCamera):
        raise TypeError(f"camera must be a wrt.PinholeCamera, not {type(camera).__name__}")
    pose = tuple(camera.position), tuple(camera.look_at), tuple(camera.up), camera.fov
    return ViewRequest(version=0, camera=pose, size=(800, 600), integrator=integrator, samples=samples)


def check_integrator(name: str, said: str) -> None:
    """Raises a ValueError for a name that no integrator has; `said` begins the message."""
    if name not in INTEGRATORS:
        raise ValueError(f"{said} {name!r}, which is no integrator; choose from {', '.join(INTEGRATORS)}")


def set_camera(server: viser.ViserServer, camera: PinholeCamera, up: Any, scene: Scene) -> None:
    """The view of new clients."""
    low, high = scene.bounds
    extent = max(float(np.linalg.norm(high - low)), float(np.linalg.norm(camera.look_at - camera.position)))
    server.scene.set_up_direction(up)
    first = server.initial_camera
    first.position, first.look_at = (tuple(map(float, point)) for point in (camera.position, camera.look_at))  # type: ignore[assignment]
    first.up, first.fov = up, float(np.radians(camera.fov))
    first.near, first.far = 1e-4 * extent, 1e2 * extent


def place_camera(client: viser.ClientHandle, camera: PinholeCamera, up: Any) -> None:
    """Moves a client's camera to the first view."""
    client.camera.up_direction = up
    client.camera.position = tuple(map(float, camera.position))  # type: ignore[assignment]
    client.camera.look_at = tuple(map(float, camera.look_at))  # type: ignore[assignment]
    client.camera.fov = float(np.radians(camera.fov))

"""`wrt.view`: shows a scene in web browsers."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.imaging.cameras import PinholeCamera, check_point
from wrt.imaging.integrators import INTEGRATORS
from wrt.kernels.validation import as_bool, as_float, as_int, as_numbers
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.up_axis import default_up
from wrt.scene.scene import Scene
from wrt.viewer.client_session import ClientSession
from wrt.viewer.panels.control_panel import ControlPanel
from wrt.viewer.panels.pick_panel import PickPanel
from wrt.viewer.panels.scene_panel import ScenePanel
from wrt.viewer.panels.tree_panel import TreePanel
from wrt.viewer.pictures.looks import make_picture
from wrt.viewer.pictures.wish import Wish
from wrt.viewer.shared_scene import SharedScene
from wrt.viewer.trees.box_lines import heat_colors
from wrt.viewer.web_server import WebServer, check_viser

if TYPE_CHECKING:
    import viser

__all__ = ["Viewer", "view"]

MOST_CLIENTS = 16
"""Clients at a time that get pictures."""

PANELS_AFTER = 1.0
"""Seconds after which a client gets its panels if it has no picture yet; else it gets them with the first one."""

MOST_PORT = 65535

MOST_POINTS = 2_000_000
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
        up: tuple[float, ...],
        first: Wish,
        options: Mapping[str, Mapping[str, Any]],
        animate: Callable[[Scene, int], Any] | None = None,
        frames: int = 0,
    ) -> None:
        self.shared = SharedScene(scene, animate, frames)
        self.sessions: dict[int, ClientSession] = {}
        self.panels: dict[int, tuple[ControlPanel, PickPanel, TreePanel]] = {}
        self._lock = threading.Lock()
        self._first, self._options = first, dict(options)
        self._ended = threading.Event()
        self._web, self._server = server, server.viser
        set_camera(self._server, camera, up, scene)
        self._panel = ScenePanel(self._server, self.shared)
        threading.Thread(target=self._prepare, name="wrt-prepare", daemon=True).start()
        self._first_view = camera, up
        self._server.on_client_connect(self._welcome)
        self._server.on_client_disconnect(self._leave)

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

    def add_points(self, points: Any, values: Any = None, *, name: str = "points", size: float = 2.0) -> None:
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
        if len(points) > MOST_POINTS:
            raise ValueError(f"there are {len(points)} points; at most {MOST_POINTS} can be drawn: leave some out")
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
            position=tuple(map(float, center)),
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
        """Ends the server, all threads and all connections; a second call does nothing."""
        if self._ended.is_set():
            return
        self._ended.set()
        self.shared.pause()
        with self._lock:
            sessions = [*self.sessions.values()]
            self.sessions.clear()
            self.panels.clear()
        for session in sessions:
            session.close()
        self._web.close()

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
        with suppress(ValueError, TypeError, RuntimeError):  # the client is told
            if self._server.get_clients():  # one waits: its picture is made already
                return
            version, scene = self.shared.current
            wish = replace(self._first, version=version, size=(160, 120))
            make_picture(scene, wish, 1.0, True, self._options.get(wish.integrator)).advance(lambda *_: None)

    def _welcome(self, client: viser.ClientHandle) -> None:
        """A browser has connected."""
        with self._lock:
            if self._ended.is_set():
                return
            if len(self.sessions) >= MOST_CLIENTS:
                client.add_notification(
                    "Too many viewers", f"{MOST_CLIENTS} browsers look at this scene. Close one, and load this page again."
                )
                return
            if not np.allclose(client.camera.position, self._first_view[0].position, rtol=1e-4):  # a slow browser is elsewhere
                place_camera(client, *self._first_view)
            session = ClientSession(client, self.shared, self._first, self._options)
            self.sessions[client.client_id] = session
        session.start()
        session.wait_for_picture(PANELS_AFTER)
        if client.client_id not in self.sessions:
            return
        panels = ControlPanel(session), PickPanel(session), TreePanel(session)
        with self._lock:
            if client.client_id in self.sessions:
                self.panels[client.client_id] = panels

    def _leave(self, client: viser.ClientHandle) -> None:
        """A browser has gone, perhaps in the middle of a picture."""
        with self._lock:
            session = self.sessions.pop(client.client_id, None)
            self.panels.pop(client.client_id, None)
        if session is not None:
            session.close()


def view(
    scene: Any,
    *,
    block: bool | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    token: bool | str | None = None,
    camera: PinholeCamera | None = None,
    up: Any = None,
    integrator: str = "ambient",
    samples: int = 4,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    animate: Callable[[Scene, int], Any] | None = None,
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
        port: to listen on; if it is taken, a higher one. 0 for any.
        token: whether the address must hold a secret, which `Viewer.url` then does: whoever lacks it gets no picture and moves
            no control. True makes one at random; a string of at least 8 letters, digits, - and _ is one. None: if other
            computers can reach `host`. False lets everybody in, with a warning. Nothing is encrypted.
        camera: the view at first; None for one that shows the whole scene. Its size does not matter.
        up: (3,) direction that stays upright when the camera turns; None for that of the meshes (`wrt.TriangleMesh.up`).
        integrator: at first, as of `wrt.render`.
        samples: of each pixel, at rest.
        options: of each integrator, as of `wrt.render`: `{"ambient": {"light": (0, 0, 9)}}`.
        animate: animate(scene, frame) moves the scene to a frame: the viewer can then play. None for `show` of a
            `wrt.FuzzyScene`, and no animation of others.
        frames: number of frames of the animation.
        open_browser: whether to open a browser of this computer.

    Returns:
        The viewer. As the last line of a notebook's cell, it shows itself there.

    Raises:
        ImportError: viser is missing.
        TypeError, ValueError: an argument has a wrong type or value.
    """
    check_viser()
    scene = Scene(scene) if isinstance(scene, TriangleMesh) else scene
    if not isinstance(scene, Scene):
        raise TypeError(f"scene must be a wrt.Scene or a wrt.TriangleMesh, not {type(scene).__name__}")
    port, samples, frames = as_int("port", port, 0, MOST_PORT), as_int("samples", samples, 1), as_int("frames", frames, 0)
    block, open_browser = None if block is None else as_bool("block", block), as_bool("open_browser", open_browser)
    if animate is not None and frames < 1:
        raise ValueError(f"frames is {frames}; an animation needs the number of its frames")
    up = tuple(map(float, check_point("up", default_up(scene) if up is None else up)))
    camera = PinholeCamera.framing(scene, 800, 600, up=up) if camera is None else camera
    first, options = first_wish(camera, integrator, samples), dict(options or {})
    for name in options:
        check_integrator(name, "options has")
    server = WebServer(host, port, token)
    viewer = Viewer(scene, server, camera=camera, up=up, first=first, options=options, animate=animate, frames=frames)
    if open_browser:
        server.open_browser()
    if not in_notebook() if block is None else block:
        viewer.wait()
    return viewer


def in_notebook() -> bool:
    """Whether a kernel of Jupyter runs this, which shows what a cell returns."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return hasattr(shell, "kernel")


def first_wish(camera: Any, integrator: str, samples: int) -> Wish:
    """What a browser shows at first.

    Raises:
        TypeError, ValueError: no camera, or no integrator.
    """
    check_integrator(integrator, "integrator is")
    if not isinstance(camera, PinholeCamera):
        raise TypeError(f"camera must be a wrt.PinholeCamera, not {type(camera).__name__}")
    pose = tuple(camera.position), tuple(camera.look_at), tuple(camera.up), camera.fov
    return Wish(version=0, camera=pose, size=(800, 600), integrator=integrator, samples=samples)


def check_integrator(name: str, said: str) -> None:
    """Raises a ValueError for a name that no integrator has; `said` begins the message."""
    if name not in INTEGRATORS:
        raise ValueError(f"{said} {name!r}, which is no integrator; choose from {', '.join(INTEGRATORS)}")


def set_camera(server: viser.ViserServer, camera: PinholeCamera, up: tuple[float, ...], scene: Scene) -> None:
    """The view of new clients."""
    low, high = scene.bounds
    extent = max(float(np.linalg.norm(high - low)), float(np.linalg.norm(camera.look_at - camera.position)))
    server.scene.set_up_direction(up)
    first = server.initial_camera
    first.position, first.look_at = (tuple(map(float, point)) for point in (camera.position, camera.look_at))
    first.up, first.fov = up, float(np.radians(camera.fov))
    first.near, first.far = 1e-4 * extent, 1e2 * extent


def place_camera(client: viser.ClientHandle, camera: PinholeCamera, up: tuple[float, ...]) -> None:
    """Moves a client's camera to the first view."""
    client.camera.up_direction = up
    client.camera.position = tuple(map(float, camera.position))
    client.camera.look_at = tuple(map(float, camera.look_at))
    client.camera.fov = float(np.radians(camera.fov))

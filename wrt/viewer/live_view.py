"""`wrt.view`: shows a scene in web browsers."""

from __future__ import annotations

import io
import threading
import warnings
import webbrowser
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.imaging.cameras import PinholeCamera, check_point
from wrt.imaging.integrators.render_settings import INTEGRATORS
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

if TYPE_CHECKING:
    import viser

__all__ = ["Viewer", "view"]

MOST_CLIENTS = 16
"""Clients at a time that get pictures."""

MOST_POINTS = 2_000_000
"""Points of a name."""

EXPOSED = (
    "the viewer listens on {host}: whoever reaches this computer sees the scene and can change it, without a password. "
    "Leave host out, and reach it through ssh: ssh -L 8080:localhost:8080 HOST"
)


class Viewer:
    """A scene shown in web browsers, until `close`. Made by `wrt.view`. In a notebook, it shows itself in the cell.

    Args:
        scene, host, port, animate, frames: as in `wrt.view`.
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
        *,
        host: str,
        port: int,
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
        self._server = start_server(host, port)
        self.host, self.port = host, self._server.get_port()
        set_camera(self._server, camera, up, scene)
        self._panel = ScenePanel(self._server, self.shared)
        threading.Thread(target=self._prepare, name="wrt-prepare", daemon=True).start()
        self._first_view = camera, up
        self._server.on_client_connect(self._welcome)
        self._server.on_client_disconnect(self._leave)

    @property
    def url(self) -> str:
        """The address to open in a browser."""
        shown = "localhost" if self.host in ("0.0.0.0", "::", "") else self.host
        return f"http://{shown}:{self.port}"

    def refresh(self) -> None:
        """Shows the scene as it is now, after `scene.update` and the like."""
        self.shared.refresh()

    def add_points(self, points: Any, values: Any = None, *, name: str = "points", size: float = 2.0) -> None:
        """Draws points over the picture, such as those of a scan, until others are drawn under the same name.

            scan = lidar.scan(scene, pose)
            viewer.add_points(scan.points, scan.intensity)

        Args:
            points: (..., 3) in the coordinates of the scene; those with a NaN are left out.
            values: (...) numbers that colour them from blue for the least to red for the largest; None for one colour.
            name: of the points.
            size: of a point, in thousandths of the scene's diagonal.

        Raises:
            ValueError: wrong shapes, or more than 2 million points.
        """
        points = np.asarray(points, dtype=np.float64)
        if points.ndim < 1 or points.shape[-1] != 3:
            raise ValueError(f"points must have shape (..., 3), not {points.shape}")
        values = np.zeros(points.shape[:-1]) if values is None else np.asarray(values, dtype=np.float64)
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
        with redirect_stdout(io.StringIO()):
            self._server.stop()

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
        self.panels[client.client_id] = ControlPanel(session), PickPanel(session), TreePanel(session)
        session.start()

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
    block: bool = True,
    host: str = "127.0.0.1",
    port: int = 8080,
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

        viewer = wrt.view(scene, block=False)       # open viewer.url
        scene.update(0, vertices=moved)
        viewer.refresh()
        viewer.close()

    It needs the package viser: `pip install 'wrt[view]'`.

    Args:
        scene: a `wrt.Scene` of any kind, or a `wrt.TriangleMesh`.
        block: whether to return only at the end, that is at a Ctrl-C.
        host: network interface to listen on. Other computers cannot reach the default. There is a warning for any other:
            there is no password.
        port: to listen on; if it is taken, a higher one. 0 for any.
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
        The viewer. In a notebook, it shows itself; give `block=False`.

    Raises:
        ImportError: viser is missing.
        TypeError, ValueError: an argument has a wrong type or value.
    """
    check_viser()
    if not is_local(host):
        warnings.warn(EXPOSED.format(host=host), stacklevel=2)
    scene = Scene(scene) if isinstance(scene, TriangleMesh) else scene
    if not isinstance(scene, Scene):
        raise TypeError(f"scene must be a wrt.Scene or a wrt.TriangleMesh, not {type(scene).__name__}")
    if animate is not None and frames < 1:
        raise ValueError(f"frames is {frames}; an animation needs the number of its frames")
    up = tuple(map(float, check_point("up", default_up(scene) if up is None else up)))
    camera = PinholeCamera.framing(scene, 800, 600, up=up) if camera is None else camera
    first, options = first_wish(camera, integrator, samples), dict(options or {})
    for name in options:
        check_integrator(name, "options has")
    viewer = Viewer(
        scene, host=host, port=port, camera=camera, up=up, first=first, options=options, animate=animate, frames=frames
    )
    if open_browser:
        with suppress(webbrowser.Error):
            webbrowser.open(viewer.url)
    if block:
        viewer.wait()
    return viewer


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


def is_local(host: str) -> bool:
    """Whether only this computer reaches a network interface."""
    return host == "localhost" or host.startswith("127.") or host == "::1"


def check_viser() -> None:
    """Raises an ImportError that says what to do if viser is missing."""
    try:
        import viser  # noqa: F401
    except ImportError as error:
        raise ImportError("the viewer needs the package viser; install it with pip install 'wrt[view]'") from error


def start_server(host: str, port: int) -> viser.ViserServer:
    """A server without what the viewer does not need: its greeting, and sharing through a server elsewhere."""
    import viser

    class Server(viser.ViserServer):
        """A server that refuses to share itself: any client could ask it to."""

        def request_share_url(self, verbose: bool = True) -> None:
            """Does nothing."""

    with redirect_stdout(io.StringIO()):
        server = Server(host=host, port=port, label="wrt", verbose=False)
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    return server


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

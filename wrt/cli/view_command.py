"""`wrt view`: shows mesh files or a built-in scene in a web browser."""

from __future__ import annotations

import gc
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wrt.cli.arguments import UpDirection, expect_build, scene_options, start_warp
from wrt.cli.number_types import Real, Whole
from wrt.cli.render import ambient_distance

if TYPE_CHECKING:
    from wrt.imaging.cameras import PinholeCamera
    from wrt.scene.scene import Scene
    from wrt.scenes import BuiltinScene
    from wrt.viewer.live_view import Viewer
    from wrt.viewer.web_server import WebServer


DEFAULT_FPS = 24


@click.command()
@click.argument("models", nargs=-1, metavar="[MODEL]...", type=click.Path(path_type=Path))
@scene_options
@click.option("--port", default=8080, show_default=True, type=Whole(0, 65535), help="0 for any that is free.")
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="Interface to listen on; the default is reachable from this machine only.",
)
@click.option(
    "--token/--no-token",
    default=None,
    help="Only the address with a random token shows the scene.  [if others can reach HOST]",
)
@click.option("--up", type=UpDirection(), help="x, y, z, -x ... or x,y,z.  [MODEL: y for glTF, OBJ, PLY, OFF, else z]")
@click.option(
    "--integrator",
    default="ambient",
    show_default=True,
    type=click.Choice(["ambient", "whitted", "distribution", "path"]),
    help="At first.",
)
@click.option("--samples", default=4, show_default=True, type=Whole(1), help="Camera rays per pixel, at rest.")
@click.option("--animate", is_flag=True, help="Each MODEL is a frame of one mesh.")
@click.option("--fps", type=Real(0, 60, min_open=True), help="Most frames per second.  [24]")
@click.option("--fuzzy", is_flag=True, help="One tree for all frames of a mesh (wrt.moving.FuzzyScene).")
@click.option("--open", "open_browser", is_flag=True, help="Open a browser of this computer.")
def view(
    models: tuple[Path, ...],
    port: int,
    host: str,
    token: bool | None,
    integrator: str,
    samples: int,
    open_browser: bool,
    **given: Any,
) -> None:
    """Shows each MODEL, any mesh file that trimesh reads, or a built-in scene in a web browser, until Ctrl-C.

    A MODEL that is a folder is an animation: its meshes, in the order of their names, are frames of one mesh.

    Rays are traced while the mouse moves the camera. From another computer: `ssh -L 8080:localhost:8080 HOST wrt view MODEL`.
    """
    with ExitStack() as at_end:
        with _collector_paused():
            server = _serve(host, port, token, open_browser)  # first: the browser loads its page while the scene is read
            at_end.callback(server.close)
            notice = server.viser.gui.add_markdown("The scene is being read.")
            viewer = _viewer(server, models, integrator, samples, given)
            notice.remove()
        viewer.wait()


@contextmanager
def _collector_paused() -> Iterator[None]:
    """Imports make many objects that stay: going through them again and again took a tenth of the start."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def _serve(host: str, port: int, token: bool | None, open_browser: bool) -> WebServer:
    """Starts the server and says where."""
    from wrt.viewer.web_server import WebServer

    server = WebServer(host, port, token)
    click.echo(f"{server.url} (Ctrl-C ends it)")
    if server.gate.token:
        click.echo(f"from other computers: {server.url_of(socket.gethostname())}")
    if open_browser:
        server.open_browser()
    return server


def _viewer(server: WebServer, models: tuple[Path, ...], integrator: str, samples: int, given: dict[str, Any]) -> Viewer:
    """Shows the scene."""
    start_warp(given["device"])
    expect_build(given)

    from wrt.cli.animated_models import load_models
    from wrt.meshes.up_axis import default_up
    from wrt.viewer.live_view import Viewer, first_request

    loaded, fuzzy = load_models(models, given, given["animate"]), given["fuzzy"]
    scene, builtin = loaded.scene(given, fuzzy), loaded.builtin
    up = given["up"] or (builtin.up if builtin else default_up(scene))
    camera = _camera(scene, builtin, up)
    options: dict[str, Any] = {"ambient_distance": ambient_distance(scene, camera)}
    if builtin:
        options["light"] = builtin.light
    click.echo(f"{scene.triangle_count:,} triangles" + (f", {loaded.frames} frames" if loaded.frames else ""))
    first, frames = first_request(camera, integrator, samples), loaded.frames
    shown: dict[str, Any] = {"camera": camera, "up": up, "first": first, "options": {"ambient": options}}
    viewer = Viewer(scene, server, **shown, animate=loaded.animation(fuzzy), frames=frames)
    if frames:
        viewer.play(given["fps"] or DEFAULT_FPS)
    return viewer


def _camera(scene: Scene, builtin: BuiltinScene | None, up: tuple[float, ...]) -> PinholeCamera:
    """The camera of the built-in scene, or one that frames the models."""
    from wrt.imaging.cameras import PinholeCamera

    if builtin:
        return PinholeCamera(800, 600, **(builtin.camera | {"up": up}))
    return PinholeCamera.framing(scene, 800, 600, up=up)

"""`wrt view`: shows mesh files or a built-in scene in a web browser."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wrt.cli.arguments import UpDirection, expect_build, load_mesh, make_scene, scene_options, start_warp
from wrt.cli.render import ambient_distance

if TYPE_CHECKING:
    from wrt.imaging.cameras import PinholeCamera
    from wrt.scene.scene import Scene
    from wrt.scenes import BuiltinScene


@click.command()
@click.argument("models", nargs=-1, metavar="[MODEL]...", type=click.Path(path_type=Path))
@scene_options
@click.option("--port", default=8080, show_default=True, type=click.IntRange(0, 65535), help="0 for any that is free.")
@click.option("--host", default="127.0.0.1", show_default=True, help="Network interface; others can only reach another one.")
@click.option("--up", type=UpDirection(), help="x, y, z, -x ... or x,y,z.  [MODEL: y for glTF, OBJ, PLY, OFF, else z]")
@click.option(
    "--integrator",
    default="ambient",
    show_default=True,
    type=click.Choice(["ambient", "whitted", "distribution", "path"]),
    help="At first.",
)
@click.option("--samples", default=4, show_default=True, type=click.IntRange(1), help="Camera rays per pixel, at rest.")
@click.option("--open", "open_browser", is_flag=True, help="Open a browser of this computer.")
def view(
    models: tuple[Path, ...], port: int, host: str, integrator: str, samples: int, open_browser: bool, **given: Any
) -> None:
    """Shows each MODEL, any mesh file that trimesh reads, or a built-in scene in a web browser, until Ctrl-C.

    Rays are traced while the mouse moves the camera. From another computer: `ssh -L 8080:localhost:8080 HOST wrt view MODEL`.
    """
    from wrt.meshes.up_axis import default_up
    from wrt.viewer.live_view import EXPOSED, check_viser, is_local
    from wrt.viewer.live_view import view as show

    check_viser()
    start_warp(given["device"])
    expect_build(given)
    loaded = [load_mesh(given | {"model": model}, materials=True) for model in models or (None,)]
    meshes, builtin = [mesh for mesh, _ in loaded], loaded[0][1]
    scene = make_scene(meshes, given)
    up = given["up"] or (builtin.up if builtin else default_up(scene))
    camera = _camera(scene, builtin, up)
    options: dict[str, Any] = {"ambient_distance": ambient_distance(scene, camera)}
    if builtin:
        options["light"] = builtin.light
    if not is_local(host):
        click.echo("warning: " + EXPOSED.format(host=host), err=True)
        warnings.simplefilter("ignore")
    viewer = show(
        scene,
        block=False,
        host=host,
        port=port,
        up=up,
        camera=camera,
        integrator=integrator,
        samples=samples,
        options={"ambient": options},
        open_browser=open_browser,
    )
    click.echo(f"{scene.triangle_count:,} triangles at {viewer.url} (Ctrl-C ends it)")
    viewer.wait()


def _camera(scene: Scene, builtin: BuiltinScene | None, up: tuple[float, ...]) -> PinholeCamera:
    """The camera of the built-in scene, or one that frames the models."""
    from wrt.imaging.cameras import PinholeCamera

    if builtin:
        return PinholeCamera(800, 600, **(builtin.camera | {"up": up}))
    return PinholeCamera.framing(scene, 800, 600, up=up)

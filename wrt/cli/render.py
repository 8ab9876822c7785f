"""`wrt render`: an image of a mesh file or of a built-in scene."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wrt.cli.arguments import (
    UpDirection,
    Vector,
    check_name,
    expect_build,
    load_mesh,
    make_scene,
    model_options,
    progress,
    start_warp,
)

if TYPE_CHECKING:
    from wrt.imaging.cameras import PinholeCamera
    from wrt.meshes.mesh import TriangleMesh
    from wrt.scene.scene import Scene
    from wrt.scenes import BuiltinScene

GROUND_SIZE = 32.0
"""Side of the ground under a model, in diagonals of the model's bounding box."""


@click.command()
@model_options
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Image to write: .png, .jpg, .npy ...")
@click.option("--width", default=800, show_default=True, type=click.IntRange(1), help="Pixels.")
@click.option("--height", default=600, show_default=True, type=click.IntRange(1), help="Pixels.")
@click.option("--samples", default=4, show_default=True, type=click.IntRange(1), help="Camera rays per pixel.")
@click.option(
    "--ambient-samples", default=16, show_default=True, type=click.IntRange(0), help="Ambient rays per camera ray; 0: none."
)
@click.option(
    "--ambient-distance",
    type=click.FloatRange(0, min_open=True),
    help="Length of ambient rays.  [inside a scene a tenth of its size, else no limit]",
)
@click.option("--camera", type=Vector(), help="Position.  [the scene's, or one that frames the MODEL]")
@click.option("--look-at", type=Vector(), help="Point at the image centre.")
@click.option("--up", type=UpDirection(), help="x, y, z, -x ... or x,y,z.  [MODEL: y for glTF, OBJ, PLY, OFF, else z]")
@click.option("--fov", type=click.FloatRange(0, 180, min_open=True, max_open=True), help="Vertical field of view in degrees.")
@click.option("--light", type=Vector(), help="Position.  [the scene's, or over the camera's left shoulder]")
@click.option("--shadows/--no-shadows", default=True, show_default=True)
@click.option("--smooth/--flat", default=True, show_default=True, help="Interpolate normals, or show facets.")
@click.option("--ground/--no-ground", default=False, show_default=True, help="Put a plane under the MODEL.")
@click.option("--triangle-test", default="auto", show_default=True, help="auto, or a name from `wrt list`.")
@click.option("--traversal", default="auto", show_default=True, help="auto, or a name from `wrt list`.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Seed of the sample pattern.")
def render(output: Path, ground: bool, **given: Any) -> None:
    """Renders MODEL, any mesh file that trimesh reads, or a built-in scene, to an image."""
    start_warp(given["device"])
    from wrt.imaging.image_files import check_path, save_image
    from wrt.imaging.rendering import render as render_image
    from wrt.meshes.up_axis import default_up

    try:
        check_path(output)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--output") from None
    query = {name: check_name(name, given[name]) for name in ("triangle_test", "traversal")}
    expect_build(given)
    mesh, builtin = load_mesh(given)
    up = given["up"] or (builtin.up if builtin else default_up(mesh))
    if ground and builtin:
        raise click.UsageError("--ground needs a MODEL; built-in scenes have their own ground")
    scene = make_scene([mesh, _ground(mesh, up)] if ground else mesh, given)
    camera = _camera(mesh, builtin, up, given)
    start = time.perf_counter()
    with progress(f"rendering {mesh.name}") as on_progress:
        image = render_image(
            scene,
            camera,
            samples=given["samples"],
            ambient_samples=given["ambient_samples"],
            ambient_distance=given["ambient_distance"] or _ambient_distance(scene, camera),
            light=given["light"] or (builtin.light if builtin else None),
            shadows=given["shadows"],
            smooth=given["smooth"],
            seed=given["seed"],
            progress=on_progress,
            **query,
        )
    seconds = time.perf_counter() - start
    save_image(output, image)
    click.echo(f"{output}: {camera.width} x {camera.height}, {scene.triangle_count:,} triangles, {seconds:.1f} s")


def _camera(mesh: TriangleMesh, builtin: BuiltinScene | None, up: tuple[float, ...], given: Mapping[str, Any]) -> PinholeCamera:
    """The camera of the built-in scene, or one that frames the model, with the given options in place of its own."""
    from wrt.imaging.cameras import PinholeCamera

    width, height = given["width"], given["height"]
    own: dict[str, Any] = dict(builtin.camera) if builtin else {"fov": 35.0, "look_at": mesh.center}
    chosen = {"fov": given["fov"], "position": given["camera"], "look_at": given["look_at"]}
    view = own | {name: value for name, value in chosen.items() if value is not None} | {"up": up}
    try:
        if "position" not in view:
            framing = PinholeCamera.framing(mesh, width, height, fov=view["fov"], up=up)
            view["position"] = framing.position
            if given["look_at"] is None:
                view["look_at"] = framing.look_at
        return PinholeCamera(width, height, **view)
    except ValueError as error:
        raise click.UsageError(str(error)) from None


def _ambient_distance(scene: Scene, camera: PinholeCamera) -> float | None:
    """None (no limit), but a tenth of the scene's diagonal if the camera is inside its box, where all would be dark."""
    low, high = scene.bounds
    inside = ((low < camera.position) & (camera.position < high)).all()
    return 0.1 * float(((high - low) ** 2).sum() ** 0.5) if inside else None


def _ground(mesh: TriangleMesh, up: tuple[float, ...]) -> TriangleMesh:
    """A square under the mesh, orthogonal to `up`."""
    import numpy as np

    from wrt.meshes.mesh import TriangleMesh

    upward = np.array(up) / np.linalg.norm(up)
    across = np.cross(upward, np.eye(3)[np.argmin(np.abs(upward))])
    across /= np.linalg.norm(across)
    along = np.cross(upward, across)
    center = mesh.center + upward * ((mesh.vertices - mesh.center) @ upward).min()
    half = GROUND_SIZE / 2 * (mesh.extent or 1.0)
    corners = [center + half * (x * across + y * along) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return TriangleMesh(np.array(corners), np.array([[0, 1, 2], [0, 2, 3]]), name="ground")

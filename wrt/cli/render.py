"""`wrt render`: an image of a mesh file or of a built-in scene."""

from __future__ import annotations

import os
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
    sample_progress,
    start_warp,
)
from wrt.cli.cloud_models import is_cloud, load_cloud
from wrt.cli.number_types import Real, Whole

if TYPE_CHECKING:
    from wrt.imaging.cameras import PinholeCamera
    from wrt.imaging.sampled_picture import SampledPicture
    from wrt.meshes.mesh import TriangleMesh
    from wrt.scene.scene import Scene
    from wrt.scenes import BuiltinScene

OPTIONS_OF_OTHERS = ("depth", "sampler", "exposure", "tone_mapping", "lens_radius", "sky", "resume")
"""Options that the integrator "ambient" does not have."""

KEPT = ".samples.npz"
"""What the name of the file with the samples of an unfinished picture adds to the picture's name."""

GROUND_SIZE = 32.0
"""Side of the ground under a model, in diagonals of the model's bounding box."""


@click.command()
@model_options
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), help="Image to write: .png, .jpg, .npy, .exr ..."
)
@click.option("--width", default=800, show_default=True, type=Whole(1), help="Pixels.")
@click.option("--height", default=600, show_default=True, type=Whole(1), help="Pixels.")
@click.option(
    "--integrator",
    default="ambient",
    show_default=True,
    type=click.Choice(["ambient", "whitted", "distribution", "path"]),
    help="ambient: one colour; the others: materials and lights.",
)
@click.option("--samples", type=Whole(1), help="Camera rays per pixel.  [ambient 4, whitted 1, others 16]")
@click.option("--depth", type=Whole(1), help="Maximum path length; not for ambient.  [8]")
@click.option("--sampler", help="regular, random, jittered, halton or sobol; not for ambient.  [sobol]")
@click.option("--exposure", type=Real(0), help="Factor of the linear picture; not for ambient.  [1]")
@click.option("--tone-mapping", help="srgb, reinhard, aces or linear; not for ambient.  [srgb]")
@click.option("--lens-radius", type=Real(0), help="Of a thin lens, focused at --look-at; not for ambient.  [0]")
@click.option("--sky", type=Real(0), help="Radiance of a grey sky; not for ambient.")
@click.option("--ambient-samples", default=16, show_default=True, type=Whole(0), help="Ambient rays per camera ray; 0: none.")
@click.option(
    "--ambient-distance",
    type=Real(0, min_open=True),
    help="Length of ambient rays.  [inside a scene a tenth of its size, else no limit]",
)
@click.option("--camera", type=Vector(), help="Position.  [the scene's, or one that frames the MODEL]")
@click.option("--look-at", type=Vector(), help="Point at the image centre.")
@click.option("--up", type=UpDirection(), help="x, y, z, -x ... or x,y,z.  [MODEL: y for glTF, OBJ, PLY, OFF, else z]")
@click.option("--fov", type=Real(0, 180, min_open=True, max_open=True), help="Vertical field of view in degrees.")
@click.option("--light", type=Vector(), help="Position.  [the scene's, or over the camera's left shoulder]")
@click.option("--shadows/--no-shadows", default=True, show_default=True)
@click.option("--smooth/--flat", default=True, show_default=True, help="Interpolate normals, or show facets.")
@click.option("--ground/--no-ground", default=False, show_default=True, help="Put a plane under the MODEL.")
@click.option("--radius", type=Real(0, min_open=True), help="Radius of a cloud's points.  [from their spacing]")
@click.option("--triangle-test", default="auto", show_default=True, help="auto, or a name from `wrt list`.")
@click.option("--traversal", default="auto", show_default=True, help="auto, or a name from `wrt list`.")
@click.option("--resume", is_flag=True, help="Continue a picture that Ctrl-C ended; not for ambient.")
@click.option("--seed", default=0, show_default=True, type=Whole(0), help="Seed of the sample pattern.")
def render(output: Path, ground: bool, **given: Any) -> None:
    """Renders MODEL, any mesh file that trimesh reads, a file of points, or a built-in scene, to an image.

    Points (.pcd, .las, .laz, .xyz, KITTI's .bin, and .ply without faces) are spheres in their colours, or in greys by their
    intensity.

    With an integrator other than ambient, Ctrl-C ends the rendering and writes the picture with the samples that it has. They
    are also kept in a file beside the picture, from which the same command with --resume goes on. .exr and .npy files hold
    linear values.
    """
    start_warp(given["device"])
    from wrt.imaging.image_files import check_path
    from wrt.meshes.up_axis import Z_UP, default_up, up_of_format

    try:
        check_path(output)
        check_replaceable(output)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--output") from None
    _check_integrator(given)
    check_size(given["width"], given["height"])
    query = {name: check_name(name, given[name]) for name in ("triangle_test", "traversal")}
    builtin, albedo = None, {}
    if is_cloud(given["model"]):
        _check_options_of_clouds(given, ground)
        model: Any = load_cloud(given["model"], given)
        scene: Any = model.build(given)
        up = given["up"] or up_of_format(given["model"].suffix[1:]) or Z_UP
        framed, contents, albedo = scene, f"{len(scene):,} points of radius {model.radius:.3g}", {"albedo": model.albedo}
    else:
        if given["radius"] is not None:
            raise click.UsageError("--radius is that of points, and this model has triangles; leave it out")
        expect_build(given)
        if given["integrator"] == "ambient":
            _expect_shading(given)
        model, builtin = load_mesh(given, materials=given["integrator"] != "ambient")
        up = given["up"] or (builtin.up if builtin else default_up(model))
        if ground and builtin:
            raise click.UsageError("--ground needs a MODEL; built-in scenes have their own ground")
        scene = make_scene([model, _ground(model, up)] if ground else model, given)
        framed, contents = model, f"{scene.triangle_count:,} triangles"
    camera = _camera(framed, builtin, up, given)
    start = time.perf_counter()
    light = given["light"] or (builtin.light if builtin else None)
    try:
        picture = _picture(scene, camera, light, given, query | albedo)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    if given["integrator"] == "ambient":
        with progress(f"rendering {model.name}") as on_progress:
            picture.advance(progress=on_progress)
        picture.save(output)
        made = ""
    else:
        made = _make_or_keep(picture, output, model.name, given["resume"])
    seconds = time.perf_counter() - start
    click.echo(f"{output}: {camera.width} x {camera.height}, {contents}, {made}{seconds:.1f} s")


def _expect_shading(given: Mapping[str, Any]) -> None:
    """Begins to compile what makes a picture of hits after what builds the scene, on which none of it depends."""
    import warp as wp

    from wrt.imaging.ambient_rendering import shading_kernels
    from wrt.kernels.runtime.launch import expect

    expect(shading_kernels(given["smooth"], given["ambient_samples"] > 0), wp.get_device(given["device"]))


def _picture(
    scene: Any, camera: PinholeCamera, light: Any, given: Mapping[str, Any], query: Mapping[str, Any]
) -> SampledPicture:
    """The picture by the options, without samples."""
    from wrt.imaging.integrators.rendering_call import new_picture

    if given["integrator"] == "ambient":
        options = {"samples": 4, "light": light, "ambient_distance": ambient_distance(scene, camera)}
        wanted: tuple[str, ...] = ("ambient_samples", "ambient_distance", "shadows")
    else:
        options = {"lights": _lights(scene, camera, light, given["sky"])}
        wanted = ("depth", "sampler", "exposure", "tone_mapping", "lens_radius")
    options |= {option: given[option] for option in (*wanted, "samples", "smooth", "seed") if given[option] is not None}
    return new_picture(scene, camera, given["integrator"], **options, **query)


def _check_options_of_clouds(given: Mapping[str, Any], ground: bool) -> None:
    """Refuses what points do not have."""
    if given["scene"] is not None or given["options"] or given["level"] is not None:
        raise click.UsageError("--scene, --level and --option choose a built-in scene: leave them out, or leave MODEL out")
    if given["integrator"] != "ambient":
        raise click.UsageError(f"--integrator {given['integrator']} needs materials, and points have none; leave it out")
    if given["triangle_test"] != "auto":
        raise click.UsageError("--triangle-test is for triangles, and this model has points; leave it out")
    if ground:
        raise click.UsageError("--ground is for triangles: points and meshes are in no scene together; leave it out")


def _check_integrator(given: Mapping[str, Any]) -> None:
    """Refuses options that the integrator does not have."""
    for option in OPTIONS_OF_OTHERS if given["integrator"] == "ambient" else ():
        if given[option] not in (None, False):
            raise click.UsageError(f"--{option.replace('_', '-')} needs --integrator whitted, distribution or path")


def _make_or_keep(picture: Any, output: Path, name: str | None, resume: bool) -> str:
    """Makes and writes a `wrt.pictures.Rendering`, whose samples Ctrl-C keeps; the number of samples, in words."""
    kept = output.with_name(output.name + KEPT)
    if resume:
        try:
            picture.load_samples(kept)
        except FileNotFoundError:
            raise click.UsageError(f"--resume: there is no '{kept}' of an interrupted picture; leave --resume out") from None
        except ValueError as error:
            raise click.UsageError(f"--resume: {error}") from None
    try:
        with sample_progress(f"rendering {name}", picture) as on_progress:
            picture.advance(progress=on_progress)
    except KeyboardInterrupt:
        if picture.done == 0:
            raise
        picture.save_samples(kept)
        text = f"interrupted: the picture has {picture.done} of {picture.samples} samples; --resume adds the others"
        click.echo(text, err=True)
    picture.save(output)
    if picture.done == picture.samples:  # not before the picture is there
        kept.unlink(missing_ok=True)
    return f"{picture.done} samples, "


def _lights(scene: Scene, camera: PinholeCamera, light: Any, sky: float | None) -> list[Any] | None:
    """Lights by the options; None for those of `wrt.pictures.Rendering`."""
    import numpy as np

    from wrt.lights.light_sources import PointLight
    from wrt.lights.sky_image import Sky

    emits = any(mesh.materials and any(one.emits for one in mesh.materials.materials) for mesh in scene.meshes)
    if sky is None and (emits or light is None):
        return None
    lights: list[Any] = [] if sky is None else [Sky(sky)]
    if light is not None and not emits:
        distance = float(np.linalg.norm(np.asarray(light) - camera.look_at))
        lights.append(PointLight(light, 3.0 * distance**2))
    return lights


def _camera(mesh: Any, builtin: BuiltinScene | None, up: tuple[float, ...], given: Mapping[str, Any]) -> PinholeCamera:
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


def check_replaceable(output: Path) -> None:
    """Refuses a picture that could not be written in the end, before rays are traced for it.

    Raises:
        ValueError: a folder, a pipe or a device, or a place that may not be written to.
    """
    if output.exists() and not output.is_file():
        what = "a folder" if output.is_dir() else "a pipe, a socket or a device"
        raise ValueError(f"'{output}' is {what}; name a file, such as picture.png")
    if not os.access(output if output.exists() else output.parent, os.W_OK):
        raise ValueError(f"'{output}' may not be written; choose another folder")


def check_size(width: int, height: int) -> None:
    """Refuses pictures that are larger than the machine's memory.

    Raises:
        click.UsageError: their pixels alone, three float32 each, do not fit.
    """
    from wrt.engine.memory import machine_bytes

    size, available = 12 * width * height, machine_bytes()
    if available and size > available:
        raise click.UsageError(
            f"{width:,} x {height:,} pixels take {size / 1e9:,.1f} GB, and this machine has {available / 1e9:,.1f} GB; choose "
            "a smaller --width or --height"
        )


def ambient_distance(scene: Scene, camera: PinholeCamera) -> float | None:
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

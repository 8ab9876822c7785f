"""The command `wrt`: pictures, figures and lists without a line of Python.

    wrt render -o teapot.png        the built-in teapot
    wrt render bunny.ply -o b.png   any mesh file
    wrt info bunny.ply              the mesh and its tree
    wrt list                        every builder, traversal, triangle test and built-in scene

Errors are one line on stderr. Exit status: 0, or 2 for a wrong call, 1 for what went wrong on the way, 130 for Ctrl-C.
"""

from __future__ import annotations

import ast
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wrt import __version__

if TYPE_CHECKING:
    from rich.table import Table

    from wrt.camera import PinholeCamera
    from wrt.mesh import TriangleMesh
    from wrt.scene import Scene
    from wrt.scenes import BuiltinScene

DEFAULT_SCENE = "teapot"
Y_UP_FORMATS = {".glb", ".gltf", ".obj", ".off", ".ply"}
UP_NAMES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
HISTOGRAM_ROWS, HISTOGRAM_WIDTH = 24, 40
GROUND_SIZE = 32.0
"""Side of the ground under a model, in diagonals of the model."""


class LazyCommand(click.Command):
    """A command that is imported only when it is called.

    Args:
        name: its name, and that of the attribute of `module`.
        module: where it is defined.
        help: its line in the list of commands.
    """

    def __init__(self, name: str, module: str, help: str) -> None:
        super().__init__(name, help=help)
        self.module = module

    def make_context(self, *args: Any, **kwargs: Any) -> click.Context:
        """The context of the real command, which click goes on with."""
        return getattr(import_module(self.module), self.name).make_context(*args, **kwargs)


class CommandLine(click.Group):
    """A group of commands whose errors are one line each."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Runs a command and ends the process with its exit status."""
        kwargs["standalone_mode"] = False
        try:
            status = super().main(*args, **kwargs)
        except click.UsageError as error:
            path = error.ctx.command_path if error.ctx else "wrt"
            _fail(f"{error.format_message()} (see '{path} --help')", 2)
        except click.ClickException as error:
            _fail(error.format_message(), 1)
        except (click.Abort, KeyboardInterrupt):
            print("interrupted", file=sys.stderr)
            sys.exit(130)
        except MemoryError:
            _fail("out of memory; take a smaller mesh or picture", 1)
        except (OSError, ValueError, TypeError, RuntimeError, ImportError) as error:
            _fail(str(error) or type(error).__name__, 1)
        sys.exit(status if isinstance(status, int) else 0)


class Vector(click.ParamType):
    """x,y,z"""

    name = "x,y,z"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        if isinstance(value, tuple):
            return value
        try:
            numbers = tuple(float(part) for part in value.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != 3 or not all(abs(x) < float("inf") for x in numbers):
            self.fail(f"{value!r} is not three numbers x,y,z", param, ctx)
        return numbers


class UpDirection(Vector):
    """x, y, z, -x, -y, -z, or a vector"""

    name = "axis"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        if isinstance(value, str) and value.lstrip("+-") in UP_NAMES:
            sign = -1.0 if value.startswith("-") else 1.0
            return tuple(sign * x + 0.0 for x in UP_NAMES[value.lstrip("+-")])
        return super().convert(value, param, ctx)


def model_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """What is loaded, and the scene that is made of it."""
    for option in reversed(
        (
            click.argument("model", required=False, type=click.Path(path_type=Path)),
            click.option("--scene", help=f"Built-in scene, if there is no MODEL; see `wrt list`. [{DEFAULT_SCENE}]"),
            click.option("--level", type=click.IntRange(1), help="Fineness of the teapot, the same as --option level=N."),
            click.option("--option", "options", multiple=True, metavar="KEY=VALUE", help="Option of the scene; repeat."),
            click.option("--accelerator", default="auto", show_default=True, help="auto, or a name from `wrt list`."),
            click.option("--device", help="cpu, cuda:0, ...  [Warp's default]"),
            click.option("--threads", type=click.IntRange(1, 1024), help="Threads on the CPU. [all cores]"),
        )
    ):
        command = option(command)
    return command


@click.group("wrt", cls=CommandLine, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="wrt", message="%(prog)s %(version)s")
def main() -> None:
    """Ray tracing of triangle meshes, on all CPU cores and on CUDA."""


@main.command()
@model_options
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Picture to write: .png, .jpg, .npy ...")
@click.option("--width", default=800, show_default=True, type=click.IntRange(1), help="Pixels.")
@click.option("--height", default=600, show_default=True, type=click.IntRange(1), help="Pixels.")
@click.option("--samples", default=4, show_default=True, type=click.IntRange(1), help="Camera rays a pixel.")
@click.option("--ambient-samples", default=16, show_default=True, type=click.IntRange(0), help="For each camera ray; 0: none.")
@click.option(
    "--ambient-distance",
    type=click.FloatRange(0, min_open=True),
    help="Reach of these rays.  [inside a scene a tenth of its size, else no limit]",
)
@click.option("--camera", type=Vector(), help="Position.  [the scene's, or one that frames the MODEL]")
@click.option("--look-at", type=Vector(), help="Middle of the picture.")
@click.option("--up", type=UpDirection(), help="x, y, z, -x ... or x,y,z.  [MODEL: y for glTF, OBJ, PLY, OFF, else z]")
@click.option("--fov", type=click.FloatRange(0, 180, min_open=True, max_open=True), help="Vertical, in degrees.")
@click.option("--light", type=Vector(), help="Position.  [the scene's, or over the camera's left shoulder]")
@click.option("--shadows/--no-shadows", default=True, show_default=True)
@click.option("--smooth/--flat", default=True, show_default=True, help="Smooth normals, or every facet.")
@click.option("--ground/--no-ground", default=False, show_default=True, help="Puts a plane under the MODEL.")
@click.option("--triangle-test", default="auto", show_default=True, help="auto, or a name from `wrt list`.")
@click.option("--traversal", default="auto", show_default=True, help="auto, or a name from `wrt list`.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Of the samples' pattern.")
def render(output: Path, ground: bool, **given: Any) -> None:
    """Renders MODEL, any mesh file that trimesh reads, or a built-in scene, to a picture."""
    _start_warp(given["device"])
    from wrt.image import check_path, save_image
    from wrt.rendering import render as render_image

    try:
        check_path(output)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--output") from None
    query = {name: _check_name(name, given[name]) for name in ("triangle_test", "traversal")}
    mesh, builtin = _load(given)
    up = given["up"] or (builtin.up if builtin else _up_of_file(given["model"]))
    if ground and builtin:
        raise click.UsageError("--ground goes with a MODEL; built-in scenes bring their own")
    scene = _make_scene([mesh, _ground(mesh, up)] if ground else mesh, given)
    camera = _camera(mesh, builtin, up, given)
    start = time.perf_counter()
    with _progress(f"rendering {mesh.name}") as progress:
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
            progress=progress,
            **query,
        )
    seconds = time.perf_counter() - start
    save_image(output, image)
    click.echo(f"{output}: {camera.width} x {camera.height}, {scene.triangle_count:,} triangles, {seconds:.1f} s")


@main.command()
@model_options
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of tables.")
def info(as_json: bool, **given: Any) -> None:
    """Shows what is in MODEL (or in a built-in scene), and figures of its tree."""
    _start_warp(given["device"])
    mesh, _ = _load(given)
    scene = _make_scene(mesh, given)
    result = {"model": mesh.summary(), **scene.statistics().to_dict()}
    if as_json:
        click.echo(json.dumps(result, indent=1))
        return
    _print_tables(_histogram(title, v) if isinstance(v, list) else _figures(title, v) for title, v in result.items())


@main.command("list")
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of tables.")
def list_command(as_json: bool) -> None:
    """Lists every builder, traversal and triangle test with its paper, and the built-in scenes."""
    tables = _all_tables()
    if as_json:
        click.echo(json.dumps(tables, indent=1))
        return
    from rich.table import Table

    printed = []
    for title, rows in tables.items():
        table = Table(*rows[0], title=title, title_justify="left", title_style="bold")
        for row in rows:
            table.add_row(*(_text(value) for value in row.values()))
        printed.append(table)
    _print_tables(printed)


def _is_there(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # not even its package
        return False


if _is_there("wrt.bench.command"):
    main.add_command(LazyCommand("bench", "wrt.bench.command", "Compares wrt with other ray tracers, on the same rays."))


# -- what is rendered --------------------------------------------------------------------------------------------------


def _load(given: Mapping[str, Any]) -> tuple[TriangleMesh, BuiltinScene | None]:
    """The mesh of the MODEL, or of the built-in scene, and in that case its entry in the table."""
    from wrt.mesh import TriangleMesh
    from wrt.scenes import BUILTIN_SCENES, build

    options = _scene_options(given["options"], given["level"])
    if given["model"] is not None:
        if given["scene"] is not None or options:
            raise click.UsageError("--scene, --level and --option choose a built-in scene: leave them out, or leave MODEL out")
        return TriangleMesh.load(given["model"]), None
    name = given["scene"] or DEFAULT_SCENE
    if name not in BUILTIN_SCENES:
        raise click.BadParameter(f"{name!r} is unknown; choose from {', '.join(BUILTIN_SCENES)}", param_hint="--scene")
    try:
        return build(name, **options), BUILTIN_SCENES[name]
    except (TypeError, ValueError) as error:
        raise click.UsageError(str(error)) from None


def _scene_options(pairs: tuple[str, ...], level: int | None) -> dict[str, Any]:
    """Options KEY=VALUE; values are Python literals (16, 0.5, (6, 3)), true, false, or else strings."""
    options: dict[str, Any] = {} if level is None else {"level": level}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals or not key.isidentifier():
            raise click.BadParameter(f"{pair!r} is not KEY=VALUE", param_hint="--option")
        try:
            options[key] = {"true": True, "false": False}[text] if text in ("true", "false") else ast.literal_eval(text)
        except (ValueError, SyntaxError):
            options[key] = text
    return options


def _make_scene(geometry: Any, given: Mapping[str, Any]) -> Scene:
    from wrt.accelerator import resolve_accelerator
    from wrt.scene import Scene

    try:
        accelerator = resolve_accelerator(given["accelerator"])
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--accelerator") from None
    return Scene(geometry, accelerator, device=given["device"], num_threads=given["threads"])


def _camera(mesh: TriangleMesh, builtin: BuiltinScene | None, up: tuple[float, ...], given: Mapping[str, Any]) -> PinholeCamera:
    """The scene's camera, or one that frames the model, with what was given in place of its own."""
    from wrt.camera import PinholeCamera

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
    """No limit outdoors. Where the camera stands inside the scene's box all would be dark: a tenth of its diagonal."""
    low, high = scene.bounds
    inside = ((low < camera.position) & (camera.position < high)).all()
    return 0.1 * float(((high - low) ** 2).sum() ** 0.5) if inside else None


def _up_of_file(path: Path) -> tuple[float, ...]:
    """Model formats of computer graphics have y up by custom (glTF by its standard), those of engineering z."""
    return UP_NAMES["y" if path.suffix.lower() in Y_UP_FORMATS else "z"]


def _ground(mesh: TriangleMesh, up: tuple[float, ...]) -> TriangleMesh:
    """A square across `up` under the mesh."""
    import numpy as np

    from wrt.mesh import TriangleMesh

    upward = np.array(up) / np.linalg.norm(up)
    across = np.cross(upward, np.eye(3)[np.argmin(np.abs(upward))])
    across /= np.linalg.norm(across)
    along = np.cross(upward, across)
    center = mesh.center + upward * ((mesh.vertices - mesh.center) @ upward).min()
    half = GROUND_SIZE / 2 * (mesh.extent or 1.0)
    corners = [center + half * (x * across + y * along) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return TriangleMesh(np.array(corners), np.array([[0, 1, 2], [0, 2, 3]]), name="ground")


# -- tables ------------------------------------------------------------------------------------------------------------


def _all_tables() -> dict[str, list[dict[str, Any]]]:
    from wrt.builders.kdtree import KDTREE_BUILDERS
    from wrt.kernels.traversal import TRAVERSALS
    from wrt.kernels.triangle import TRIANGLE_TESTS
    from wrt.scenes import BUILTIN_SCENES

    tests = ("name", "paper", "watertight", "two_sided", "needs_shared_origin")
    builders = {"kd-tree builders": KDTREE_BUILDERS}
    if _is_there("wrt.builders.bvh"):
        builders["BVH builders"] = import_module("wrt.builders.bvh").BVH_BUILDERS
    return {
        **{title: _rows(table, ("name", "paper")) for title, table in builders.items()},
        "traversals": _rows(TRAVERSALS, ("name", "tree", "paper")),
        "triangle tests": _rows(TRIANGLE_TESTS, tests),
        "built-in scenes": _rows(BUILTIN_SCENES, ("name", "description", "options")),
    }


def _rows(table: Mapping[str, Any], columns: tuple[str, ...]) -> list[dict[str, Any]]:
    values = ({column: getattr(entry, column) for column in columns} for entry in table.values())
    return [{k: dict(v) if isinstance(v, Mapping) else v for k, v in row.items()} for row in values]


def _figures(title: str, values: Any) -> Table:
    """Names and values; dicts within dicts become names with a dot. A single value is a table of its own."""
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold", show_header=False)
    pending = list(values.items()) if isinstance(values, Mapping) else [(title, values)]
    while pending:
        name, value = pending.pop(0)
        if isinstance(value, Mapping):
            pending[:0] = [(f"{name}.{key}", inner) for key, inner in value.items()]
        else:
            table.add_row(str(name).replace("_", " "), _text(value))
    return table


def _histogram(title: str, counts: list[float]) -> Table:
    """Counts of 0, 1, 2 ... with a bar each; neighbours are added up where there are too many."""
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold", show_header=False)
    step = -(-len(counts) // HISTOGRAM_ROWS) or 1
    sums = {first: sum(counts[first : first + step]) for first in range(0, len(counts), step)}
    largest = max(sums.values(), default=0) or 1
    for first, total in sums.items():
        last = min(first + step, len(counts)) - 1
        label = str(first) if first == last else f"{first} - {last}"
        table.add_row(label, _text(total), "\u2588" * round(HISTOGRAM_WIDTH * total / largest))
    return table


def _text(value: Any) -> str:
    """A value as people read it."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}={inner}" for key, inner in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(f"({_text(item)})" if isinstance(item, (list, tuple)) else _text(item) for item in value)
    return str(value)


def _print_tables(tables: Any) -> None:
    from rich.console import Console

    console = Console() if sys.stdout.isatty() else Console(width=140)
    for table in tables:
        console.print(table)


# -- the process -------------------------------------------------------------------------------------------------------


def _check_name(argument: str, name: str) -> str:
    """An entry of the table of that argument, or "auto"."""
    from wrt.kernels.traversal import TRAVERSALS
    from wrt.kernels.triangle import TRIANGLE_TESTS

    table = {"triangle_test": TRIANGLE_TESTS, "traversal": TRAVERSALS}[argument]
    if name != "auto" and name not in table:
        option = "--" + argument.replace("_", "-")
        raise click.BadParameter(f"{name!r} is unknown; choose from auto, {', '.join(table)}", param_hint=option)
    return name


def _start_warp(device: str | None) -> None:
    """Starts Warp without its log lines, its native library's remark that there is no CUDA included; checks the device."""
    import warp

    warp.config.log_level = max(warp.config.log_level, warp.LOG_WARNING)
    sys.stderr.flush()
    saved = os.dup(2)
    null = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 2)
        warp.init()
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(null)
    names = [known.alias for known in warp.get_devices()]
    if device is not None and device not in (*names, "cuda" if len(names) > 1 else "cpu"):
        raise click.BadParameter(f"{device!r} is not there; choose from {', '.join(names)}", param_hint="--device")


@contextmanager
def _progress(title: str) -> Iterator[Callable[[int, int], None] | None]:
    """A bar on stderr, if that is a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _fail(message: str, status: int) -> None:
    line = " ".join(str(message).split())
    print(f"error: {line}", file=sys.stderr)
    sys.exit(status)

"""Parts shared by the commands: arguments, loading of meshes and scenes, Warp's initialisation, progress bars."""

from __future__ import annotations

import ast
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wrt.cli.number_types import LARGEST, Whole

if TYPE_CHECKING:
    from wrt.meshes.mesh import TriangleMesh
    from wrt.scene.scene import Scene
    from wrt.scenes import BuiltinScene

DEFAULT_SCENE = "teapot"
WORDS = {"true": True, "false": False, "nan": float("nan"), "inf": float("inf"), "-inf": float("-inf")}
"""Values of options of scenes that are no literals of Python; scenes refuse those that they cannot be made with."""

UP_NAMES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


class Vector(click.ParamType):
    """A vector x,y,z."""

    name = "x,y,z"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        if isinstance(value, tuple):
            return value
        try:
            numbers = tuple(float(part) for part in value.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != 3 or not all(abs(x) <= LARGEST for x in numbers):
            self.fail(f"{value!r} is not three numbers x,y,z", param, ctx)
        return numbers


class UpDirection(Vector):
    """x, y, z, -x, -y, -z, or a vector."""

    name = "axis"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        if isinstance(value, str) and value.lstrip("+-") in UP_NAMES:
            sign = -1.0 if value.startswith("-") else 1.0
            return tuple(sign * x + 0.0 for x in UP_NAMES[value.lstrip("+-")])
        return super().convert(value, param, ctx)


def _set_target(ctx: click.Context, param: click.Parameter, value: Any) -> None:
    from wrt.kernels.compilation.target import choose

    try:
        choose(**{{"target": "target", "lanes": "width"}[param.name]: value})
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


def target_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options for the target of CPU kernels (`wrt.kernels.compilation.target`); set while arguments are parsed, before Warp
    starts."""
    shared: dict[str, Any] = {"expose_value": False, "is_eager": True, "callback": _set_target}
    name = "native, x86-64-v3 (AVX2), x86-64-v4 (AVX-512), neoverse-n1 or neoverse-v2 (ARM). [WRT_TARGET, or native]"
    lanes = "Lanes of CPU kernels: 4, 8 or 16. [WRT_WIDTH, or the target's]"
    command = click.option("--lanes", type=Whole(), help=lanes, **shared)(command)
    return click.option("--target", help=f"CPU to compile for: {name}", **shared)(command)


def model_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """An argument for the mesh to load, and options for the scene."""
    return click.argument("model", required=False, type=click.Path(path_type=Path))(scene_options(command))


def scene_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options for the scene."""
    for option in reversed(
        (
            click.option("--scene", help=f"Built-in scene, if no MODEL is given; see `wrt list`. [{DEFAULT_SCENE}]"),
            click.option("--level", type=Whole(1), help="Tessellation level of the teapot, the same as --option level=N."),
            click.option(
                "--option", "options", multiple=True, metavar="KEY=VALUE", help="Option of the scene; may be repeated."
            ),
            click.option("--accelerator", default="auto", show_default=True, help="auto, bvh or kdtree."),
            click.option("--device", help="cpu, cuda:0, ...  [Warp's default]"),
            click.option("--threads", type=Whole(1, 1024), help="CPU threads. [all cores]"),
            target_options,
        )
    ):
        command = option(command)
    return command


def load_mesh(given: Mapping[str, Any], materials: bool = False) -> tuple[TriangleMesh, BuiltinScene | None]:
    """The mesh of MODEL, with its materials if asked to, or that of the built-in scene and its entry in the table."""
    from wrt.meshes.mesh import TriangleMesh
    from wrt.scenes import BUILTIN_SCENES, build

    options = _scene_options(given["options"], given["level"])
    if given["model"] is not None:
        if given["scene"] is not None or options:
            raise click.UsageError("--scene, --level and --option choose a built-in scene: leave them out, or leave MODEL out")
        check_file(given["model"])
        with busy(f"reading {given['model']}"):
            return TriangleMesh.load(given["model"], materials=materials), None
    name = DEFAULT_SCENE if given["scene"] is None else given["scene"]
    if name not in BUILTIN_SCENES:
        raise click.BadParameter(f"{name!r} is unknown; choose from {', '.join(BUILTIN_SCENES)}", param_hint="--scene")
    try:
        return build(name, **options), BUILTIN_SCENES[name]
    except (TypeError, ValueError) as error:
        raise click.UsageError(str(error)) from None


def check_file(path: Path) -> None:
    """Refuses what is no file: to read from a pipe or a device might never end.

    Raises:
        ValueError: a folder, a pipe, a socket or a device.
    """
    if path.exists() and not path.is_file():
        what = "a folder" if path.is_dir() else "a pipe, a socket or a device"
        raise ValueError(f"no mesh file at '{path}', but {what}; name a file, such as model.ply")


def _scene_options(pairs: tuple[str, ...], level: int | None) -> dict[str, Any]:
    """Parses options KEY=VALUE; values are Python literals (16, 0.5, (6, 3)), `WORDS`, or else strings."""
    options: dict[str, Any] = {} if level is None else {"level": level}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals or not key.isidentifier():
            raise click.BadParameter(f"{pair!r} is not KEY=VALUE", param_hint="--option")
        try:
            options[key] = WORDS[text] if text in WORDS else ast.literal_eval(text)
        except (ValueError, SyntaxError):
            options[key] = text
        except (RecursionError, MemoryError, TypeError):
            raise click.BadParameter(f"{key} is not a value: {text[:40]!r} ...", param_hint="--option") from None
    return options


def expect_build(given: Mapping[str, Any]) -> None:
    """Begins to compile what builds a scene, while its mesh is being read."""
    import numpy as np
    import warp as wp

    from wrt.accelerators.accelerator import resolve_accelerator
    from wrt.engine.launch.expected_kernels import MANY_TRIANGLES, build_kernels
    from wrt.kernels.runtime.launch import expect, use_threads

    with use_threads(given["threads"]), suppress(ValueError):  # `make_scene` says what is wrong with a name
        accelerator, device = resolve_accelerator(given["accelerator"]), wp.get_device(given["device"])
        expect(build_kernels(accelerator, device, np.float64, 2 * MANY_TRIANGLES), wp.get_device("cpu"))


def make_scene(geometry: Any, given: Mapping[str, Any], triangle_test: str = "auto") -> Scene:
    """The scene, with the requested accelerator, device and number of threads."""
    from wrt.accelerators.accelerator import resolve_accelerator
    from wrt.scene.scene import Scene

    try:
        accelerator = resolve_accelerator(given["accelerator"])
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--accelerator") from None
    with busy("building the tree"):
        return Scene(geometry, accelerator, triangle_test=triangle_test, device=given["device"], num_threads=given["threads"])


def check_name(argument: str, name: str) -> str:
    """Checks that a name is "auto" or an entry of the argument's table."""
    from wrt.kernels.traversal import TRAVERSALS
    from wrt.kernels.triangle import TRIANGLE_TESTS

    tables: dict[str, Mapping[str, Any]] = {"triangle_test": TRIANGLE_TESTS, "traversal": TRAVERSALS}
    table = tables[argument]
    if name != "auto" and name not in table:
        option = "--" + argument.replace("_", "-")
        raise click.BadParameter(f"{name!r} is unknown; choose from auto, {', '.join(table)}", param_hint=option)
    return name


def start_warp(device: str | None, *, compiles_later: bool = True) -> None:
    """Initialises Warp without its log lines; checks the device, and begins what compiling for it waits for.

    Args:
        device: the name of a device; None for Warp's default.
        compiles_later: whether kernels may be compiled later (`wrt.kernels.compilation.compile_later`): not where "auto" is
            measured, or all kernels are wanted.
    """
    import warp

    import wrt.kernels.runtime.options  # noqa: F401 (chooses the target, for whose flags the header is)
    from wrt.kernels.compilation import compile_later
    from wrt.kernels.compilation.kernel_cache import init_warp
    from wrt.kernels.compilation.module_compiler import expect_header

    if not compiles_later:
        os.environ[compile_later.VARIABLE] = "0"
    warp.config.log_level = max(warp.config.log_level, warp.LOG_WARNING)
    init_warp()
    names = [known.alias for known in warp.get_devices()]
    if device is not None and device not in (*names, "cuda" if len(names) > 1 else "cpu"):
        raise click.BadParameter(f"device {device!r} does not exist; choose from {', '.join(names)}", param_hint="--device")
    expect_header(warp.get_device(device))


@contextmanager
def progress(title: str) -> Iterator[Callable[[int, int], None] | None]:
    """A progress bar on stderr, if that is a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    from wrt.kernels.compilation import compile_progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=None)
        with compile_progress.report_to(lambda text: bar.update(task, description=title if text is None else text)):
            yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def sample_progress(title: str, rendering: Any) -> Iterator[Callable[[int, int], None] | None]:
    """A progress bar on stderr, if that is a terminal, with the noise of the picture so far and the time left.

    The noise is the mean standard error of the pixels over their mean brightness.
    """
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[samples]}"),
        TextColumn("{task.fields[noise]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=None, samples="", noise="")
        shown = 0

        def show(done: int, total: int) -> None:
            nonlocal shown
            fields: dict[str, Any] = {"samples": f"{rendering.done}/{rendering.samples} samples"}
            if rendering.done >= 2 and rendering.done >= 1.25 * shown:
                shown, brightness = rendering.done, float(rendering.linear.mean())
                fields["noise"] = f"noise {float(rendering.noise.mean()) / max(brightness, 1e-30):.1%}"
            bar.update(task, completed=done, total=total, **fields)

        yield show


@contextmanager
def busy(title: str) -> Iterator[None]:
    """A spinner on stderr, if that is a terminal, for work of unknown length."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    from wrt.kernels.compilation import compile_progress

    with (
        Console(stderr=True).status(title) as status,
        compile_progress.report_to(lambda text: status.update(title if text is None else text)),
    ):
        yield

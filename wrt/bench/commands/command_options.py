"""What the commands of the benchmark share: options, models by name, errors, what is under way, and where figures go."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from wrt.atomic_files import write_text
from wrt.cli.arguments import check_file
from wrt.cli.number_types import Whole
from wrt.kernels.runtime.launch import MAX_THREADS
from wrt.meshes.mesh import TriangleMesh

if TYPE_CHECKING:
    from rich.console import Console
    from rich.status import Status

LINE_SECONDS = 10.0
"""Seconds between lines about progress where stderr is no terminal."""

SCENE_OPTIONS = {"teapot": {"level": 32, "ground": False}}
"""Where a scene's defaults do not suit: the teapot's ground would fill every view."""


class FigureFile(click.Path):
    """A file that is written at the end, in a folder that is there at the start."""

    def __init__(self) -> None:
        super().__init__(dir_okay=False, writable=True, path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path."""
        path = Path(str(super().convert(value, param, ctx)))
        if not path.parent.is_dir():
            self.fail(f"there is no folder '{path.parent}' to write '{path.name}' to; create it first", param, ctx)
        return path


threads_option = click.option("--threads", type=Whole(1, MAX_THREADS), help="CPU threads. [all cores]")
json_option = click.option("--json", "json_file", type=FigureFile(), help="Write all figures.")
plot_option = click.option("--plot", "plot_file", type=FigureFile(), help="Write a picture.")


def load_model(name: str) -> TriangleMesh:
    """A mesh file, or a built-in scene by its name."""
    from wrt import scenes

    try:
        if name in scenes.BUILTIN_SCENES and not Path(name).is_file():
            mesh = scenes.build(name, **SCENE_OPTIONS.get(name, {}))
            return TriangleMesh(mesh.vertices, mesh.faces, name=name)
        check_file(Path(name))
        return TriangleMesh.load(name)
    except (FileNotFoundError, ValueError) as error:
        raise click.BadParameter(
            f"{error}; built-in scenes are {', '.join(scenes.BUILTIN_SCENES)}", param_hint="MODEL"
        ) from None


@contextmanager
def usage_errors() -> Iterator[None]:
    """Values that turn out to be wrong, and files that cannot be written, as errors of the command line."""
    try:
        yield
    except (ValueError, OSError) as error:
        raise click.ClickException(str(error)) from error


def table_console(width: int = 180) -> Console:
    """Where tables are printed: as wide as the terminal, or where there is none, so wide that no figure is cut off."""
    from rich.console import Console

    console = Console()
    return console if console.is_terminal else Console(width=width)


def write_json(path: Path | None, figures: dict[str, Any]) -> None:
    """Writes plain data to a file, if one was asked for."""
    if path is not None:
        with usage_errors():
            write_text(path, json.dumps(figures, indent=1) + "\n")


class Steps:
    """Says on stderr what is under way: the latest step at a terminal, and elsewhere a line every `LINE_SECONDS`.

    Args:
        status: what shows it at a terminal; None elsewhere.
    """

    def __init__(self, status: Status | None = None) -> None:
        self._status, self._said = status, -inf

    def __call__(self, name: str) -> None:
        """Begins a step."""
        text = f"bench: {name}"
        if self._status is not None:
            self._status.update(text)
        elif time.monotonic() - self._said >= LINE_SECONDS:
            self._said = time.monotonic()
            click.echo(text, err=True)

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Shows nothing inside the `with` block, in which tables are printed."""
        if self._status is not None:
            self._status.stop()
        try:
            yield
        finally:
            if self._status is not None:
                self._status.start()


@contextmanager
def progress() -> Iterator[Steps]:
    """What to call with the name of each step."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield Steps()
        return
    with console.status("bench") as status:
        yield Steps(status)


@contextmanager
def progress_bar(steps: int) -> Iterator[Callable[[str], None]]:
    """What to call with the name of each of this many steps when it begins: a bar on stderr if that is a terminal."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    if not console.is_terminal:
        yield Steps()
        return
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task("bench", total=steps)
        begun = count()
        yield lambda name: bar.update(task, description=f"bench: {name}", completed=next(begun))

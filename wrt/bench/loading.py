"""What the commands of the benchmark share: models by name, errors of the command line, and what is under way."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import click

from wrt.mesh import TriangleMesh

SCENE_OPTIONS = {"teapot": {"level": 32, "ground": False}}
"""Where a scene's defaults do not suit: the teapot's ground would fill every view."""


def load_model(name: str) -> TriangleMesh:
    """A mesh file, or a built-in scene by its name."""
    from wrt import scenes

    try:
        if name in scenes.BUILTIN_SCENES and not Path(name).is_file():
            mesh = scenes.build(name, **SCENE_OPTIONS.get(name, {}))
            return TriangleMesh(mesh.vertices, mesh.faces, name=name)
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


@contextmanager
def progress() -> Iterator[Callable[[str], None]]:
    """What to call with the name of each step: shown on stderr if that is a terminal."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda name: None
        return
    with console.status("bench") as status:
        yield lambda name: status.update(f"bench: {name}")


@contextmanager
def progress_bar(steps: int) -> Iterator[Callable[[str], None]]:
    """What to call with the name of each of so many steps when it begins: a bar on stderr if that is a terminal."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda name: None
        return
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task("bench", total=steps)
        begun = count()
        yield lambda name: bar.update(task, description=f"bench: {name}", completed=next(begun))

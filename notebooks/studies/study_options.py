"""What commands of studies share: options, and tables with a title."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import click

from wrt.bench.commands.command_options import json_option
from wrt.cli.arguments import target_options
from wrt.cli.number_types import Whole
from wrt.kernels.runtime.launch import MAX_THREADS, get_num_threads
from wrt.meshes.mesh import TriangleMesh

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

Decorator = Callable[..., Any]


def model_argument(default: str) -> Decorator:
    """MODEL: a mesh file or a built-in scene."""
    return click.argument("model", default=default)


def number(name: str, default: int, text: str, *limits: int) -> Decorator:
    """An option that is a whole number; limits: the least one, 1 if none is given, and the greatest one."""
    return click.option(name, default=default, show_default=True, type=Whole(*(limits or (1,))), help=text)


def several(name: str, to: str, choices: Iterable[str], text: str = "Repeat. [all]") -> Decorator:
    """An option that can be repeated, of these choices; `to`: the parameter."""
    return click.option(name, to, multiple=True, type=click.Choice([*choices]), help=text)


def resolve(ctx: click.Context, param: click.Parameter, value: int | None) -> int:
    """The number of threads that is meant."""
    return value or get_num_threads()


threads_option = click.option("--threads", type=Whole(1, MAX_THREADS), callback=resolve, help="CPU threads. [all cores]")


def study(name: str) -> Callable[[Callable[..., None]], click.Command]:
    """A command with its own options, between those for the target of CPU kernels, and --threads and --json."""
    return lambda run: json_option(threads_option(click.command(name)(target_options(run))))


def described(mesh: TriangleMesh, threads: int) -> str:
    """What was measured, and by how many threads."""
    return f"{mesh.name or 'mesh'}, {mesh.triangle_count:,} triangles, {threads} threads"


def show(console: Console, title: str, table: Table, note: str = "") -> None:
    """Prints a table below its title, and a note below that."""
    console.print(f"[bold]{title}[/bold]", highlight=False)
    console.print(table)
    if note:
        console.print(note, style="dim", highlight=False)

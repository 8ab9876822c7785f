"""`wrt info` and `wrt list`: statistics and lists as tables, or as JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import click

from wrt.cli.arguments import load_mesh, make_scene, model_options, start_warp
from wrt.cli.cloud_models import is_cloud, load_cloud

if TYPE_CHECKING:
    from rich.table import Table

HISTOGRAM_ROWS, HISTOGRAM_WIDTH = 24, 40


@click.command()
@model_options
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object instead of tables.")
def info(as_json: bool, **given: Any) -> None:
    """Shows statistics of MODEL (or of a built-in scene), of its tree, and what its kernels are compiled for.

    Of a file of points (.pcd, .las, .laz, .xyz, KITTI's .bin, and .ply without faces), those of the points and their spacing.
    """
    start_warp(given["device"])
    if is_cloud(given["model"]):
        figures: dict[str, Any] = {"points": load_cloud(given["model"], given).summary()}
    else:
        mesh, _ = load_mesh(given)
        figures = {"model": mesh.summary(), **make_scene(mesh, given).statistics().to_dict()}
    result = {**figures, "CPU": _cpu(), "kernels": _kernels()}
    if as_json:
        click.echo(json.dumps(result, indent=1))
        return
    _print_tables(_histogram(title, v) if isinstance(v, list) else _figures(title, v) for title, v in result.items())


def _cpu() -> dict[str, Any]:
    """This CPU, and the target of its kernels."""
    from wrt.kernels.compilation.cores import available_cores
    from wrt.kernels.compilation.host_cpu import cpu_name
    from wrt.kernels.compilation.target import lane_width, simd_bits, target_name
    from wrt.kernels.runtime import pool

    helpers = "native" if pool.is_available() else "Python (native ones need Linux)"
    found = {"name": cpu_name(), "threads": available_cores(), "helper threads": helpers}
    return {**found, "target": target_name(), "SIMD bits": simd_bits(), "lanes": lane_width()}


def _kernels() -> dict[str, Any]:
    """Where compiled kernels are."""
    import warp

    from wrt.kernels.compilation import kernel_cache, shipped_kernels

    modules, size = kernel_cache.folder_size()
    shipped = ", ".join(shipped_kernels.targets()) or "none that fit"
    return {"cache": str(warp.config.kernel_cache_dir), "modules": modules, "bytes": size, "shipped": shipped}


@click.command("list")
@click.argument("words", nargs=-1, metavar="[WORD]...")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object instead of tables.")
def list_tables(words: tuple[str, ...], as_json: bool) -> None:
    """Lists every algorithm with its paper, and the built-in scenes.

    With WORDs, only those that have all of them in their names, papers, authors, years or the titles of their tables. Capitals
    and accents do not matter. The exit status is 1 if there are none.
    """
    from wrt.cli.catalogue import all_tables, with_words

    tables = with_words(all_tables(), words)
    if not tables:
        raise click.ClickException(
            f"nothing has {' and '.join(map(repr, words))} in it; wrt list without words lists everything"
        )
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


def _figures(title: str, values: Any) -> Table:
    """A table of names and values; keys of nested dicts are joined by dots. A single value becomes a table of its own."""
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
    """A table of the counts of 0, 1, 2 ... with a bar each; neighbouring rows are added up where there are too many."""
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
    """A value, formatted for a table."""
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


def _print_tables(tables: Iterable[Table]) -> None:
    from rich.console import Console

    console = Console() if sys.stdout.isatty() else Console(width=140)
    for table in tables:
        console.print(table)

"""`wrt bench build-sizes`: the time of a build by the number of triangles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from wrt.bench.commands.command_options import json_option, progress, table_console, threads_option, usage_errors, write_json
from wrt.bench.core.benchmark_results import machine
from wrt.bench.peers.peer_table import make_peers
from wrt.bench.studies.build_sizes import SIZES, SizeFigures, measure_sizes
from wrt.cli.arguments import target_options
from wrt.kernels.runtime.launch import get_num_threads

BUILDING = ("embree", "open3d", "embreex", "warp_mesh")
"""Peers whose builds are timed, all that are found unless some are asked for."""


@click.command("build-sizes")
@target_options
@click.option("--triangles", "sizes", multiple=True, type=click.IntRange(2), help="Of a sheet; repeat. [1,000 to 3,000,000]")
@click.option("--peer", "names", multiple=True, type=click.Choice([*BUILDING, "embree3", "embree4"]), help="Repeat. [all]")
@click.option("--rounds", default=7, show_default=True, type=click.IntRange(1), help="Turns of each contender.")
@threads_option
@json_option
def build_sizes_command(
    sizes: tuple[int, ...], names: tuple[str, ...], rounds: int, threads: int | None, json_file: Path | None
) -> None:
    """Builds sheets of a thousand to millions of triangles, until the first ray is answered, beside the peers."""
    count = threads or get_num_threads()

    def make() -> list[Any]:
        return make_peers(names or BUILDING, count, "cpu")[0]

    missing = make_peers(names or BUILDING, count, "cpu")[1]
    with progress() as on_turn, usage_errors():
        figures = measure_sizes(make, sizes or SIZES, rounds, on_turn)
    print_sizes(figures, count, table_console(140))
    for name, reason in missing.items():
        click.echo(f"left out: {name} ({reason})")
    write_json(json_file, {"machine": machine("cpu"), "threads": count, "sizes": [asdict(row) for row in figures]})


def print_sizes(figures: Sequence[SizeFigures], threads: int, console: Any) -> None:
    """A line a size, a column a contender."""
    from wrt.bench.core.benchmark_report import new_table, times

    names = [*figures[0].seconds]
    table = new_table((), ("triangles", *names))
    for row in figures:
        cells = [f"{row.seconds[name] * 1e3:.3g} ({times(row.ratios[name])})" if name in row.seconds else "-" for name in names]
        table.add_row(f"{row.triangles:,}", *cells)
    console.print(f"[bold]Build by size, {threads} thread{'s' * (threads > 1)}, ms (time / wrt)[/bold]", highlight=False)
    console.print(table)

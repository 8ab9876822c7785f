"""`wrt bench scaling`: queries and builds by the number of threads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from itertools import groupby
from pathlib import Path

import click

from wrt.bench.commands.command_options import (
    json_option,
    load_model,
    plot_option,
    progress,
    table_console,
    threads_option,
    usage_errors,
    write_json,
)
from wrt.bench.comparisons.thread_scaling import JobFigures, measure_scaling, powers_of_two
from wrt.bench.core.benchmark_plot import save_figure
from wrt.bench.core.benchmark_results import machine
from wrt.bench.peers.embree import Embree
from wrt.bench.peers.embree_library import EMBREES
from wrt.cli.number_types import Whole
from wrt.kernels.runtime.launch import get_num_threads


@click.command("scaling")
@click.argument("model", default="teapot")
@click.option("--rounds", default=7, show_default=True, type=Whole(1), help="Rounds per number of threads.")
@plot_option
@click.option("--embree/--no-embree", default=True, show_default=True, help="Time Embree 3 and 4 too, where found.")
@threads_option
@json_option
def scaling_command(
    model: str, rounds: int, plot_file: Path | None, embree: bool, threads: int | None, json_file: Path | None
) -> None:
    """Times queries and builds of MODEL, a mesh file or a built-in scene, with 1, 2, 4 ... threads.

    Embree answers the same rays in turn with wrt, in chunks of the same pool of threads, and builds with as many threads of its
    own.
    """
    from wrt.bench.core.benchmark_plot import matplotlib_missing

    if plot_file is not None and (reason := matplotlib_missing()) is not None:
        raise click.UsageError(reason)
    mesh, max_threads = load_model(model), threads or get_num_threads()
    peers = [Embree(1, version) for version in EMBREES] if embree else []
    missing = {peer.name: reason for peer in peers if (reason := peer.available()) is not None}
    found = [peer.version.number for peer in peers if peer.name not in missing]
    with progress() as on_turn, usage_errors():
        figures = measure_scaling(mesh, powers_of_two(max_threads), rounds, found, on_turn)
    print_figures(f"threads: {mesh.name or 'mesh'}, {mesh.triangle_count:,} triangles", figures)
    for name, reason in missing.items():
        click.echo(f"{name}: {reason}")
    write_json(json_file, {"machine": machine("cpu"), "jobs": [asdict(row) for row in figures]})
    if plot_file is not None:
        with usage_errors():
            save_scaling_plot(figures, plot_file)


def print_figures(title: str, figures: Sequence[JobFigures]) -> None:
    """A table with a line a job and a column a contender; more lines for each peer, its ratio to wrt and the least ratio."""
    from wrt.bench.core.benchmark_report import new_table, times

    table = new_table(("job", "engine", "unit"), tuple(figures[0].names))
    for _, rows in groupby(figures, key=lambda row: row.job):
        own, *peers = rows
        for row in (own, *peers):
            cells = [f"{figure:.1f} ({gain:.2f}x)" for figure, gain in zip(row.figures, row.gains, strict=True)]
            table.add_row(row.job, row.engine, row.unit, *cells)
            if row.ratios:
                table.add_row("", f"{row.engine} / wrt", "time", *map(times, row.ratios))
        if len(peers) > 1:
            table.add_row("", "fastest / wrt", "time", *map(times, own.least_ratios))
    console = table_console()
    console.print(f"[bold]{title}[/bold]", highlight=False)
    console.print(table)
    note = f"In brackets: speed over that with {figures[0].names[0]}."
    if any(row.ratios for row in figures):
        note += " Ratios above 1x: wrt is faster."
    console.print(note, style="dim", highlight=False)


def save_scaling_plot(figures: Sequence[JobFigures], path: Path) -> None:
    """Speed over one thread against the number of threads, a line a job; those of peers are dotted."""
    from matplotlib.figure import Figure

    counts = [int(name.split()[0]) for name in figures[0].names]
    figure = Figure(figsize=(6.4, 4.8), layout="constrained")
    axes = figure.subplots()
    axes.plot(counts, counts, color="0.7", linestyle="--", label="linear")
    for row in figures:
        line, label = ("-", row.job) if row.engine == "wrt" else (":", f"{row.job}, {row.engine}")
        axes.plot(counts, row.gains, line, marker="o", label=label)
    axes.set_xscale("log", base=2)
    axes.set_yscale("log", base=2)
    axes.set_xticks(counts, [str(count) for count in counts])
    axes.set_yticks(counts, [str(count) for count in counts])
    axes.set_xlabel("threads")
    axes.set_ylabel("speed, one thread = 1")
    axes.legend()
    save_figure(figure, path)

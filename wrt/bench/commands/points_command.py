"""`wrt bench points`: closest points beside other libraries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import click

from wrt.bench.commands.command_options import (
    json_option,
    load_model,
    progress,
    table_console,
    threads_option,
    usage_errors,
    write_json,
)
from wrt.bench.comparisons.pair_comparison import PairRow, compare_pairs
from wrt.bench.comparisons.point_comparison import POINT_PEERS, PointRow, compare_points, missing_peers
from wrt.bench.core.benchmark_results import machine
from wrt.cli.number_types import Whole
from wrt.kernels.runtime.launch import get_num_threads

PAIRS = "fcl"
"""The peer that is asked about two bodies and more, and not about points."""


@click.command("points")
@click.argument("model", default="teapot")
@click.option(
    "--peer", "peers", multiple=True, type=click.Choice([*POINT_PEERS, PAIRS]), help="Others to compare with; repeatable. [all]"
)
@click.option("--points", "count", default=100_000, show_default=True, type=Whole(1), help="Points of each set.")
@click.option("--rounds", default=5, show_default=True, type=Whole(1), help="Rounds per contender.")
@threads_option
@json_option
def points_command(
    model: str, peers: tuple[str, ...], count: int, rounds: int, threads: int | None, json_file: Path | None
) -> None:
    """Times `Scene.closest_point` on MODEL, a mesh file or a built-in scene, beside the libraries that are installed.

    Points are uniform in the box of the mesh, and near its surface: on its triangles, moved by half a percent of the diagonal.
    Contenders take turns. FCPW and libigl use all cores, whatever --threads says; wp.Mesh and trimesh use one.

    "fcl" compares distances and collisions of bodies instead, on one thread: copies of the mesh, turned at random. Two of them
    are apart or meet in many triangles, and of 64 the nearest two are found.
    """
    mesh, names = load_model(model), peers or (*POINT_PEERS, PAIRS)
    missing, max_threads = missing_peers(names), threads or get_num_threads()
    with progress() as on_turn, usage_errors():
        chosen = [name for name in names if name not in missing and name != PAIRS]
        rows = list(compare_points(mesh, chosen, count, rounds, max_threads, on_turn))
        pairs = list(compare_pairs(mesh, rounds, on_turn)) if PAIRS in names and PAIRS not in missing else []
    print_rows(f"points: {mesh.name or 'mesh'}, {mesh.triangle_count:,} triangles", rows)
    if pairs:
        print_pairs(pairs)
    for name, reason in missing.items():
        click.echo(f"{name}: {reason}")
    write_json(
        json_file,
        {
            "machine": machine("cpu"),
            "points": count,
            "rows": [asdict(row) for row in rows],
            "pairs": [asdict(row) for row in pairs],
        },
    )


def print_rows(title: str, rows: Sequence[PointRow]) -> None:
    """A table with a line for each contender and set of points, and what a point visits."""
    from wrt.bench.core.benchmark_report import new_table, times

    table = new_table(("points", "engine"), ("threads", "Mpoints/s", "time / wrt", "same distance"))
    for row in rows:
        if row.error is not None:
            table.add_row(row.points, row.engine, str(row.threads), row.error)
            continue
        ratio = "" if row.ratio is None else times(row.ratio)
        table.add_row(row.points, row.engine, str(row.threads), f"{row.speed:.3f}", ratio, f"{row.agreement:.2%}")
    console = table_console()
    console.print(f"[bold]{title}[/bold]", highlight=False)
    console.print(table)
    for row in rows:
        if row.work is not None:
            nodes, triangles, *minima = row.work.values()
            console.print(
                f"{row.points}: {nodes:.1f} nodes and {triangles:.1f} triangles a point; {minima[0]:.1f} and {minima[1]:.1f} "
                "if its distance were known.",
                style="dim",
                highlight=False,
            )


def print_pairs(rows: Sequence[PairRow]) -> None:
    """A table with a line for each contender and question about bodies."""
    from wrt.bench.core.benchmark_report import new_table, times

    table = new_table(("bodies", "engine"), ("ms", "time / wrt", "answer", "same answer"))
    for row in rows:
        if row.error is not None:
            table.add_row(row.question, row.engine, row.error)
            continue
        ratio = "" if row.ratio is None else times(row.ratio)
        table.add_row(row.question, row.engine, f"{row.seconds * 1e3:.3f}", ratio, f"{row.answer:.6g}", str(row.agrees))
    table_console().print(table)

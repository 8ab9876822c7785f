"""`wrt bench shading`: streams that shade, beside sorting by material and a branch for each hit, generation by generation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from wrt.bench.commands.command_options import json_option, progress, table_console, threads_option, usage_errors, write_json
from wrt.bench.studies.bounces.shading_streams_comparison import (
    STREAM,
    StreamFigures,
    compare_shading,
    scene_of_materials,
)
from wrt.cli.arguments import target_options
from wrt.imaging.cameras import PinholeCamera
from wrt.kernels.runtime.launch import get_num_threads, use_threads

KINDS = ("missed", "diffuse", "mirror", "dielectric", "glossy")
"""What the shares of the figures are of, in their order."""

MOST_BALLS = 255
"""More would be as many materials as the study can number."""


@click.command("shading")
@target_options
@click.option("--size", default=448, show_default=True, type=click.IntRange(8, 2048), help="SIZE x SIZE pixels.")
@click.option("--balls", default=12, show_default=True, type=click.IntRange(1, MOST_BALLS), help="BALLS x BALLS materials.")
@click.option("--depth", default=5, show_default=True, type=click.IntRange(1, 60), help="Generations of rays.")
@click.option("--stream", default=STREAM, show_default=True, type=click.IntRange(1), help="Rays of a stream.")
@click.option("--rounds", default=3, show_default=True, type=click.IntRange(1), help="Turns of each way.")
@threads_option
@json_option
def shading_command(
    size: int, balls: int, depth: int, stream: int, rounds: int, threads: int | None, json_file: Path | None
) -> None:
    """Ways to shade hits of many materials: filter stacks, sorting and branches, one by one and in lanes.

    The scene has a ball for each material, matte, mirrors, glass and glossy ones at random, over a floor.
    """
    count = threads or get_num_threads()
    middle = 0.5 * (balls - 1)
    camera = PinholeCamera(
        size, size, fov=50, position=(middle, -0.42 * balls, 0.5 * balls), look_at=(middle, middle - 1.0, 0), up=(0, 0, 1)
    )
    with progress() as on_turn, usage_errors(), use_threads(count):
        options = {"depth": depth, "stream": stream, "rounds": rounds, "on_turn": on_turn}
        figures = compare_shading(scene_of_materials(balls), camera, **options)
    print_shading(figures, table_console(120))
    write_json(json_file, {"threads": count, "stream": stream, "shading": [asdict(row) for row in figures]})


def print_shading(figures: Sequence[StreamFigures], console: Any) -> None:
    """A table for each generation: a line a way.

    Raises:
        click.ClickException: some answers differ.
    """
    from wrt.bench.core.benchmark_report import new_table

    for generation in dict.fromkeys(row.generation for row in figures):
        rows = [row for row in figures if row.generation == generation]
        shares = ", ".join(f"{share:.0%} {kind}" for kind, share in zip(KINDS, rows[0].shares, strict=True))
        table = new_table(("way",), ("ms", "of them to prepare", f"speed / {rows[0].way}"))
        for row in rows:
            table.add_row(row.way, f"{1e3 * row.seconds:.2f}", f"{1e3 * row.prepared:.2f}", f"{row.ratio:.2f}")
        console.print(f"[bold]generation {generation}, {rows[0].rays} rays:[/bold] {shares}", highlight=False)
        console.print(table)
    if not all(row.same for row in figures):
        raise click.ClickException("some answers differ from those of branches")

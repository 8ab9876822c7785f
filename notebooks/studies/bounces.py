"""Packets by bounce, with the rays of path tracing, and the survey's claims about them; ways to shade hits of many materials:
streams, sorting by material, a branch for each hit, generation by generation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from studies.light.bounce_claims import Verdict, judge
from studies.light.bounce_comparison import WAYS, BounceFigures, compare_bounces
from studies.light.bounce_rays import BOUNCES
from studies.light.shading_streams_comparison import STREAM, StreamFigures, compare_shading, scene_of_materials
from studies.study_options import number, show, study
from wrt.bench.commands.command_options import load_model, progress, table_console, usage_errors, write_json
from wrt.bench.core.benchmark_report import new_table
from wrt.imaging.cameras import PinholeCamera
from wrt.kernels.runtime.launch import use_threads

VALUES = {"megarays": "million rays/s", "boxes": "box tests a ray", "triangles": "triangle tests a ray", "usage": "places used"}
"""Tables that are printed, by field of the figures."""

KINDS = ("missed", "diffuse", "mirror", "dielectric", "glossy")
"""What the shares of the figures are of, in their order."""

MOST_BALLS = 255
"""More would be as many materials as the study can number."""


@study("bounces")
@click.argument("models", nargs=-1)
@number("--size", 256, "One path from SIZE x SIZE pixels.", 8, 512)
@number("--bounces", BOUNCES, "Number of the last bounce.", 1, 60)
@number("--rounds", 3, "Rounds per way.")
def bounces_command(
    models: tuple[str, ...], size: int, bounces: int, rounds: int, threads: int, json_file: Path | None
) -> None:
    """Orders of packets, repacking, omnidirectional packets and two-plane frusta, bounce by bounce, on MODELS [atrium]."""
    figures = []
    with progress() as on_turn, usage_errors():
        for model in models or ("atrium",):
            options = {"size": size, "bounces": bounces, "rounds": rounds, "threads": threads}
            figures += compare_bounces(load_model(model), Path(model).stem, **options, on_turn=on_turn)
    verdicts = judge(figures)
    console = table_console(160)
    print_bounces(figures, console)
    print_verdicts(verdicts, console)
    rows = {"threads": threads, "bounces": [asdict(row) for row in figures], "verdicts": [asdict(row) for row in verdicts]}
    write_json(json_file, rows)


def print_bounces(figures: Sequence[BounceFigures], console: Any) -> None:
    """A table for each model and value: a line a way, a column a bounce."""
    bounces = sorted({row.bounce for row in figures})
    for model in dict.fromkeys(row.model for row in figures):
        for field, what in VALUES.items():
            table = new_table((model,), tuple(str(bounce) for bounce in bounces))
            for way in WAYS:
                cells = {row.bounce: getattr(row, field) for row in figures if (row.model, row.way) == (model, way)}
                table.add_row(way, *(f"{cells[bounce]:.2f}" if bounce in cells else "" for bounce in bounces))
            show(console, f"{what} by bounce", table)
    if not all(row.same for row in figures):
        raise click.ClickException("some hits differ from those of single rays")


def print_verdicts(verdicts: Sequence[Verdict], console: Any) -> None:
    """A line a claim."""
    table = new_table(("claim",), ("paper", "here: median (least to most)", "holds"))
    for row in verdicts:
        table.add_row(row.claim, row.paper, row.found, "yes" if row.holds else "no")
    console.print(table)


@study("shading")
@number("--size", 448, "SIZE x SIZE pixels.", 8, 2048)
@number("--balls", 12, "BALLS x BALLS materials.", 1, MOST_BALLS)
@number("--depth", 5, "Generations of rays.", 1, 60)
@number("--stream", STREAM, "Rays of a stream.")
@number("--rounds", 3, "Rounds per way.")
def shading_command(size: int, balls: int, depth: int, stream: int, rounds: int, threads: int, json_file: Path | None) -> None:
    """Ways to shade hits of many materials: filter stacks, sorting and branches, one by one and in lanes.

    The scene has a ball for each material, matte, mirrors, glass and glossy ones at random, over a floor.
    """
    middle = 0.5 * (balls - 1)
    camera = PinholeCamera(
        size, size, fov=50, position=(middle, -0.42 * balls, 0.5 * balls), look_at=(middle, middle - 1.0, 0), up=(0, 0, 1)
    )
    with progress() as on_turn, usage_errors(), use_threads(threads):
        options = {"depth": depth, "stream": stream, "rounds": rounds, "on_turn": on_turn}
        figures = compare_shading(scene_of_materials(balls), camera, **options)
    print_shading(figures, table_console(120))
    write_json(json_file, {"threads": threads, "stream": stream, "shading": [asdict(row) for row in figures]})


def print_shading(figures: Sequence[StreamFigures], console: Any) -> None:
    """A table for each generation: a line a way.

    Raises:
        click.ClickException: some answers differ.
    """
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

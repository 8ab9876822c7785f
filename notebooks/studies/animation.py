"""`python -m studies animation`: ways to update moving meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import numpy as np

from studies.moving.animation_comparison import ANIMATIONS, REFERENCE, WAYS, Stage, WayFigures, compare_ways
from wrt.bench.commands.command_options import json_option, progress, table_console, threads_option, usage_errors, write_json
from wrt.cli.arguments import target_options
from wrt.cli.number_types import Whole
from wrt.imaging.cameras import PinholeCamera
from wrt.kernels.runtime.launch import get_num_threads
from wrt.scenes.colonnade import atrium


@click.command("animation")
@click.argument("name", default="figure", type=click.Choice([*ANIMATIONS]))
@target_options
@click.option("--way", "ways", multiple=True, type=click.Choice([*WAYS]), help="Repeat. [all]")
@click.option("--frames", default=24, show_default=True, type=Whole(1), help="Frames of a period.")
@click.option("--detail", default=24, show_default=True, type=Whole(3), help="Triangles grow with its square.")
@click.option("--size", default=256, show_default=True, type=Whole(4), help="Trace SIZE x SIZE rays.")
@click.option("--rounds", default=3, show_default=True, type=Whole(1), help="Rounds per way.")
@threads_option
@json_option
def animation_command(
    name: str,
    ways: tuple[str, ...],
    frames: int,
    detail: int,
    size: int,
    rounds: int,
    threads: int | None,
    json_file: Path | None,
) -> None:
    """Follows a cloth or a figure that moves in the atrium in every way that scenes offer: frames a second, and same hits."""
    stage, count = Stage(atrium(), ANIMATIONS[name](frames, detail)), threads or get_num_threads()
    camera = PinholeCamera(size, size, fov=60, position=(-6.0, -3.5, 2.0), look_at=(0.0, 0.0, 1.6), up=(0.0, 0.0, 1.0))
    with progress() as on_turn, usage_errors():
        figures = compare_ways(stage, camera, ways or tuple(WAYS), rounds=rounds, threads=count, on_turn=on_turn)
    print_ways(figures, stage, count, table_console(140))
    write_json(json_file, {"animation": name, "threads": count, "ways": [asdict(row) for row in figures]})


def print_ways(figures: Sequence[WayFigures], stage: Stage, threads: int, console: Any) -> None:
    """The table of ways."""
    from wrt.bench.core.benchmark_report import new_table, times

    table = new_table(("way",), ("frames/s", "as fast", "update ms", "trace ms", "start ms", "same triangle", "same t"))
    speeds = {row.way: row.frames_per_second for row in figures}
    for row in figures:
        ratio = row.frames_per_second / speeds[REFERENCE] if REFERENCE in speeds else None
        means = (1e3 * float(np.mean(seconds)) for seconds in (row.update, row.trace))
        cells = [f"{mean:.2f}" for mean in (*means, 1e3 * row.start)]
        table.add_row(
            row.way, f"{row.frames_per_second:.1f}", times(ratio), *cells, f"{row.same_triangle:.3%}", f"{row.same_bits:.3%}"
        )
    moving, still = len(stage.animation.faces), stage.static.triangle_count
    sizes = f"{moving:,} triangles in {still:,} that stay"
    label = f"{stage.animation.name}: {len(stage.animation)} frames, {sizes}, {threads} threads"
    console.print(f"[bold]{label}[/bold]", highlight=False)
    console.print(table)

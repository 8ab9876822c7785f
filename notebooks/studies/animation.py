"""`python -m studies animation`: ways to update moving meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import numpy as np

from studies.moving.animation_comparison import ANIMATIONS, REFERENCE, WAYS, Stage, WayFigures, compare_ways
from studies.study_options import number, several, show, study
from wrt.bench.commands.command_options import progress, table_console, usage_errors, write_json
from wrt.bench.core.benchmark_report import new_table, times
from wrt.imaging.cameras import PinholeCamera
from wrt.scenes.colonnade import atrium


@study("animation")
@click.argument("name", default="figure", type=click.Choice([*ANIMATIONS]))
@several("--way", "ways", WAYS)
@number("--frames", 24, "Frames of a period.")
@number("--detail", 24, "Triangles grow with its square.", 3)
@number("--size", 256, "Trace SIZE x SIZE rays.", 4)
@number("--rounds", 3, "Rounds per way.")
def animation_command(
    name: str, ways: tuple[str, ...], frames: int, detail: int, size: int, rounds: int, threads: int, json_file: Path | None
) -> None:
    """Follows a cloth or a figure that moves in the atrium in every way that scenes offer: frames a second, and same hits."""
    stage = Stage(atrium(), ANIMATIONS[name](frames, detail))
    camera = PinholeCamera(size, size, fov=60, position=(-6.0, -3.5, 2.0), look_at=(0.0, 0.0, 1.6), up=(0.0, 0.0, 1.0))
    with progress() as on_turn, usage_errors():
        figures = compare_ways(stage, camera, ways or tuple(WAYS), rounds=rounds, threads=threads, on_turn=on_turn)
    print_ways(figures, stage, threads, table_console(140))
    write_json(json_file, {"animation": name, "threads": threads, "ways": [asdict(row) for row in figures]})


def print_ways(figures: Sequence[WayFigures], stage: Stage, threads: int, console: Any) -> None:
    """The table of ways."""
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
    show(console, label, table)

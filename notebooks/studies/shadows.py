"""`python -m studies shadows`: shadow rays to a point light and to an area light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from studies.light.shadow_comparison import SAMPLES, ShadowFigures, compare_shadows
from wrt.bench.commands.command_options import (
    json_option,
    load_model,
    progress,
    table_console,
    threads_option,
    usage_errors,
    write_json,
)
from wrt.cli.arguments import target_options
from wrt.cli.number_types import Real, Whole
from wrt.imaging.cameras import PinholeCamera
from wrt.kernels.layout.light_cells import MAX_RESOLUTION
from wrt.kernels.runtime.launch import get_num_threads
from wrt.meshes.mesh import TriangleMesh
from wrt.scenes import BUILTIN_SCENES
from wrt.shadows.area_light_visibility import MAX_SAMPLES


@click.command("shadows")
@click.argument("model", default="atrium")
@target_options
@click.option("--light", nargs=3, type=Real(), help="Position. [the scene's, or above the model]")
@click.option(
    "--samples", multiple=True, type=Whole(1, MAX_SAMPLES), help="Samples per point on the area light. [1 4 16 64 256]"
)
@click.option("--resolution", type=Whole(1, MAX_RESOLUTION), help="Cells along an edge. [by the number of triangles]")
@click.option("--size", default=512, show_default=True, type=Whole(4), help="Shadow rays from SIZE x SIZE pixels.")
@click.option("--rounds", default=5, show_default=True, type=Whole(1), help="Rounds per engine.")
@threads_option
@json_option
def shadows_command(
    model: str,
    light: tuple[float, float, float] | None,
    samples: tuple[int, ...],
    resolution: int | None,
    size: int,
    rounds: int,
    threads: int | None,
    json_file: Path | None,
) -> None:
    """Light buffer and multi-frusta beside packets, streams and single rays, on the same shadow rays."""
    mesh, count = load_model(model), threads or get_num_threads()
    camera, position = view_of(model, mesh, size)
    with progress() as on_turn, usage_errors():
        figures = compare_shadows(
            mesh,
            camera,
            light or position,
            samples=samples or SAMPLES,
            resolution=resolution,
            rounds=rounds,
            threads=count,
            on_turn=on_turn,
        )
    console = table_console(120)
    console.print(f"[bold]{model}: {mesh.triangle_count:,} triangles, {count} threads[/bold]", highlight=False)
    print_shadows(figures, console)
    write_json(json_file, {"model": model, "threads": count, "shadows": [asdict(row) for row in figures]})


def view_of(model: str, mesh: TriangleMesh, size: int) -> tuple[PinholeCamera, tuple[float, ...]]:
    """A camera of size x size pixels, and where the light is."""
    if model in BUILTIN_SCENES and not Path(model).is_file():
        scene = BUILTIN_SCENES[model]
        return PinholeCamera(size, size, **scene.camera), scene.light
    low, high = mesh.bounds
    return PinholeCamera.framing(mesh, size, size), tuple((high + 0.7 * (high - low)).tolist())


def print_shadows(figures: Sequence[ShadowFigures], console: Any) -> None:
    """The table of both lights."""
    from wrt.bench.core.benchmark_report import new_table, times

    names = ("rays", "occluded", "million rays/s", "speed / packets", "same", "build ms", "MB")
    table = new_table(("light", "engine"), names)
    for row in figures:
        build = "" if row.build is None else f"{1e3 * row.build:.1f}"
        size = "" if row.bytes is None else f"{row.bytes / 1e6:.1f}"
        cells = (f"{row.rays:,}", f"{row.occluded:.0%}", f"{row.megarays:.1f}", times(row.ratio), str(row.same), build, size)
        table.add_row(row.light, row.engine, *cells)
    console.print(table)

"""`python -m studies shadows`: shadow rays to a point light and to an area light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import click
from rich.table import Table

from studies.light.shadow_comparison import SAMPLES, ShadowFigures, compare_shadows
from studies.study_options import model_argument, number, show, study
from wrt.bench.commands.command_options import load_model, progress, table_console, usage_errors, write_json
from wrt.bench.core.benchmark_report import new_table, times
from wrt.cli.number_types import Real, Whole
from wrt.imaging.cameras import PinholeCamera
from wrt.kernels.layout.light_cells import MAX_RESOLUTION
from wrt.meshes.mesh import TriangleMesh
from wrt.scenes import BUILTIN_SCENES
from wrt.shadows.area_light_visibility import MAX_SAMPLES


@study("shadows")
@model_argument("atrium")
@click.option("--light", nargs=3, type=Real(), help="Position. [the scene's, or above the model]")
@click.option(
    "--samples", multiple=True, type=Whole(1, MAX_SAMPLES), help="Samples per point on the area light. [1 4 16 64 256]"
)
@click.option("--resolution", type=Whole(1, MAX_RESOLUTION), help="Cells along an edge. [by the number of triangles]")
@number("--size", 512, "Shadow rays from SIZE x SIZE pixels.", 4)
@number("--rounds", 5, "Rounds per engine.")
def shadows_command(
    model: str,
    light: tuple[float, float, float] | None,
    samples: tuple[int, ...],
    resolution: int | None,
    size: int,
    rounds: int,
    threads: int,
    json_file: Path | None,
) -> None:
    """Light buffer and multi-frusta beside packets, streams and single rays, on the same shadow rays."""
    mesh = load_model(model)
    camera, position = view_of(model, mesh, size)
    with progress() as on_turn, usage_errors():
        options = {"samples": samples or SAMPLES, "resolution": resolution, "rounds": rounds, "threads": threads}
        figures = compare_shadows(mesh, camera, light or position, **options, on_turn=on_turn)
    show(table_console(120), f"{model}: {mesh.triangle_count:,} triangles, {threads} threads", shadows_table(figures))
    write_json(json_file, {"model": model, "threads": threads, "shadows": [asdict(row) for row in figures]})


def view_of(model: str, mesh: TriangleMesh, size: int) -> tuple[PinholeCamera, tuple[float, ...]]:
    """A camera of size x size pixels, and where the light is."""
    if model in BUILTIN_SCENES and not Path(model).is_file():
        scene = BUILTIN_SCENES[model]
        return PinholeCamera(size, size, **scene.camera), scene.light
    low, high = mesh.bounds
    return PinholeCamera.framing(mesh, size, size), tuple((high + 0.7 * (high - low)).tolist())


def shadows_table(figures: Sequence[ShadowFigures]) -> Table:
    """The table of both lights."""
    names = ("rays", "occluded", "million rays/s", "speed / packets", "same", "build ms", "MB")
    table = new_table(("light", "engine"), names)
    for row in figures:
        build = "" if row.build is None else f"{1e3 * row.build:.1f}"
        size = "" if row.bytes is None else f"{row.bytes / 1e6:.1f}"
        cells = (f"{row.rays:,}", f"{row.occluded:.0%}", f"{row.megarays:.1f}", times(row.ratio), str(row.same), build, size)
        table.add_row(row.light, row.engine, *cells)
    return table

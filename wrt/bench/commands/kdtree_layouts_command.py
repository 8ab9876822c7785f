"""`wrt bench layouts`: orders of a kd-tree's nodes in memory."""

from __future__ import annotations

from typing import Any

import click

from wrt.bench.commands.command_options import load_model, progress, table_console, threads_option, usage_errors
from wrt.bench.studies.kdtrees.layout_comparison import RAYS, REFERENCE, LayoutFigures, compare_layouts
from wrt.builders.kdtree import KDTREE_BUILDERS
from wrt.cli.arguments import target_options
from wrt.kernels.runtime.launch import get_num_threads
from wrt.meshes.mesh import TriangleMesh


@click.command("layouts")
@click.argument("model", default="teapot")
@target_options
@click.option(
    "--builder", default="in_place", show_default=True, type=click.Choice([*KDTREE_BUILDERS]), help="Builder of the tree."
)
@click.option("--width", type=click.Choice([1, 2, 4, 8, 16]), help="Triangles a block; 1 for deep trees. [what suits the CPU]")
@click.option("--size", default=512, show_default=True, type=click.IntRange(4), help="Trace SIZE x SIZE rays.")
@click.option("--rounds", default=5, show_default=True, type=click.IntRange(1), help="Turns of each layout.")
@threads_option
def layouts_command(model: str, builder: str, width: int | None, size: int, rounds: int, threads: int | None) -> None:
    """Compares orders of a kd-tree's nodes in memory on MODEL, a mesh file or a built-in scene: nanoseconds a step."""
    mesh, count = load_model(model), threads or get_num_threads()
    with progress() as on_turn, usage_errors():
        figures = compare_layouts(mesh, builder=builder, width=width, rounds=rounds, threads=count, size=size, on_turn=on_turn)
    print_layouts(figures, mesh, count, table_console())


def print_layouts(figures: list[LayoutFigures], mesh: TriangleMesh, threads: int, console: Any) -> None:
    """The table of layouts."""
    from wrt.bench.core.benchmark_report import new_table, times

    columns = [text for rays in RAYS for text in (f"{rays}, ns a step", "speed")]
    table = new_table(("layout",), ("node kB", *columns))
    for row in figures:
        cells = [text for rays in RAYS for text in (f"{row.step_ns[rays]:.1f}", times(row.ratios[rays]))]
        table.add_row(row.layout, f"{row.node_bytes / 1e3:.0f}", *cells)
    label = f"kd-tree layouts: {mesh.name or 'mesh'}, {mesh.triangle_count:,} triangles, {threads} threads"
    console.print(f"[bold]{label}[/bold]", highlight=False)
    console.print(table)
    console.print(
        f"Speed is a ratio to {REFERENCE}'s; a step is a node or a leaf with its tests.", style="dim", highlight=False
    )

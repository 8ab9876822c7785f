"""`studies builders`: kd-tree builders beside each other, and how they grow. `studies layouts`: orders of nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from studies.kdtrees import layout_comparison
from studies.kdtrees.kdtree_comparison import RAYS, REFERENCE, BuilderFigures, compare_builders
from studies.kdtrees.kdtree_growth import Growth, growth_sizes, growth_turns, measure_growth
from studies.kdtrees.layout_comparison import LayoutFigures, compare_allocations, compare_compact, compare_layouts
from studies.study_options import described, model_argument, number, several, show, study, threads_option
from wrt.bench.commands.command_options import load_model, progress, progress_bar, table_console, usage_errors, write_json
from wrt.bench.comparisons.build_comparison import kdtree_descriptions
from wrt.bench.core.benchmark_report import new_table, times
from wrt.builders.classics.kdtree.streaming import EXACT
from wrt.builders.kdtree import KDTREE_BUILDERS
from wrt.cli.arguments import target_options
from wrt.cli.number_types import Whole
from wrt.meshes.mesh import TriangleMesh


@study("builders")
@model_argument("teapot")
@several("--builder", "builders", KDTREE_BUILDERS)
@number("--size", 512, "Trace SIZE x SIZE rays.", 4)
@number("--rounds", 5, "Rounds per builder.")
@click.option("--growth", type=Whole(1000), metavar="N", help="Show growth too, from 10^3 to N triangles.")
def builders_command(
    model: str, builders: tuple[str, ...], size: int, rounds: int, growth: int | None, threads: int, json_file: Path | None
) -> None:
    """Compares kd-tree builders on MODEL, a mesh file or a built-in scene: time to build, cost, memory, time to trace.

    Figures are ratios to the O(N log N) sweep in the same round; above 1 is slower, dearer or larger.
    """
    mesh = load_model(model)
    chosen = builders or tuple(description.builder for description in kdtree_descriptions(mesh.triangle_count))
    grown: list[Growth] = []
    with progress() as on_turn, usage_errors():
        figures = compare_builders(mesh, chosen, rounds=rounds, threads=threads, size=size, on_turn=on_turn)
    if growth is not None:
        sizes = growth_sizes(growth)
        with progress_bar(growth_turns(chosen, sizes, rounds)) as on_turn:
            grown = measure_growth(chosen, sizes, rounds=rounds, threads=threads, on_turn=on_turn)
    console = table_console()
    print_figures(figures, mesh, threads, console)
    if grown:
        print_growth(grown, console)
    found = {"model": mesh.name, "triangles": mesh.triangle_count, "threads": threads}
    found["builders"] = [asdict(row) for row in figures]
    found["growth"] = [asdict(row) | {"per_n_log_n": row.per_n_log_n} for row in grown]
    write_json(json_file, found)


def print_figures(figures: Sequence[BuilderFigures], mesh: TriangleMesh, threads: int, console: Any) -> None:
    """The table of builders."""
    table = new_table(
        ("builder",), ("build", "ms", "SAH cost", "of sweep's", "tree B", "peak B", *(f"trace {rays}" for rays in RAYS))
    )
    for row in figures:
        table.add_row(
            row.builder,
            times(row.build_ratio),
            f"{row.seconds * 1e3:.1f}",
            f"{row.sah_cost:.2f}",
            f"{row.sah_ratio:.3f}x",
            f"{row.tree_bytes:.0f}",
            f"{row.peak_bytes:.0f}",
            *(times(row.trace_ratios[rays]) for rays in RAYS),
        )
    note = f"Times are ratios to {REFERENCE}'s; bytes are per triangle."
    if mesh.triangle_count <= EXACT and any(row.builder == "streaming" for row in figures):
        note += f" Of up to {EXACT:,} triangles, streaming samples none: its tree is the exact one."
    show(console, f"kd-tree builders: {described(mesh, threads)}", table, note)


def print_growth(grown: Sequence[Growth], console: Any) -> None:
    """The table of growth."""
    sizes = max((growth.triangles for growth in grown), key=len)
    table = new_table(("builder",), [*(f"{size:,}" for size in sizes), "tree B", "peak B"])
    for growth in grown:
        cells = [
            f"{seconds * 1e3:,.1f} ms ({factor:.2f}x)"
            for seconds, factor in zip(growth.seconds, growth.per_n_log_n, strict=True)
        ]
        missing = [""] * (len(sizes) - len(cells))
        table.add_row(growth.builder, *cells, *missing, f"{growth.tree_bytes[-1]:.0f}", f"{growth.peak_bytes[-1]:.0f}")
    console.print()
    title = "Growth: time to build, and time / (n log n) as a multiple of the first"
    show(console, title, table, "Bytes are per triangle, at the last size of each.")


@click.command("layouts")
@model_argument("teapot")
@target_options
@click.option(
    "--builder", default="in_place", show_default=True, type=click.Choice([*KDTREE_BUILDERS]), help="Builder of the tree."
)
@click.option("--width", type=click.Choice([1, 2, 4, 8, 16]), help="Triangles a block; 1 for deep trees. [what suits the CPU]")
@number("--size", 512, "Trace SIZE x SIZE rays.", 4)
@number("--rounds", 5, "Rounds per layout.")
@threads_option
@click.option("--allocations", is_flag=True, help="Compare general with fixed-size allocation of nodes instead.")
@click.option("--compact", is_flag=True, help="Compare nodes with and without indices of their children instead.")
def layouts_command(
    model: str, builder: str, width: int | None, size: int, rounds: int, threads: int, allocations: bool, compact: bool
) -> None:
    """Compares orders of a kd-tree's nodes in memory on MODEL, a mesh file or a built-in scene: nanoseconds a step."""
    if allocations and compact:
        raise click.UsageError("--allocations and --compact are different comparisons; give one of them")
    mesh = load_model(model)
    compare = compare_allocations if allocations else compare_compact if compact else compare_layouts
    with progress() as on_turn, usage_errors():
        figures = compare(mesh, builder=builder, width=width, rounds=rounds, threads=threads, size=size, on_turn=on_turn)
    print_layouts(figures, mesh, threads, table_console())


def print_layouts(figures: list[LayoutFigures], mesh: TriangleMesh, threads: int, console: Any) -> None:
    """The table of layouts; speeds refer to the first."""
    columns = [text for rays in layout_comparison.RAYS for text in (f"{rays}, ns a step", "speed")]
    table = new_table(("layout",), ("node kB", "B a node", *columns))
    for row in figures:
        cells = [text for rays in layout_comparison.RAYS for text in (f"{row.step_ns[rays]:.1f}", times(row.ratios[rays]))]
        table.add_row(row.layout, f"{row.node_bytes / 1e3:.0f}", f"{row.node_bytes / row.nodes:.1f}", *cells)
    note = f"Speed is a ratio to that of {figures[0].layout}; a step is a node or a leaf with its tests."
    show(console, f"kd-tree layouts: {described(mesh, threads)}", table, note)

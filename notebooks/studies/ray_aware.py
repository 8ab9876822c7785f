"""`python -m studies ray-aware`: the figures of `studies.known_rays.ray_aware_comparison` as tables and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from studies.known_rays.affinity import compare_affinity
from studies.known_rays.ray_aware_comparison import (
    GIVEN,
    REFERENCE,
    TRAVERSALS,
    Figure,
    Turns,
    areas_of,
    compare_builds,
    compare_searches,
    compare_traces,
)
from studies.study_options import described, model_argument, number, several, show, study
from wrt.bench.commands.command_options import load_model, progress, table_console, usage_errors, write_json
from wrt.bench.core.benchmark_report import new_table, times
from wrt.bench.core.benchmark_results import machine
from wrt.kernels.traversal import TRAVERSALS as WALKS

TITLES = {
    "search": "Search of a node's plane, one thread: projected areas / surface areas",
    "build": "Build",
    "trace": "Trace",
    "affinity": "Area of each ray, found and given, beside tracing",
}

FOOTNOTE = f"""time / {REFERENCE}: median of the rounds' ratios; above 1 is slower. work: what single rays do, by count and
by the build's cost model. ProjectedBvh: one tree for the rays; RayAwareBvh: the default tree and one for the area; {GIVEN}: the
same, told the area."""


@study("ray-aware")
@model_argument("atrium")
@number("--size", 1024, "Trace SIZE x SIZE rays.", 4)
@number("--rounds", 5, "Rounds per tree.")
@several("--traversal", "traversals", ("auto", *WALKS), "Repeat. [auto, single]")
def ray_aware_command(
    model: str, size: int, rounds: int, traversals: tuple[str, ...], threads: int, json_file: Path | None
) -> None:
    """Compares trees for rays of known directions with the default tree on MODEL, a mesh file or a built-in scene.

    Time to search a node, to build, and to trace shadow rays of a sun and a lamp, a camera's rays, and those of ray casters.
    """
    mesh = load_model(model)
    with progress() as on_turn, usage_errors():
        figures: list[Figure] = []
        areas = areas_of(mesh)
        for name, area in areas.items():
            figures += compare_searches(mesh, area, name, rounds=rounds)
        turns = Turns(rounds, threads, on_turn)
        figures += compare_builds(mesh, areas, turns)
        figures += compare_traces(mesh, turns, size=size, traversals=traversals or TRAVERSALS)
        figures += compare_affinity(mesh, turns, size=size)
    console = table_console()
    console.print(described(mesh, threads), highlight=False)
    for question, title in TITLES.items():
        console.print()
        show(console, title, table_of([figure for figure in figures if figure.question == question]))
    console.print(FOOTNOTE, style="dim", highlight=False)
    found = {"model": mesh.name, "triangles": mesh.triangle_count, "threads": threads, "machine": machine("cpu")}
    write_json(json_file, found | {"figures": [asdict(figure) for figure in figures]})


def table_of(figures: Sequence[Figure]):
    """A row a subject and tree; the reference's own ratio is left out."""
    table = new_table(("of", "traversal", "tree"), (f"time / {REFERENCE}", "least - greatest", "work", "ns an item"))
    for figure in figures:
        is_reference = figure.contender == REFERENCE
        table.add_row(
            figure.subject if is_reference else "",
            (figure.traversal or "") if is_reference else "",
            figure.contender,
            "" if is_reference else times(figure.ratio),
            "" if is_reference else f"{figure.least:.2f} - {figure.greatest:.2f}",
            "" if is_reference or figure.work is None else times(figure.work),
            f"{figure.seconds / figure.items * 1e9:,.0f}",
        )
    return table

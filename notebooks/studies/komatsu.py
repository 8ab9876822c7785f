"""The tables of the two papers on triangle tests, Pichler 2018 and Komatsu et al. 2008, as tables and as JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from studies.study_options import number, several, show
from studies.triangles import komatsu_packets, komatsu_tables, pichler_tables, pichler_variants
from wrt.bench.commands.command_options import json_option, load_model, progress, table_console, usage_errors, write_json
from wrt.bench.core.benchmark_report import new_table
from wrt.bench.core.benchmark_results import machine
from wrt.cli.arguments import target_options
from wrt.cli.number_types import Whole
from wrt.meshes.mesh import TriangleMesh

Rows = list[dict[str, Any]]

PICHLER = {
    "6.1": "comparisons of pruning",
    "6.2": "times of the variants, to the unit triangle's",
    "6.3": "times of whole queries, to Woop's test, by hit rate",
    "6.4": "error of a picture at equal time",
    "tried": "5.3, 5.5, 6.1: ways to the transform, spheres, when to compare t; times to range_delayed",
    "edge-planes": "3.1: Amanatides and Choi's two tests",
    "subdivision": "3.1: Dammertz and Keller's test",
    "errors": "3.1: Havel and Herout's comparison by mean squared error",
    "leaks": "7.2: rays that pass at edges and vertices",
    "watertight": "7.2: a pruning by which none passes; times to the same test without pruning",
}
"""Tables of the thesis, and what it names without one."""

KOMATSU = {
    "1": "operations and bytes",
    "2": "times without a tree, to Möller's (Fig. 6)",
    "3": "where tests end",
    "7": "precomputation and exits one by one (Fig. 7)",
    "8": "resolution (Fig. 8)",
    "4": "with a SAH-BVH (Fig. 9)",
    "bundles": "future work: bundles of shadow and of diffuse rays, precomputation counted",
    "records": "the same with a tree",
}
"""Tables and figures of the paper."""


def pichler_rows(table: str, scenes: Sequence[str], size: int | None, rounds: int) -> Rows:
    """The rows of a table of `PICHLER`; the size None for the table's own."""
    sized = {} if size is None else {"size": size}
    if table == "leaks":
        return pichler_variants.leak_counts((*pichler_variants.LEAKING, pichler_variants.PRUNED.name))
    if table == "6.4":
        return pichler_tables.errors(scenes or ("stadium", "wood"), **sized, rounds=rounds)
    untimed = {"6.1": pichler_tables.pruning_tests, "errors": pichler_variants.squared_errors}
    timed = {
        "6.2": pichler_tables.pruning_times,
        "6.3": pichler_tables.times,
        "tried": pichler_variants.replays,
        "edge-planes": pichler_variants.edge_planes,
        "subdivision": pichler_variants.subdivision,
        "watertight": pichler_variants.watertight_pruning,
    }
    run = untimed[table] if table in untimed else partial(timed[table], rounds=rounds)
    return run(scenes or tuple(pichler_tables.SCENES), **sized)


def komatsu_rows(table: str, meshes: Iterable[TriangleMesh], rounds: int, tests: int) -> Rows:
    """The rows of a table of `KOMATSU`, mesh by mesh."""
    if table == "1":
        return komatsu_tables.table_1()
    effort = {"rounds": rounds, "tests": tests}
    tables: dict[str, Callable[[TriangleMesh], Rows]] = {
        "2": partial(komatsu_tables.contenders, **effort),
        "3": partial(komatsu_tables.exit_shares, tests=tests >> 3),
        "7": partial(komatsu_tables.early_exits, **effort),
        "8": partial(komatsu_tables.resolutions, **effort),
        "4": partial(komatsu_tables.with_tree, rounds=rounds),
        "bundles": partial(komatsu_packets.bundles, rounds=rounds, pairs=tests >> 2),
        "records": partial(komatsu_packets.with_records, rounds=rounds),
    }
    return [{"scene": mesh.name} | row for mesh in meshes for row in tables[table](mesh)]


def cell(value: Any) -> str:
    """A value of a row as text."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {cell(part)}" for name, part in value.items())
    return f"{value:.4g}" if isinstance(value, float) else "-" if value is None else str(value)


def print_rows(console: Any, title: str, rows: Rows) -> None:
    """A table with the columns of its rows."""
    names = [*dict.fromkeys(name for row in rows for name in row)]
    words = [name for name in names if any(isinstance(row.get(name), str) for row in rows)]
    last = [name for name in names if any(isinstance(row.get(name), Mapping) for row in rows)]
    numbers = [name for name in names if name not in words and name not in last]
    table = new_table(words, numbers, last)
    for row in rows:
        table.add_row(*(cell(row.get(name)) for name in (*words, *numbers, *last)))
    console.print()
    show(console, title, table)


def report(tables: Mapping[str, str], chosen: Sequence[str], make: Callable[[str], Rows], json_file: Path | None) -> None:
    """Makes the chosen tables one by one, prints each when it is made, and writes all of them."""
    console, found = table_console(200), {}
    for table in chosen or tuple(tables):
        with progress() as on_turn, usage_errors():
            on_turn(tables[table])
            found[table] = make(table)
        print_rows(console, f"{table}: {tables[table]}", found[table])
    write_json(json_file, {"machine": machine("cpu"), "tables": found})


@click.command("pichler")
@target_options
@several("--table", "tables", PICHLER, "Tables; may be repeated. [all]")
@several("--scene", "scenes", pichler_tables.SCENES, "Scenes; may be repeated. [all]")
@click.option("--size", type=Whole(4), help="Views have SIZE x SIZE pixels, a multiple of 4. [each table's own]")
@number("--rounds", 5, "Rounds per contender.")
@json_option
def pichler_command(
    tables: tuple[str, ...], scenes: tuple[str, ...], size: int | None, rounds: int, json_file: Path | None
) -> None:
    """The tables of Pichler 2018, Fast CPU Ray-Triangle Intersection Method, measured again on built-in scenes, one thread."""
    report(PICHLER, tables, lambda table: pichler_rows(table, scenes, size, rounds), json_file)


@click.command("komatsu")
@click.argument("models", nargs=-1)
@target_options
@several("--table", "tables", KOMATSU, "Tables; may be repeated. [all]")
@click.option(
    "--models", "folder", type=click.Path(file_okay=False, exists=True, path_type=Path), help="Folder of the Stanford models."
)
@number("--tests", 1 << 23, "Tests of a call.", 1 << 10)
@number("--rounds", 5, "Rounds per contender.")
@json_option
def komatsu_command(
    models: tuple[str, ...], tables: tuple[str, ...], folder: Path | None, tests: int, rounds: int, json_file: Path | None
) -> None:
    """The tables of Komatsu et al. 2008, A fast ray frustum-triangle intersection algorithm, on MODELS, one thread.

    Without MODELS: the bunny and the dragon, if the folder has them, and four built-in scenes.
    """
    meshes = [load_model(model) for model in models] if models else [*komatsu_packets.scenes(folder).values()]
    report(KOMATSU, tables, lambda table: komatsu_rows(table, meshes, rounds, tests), json_file)

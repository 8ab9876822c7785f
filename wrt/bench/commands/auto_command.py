"""`wrt bench auto`: what "auto" chooses, and its time over that of the best engine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from wrt.bench.commands.command_options import (
    json_option,
    load_model,
    progress,
    table_console,
    threads_option,
    usage_errors,
    write_json,
)
from wrt.bench.comparisons.auto_cases import KINDS, SCENES, SIZES, scene_of, subdivided
from wrt.bench.comparisons.auto_choices import Choice, compare_choices
from wrt.bench.comparisons.auto_journeys import compare_journeys
from wrt.bench.core.benchmark_results import machine
from wrt.cli.arguments import target_options
from wrt.cli.number_types import Whole
from wrt.kernels.runtime.launch import get_num_threads
from wrt.meshes.mesh import TriangleMesh

if TYPE_CHECKING:
    from rich.console import Console

GOOD, BAD = 1.1, 1.25
"""Ratios that 99 of 100 cases and all cases should not exceed."""


@click.command("auto")
@click.argument("model", default="teapot")
@target_options
@click.option("--scene", "scenes", multiple=True, type=click.Choice([*SCENES]), help="May be repeated. [all]")
@click.option("--kind", "kinds", multiple=True, type=click.Choice(KINDS), help="Kind of rays; may be repeated. [all]")
@click.option("--size", "sizes", multiple=True, type=Whole(8), help="Views have SIZE x SIZE pixels. [64 256 1024]")
@click.option("--divide", default=0, show_default=True, type=Whole(0, 4), help="Subdivide every triangle into 4, N times.")
@click.option("--rounds", default=5, show_default=True, type=Whole(1), help="Rounds per engine.")
@click.option("--journeys", is_flag=True, help="A lidar that jumps from place to place, in place of the cases.")
@click.option("--open3d/--no-open3d", default=False, show_default=True, help="Time Open3D beside, if it is installed.")
@threads_option
@json_option
def auto_command(
    model: str,
    scenes: tuple[str, ...],
    kinds: tuple[str, ...],
    sizes: tuple[int, ...],
    divide: int,
    rounds: int,
    journeys: bool,
    open3d: bool,
    threads: int | None,
    json_file: Path | None,
) -> None:
    """What "auto" chooses for a grid of cases: its time over that of the best traversal and culling.

    "auto" learns from some calls before it is timed; with --journeys, what it loses meanwhile counts.

    Scenes: "model", MODEL alone; "world", an atrium with ten copies of it in one tree; "instances", the same as instances;
    "city", 10^6 triangles of houses.
    """
    if any(size % 4 for size in sizes):
        raise click.BadParameter("must be a multiple of 4", param_hint="--size")
    count, mesh = threads or get_num_threads(), load_model(model)
    mesh = subdivided(mesh, divide) if divide else mesh
    console = table_console(200)
    with progress() as on_turn, usage_errors():
        chosen = [
            choice
            for name in scenes or SCENES
            for choice in (
                compare_journeys(name, *scene_of(name, mesh, count), on_turn)
                if journeys
                else choices_of(name, mesh, kinds or KINDS, sizes or SIZES, rounds, count, open3d, on_turn)
            )
        ]
    found = machine("cpu")
    about = f"{found['cpu']}, {found['lanes']} lanes, code for {found['target']}, {count} threads"
    console.print(f"[bold]{mesh.name or model}, {mesh.triangle_count:,} triangles: {about}[/bold]", highlight=False)
    print_choices(chosen, console)
    write_json(json_file, {"machine": found, "threads": count, "choices": [asdict(row) for row in chosen]})


def choices_of(
    name: str,
    model: TriangleMesh,
    kinds: Sequence[str],
    sizes: Sequence[int],
    rounds: int,
    threads: int,
    open3d: bool,
    on_turn: Callable[[str], None],
) -> Iterator[Choice]:
    """The cases of one scene."""
    from wrt.bench.peers.open3d_peer import Open3D

    scene, mesh = scene_of(name, model, threads)
    peer = Open3D(threads) if open3d else None
    if peer is not None and (reason := peer.available()) is not None:
        raise click.UsageError(reason)
    if peer is not None:
        peer.build(mesh)
    yield from compare_choices(name, scene, mesh, kinds=kinds, sizes=sizes, rounds=rounds, peer=peer, on_turn=on_turn)


def print_choices(choices: Sequence[Choice], console: Console) -> None:
    """The table, and how many cases are as fast as they should be."""
    from wrt.bench.core.benchmark_report import new_table, times

    names = ("rays", "auto / best", "rules / best", "Open3D / auto", "milliseconds")
    table = new_table(("scene", "rays of", "auto"), names)
    for row in choices:
        beside = "" if row.open3d is None else times(row.open3d / row.auto_milliseconds)
        each = ", ".join(f"{engine} {value:.2f}" for engine, value in sorted(row.milliseconds.items(), key=lambda one: one[1]))
        table.add_row(row.scene, row.kind, row.auto, f"{row.rays:,}", times(row.ratio), times(row.rules_ratio), beside, each)
    console.print(table)
    for name, ratios in (("auto", [row.ratio for row in choices]), ("its rules", [row.rules_ratio for row in choices])):
        good, fair = (sum(ratio <= limit for ratio in ratios) for limit in (GOOD, BAD))
        found = f"within {GOOD} of the best in {good}, within {BAD} in {fair}, at most {max(ratios):.2f}"
        console.print(f"{len(choices)} cases: {name} {found}", highlight=False)
    noise = sorted(row.noise for row in choices)
    beyond = sum(row.ratio > GOOD * row.noise for row in choices)
    found = f"at most {noise[len(noise) // 2]:.2f} in half of the cases, {noise[-1]:.2f} in all"
    console.print(f"the best engine against itself: {found}; auto is beyond {GOOD} times that in {beyond}", highlight=False)

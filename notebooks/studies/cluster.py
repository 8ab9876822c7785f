"""`python -m studies cluster`: one process and several, on CPU cores or GPUs, and a simulation of more."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from studies.clusters.cluster_scaling import EXECUTORS, measure
from studies.clusters.cluster_simulation import ClusterModel, simulate
from studies.clusters.town import town
from studies.study_options import number, several
from wrt.bench.commands.command_options import json_option, progress, table_console, usage_errors, write_json
from wrt.bench.core.benchmark_results import machine
from wrt.cli.number_types import Whole
from wrt.scene.scene import Scene

SIMULATED = (1, 2, 4, 8, 16, 64, 256, 1000)


@click.command("cluster")
@number("--triangles", 1_000_000, "Number of triangles of the town.", 1000)
@number("--points", 10_000, "Places whose sun hours are wanted.")
@number("--suns", 400, "Directions to the sun.")
@number("--task-rays", 200_000, "Rays of a task.")
@click.option("--workers", "counts", multiple=True, type=Whole(1), help="Processes; may be repeated. [1, 2]")
@click.option("--device", "devices", multiple=True, help="A GPU for each process, such as cuda:0; repeat for each GPU.")
@several("--executor", "names", EXECUTORS, "May be repeated. [processes]")
@number("--rounds", 3, "Rounds per number of processes.")
@json_option
def cluster_command(
    triangles: int,
    points: int,
    suns: int,
    task_rays: int,
    counts: tuple[int, ...],
    devices: tuple[str, ...],
    names: tuple[str, ...],
    rounds: int,
    json_file: Path | None,
) -> None:
    """Sun hours of a town: Mrays/s of 1, 2 ... processes of one thread, or of one GPU each, and a simulation of up to 1,000.

    With GPUs: wrt bench cluster --device cuda:0 --device cuda:1 --points 200000 --suns 4000 --task-rays 20000000
    """
    if devices and "dask" in names:
        raise click.UsageError("workers of Dask choose their GPU by CUDA_VISIBLE_DEVICES; use --executor processes")
    counts = counts or ((1, len(devices)) if len(devices) > 1 else (1, 2))
    scene = Scene(town(triangles), device=devices[0] if devices else "cpu")
    with progress() as on_turn, usage_errors():
        rows, is_same = measure(scene, counts, names or ("processes",), points, suns, task_rays, rounds, devices, on_turn)
    rays = points * suns
    console = table_console()
    console.print(
        f"{scene.triangle_count:,} triangles, {rays:,} rays, tasks of {task_rays:,}; same bits: {is_same}", highlight=False
    )
    for row in rows:
        console.print(
            f"{row.workers} x {row.name}: {rays / row.seconds / 1e6:.1f} Mrays/s, {row.gain:.2f}x of {counts[0]}, "
            f"{row.task_seconds * 1e3:.2f} ms a task",
            highlight=False,
        )
    one = rows[0]
    speed = rays / one.seconds
    model = ClusterModel(1e12, speed, speed, client_seconds=one.task_seconds, task_seconds=one.task_seconds)
    console.print("Simulated: 10^12 rays, tasks of a second, a scene of 100 MB through one link of 10 Gbit/s:", highlight=False)
    for workers in SIMULATED:
        console.print(
            f"{workers:5d} workers: {simulate(model, workers) / 3600:8.2f} h, by the formula "
            f"{model.bound(workers) / 3600:8.2f} h, {model.bytes(workers) / 1e9:.1f} GB",
            highlight=False,
        )
    write_json(json_file, {"machine": machine(devices[0] if devices else "cpu"), "rows": [asdict(row) for row in rows]})

"""How queries and builds gain from threads, and how the schedules of the thread pool compare, on the CPU.

Both commands run the same jobs: views, random rays, and builds of the mesh by each kind of tree. For a job, contenders are the
numbers of threads (or the schedules), which take turns; ratios are those of the same round.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from wrt.bench.loading import json_option, load_model, progress, table_console, threads_option, usage_errors, write_json
from wrt.bench.measure import Contender, take_turns
from wrt.bench.results import machine
from wrt.imaging.cameras import PinholeCamera
from wrt.kernels.runtime.launch import get_num_threads, use_schedule
from wrt.kernels.runtime.schedules import DEFAULT_SCHEDULE, SCHEDULES
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

VIEWS = (256, 1024)
"""Pixels a side."""

RANDOM = (1 << 16, 1 << 21)
"""Rays."""

BUILDS = ("bvh", "kdtree")


@dataclass(frozen=True)
class Job:
    """Something to do with a number of threads.

    Attributes:
        name: what the tables call it.
        unit: "Mrays/s" or "ms".
        amount: rays; 0 for a build.
        prepare: makes what is run, for a number of threads.
    """

    name: str
    unit: str
    amount: int
    prepare: Callable[[int], Callable[[], Any]]

    def figure(self, seconds: float) -> float:
        """The time of one run in the job's unit."""
        return self.amount / seconds / 1e6 if self.amount else seconds * 1e3


@dataclass
class JobFigures:
    """What was measured of a job.

    Attributes:
        job, unit: its name and unit.
        names: of the contenders: numbers of threads, or schedules.
        figures: of each, by the median time.
        gains: of each, the first contender's time / its own, median of the rounds.
    """

    job: str
    unit: str
    names: list[str]
    figures: list[float]
    gains: list[float]


def make_jobs(mesh: TriangleMesh, builds: bool = True) -> list[Job]:
    """The jobs on a mesh."""
    scenes: dict[int, Scene] = {}

    def scene_for(threads: int) -> Scene:
        if threads not in scenes:
            scenes[threads] = Scene(mesh, device="cpu", num_threads=threads)
        return scenes[threads]

    def rays_job(name: str, count: int, *rays: Any) -> Job:
        return Job(name, "Mrays/s", count, lambda threads: lambda: scene_for(threads).intersect(*rays))

    def build_job(kind: str) -> Job:
        return Job(f"build {kind}", "ms", 0, lambda threads: lambda: Scene(mesh, kind, device="cpu", num_threads=threads))

    rng, (low, high) = np.random.default_rng(0), mesh.bounds
    jobs = [rays_job(f"view {size} x {size}", size * size, PinholeCamera.framing(mesh, size, size).rays()) for size in VIEWS]
    for count in RANDOM:
        origins = rng.uniform(low, high, (count, 3)).astype(np.float32)
        jobs.append(rays_job(f"random {count:,}", count, origins, rng.normal(size=(count, 3)).astype(np.float32)))
    return jobs + ([build_job(kind) for kind in BUILDS] if builds else [])


def measure(job: Job, contenders: Sequence[Contender], rounds: int, on_turn: Callable[[str], None]) -> JobFigures:
    """Times a job's contenders in turn; gains are over the first of them."""
    timings = take_turns(contenders, rounds, settle=0.05, on_turn=lambda name: on_turn(f"{job.name}, {name}"))
    first = timings[contenders[0].name]
    names = [contender.name for contender in contenders]
    figures = [job.figure(timings[name].median) for name in names]
    gains = [1.0 / ratio if (ratio := timings[name].ratio_to(first)) else float("nan") for name in names]
    return JobFigures(job.name, job.unit, names, figures, gains)


def measure_scaling(
    mesh: TriangleMesh, threads: Sequence[int], rounds: int, on_turn: Callable[[str], None] = lambda name: None
) -> list[JobFigures]:
    """Times every job with each number of threads."""
    return [
        measure(
            job, [Contender(f"{count} thread{'s' * (count > 1)}", job.prepare(count)) for count in threads], rounds, on_turn
        )
        for job in make_jobs(mesh)
    ]


def measure_schedules(
    mesh: TriangleMesh, threads: int, rounds: int, on_turn: Callable[[str], None] = lambda name: None
) -> list[JobFigures]:
    """Times every job with each schedule, the default first."""

    def contender(job: Job, name: str) -> Contender:
        run = job.prepare(threads)

        def scheduled() -> Any:
            with use_schedule(name):
                return run()

        return Contender(name, scheduled)

    names = [DEFAULT_SCHEDULE, *(name for name in SCHEDULES if name != DEFAULT_SCHEDULE)]
    return [measure(job, [contender(job, name) for name in names], rounds, on_turn) for job in make_jobs(mesh)]


def powers_of_two(most: int) -> list[int]:
    """1, 2, 4 and so on; `most` is the last."""
    return [1 << i for i in range(most.bit_length()) if 1 << i < most] + [most]


@click.command("scaling")
@click.argument("model", default="teapot")
@click.option("--rounds", default=7, show_default=True, type=click.IntRange(1), help="Turns of each number of threads.")
@click.option("--plot", "plot_file", type=click.Path(dir_okay=False, writable=True, path_type=Path), help="Write a picture.")
@threads_option
@json_option
def scaling_command(model: str, rounds: int, plot_file: Path | None, threads: int | None, json_file: Path | None) -> None:
    """Times queries and builds of MODEL, a mesh file or a built-in scene, with 1, 2, 4 ... threads."""
    from wrt.bench.plot import matplotlib_missing

    if plot_file is not None and (reason := matplotlib_missing()) is not None:
        raise click.UsageError(reason)
    mesh, most = load_model(model), threads or get_num_threads()
    with progress() as on_turn, usage_errors():
        figures = measure_scaling(mesh, powers_of_two(most), rounds, on_turn)
    print_figures(f"threads: {mesh.name or 'mesh'}, {mesh.triangle_count:,} triangles", figures)
    write_json(json_file, {"machine": machine("cpu"), "jobs": [asdict(row) for row in figures]})
    if plot_file is not None:
        with usage_errors():
            save_scaling_plot(figures, plot_file)


@click.command("scheduling")
@click.argument("model", default="teapot")
@click.option("--rounds", default=7, show_default=True, type=click.IntRange(1), help="Turns of each schedule.")
@threads_option
@json_option
def scheduling_command(model: str, rounds: int, threads: int | None, json_file: Path | None) -> None:
    """Compares ways to divide work among threads on MODEL, a mesh file or a built-in scene."""
    mesh, count = load_model(model), threads or get_num_threads()
    with progress() as on_turn, usage_errors():
        figures = measure_schedules(mesh, count, rounds, on_turn)
    print_figures(f"schedules: {mesh.name or 'mesh'}, {mesh.triangle_count:,} triangles, {count} threads", figures)
    write_json(json_file, {"machine": machine("cpu"), "jobs": [asdict(row) for row in figures]})


def print_figures(title: str, figures: Sequence[JobFigures]) -> None:
    """A table with a line a job and a column a contender."""
    from wrt.bench.report import new_table

    table = new_table(("job", "unit"), tuple(figures[0].names))
    for row in figures:
        cells = [f"{figure:.1f} ({gain:.2f}x)" for figure, gain in zip(row.figures, row.gains, strict=True)]
        table.add_row(row.job, row.unit, *cells)
    console = table_console()
    console.print(f"[bold]{title}[/bold]", highlight=False)
    console.print(table)
    console.print(f"In brackets: speed over that with {figures[0].names[0]}.", style="dim", highlight=False)


def save_scaling_plot(figures: Sequence[JobFigures], path: Path) -> None:
    """Speed over one thread against the number of threads, a line a job."""
    from matplotlib.figure import Figure

    counts = [int(name.split()[0]) for name in figures[0].names]
    figure = Figure(figsize=(6.4, 4.8), layout="constrained")
    axes = figure.subplots()
    axes.plot(counts, counts, color="0.7", linestyle="--", label="linear")
    for row in figures:
        axes.plot(counts, row.gains, marker="o", label=row.job)
    axes.set_xscale("log", base=2)
    axes.set_yscale("log", base=2)
    axes.set_xticks(counts, [str(count) for count in counts])
    axes.set_yticks(counts, [str(count) for count in counts])
    axes.set_xlabel("threads")
    axes.set_ylabel("speed, one thread = 1")
    axes.legend()
    figure.savefig(path, dpi=150)

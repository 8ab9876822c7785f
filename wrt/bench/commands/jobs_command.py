"""`wrt bench jobs`: whole jobs beside their rays and today's tools."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import click

from wrt.bench.commands.command_options import (
    json_option,
    progress,
    table_console,
    threads_option,
    usage_errors,
    write_json,
)
from wrt.bench.comparisons.whole_jobs import JOBS, JobTimes, measure_jobs
from wrt.bench.core.benchmark_results import machine
from wrt.cli.number_types import Real, Whole


@click.command("jobs")
@click.argument("names", nargs=-1, type=click.Choice([*JOBS]))
@click.option("--size", default=1.0, show_default=True, type=Real(0.01, 4.0), help="Rows and columns, in proportion.")
@click.option("--rounds", default=15, show_default=True, type=Whole(1), help="Rounds, in which contenders take turns.")
@click.option("--process/--no-process", default=True, show_default=True, help="Time a fresh process for each job, too.")
@threads_option
@json_option
def jobs_command(
    names: Sequence[str], size: float, rounds: int, process: bool, threads: int | None, json_file: Path | None
) -> None:
    """Times whole jobs: a scan, an image, a table, a robot's step, hours of sun, checks before a print, a picture in glass, a
    step of 2,048 environments; all, or those of NAMES.

    The first line of a job is its rays alone, and ratios are to them, round by round. Open3D, trimesh with embreex, Mitsuba and
    wp.Mesh do the same, with NumPy where that is needed and where they are installed; what is missing is named below the table.
    """
    with progress() as on_turn, usage_errors():
        found = measure_jobs(names or [*JOBS], size, rounds, threads, process, on_turn)
    print_jobs(found)
    rows = [row for job in found for row in job.rows()]
    write_json(json_file, {"machine": machine("cpu"), "jobs": rows, "processes": {job.job: job.process for job in found}})


def why_absent(error: str) -> tuple[str, str]:
    """Why a contender did not take part, in a few words, and in a sentence."""
    missing = re.fullmatch(r"ModuleNotFoundError: No module named '(\w+).*'", error)
    if missing is None:
        return error.split(":")[0], error
    return "not installed", f"{missing[1]} is not installed: pip install {missing[1]}"


def print_jobs(found: Sequence[JobTimes]) -> None:
    """A table with a line for each contender, and why some did not take part."""
    from wrt.bench.core.benchmark_report import new_table, times

    absent: dict[str, None] = {}
    table = new_table(("job", "what is done"), ("rays", "median ms", "least ms", "/ rays", "least / least"))
    for job in found:
        for row in job.rows():
            if row["error"] is None:
                figures = (
                    f"{1e3 * row['seconds']:.2f}",
                    f"{1e3 * row['least']:.2f}",
                    times(row["ratio"]),
                    times(row["least_ratio"]),
                )
            else:
                short, sentence = why_absent(row["error"])
                figures, absent[sentence] = (short, "", "", ""), None
            table.add_row(job.job, row["contender"], f"{job.rays:,}", *figures)
        if job.process is not None:
            table.add_row(job.job, "a fresh process, once", "", f"{1e3 * job.process:.0f}", "", "", "")
    console = table_console()
    console.print(table)
    for sentence in absent:
        console.print(sentence, markup=False, highlight=False)

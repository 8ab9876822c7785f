"""`wrt job`: runs resumable batches, and shows their progress."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from wrt.cli.arguments import start_warp

if TYPE_CHECKING:
    from wrt.cluster.job import JobStatus


@click.group()
def job() -> None:
    """Runs and resumes batches of rays in job folders."""


@job.command("run")
@click.argument("file", type=click.Path(exists=True, path_type=Path))
@click.option("--allow-output-outside", "outside", is_flag=True, help="Let the job write outside of the folder of FILE.")
def run_command(file: Path, outside: bool) -> None:
    """Runs the job of FILE, a TOML file, or goes on with it; see the guide about clusters.

    FILE may also be the folder of a job, beside its TOML file. Progress is shown on stderr: a bar in a terminal, and in a log
    file a line a minute. Ctrl-C ends the job after the blocks under way. Run job files of people whom you trust, or
    without a function and Dask: see the page about security.
    """
    from wrt.cluster.job_file import job_file_of

    run_file(job_file_of(file) if file.is_dir() else file, outside)


@job.command("resume")
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--allow-output-outside", "outside", is_flag=True, help="As in wrt job run.")
def resume_command(folder: Path, outside: bool) -> None:
    """Goes on with the job in FOLDER, by the job file beside it; blocks that are done are not computed again.

    A job that a script began is resumed by running that script again: the folder does not hold its scene and its rays.
    """
    from wrt.cluster.job_file import job_file_of

    run_file(job_file_of(folder), outside)


def run_file(file: Path, outside: bool) -> None:
    """Runs the job of a file and says how far it is then."""
    from wrt.cluster.job_file import run_job_file

    start_warp(None)
    click.echo(status_line(run_job_file(file, True, outside).status))


@job.command("status")
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print the status as JSON.")
def status_command(folder: Path, as_json: bool) -> None:
    """Says how far the job in FOLDER is."""
    import json
    from dataclasses import asdict

    from wrt.cluster.job import job_status

    status = job_status(folder)
    click.echo(json.dumps(asdict(status), default=str) if as_json else status_line(status))


def status_line(status: JobStatus) -> str:
    """How far a job is, in words."""
    state = "complete" if status.is_complete else "running" if status.is_running else f"not running: {remedy(status.folder)}"
    share = status.rays_done / status.rays if status.rays else 1.0
    return (
        f"{status.folder}: {status.query}, {status.done:,} of {status.blocks:,} blocks, {status.rays_done:,} of "
        f"{status.rays:,} rays ({share:.1%}), answers of {status.bytes / 1e6:,.1f} MB; {state}"
    )


def remedy(folder: Path) -> str:
    """How to go on with a job."""
    from shlex import quote

    from wrt.cluster.job_file import job_file_of

    try:
        job_file_of(folder)
        return f"wrt job resume {quote(str(folder))} goes on with it"
    except (ImportError, OSError, ValueError):
        return "the script or the job file that began it goes on with it"

"""`wrt job`: runs batches that survive, and says how far they are."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from wrt.cli.arguments import start_warp

if TYPE_CHECKING:
    from wrt.cluster.job import JobStatus


@click.group()
def job() -> None:
    """Runs batches of rays in folders, where they go on after whatever ended them."""


@job.command("run")
@click.argument("file", type=click.Path(exists=True, dir_okay=False, path_type=Path))
def run_command(file: Path) -> None:
    """Runs the job of FILE, a TOML file, or goes on with it; see the guide about clusters.

    Progress is shown on stderr if that is a terminal. Ctrl-C ends the job after the blocks under way.
    """
    from wrt.cluster.job_file import run_job_file

    start_warp(None)
    click.echo(status_line(run_job_file(file, progress=sys.stderr.isatty()).status))


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
    state = "complete" if status.is_complete else "running" if status.is_running else "not running: wrt job run goes on with it"
    share = status.rays_done / status.rays if status.rays else 1.0
    return (
        f"{status.folder}: {status.query}, {status.done:,} of {status.blocks:,} blocks, {status.rays_done:,} of "
        f"{status.rays:,} rays ({share:.1%}), answers of {status.bytes / 1e6:,.1f} MB; {state}"
    )

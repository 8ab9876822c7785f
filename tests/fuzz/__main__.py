"""`python -m tests.fuzz --minutes N`: see the package."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import date
from pathlib import Path

import click

from .child import MODULES, Job
from .driver import ROOT, Found, run_jobs

FOUND = ROOT / "fuzz-found"
RECORDS = ROOT / "notebooks" / "records"
SHARES = {"meshes": 0.5, "rays": 0.25, "files": 0.1, "loaders": 0.15}
"""Of the time, what each kind gets."""

MIN_RECORD_MINUTES = 1.0
"""Minutes from which on a run is worth a record."""


@click.command()
@click.option("--minutes", default=1.0, show_default=True, type=click.FloatRange(min=0.0, min_open=True), help="For how long.")
@click.option("--seed", type=click.IntRange(0), help="Of all cases.  [the clock's]")
@click.option("--what", type=click.Choice(list(MODULES)), multiple=True, help="Only this; repeat.  [all]")
@click.option("--processes", type=click.IntRange(1), help="At a time.  [one a core]")
@click.option("--found", default=FOUND, type=click.Path(path_type=Path), help="Folder for what fails.  [fuzz-found]")
@click.option("--record/--no-record", default=None, help="Write a record to notebooks/records.  [from a minute on]")
@click.option("--replay", type=click.Path(exists=True, path_type=Path), multiple=True, help="Run these cases instead.")
def main(
    minutes: float,
    seed: int | None,
    what: Sequence[str],
    processes: int | None,
    found: Path,
    record: bool | None,
    replay: Sequence[Path],
) -> None:
    """Tries to break builders, traversals and readers of files. Exit status 1 if something broke."""
    seed = int(time.time()) if seed is None else seed
    processes, kinds = processes or os.cpu_count() or 1, list(what) or list(MODULES)
    if replay:
        jobs, seconds = replay_jobs(replay), LONGEST_REPLAY
    else:
        jobs, seconds = make_jobs(kinds, seed, processes, 60.0 * minutes), 60.0 * minutes
    begin = time.monotonic()
    with progress(seconds) as tell:
        result = run_jobs(jobs, found, lambda state: tell(time.monotonic() - begin, state), processes)
    took = time.monotonic() - begin
    click.echo(summary(result, seed))
    if record or (record is None and minutes >= MIN_RECORD_MINUTES and not replay):
        path = write_record(result, seed, kinds, processes, took)
        click.echo(f"recorded in {path}")
    raise SystemExit(1 if result.failures else 0)


LONGEST_REPLAY = 600.0
"""Seconds that cases which are run again may take together."""


def make_jobs(kinds: Sequence[str], seed: int, processes: int, seconds: float) -> list[Job]:
    """Jobs that fill the processes for that time: one after the other in each, every second of them with several threads."""
    share = {kind: SHARES[kind] / sum(SHARES[kind] for kind in kinds) for kind in kinds}
    return [
        Job(kind, seed, first, processes, 1 << 40, share[kind] * seconds, 3 if first % 2 else 1, "")
        for kind in kinds
        for first in range(processes)
    ]


def replay_jobs(paths: Sequence[Path]) -> list[Job]:
    """Jobs that run cases from files, a kind each."""
    from .cases import Case

    by_kind: dict[str, list[str]] = {}
    for path in paths:
        by_kind.setdefault(Case.load(path).what, []).append(str(path.resolve()))
    return [Job(kind, 0, 0, 1, len(own), LONGEST_REPLAY, 3, "", tuple(own)) for kind, own in by_kind.items()]


@contextmanager
def progress(seconds: float) -> Iterator:
    """A bar on stderr; what it is told is how long the run has been going, and what it has found."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=seconds)

        def tell(elapsed: float, found: Found) -> None:
            counts = ", ".join(f"{count:,} {kind}" for kind, count in found.done.items())
            text = f"{counts}; {len(found.failures)} failed"
            bar.update(task, completed=min(elapsed, seconds), description=text)

        yield tell


def summary(found: Found, seed: int) -> str:
    """What ran and what failed, in lines."""
    lines = [f"seed {seed}"]
    for kind, done in found.done.items():
        rate = done / max(found.seconds[kind], 1e-9)
        lines.append(f"{kind}: {done:,} cases, {found.refused[kind]:,} of them refused, {rate:.0f} a second and process")
    lines += [f"FAILED {path}: {reason}" for path, reason in found.failures.items()]
    return "\n".join(lines if found.failures else [*lines, "nothing failed"])


def write_record(found: Found, seed: int, kinds: Sequence[str], processes: int, took: float) -> Path:
    """Writes what ran to a dated file; a later run of the same day takes its place."""
    import numpy as np
    import warp as wp

    RECORDS.mkdir(parents=True, exist_ok=True)
    path = RECORDS / f"{date.today().isoformat()}-fuzz.md"
    command = " ".join(f"--what {kind}" for kind in kinds)
    rows = [
        f"| {kind} | {done:,} | {found.refused[kind]:,} | {done / max(found.seconds[kind], 1e-9):.0f} |"
        for kind, done in found.done.items()
    ]
    failures = [f"* `{path.name}`: {reason}" for path, reason in found.failures.items()] or ["Nothing failed."]
    text = [
        f"# Fuzz run of {date.today().isoformat()}",
        "",
        f"`python -m tests.fuzz --minutes {took / 60:.1f} --seed {seed} {command}`",
        "",
        f"{cpu_name()}, {processes} processes at a time; Python {platform.python_version()}, NumPy {np.__version__}, "
        f"Warp {wp.__version__}. Kernels are compiled within the time.",
        "",
        "| what | cases | refused | a second and process |",
        "|---|---|---|---|",
        *rows,
        "",
        *failures,
        "",
    ]
    path.write_text("\n".join(text))
    return path


def cpu_name() -> str:
    """The processor's name, as the system has it."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


if __name__ == "__main__":
    main()

"""`python -m tests.mutate`: see the package."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import click

from .mutation import areas, choose
from .report import record_lines, summary
from .runner import KILLED, Runner


@click.command()
@click.option("--area", "chosen", multiple=True, type=click.Choice(areas()), help="Only this table; repeat.  [all]")
@click.option("--only", multiple=True, metavar="AREA:N", help="Only this mutation; repeat.")
@click.option("--jobs", default=1, show_default=True, type=click.IntRange(1, 64), help="Mutations at a time.")
@click.option("--timeout", default=600.0, show_default=True, type=click.FloatRange(1.0), help="Seconds for the tests of one.")
@click.option("--list", "listed", is_flag=True, help="Say what would run, and run nothing.")
@click.option(
    "--record", is_flag=False, flag_value="", metavar="[FILE]", help="Write a record.  [a dated one in notebooks/records]"
)
def main(
    chosen: Sequence[str],
    only: Sequence[str],
    jobs: int,
    timeout: float,
    listed: bool,
    record: str | None,
) -> None:
    """Puts faults into copies of the product, one at a time, and runs tests that must notice. Exit status 1 if some do not."""
    try:
        mutations = choose(chosen, only)
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    if listed:
        for name, mutation in mutations.items():
            click.echo(f"{name}  {mutation.path}  {mutation.promise}")
        return
    start = time.monotonic()
    runner = Runner(jobs=jobs, timeout=timeout, tell=lambda line: click.echo(line, err=True), kernel_cache=kernel_cache())
    try:
        outcomes = runner.run(mutations)
    except KeyboardInterrupt:
        click.echo("interrupted", err=True)
        raise SystemExit(130) from None
    click.echo(summary(outcomes))
    if record is not None:
        from tests.records import write_record

        command = shlex.join(["python", "-m", "tests.mutate", *sys.argv[1:]])
        lines = record_lines(outcomes, command, time.monotonic() - start)
        click.echo(f"recorded in {write_record('mutations', 'Mutations', lines, Path(record) if record else None)}")
    raise SystemExit(0 if all(outcome.state == KILLED for outcome in outcomes) else 1)


def kernel_cache() -> Path:
    """Warp's folder of compiled kernels, which tests without mutations use and fill."""
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    return Path(wp.config.kernel_cache_dir)


if __name__ == "__main__":
    main()

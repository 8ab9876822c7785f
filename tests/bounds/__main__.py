"""`python -m tests.bounds --cases N`: see the package."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import click

sys.path.insert(0, str(Path(__file__).parents[1]))  # for records

from records import write_record

from .search import BATCH, BOUNDS, batches


@click.command()
@click.option("--cases", default=1_000_000, show_default=True, type=click.IntRange(1), help="Of each bound.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Of all cases.")
@click.option("--what", multiple=True, type=click.Choice(list(BOUNDS)), help="Only this bound; repeat.  [all]")
@click.option("--record/--no-record", default=False, show_default=True, help="Write a record to notebooks/records.")
def main(cases: int, seed: int, what: tuple[str, ...], record: bool) -> None:
    """Looks for counterexamples to bounds of errors. Exits with 1 if it finds one."""
    rows, counterexamples, begin = [], [], time.perf_counter()
    for name in what or BOUNDS:
        largest, searched, over, start = 0.0, 0, 0, time.perf_counter()
        for number, ratios in batches(name, cases, seed):
            searched += int((ratios > 0.0).sum())
            largest, own = max(largest, float(ratios.max())), int((ratios > 1.0).sum())
            over += own
            if own:
                counterexamples.append(f"{name}: batch {number}, case {int(ratios.argmax())}: {ratios.max():.4g}")
        seconds = time.perf_counter() - start
        rows.append(f"| {name} | {BOUNDS[name].proof} | {cases:,} | {searched:,} | {largest:.3f} | {over} | {seconds:.0f} |")
        click.echo(rows[-1])
    for line in counterexamples:
        click.echo(line)
    minutes = (time.perf_counter() - begin) / 60.0
    if record:
        only = "".join(f" --what {name}" for name in what)
        lines = [
            f"`python -m tests.bounds --cases {cases} --seed {seed}{only} --record`: {minutes:.0f} minutes, in batches of "
            f"{BATCH:,}, on a machine with other work.",
            "",
            "Ratio: the greatest error found over the error that the bound allows. Cases with an error: those in which the "
            "ratio is not 0; in the others nothing was rounded, or the bound says nothing of them.",
            "",
            "| bound | proof | cases | with an error | greatest ratio | counterexamples | seconds |",
            "|---|---|---|---|---|---|---|",
            *rows,
            *(["", *counterexamples] if counterexamples else []),
        ]
        click.echo(write_record("bounds", "Search for counterexamples to bounds", lines))
    raise SystemExit(1 if counterexamples else 0)


main()

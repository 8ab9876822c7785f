"""`python -m studies measure` makes one run of a study, `python -m studies figures` makes results and fills the pages."""

from __future__ import annotations

import json
import subprocess
from datetime import date
from pathlib import Path
from typing import Any

import click

from studies.evidence.single_runs import STUDIES, Effort
from studies.study_options import number
from wrt.bench.commands.command_options import usage_errors


@click.command("measure")
@click.argument("name", type=click.Choice([*STUDIES]))
@click.option("--models", type=click.Path(file_okay=False, exists=True, path_type=Path), help="Folder of the Stanford models.")
@number("--rounds", 5, "Rounds in which contenders take turns.")
@number("--size", 256, "Views have SIZE x SIZE pixels, a multiple of 64.", 64)
@number("--tests", 1 << 21, "Tests of a call.", 1 << 10)
@click.option(
    "--json", "json_file", required=True, type=click.Path(dir_okay=False, path_type=Path), help="File that is written."
)
def measure_command(name: str, models: Path | None, rounds: int, size: int, tests: int, json_file: Path) -> None:
    """Measures the figures of NAME once and writes them; several such runs make the results that pages quote."""
    from wrt.bench.core.benchmark_results import machine

    effort = Effort(rounds, size, tests)
    with usage_errors():
        found = STUDIES[name].run(models, effort)
    held = {"study": name, "machine": machine("cpu"), "settings": effort.settings, "date": str(date.today()), "tables": found}
    json_file.write_text(json.dumps(held), encoding="utf-8")


def described(machine: dict[str, Any]) -> str:
    """The machine of a run in a line."""
    return f"{machine['cpu']}, {machine['simd_bits']} bit vectors, kernels of {machine['lanes']} lanes, {machine['system']}"


def head() -> str:
    """The commit of the checkout."""
    found = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True)
    return found.stdout.strip()


@click.command("figures")
@click.option("--collect", "study", type=click.Choice([*STUDIES]), help="Makes results of the runs in FILES.")
@click.option("--bench", "table", help="Makes a table of speed, such as queries, of the reports of wrt bench RUN=FILE.")
@click.option("--measured", help="Date of these reports.  [today]")
@click.option("--commit", help="Commit that FILES were measured at.  [that of the checkout]")
@click.option(
    "--keep", nargs=2, metavar="NAME REASON", help="Says why a change of the code leaves the figures of NAME as they are."
)
@click.argument("files", nargs=-1)
def figures_command(
    study: str | None,
    table: str | None,
    measured: str | None,
    commit: str | None,
    keep: tuple[str, str] | None,
    files: tuple[str, ...],
) -> None:
    """Makes results and fills the pages from them: docs/documents.md, docs/claims.md, docs/performance.md, README.md."""
    from studies.evidence import bench_tables, page_filling, results

    with usage_errors():
        if bool(files) != bool(study or table) or (study and table):
            raise ValueError("--collect NAME, or --bench NAME, and FILES come together")
        if table:
            made = bench_tables.write_table(table, files, commit=commit or head(), measured=measured or str(date.today()))
            click.echo(f"wrote {made}")
        if study:
            runs = [json.loads(Path(file).read_text(encoding="utf-8")) for file in files]
            strangers = {run["study"] for run in runs} - {study}
            if strangers:
                raise ValueError(f"FILES are runs of {', '.join(sorted(strangers))}, not of {study}")
            of = f"python -m studies measure {study}"
            origin = {"of": of, "measured": runs[-1]["date"], "commit": commit or head()}
            about = {"origin": origin, "machine": described(runs[0]["machine"]), "settings": runs[0]["settings"]}
            found = results.collect(
                study, [run["tables"] for run in runs], STUDIES[study].is_counted, sources=STUDIES[study].sources, **about
            )
            click.echo(f"wrote {results.write(found)}")
        if keep:
            results.keep(*keep, today=str(date.today()))
        click.echo("filled " + (", ".join(page_filling.fill_pages()) or "nothing: all pages are as their results"))

"""Fills pages from results: claims with their verdicts, and tables of speed.

Pages have marks in comments. What stands between a mark and its end is written by `fill` and by nobody else:

    <!-- claim NAME -->figures and verdict<!-- end -->
    <!-- claims DOCUMENT -->   a table of all claims of a document   <!-- end -->
    <!-- table NAME -->        a table of notebooks/results/tables/   <!-- end -->
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from studies.evidence import tree_claims, triangle_claims
from studies.evidence.claims import CLAIMS, Claim
from studies.evidence.results import FOLDER, NOTEBOOKS, Results, load, studies_with_results
from studies.evidence.verdicts import Verdict

REGISTERED = (triangle_claims, tree_claims)
"""Modules that register claims."""

PAGES = ("README.md", "docs/documents.md", "docs/claims.md", "docs/performance.md")

MARK = re.compile(r"(<!-- (claim|claims|table) ([\w-]+) -->)(.*?)(<!-- end -->)", re.DOTALL)

NOT_MEASURED = "not measured yet"

Read = Callable[[str], Results]


def judged(claim: Claim, read: Read = load) -> tuple[Verdict | None, str]:
    """Verdict and figures of a claim; None if there are no results for it."""
    if read is load and not {*claim.needs} <= {*studies_with_results()}:
        return None, NOT_MEASURED
    return claim.judge({name: read(name) for name in claim.needs})


def sentence(claim: Claim) -> str:
    """Figures and verdict as they stand in a row of the page of the documents."""
    verdict, here = judged(claim)
    return here if verdict is None else f"{here}: **{verdict.word}**" + (f" ({verdict.why})" if verdict.why else "")


def origin(name: str) -> str:
    """When and how results were measured."""
    results = load(name)
    runs = max((measure.runs for row in results.rows for measure in row.measures.values()), default=0)
    return f"{results.origin['measured']}, {f'{runs} runs' if runs > 1 else 'counted'}"


def claims_table(document: str, *places: str) -> str:
    """All claims of a document, or those of the sections, tables and figures whose names begin with one of `places`."""
    lines = ["| claim | where | verdict | here | measured |", "| --- | --- | --- | --- | --- |"]
    for claim in CLAIMS.values():
        if claim.document == document and claim.place.startswith(places or ""):
            verdict, here = judged(claim)
            word = "-" if verdict is None else str(verdict)
            measured = "; ".join(dict.fromkeys(map(origin, claim.needs))) if verdict is not None else "-"
            lines.append(f"| {claim.says} | {claim.place} | {word} | {here} | {measured} |")
    return "\n".join(lines)


def table(name: str) -> str:
    """A table of speed, by its columns' forms."""
    held = json.loads((FOLDER / "tables" / f"{name}.json").read_text(encoding="utf-8"))
    if "from" in held:
        held = chosen(held)
    lines = ["| " + " | ".join(held["columns"]) + " |", "|" + " --- |" * len(held["columns"])]
    for label, *values in held["rows"]:
        cells = [shown(value, form) for value, form in zip(values, held["forms"], strict=True)]
        lines.append("| " + " | ".join([label, *cells]) + " |")
    return "\n".join(lines).replace("|  |", "| |")


def chosen(held: dict[str, Any]) -> dict[str, Any]:
    """A table whose cells are those of another: "rows" say for each cell row and column there; None is a dash."""
    other = json.loads((FOLDER / "tables" / f"{held['from']}.json").read_text(encoding="utf-8"))
    at = {row[0]: dict(zip(other["columns"][1:], row[1:], strict=True)) for row in other["rows"]}
    form = dict(zip(other["columns"][1:], other["forms"], strict=True))
    rows = []
    for label, *cells in held["rows"]:
        rows.append([label, *(None if cell is None else shown(at[cell[0]][cell[1]], form[cell[1]]) for cell in cells)])
    return {"columns": held["columns"], "forms": ["text"] * (len(held["columns"]) - 1), "rows": rows}


def shown(value: Any, form: str) -> str:
    """A number as text: "text", "range", "ms", "2gx" or "2fx" (times), or a format; several numbers with strokes."""
    if value is None:
        return "-"
    if form == "text":
        return str(value)
    if form == "range":
        return "{:.2f} ({:.2f} to {:.2f})".format(*value)
    if isinstance(value, list):
        return " / ".join(shown(part, form) for part in value)
    if form == "ms":
        return f"{value} ms"
    if form == "2gx":
        return f"{value:.0f}x" if value >= 10 else f"{value:.1f}x"
    return f"{value:.2f}x" if form == "2fx" else format(value, form)


def fill(text: str) -> str:
    """A page with everything between its marks made anew.

    Raises:
        KeyError: a mark names no claim.
        FileNotFoundError: a mark names no table.
    """

    def made(found: re.Match[str]) -> str:
        start, kind, name, _, end = found.groups()
        if kind == "claim":
            return f"{start}{sentence(CLAIMS[name])}{end}"
        return f"{start}\n{claims_table(name) if kind == 'claims' else table(name)}\n{end}"

    return MARK.sub(made, text)


def path_of(page: str) -> Path:
    """File of a page."""
    return NOTEBOOKS.parent / page


def fill_pages() -> list[str]:
    """Fills all pages; those that changed."""
    changed = []
    for page in PAGES:
        text = path_of(page).read_text(encoding="utf-8")
        new = fill(text)
        if new != text:
            path_of(page).write_text(new, encoding="utf-8")
            changed.append(page)
    return changed

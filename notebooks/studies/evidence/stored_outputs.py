"""Reads results from the tables that notebooks were committed with, and from those of records.

For studies that have not been run since their results are written as JSON: no number is typed, each is parsed. The date and
the commit are those at which the outputs of the cells last changed, or those of the record.
"""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from studies.evidence.results import NOTEBOOKS, Results, Row, write
from studies.evidence.verdicts import Measure, counted

NUMBER = re.compile(r"[+-]?\d[\d,]*(?:\.\d+)?")


def cells_of(notebook: str, commit: str | None = None) -> list[dict[str, Any]]:
    """Cells of a notebook, of the checkout or of a commit."""
    if commit is None:
        return json.loads((NOTEBOOKS / f"{notebook}.ipynb").read_text(encoding="utf-8"))["cells"]
    return json.loads(git("show", f"{commit}:notebooks/{notebook}.ipynb"))["cells"]


def git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=NOTEBOOKS.parent, capture_output=True, text=True, check=True).stdout


def texts(cell: dict[str, Any]) -> list[str]:
    """Texts of the outputs of a cell."""
    found = []
    for output in cell.get("outputs", []):
        data = output.get("data", {})
        found.append("".join(data.get("text/markdown") or output.get("text") or ""))
    return [text for text in found if text]


def tables(cell: dict[str, Any]) -> list[list[dict[str, str]]]:
    """Markdown tables among the outputs of a cell, a dict a row by its headings."""
    return [table for text in texts(cell) for table in tables_of(text)]


def tables_of(text: str) -> list[list[dict[str, str]]]:
    """Markdown tables of a text, a dict a row by its headings."""
    found, lines = [], []
    for line in [*text.splitlines(), ""]:
        if line.startswith("|"):
            lines.append([part.strip() for part in f"{line.rstrip()} "[1:].removesuffix("| ").split(" | ")])
        elif lines:
            found.append([dict(zip(lines[0], cells, strict=True)) for cells in lines[2:]])
            lines = []
    return found


def record(name: str) -> list[list[dict[str, str]]]:
    """Tables of a record."""
    return tables_of((NOTEBOOKS / "records" / f"{name}.md").read_text(encoding="utf-8"))


def numbers(text: str) -> list[float]:
    """All numbers in a text, without separators of thousands."""
    return [float(number.replace(",", "")) for number in NUMBER.findall(text)]


def alone(text: str) -> Measure:
    """The first number of a text; its spread was not stored, so that one run is known."""
    value = numbers(text)[0]
    return Measure(value, value, value, 1)


def ray_distribution() -> Iterable[Row]:
    """Precision of estimates."""
    cells = cells_of("ray_distribution")
    for row in tables(cells[3])[0]:
        yield Row("precision", {"error": row["error"]}, {"percent": counted(numbers(row["here"])[0])})


def leaf_sizes() -> Iterable[Row]:
    """Tests that cullings avoid, by the size of leaves."""
    for row in record("2026-11-22-leaf-sizes")[0]:
        key = {"mesh": row["mesh"].split(",")[0], "leaf": row["divided down to"]}
        avoided = {
            name: counted(numbers(row[column])[0])
            for name, column in (("vertex", "avoided by vertex culling"), ("interval", "by intervals"))
        }
        sizes = {
            "nodes": counted(numbers(row["nodes"])[0]),
            "triangles": counted(numbers(row["triangles in a visited leaf"])[0]),
        }
        yield Row("leaves", key, avoided | sizes | {"speed": alone(row["million rays/s, vertex"])})


def bounces() -> Iterable[Row]:
    """Claims on bounces: median and range over scenes."""
    claims = next(table for table in record("2026-11-22-bounces") if "claim" in table[0])
    for row in claims:
        values = numbers(row["here"].replace(" to ", " "))
        if "(" in row["here"]:
            yield Row(
                "claims",
                {"claim": row["claim"]},
                {"median": counted(values[0]), "least": counted(values[1]), "greatest": counted(values[2])},
            )


@dataclass(frozen=True)
class Source:
    """What is read, and from where.

    Attributes:
        read: makes the rows.
        of: name of a notebook, or of a record.
        cells: of the notebook; none for a record.
        modules: that make the figures.
    """

    read: Callable[[], Iterable[Row]]
    of: str
    cells: tuple[int, ...]
    modules: tuple[str, ...]


SOURCES = {
    "ray_distribution": Source(ray_distribution, "ray_distribution", (3,), ("studies.known_rays.ray_distribution",)),
    "leaf_sizes": Source(leaf_sizes, "2026-11-22-leaf-sizes", (), ("studies.kdtrees.leaf_sizes",)),
    "bounces": Source(bounces, "2026-11-22-bounces", (), ("studies.light.bounce_comparison", "studies.light.bounce_claims")),
}
"""By the name of the results."""


def last_change(notebook: str, cell: int) -> tuple[str, str]:
    """Commit and date at which the tables of a cell became what they are."""
    now = tables(cells_of(notebook)[cell])
    commit, date = "", ""
    for line in git("log", "--format=%h %ad", "--date=short", "--", f"notebooks/{notebook}.ipynb").splitlines():
        at, day = line.split()
        if not any(tables(old) == now for old in cells_of(notebook, at) if old["cell_type"] == "code"):
            break
        commit, date = at, day
    return commit, date


def extract(name: str) -> Results:
    """Reads a notebook or a record and writes its results."""
    source = SOURCES[name]
    if source.cells:
        changes = sorted({last_change(source.of, cell)[::-1] for cell in source.cells})
        of = f"notebooks/{source.of}.ipynb, cells {', '.join(map(str, source.cells))}"
        origin = {"kind": "stored outputs", "of": of, "measured": changes[-1][0], "commit": changes[-1][1]}
        first = texts(cells_of(source.of)[1])
        machine = next((line for text in first for line in text.splitlines() if line.strip()), "not named by the notebook")
    else:
        path = f"notebooks/records/{source.of}.md"
        commit = git("log", "--reverse", "--format=%h", "--follow", "--", path).split()[0]
        origin = {"kind": "record", "of": path, "measured": source.of[:10], "commit": commit}
        machine = "named in the record"
    cells = tuple(f"{source.of}.ipynb[{cell}]" for cell in source.cells)
    results = Results(name, origin, machine, {}, (*source.modules, *cells), list(source.read()))
    write(results)
    return results

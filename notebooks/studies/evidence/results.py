"""Results of studies as JSON in notebooks/results/: values with their spread, and what they came from.

A file has "study", "origin" (the command, the date, and the commit), "machine", "settings", "code" (the sources
that made it and their hash) and "rows". A row has the "table" that it belongs to, a "key" (scene, test and so on) and
"measures": by the name of a quantity its median, least and greatest value and the number of runs, 0 for what is counted.

The hash covers what computes: comments, docstrings and the layout of the sources can change, statements cannot. After a
change the study is run again, or `python -m studies figures --keep NAME REASON` says why its figures stay.
"""

from __future__ import annotations

import ast
import hashlib
import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from studies.evidence.verdicts import Measure, counted, measured

NOTEBOOKS = Path(__file__).resolve().parents[2]
"""Folder of the notebooks and of the package `studies`."""

FOLDER = NOTEBOOKS / "results"

VARYING = frozenset({"hits", "samples", "bytes"})
"""Whole numbers of a row that do not tell cases apart."""


@dataclass(frozen=True)
class Row:
    """Measures of one case: `table` of the study, `key` of the case."""

    table: str
    key: Mapping[str, Any]
    measures: Mapping[str, Measure]


@dataclass(frozen=True)
class Results:
    """What a study found.

    Attributes:
        study: name of the file.
        origin: "of" (the command), "measured" (a date), "commit".
        machine: where it ran.
        settings: of the runs.
        sources: modules of `studies`.
        rows: in the order of the study.
    """

    study: str
    origin: Mapping[str, str]
    machine: str
    settings: Mapping[str, Any]
    sources: Sequence[str]
    rows: Sequence[Row]

    def take(self, table: str, quantity: str, **key: Any) -> list[Measure]:
        """A quantity in all rows of a table that have these values; the case is named by the other parts of the key.

        Raises:
            ValueError: there is no such row.
        """
        found = []
        for row in self.rows:
            if row.table == table and quantity in row.measures and all(matches(row.key.get(k), v) for k, v in key.items()):
                rest = [str(v) for k, v in row.key.items() if k not in key or not isinstance(key[k], str)]
                found.append(replace(row.measures[quantity], case=", ".join(rest)))
        if not found:
            raise ValueError(f"results of {self.study!r} have no {quantity!r} in table {table!r} with {key}")
        return found


def matches(value: Any, wanted: Any) -> bool:
    """Whether a part of a key is the wanted one, or one of several."""
    return value in wanted if isinstance(wanted, tuple | set | frozenset) else value == wanted


def load(study: str) -> Results:
    """Reads a file of `FOLDER`.

    Raises:
        FileNotFoundError: there is none.
    """
    held = json.loads((FOLDER / f"{study}.json").read_text(encoding="utf-8"))
    rows = [
        Row(row["table"], row["key"], {name: Measure(*values) for name, values in row["measures"].items()})
        for row in held["rows"]
    ]
    return Results(held["study"], held["origin"], held["machine"], held["settings"], held["code"]["sources"], rows)


def write(results: Results, folder: Path | None = None, kept: Sequence[Mapping[str, str]] = ()) -> Path:
    """Writes a file with the present hash of its sources; `kept`: why its figures stayed when these changed."""
    held = {
        "study": results.study,
        "origin": dict(results.origin),
        "machine": results.machine,
        "settings": dict(results.settings),
        "code": {"sources": list(results.sources), "hash": code_hash(results.sources)},
    }
    if kept:
        held["code"]["kept"] = list(kept)
    rows = [
        {
            "table": row.table,
            "key": dict(row.key),
            "measures": {n: [*map(short, (m.value, m.least, m.greatest)), m.runs] for n, m in row.measures.items()},
        }
        for row in results.rows
    ]
    lines = ",\n".join("  " + json.dumps(row, ensure_ascii=False) for row in rows)
    folder = folder or FOLDER
    folder.mkdir(exist_ok=True)
    path = folder / f"{results.study}.json"
    head = json.dumps(held, ensure_ascii=False, indent=1).removesuffix("\n}")
    path.write_text(f'{head},\n "rows": [\n{lines}\n ]\n}}\n', encoding="utf-8")
    return path


def short(value: float) -> float:
    """Six significant digits."""
    return float(f"{value:.6g}")


def keep(study: str, reason: str, today: str) -> None:
    """Says that a change of the sources leaves the figures as they are: the new hash, with the reason and the date."""
    path = FOLDER / f"{study}.json"
    held = json.loads(path.read_text(encoding="utf-8"))
    if not reason.strip():
        raise ValueError("say why the figures stay")
    if held["code"]["hash"] == code_hash(held["code"]["sources"]):
        raise ValueError(f"the sources of {study!r} have not changed")
    write(load(study), kept=[*held["code"].get("kept", []), {"date": today, "reason": reason}])


def recorded_hash(study: str) -> str:
    """The hash of the sources with which a file was made."""
    return json.loads((FOLDER / f"{study}.json").read_text(encoding="utf-8"))["code"]["hash"]


def studies_with_results() -> list[str]:
    """Names of all files."""
    return sorted(path.stem for path in FOLDER.glob("*.json"))


def code_hash(sources: Iterable[str]) -> str:
    """Hash of the statements of modules, with the modules of `studies` that they import."""
    texts, waiting = {}, [*sources]
    while waiting:
        name = waiting.pop()
        if name in texts:
            continue
        tree = ast.parse(module_path(name).read_text(encoding="utf-8"))
        waiting += [module for module in imported(tree) if not module.startswith("studies.evidence")]
        texts[name] = statements(tree)
    return hashlib.sha256("\n".join(f"{name}\n{texts[name]}" for name in sorted(texts)).encode()).hexdigest()[:16]


def module_path(name: str) -> Path:
    """File of a module of `studies`."""
    return NOTEBOOKS / (name.replace(".", "/") + ".py")


def statements(tree: ast.Module) -> str:
    """A module without docstrings, comments and layout; of imports only the names, so that modules can move."""
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    names = sorted({alias.asname or alias.name for node in imports for alias in node.names})
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [line for line in body if line not in imports and not is_text(line)] or [ast.Pass()]
    return f"{names}\n{written(tree)}"


def written(node: object) -> str:
    """A syntax tree as text that is the same in all versions of Python: `ast.dump` writes fields that newer ones have added."""
    if isinstance(node, list):
        return f"[{', '.join(map(written, node))}]"
    if not isinstance(node, ast.AST):
        return repr(node)
    fields = [(name, value) for name, value in ast.iter_fields(node) if value is not None and value != []]
    return f"{type(node).__name__}({', '.join(f'{name}={written(value)}' for name, value in fields)})"


def is_text(line: ast.stmt) -> bool:
    """Whether a statement is a docstring."""
    return isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant)


def imported(tree: ast.Module) -> list[str]:
    """Modules of `studies` that a module imports."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            found += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return [name for name in found if name.startswith("studies.") and module_path(name).is_file()]


def collect(
    study: str, runs: Sequence[Mapping[str, Sequence[Mapping[str, Any]]]], is_counted: bool = False, **about: Any
) -> Results:
    """One result of several runs of the same study.

    Args:
        study: name of the file.
        runs: of each run its rows by table. Numbers with a decimal point are measures, all else is part of the key. One run
            whose rows have "rounds", "least" and "greatest" beside the "ratio" is as good as its rounds.
        is_counted: whether nothing is timed, so that one run is enough.
        about: further attributes of `Results`.

    Raises:
        ValueError: a run lacks a case that another has.
    """
    gathered: dict[tuple, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for run in runs:
        for table, rows in run.items():
            for row in rows:
                key = tuple(
                    (name, value) for name, value in row.items() if isinstance(value, str | int) and name not in VARYING
                )
                for name, value in row.items():
                    if isinstance(value, float):
                        gathered[table, key][name].append(value)
    rows = []
    for (table, key), measures in gathered.items():
        if len(runs) == 1 and "rounds" in measures:
            (value,), (least,), (greatest,), (rounds,) = (measures[name] for name in ("ratio", "least", "greatest", "rounds"))
            rows.append(Row(table, dict(key), {"ratio": Measure(value, least, greatest, int(rounds))}))
            continue
        lacking = [name for name, values in measures.items() if len(values) != len(runs)]
        if lacking:
            raise ValueError(f"{study}, table {table}, {dict(key)}: {', '.join(lacking)} in some of {len(runs)} runs only")
        rows.append(Row(table, dict(key), {name: gather(values, is_counted) for name, values in measures.items()}))
    return Results(study=study, rows=rows, **about)


def gather(values: Sequence[float], is_counted: bool) -> Measure:
    """A measure of the values of several runs; counted if they are all the same."""
    return counted(values[0]) if (is_counted or len(values) > 1) and min(values) == max(values) else measured(values)

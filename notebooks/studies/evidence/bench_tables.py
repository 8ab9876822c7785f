"""Tables of speed from reports of `wrt bench --json`: `python -m studies figures --bench NAME --commit C RUN=FILE ...`.

A table of `notebooks/results/tables` that comes from reports has a layout here. It says for each cell which run, mesh,
question, contender and quantity it shows. The runs are named on the command line; files of the same run are repetitions, of
which a cell shows the median, or the median and the range.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from studies.evidence.results import FOLDER

CLOSEST_AND_OCCLUSION = ("far", "near", "random", "shadow", "ao")

TARGETS = {"AVX-512": "avx512", "AVX2": "avx2"}
"""Names of runs by what rows say."""

LARGEST = "810,080 triangles"
SCENES = {"bunny": "bunny", "dragon_res2": "dragon_res2", "atrium": "atrium", LARGEST: "dragon_res2 810080"}
"""Names of meshes in reports by what rows say; the largest is the dragon with each triangle divided into four."""

FASTEST_EMBREE = "Embree"
"""The faster of the versions of Embree, in packets that were filled before the clock started."""


@dataclass(frozen=True)
class Place:
    """Where the number of a cell is.

    Attributes:
        run: name of the run.
        model: of the mesh; None for the only one of the report.
        workload: name of the rays; None for the build.
        contender: name of the row, "wrt" for the one that ratios refer to; `FASTEST_EMBREE` for the least of Embree's ratios.
        quantity: "ratio", to wrt in the same round; "million/s", of rays; "ms", a call.
    """

    run: str = ""
    model: str | None = None
    workload: str | None = None
    contender: str = "wrt"
    quantity: str = "ratio"

    def of(self, name: str) -> bool:
        """Whether a mesh of this name is meant."""
        return self.model in (None, name)


@dataclass(frozen=True)
class Layout:
    """A table: its rows and columns fill different fields of a `Place`.

    Attributes:
        corner: text above the names of rows.
        rows: fields by name of the row.
        columns: name, form (`page_filling.shown`) and fields; of a list of fields, several numbers are shown.
    """

    corner: str
    rows: Mapping[str, Mapping[str, Any]]
    columns: Sequence[tuple[str, str, Mapping[str, Any] | Sequence[Mapping[str, Any]]]]


def _ratios(*contenders: tuple[str, str, dict[str, Any]]) -> list[tuple[str, str, dict[str, Any]]]:
    return [(name, "2gx", {"contender": contender, **more}) for name, contender, more in contenders]


def _by_scene(form: str, targets: Mapping[str, str]) -> Layout:
    rows = {
        f"{target}, {shown}": {"run": run, "model": model}
        for target, run in targets.items()
        for shown, model in SCENES.items()
        if "threads" not in target or shown != LARGEST
    }
    columns = [(name, form, {"workload": name, "contender": FASTEST_EMBREE}) for name in CLOSEST_AND_OCCLUSION]
    return Layout("", rows, columns)


def _gpu() -> Layout:
    rows = {
        f"{kind}, {name}": {"workload": name}
        for kind, names in (("closest hit", ("far", "near", "random")), ("occlusion", ("shadow", "ao")))
        for name in names
    }
    columns: list[Any] = []
    for model in ("bunny", "dragon"):
        runs = [{"run": f"{model}-1m"}, {"run": f"{model}-4m"}]
        columns.append((f"{model}: wrt, million rays/s", ",.0f", [{**run, "quantity": "million/s"} for run in runs]))
        columns.append(("wp.Mesh", "2fx", [{**run, "contender": "wp.Mesh"} for run in runs]))
    return Layout("", rows, columns)


def _queries() -> Layout:
    names = ("view from afar", "view from near by", "random rays", "shadow rays", "ambient occlusion")
    rate = {"quantity": "million/s"}
    columns = [
        ("wrt, million/s", ",.0f", {"run": "avx512", **rate}),
        *_ratios(
            ("Embree", FASTEST_EMBREE, {"run": "avx512"}),
            ("Open3D 0.20", "Open3D", {"run": "avx512"}),
            ("`wp.Mesh`", "wp.Mesh", {"run": "one-thread"}),
            ("trimesh, embreex", "trimesh+embreex", {"run": "one-thread"}),
        ),
        ("AVX2: wrt, million/s", ",.0f", {"run": "avx2", **rate}),
        *_ratios(("AVX2: Embree", FASTEST_EMBREE, {"run": "avx2"}), ("AVX2: Open3D", "Open3D", {"run": "avx2"})),
        ("GPU: wrt, million/s", ",.0f", {"run": "gpu", **rate}),
        ("GPU: `wp.Mesh`", "2fx", {"run": "gpu", "contender": "wp.Mesh"}),
    ]
    rows = {name: {"workload": workload} for name, workload in zip(names, CLOSEST_AND_OCCLUSION, strict=True)}
    return Layout("rays", rows, columns)


def _builds() -> Layout:
    rows = {name: {"run": name} for name in ("bunny", "dragon")}
    own = ("wrt, BVH", "ms", {"quantity": "ms"})
    peers = (("Open3D",) * 2, ("Embree", FASTEST_EMBREE), ("wp.Mesh",) * 2, ("trimesh with embreex", "trimesh+embreex"))
    return Layout("", rows, [own, *_ratios(*((shown, contender, {}) for shown, contender in peers))])


def _all_hits() -> Layout:
    names = {"all hits, far": "all_far", "all hits, random": "all_random", "inside": "inside"}
    rows = {shown: {"workload": name} for shown, name in names.items()}
    columns = []
    for model in ("bunny", "dragon"):
        columns += _ratios(
            (f"{model}: Open3D", "Open3D", {"run": model}), ("trimesh with embreex", "trimesh+embreex", {"run": model})
        )
    return Layout("", rows, columns)


LAYOUTS = {
    "queries": _queries(),
    "by-scene-zen4": _by_scene("range", TARGETS),
    "by-scene-xeon": _by_scene(".2f", {**TARGETS, "AVX-512, 16 threads": "avx512-16"}),
    "builds": _builds(),
    "all-hits": _all_hits(),
    "gpu": _gpu(),
}
"""By the name of the table."""


def number(report: Mapping[str, Any], place: Place) -> float | None:
    """The number of a cell in one report; None if the contender was not there.

    Raises:
        ValueError: the report has no such mesh or no such question.
    """
    asked = [one for model in report["models"] if place.of(model["name"]) for one in model["questions"]]
    asked = [one for one in asked if one["workload"] == place.workload]
    if len(asked) != 1:
        what = f"{place.workload or 'build'} of {place.model or 'one mesh'}"
        raise ValueError(f"a report of the run {place.run!r} has {len(asked)} answers for {what}, and not one")
    if place.contender == FASTEST_EMBREE:
        return min(asked[0]["embree_ratios"], default=None)
    name = asked[0]["reference"] if place.contender == "wrt" else place.contender
    rows = [row for row in asked[0]["rows"] if row["name"].split(", ")[0] == name or row["name"] == name]
    row = max(rows, key=lambda row: row["threads"], default=None)
    if row is None or row["median"] is None:
        return None
    if place.quantity == "million/s":
        return row["rays_per_second"] / 1e6
    return 1e3 * row["median"] if place.quantity == "ms" else row["ratio"]


def cell(reports: Mapping[str, Sequence[Mapping[str, Any]]], place: Place, form: str) -> float | list[float] | None:
    """The median of a run's reports; of "range" with the least and the greatest."""
    mine = [one for one in reports.get(place.run, ()) if any(place.of(model["name"]) for model in one["models"])]
    if not mine:
        raise ValueError(f"no report of {place.model or 'any mesh'} in the run {place.run!r}; pass {place.run}=FILE")
    found = [value for report in mine if (value := number(report, place)) is not None]
    if not found:
        return None
    values = (median(found), min(found), max(found)) if form == "range" else (median(found),)
    rounded = [float(f"{value:.4g}") for value in values]
    return rounded if form == "range" else rounded[0]


def table_of(name: str, reports: Mapping[str, Sequence[Mapping[str, Any]]], *, commit: str, measured: str) -> dict[str, Any]:
    """A table as `notebooks/results/tables` holds it.

    Args:
        name: of a layout.
        reports: what `wrt bench --json` wrote, by the name of the run.
        commit: at which they were measured.
        measured: the date.

    Raises:
        ValueError: a run, a mesh or a question is missing.
    """
    layout = LAYOUTS[name]
    rows = []
    for label, mine in layout.rows.items():
        cells: list[Any] = []
        for _, form, given in layout.columns:
            places = [Place(**{**mine, **fields}) for fields in ([given] if isinstance(given, Mapping) else given)]
            found = [cell(reports, place, form) for place in places]
            cells.append(found[0] if len(found) == 1 else found)
        rows.append([label, *cells])
    machines = {run: {described(report["machine"]) for report in found} for run, found in reports.items()}
    for run, found in machines.items():
        if len(found) > 1:
            raise ValueError(f"reports of the run {run!r} are of different machines: {'; '.join(sorted(found))}")
    counts = ", ".join(f"{run} {len(found)}" for run, found in reports.items())
    origin = {"of": "wrt bench --json", "commit": commit, "measured": measured, "note": f"reports: {counts}"}
    return {
        "origin": origin,
        "machine": "; ".join(dict.fromkeys(text for found in machines.values() for text in found)),
        "columns": [layout.corner, *(column for column, *_ in layout.columns)],
        "forms": [form for _, form, _ in layout.columns],
        "rows": rows,
    }


def described(machine: Mapping[str, Any]) -> str:
    """A machine in a line."""
    where = machine["gpu"] or f"{machine['cpu']}, {machine['target']}, {machine['lanes']} lanes"
    return f"{where}, {machine['system']}"


def write_table(name: str, files: Sequence[str], *, commit: str, measured: str) -> Path:
    """Writes a table from files, each "RUN=FILE".

    Raises:
        ValueError: no layout of this name, a file without a run, or as in `table_of`.
    """
    if name not in LAYOUTS:
        raise ValueError(f"no layout {name!r}; choose from {', '.join(LAYOUTS)}")
    reports: dict[str, list[dict[str, Any]]] = {}
    for file in files:
        run, _, path = file.partition("=")
        if not path:
            raise ValueError(f"{file!r} does not name its run; write RUN=FILE")
        reports.setdefault(run, []).append(json.loads(Path(path).read_text(encoding="utf-8")))
    made = table_of(name, reports, commit=commit, measured=measured)
    rows = ",\n".join("  " + json.dumps(row, ensure_ascii=False) for row in made.pop("rows"))
    head = json.dumps(made, indent=1, ensure_ascii=False).removesuffix("\n}")
    path = FOLDER / "tables" / f"{name}.json"
    path.write_text(f'{head},\n "rows": [\n{rows}\n ]\n}}\n', encoding="utf-8")
    return path

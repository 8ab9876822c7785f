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


def spread(text: str, runs: int, scale: float = 1.0) -> Measure:
    """A measure from "0.88 (0.84 - 0.89)" or "94 (85 to 99)"."""
    value, least, greatest = (number * scale for number in numbers(text.replace(" - ", " to "))[-3:])
    return Measure(value, min(least, value), max(greatest, value), runs)


def inverse(measure: Measure) -> Measure:
    """Time ratio of a speed, or the reverse."""
    return Measure(1 / measure.value, 1 / measure.greatest, 1 / measure.least, measure.runs)


def alone(text: str, runs: int = 1, scale: float = 1.0) -> Measure:
    """The first number of a text; its spread was not stored, so that one run is known."""
    value = numbers(text)[0] * scale
    return Measure(value, value, value, runs)


def komatsu() -> Iterable[Row]:
    """Tables 2, 3 and 4."""
    cells = cells_of("komatsu")
    (second,) = tables(cells[5])
    for row in second:
        for name in ("Möller", "Projection", "Pluecker", "Proposed"):
            speed = spread(next(text for head, text in row.items() if head.startswith(name)), 3)
            yield Row("2", {"scene": row["scene"], "contender": name}, {"ratio": inverse(speed)})
    for row in tables(cells[9])[0]:
        key = {"scene": row["scene"], "contender": row["test"], "exit": row["exit"]}
        yield Row("3", key, {"tests": counted(numbers(row["tests"])[0] / 100)})
    for order in ("file", "tree", "exit"):
        (rows,) = tables(cells[13])
        for row in rows:
            yield Row("foreseen", {"contender": row["test"], "order": order}, {"nanoseconds": alone(row[f"order: {order}"])})
    for row in tables(cells[19])[0]:
        key = {"scene": row["scene"], "contender": row["test"], "traversal": row["traversal"]}
        yield Row("4", key, {"ratio": inverse(spread(row["speed (range)"], 5))})
    for row in tables(cells[21])[0]:
        key = {"scene": row["scene"], "contender": row["test"], "kind": row["rays"]}
        measures = {"ratio": inverse(alone(row["speed / Möller's"])), "ratio_counted": inverse(alone(row["counted"]))}
        yield Row("bundles", key, measures | {"pays_from": alone(row["pays from"])})


TESTS = {"Woop": "woop", "Baldwin-Weber": "baldwin_weber", "UTM": "ferko_utm", "hybrid": "ferko_hybrid"}


def pichler() -> Iterable[Row]:
    """Tables 6.1 to 6.4."""
    from studies.triangles.pichler_tables import LABELS

    cells = cells_of("pichler")
    (first,) = tables(cells[3])
    for row in first:
        for scene in ("needles", "stadium", "soup", "teapot"):
            yield Row("6.1", {"scene": scene, "variant": row["variant"]}, {"percent": counted(float(row[scene]))})
    for row in tables(cells[7])[0]:
        if not row["scene"].startswith("thesis"):
            for label, test in TESTS.items():
                key = {"scene": row["scene"], "mode": row["mode"], "test": test}
                yield Row(
                    "6.3", key, {"ratio": alone(row[label], scale=0.01), "hit_rate": counted(numbers(row["hit rate"])[0] / 100)}
                )
    tests = {label: test for test, label in LABELS.items()}
    for row in tables(cells[10])[0]:
        for scene in ("needles", "stadium"):
            key = {"scene": scene, "mode": "alone", "test": tests[row["variant"]]}
            yield Row("6.2", key, {"ratio": spread(row[scene], 5, 0.01)})
    for row in tables(cells[18])[0]:
        measures = {"error": counted(float(row["error, 1e-4"]) * 1e-4), "bias": counted(float(row["bias"]))}
        yield Row("6.4", {"scene": row["scene"], "test": row["test"]}, measures)


def dynamic() -> Iterable[Row]:
    """Rebuilds of subtrees, instances, groups, two trees, split threads."""
    cells = cells_of("dynamic")
    for row in tables(cells[6])[0]:
        counts = {name: counted(float(row[name])) for name in ("kept", "in parts", "built")}
        yield Row("rebuilds", {"motion": row["motion"], "tree": row["tree"], "tolerance": row["tolerance"]}, counts)
    for row in tables(cells[8])[0]:
        measures = {name: alone(row[f"{name}, ms"]) for name in ("update", "trace")}
        yield Row("instances", {"copies": row["copies"], "way": row["way"]}, measures)
    for row in tables(cells[10])[0]:
        for way, text in row.items():
            if way != "moving groups":
                yield Row("groups", {"moving": row["moving groups"], "way": way}, {"speed": alone(text)})
    for row in tables(cells[17])[0]:
        yield Row("ways", {"way": row["way"]}, {name: alone(row[f"{name}, ms"]) for name in ("update", "trace")})
    for row in tables(cells[19])[0]:
        measures = {name: alone(row[f"{column}, ms"]) for name, column in (("turns", "in turns"), ("split", "split"))}
        yield Row("threads", {"case": row["tree and view"]}, measures)


def traversal() -> Iterable[Row]:
    """Speeds against single rays, and nodes and tests a ray."""
    for row in tables(cells_of("traversal")[3])[0]:
        key = {"traversal": row["traversal"], "tree": row["tree"]}
        counts = {name: counted(float(row[f"{name} per ray"])) for name in ("nodes", "leaves", "triangles")}
        yield Row("speeds", key, {"speed": alone(row["speed against single rays"])} | counts)


def kdtree_builders() -> Iterable[Row]:
    """Times and costs against the builder `sweep`."""
    for row in tables(cells_of("kdtree_builders")[4])[0]:
        key = {"scene": row["scene"], "builder": row["builder"]}
        yield Row("builders", key, {"build": alone(row["build"]), "cost": counted(numbers(row["SAH cost"])[0])})


def ray_distribution() -> Iterable[Row]:
    """Precision of estimates, and the costs of Table 6.1."""
    cells = cells_of("ray_distribution")
    for row in tables(cells[3])[0]:
        yield Row("precision", {"error": row["error"]}, {"percent": counted(numbers(row["here"])[0])})


def komatsu_scenes() -> Iterable[Row]:
    """Table 2 on six scenes."""
    names = {"projection": "Projection", "Plücker": "Pluecker", "proposed": "Proposed"}
    for row in record("2026-11-23-komatsu-bundles")[0]:
        for column, name in names.items():
            yield Row("2", {"scene": row["scene"], "contender": name}, {"ratio": inverse(spread(row[column], 3))})


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
        yield Row("leaves", key, avoided | sizes | {"speed": alone(row["million rays/s, vertex"], 7)})


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


FAN_WAYS = {
    "Moeller and Trumbore with precomputed edges and normal": "moeller_trumbore_precomputed",
    "Havel and Herout": "havel_herout",
    "fans": "fans",
    "fans with precomputed edges": "fans, edges",
    "fans with precomputed edges and normals": "fans, edges, normals",
    "fans by Havel and Herout's planes": "fans, planes",
    "leaves of fans, BVH": "fans, bvh",
    "the same, planes": "fans, bvh, planes",
    "leaves of fans, kd-tree": "fans, kdtree",
    "leaves of 16 triangles at once, BVH": "bvh",
    "leaves of 16 triangles at once, kd-tree": "kdtree",
}
"""Ways of `fan_comparison` by their names in the record."""


def fans() -> Iterable[Row]:
    """Brute force over fans, and leaves of fans."""
    for table, rows in zip(("brute force", "trees"), record("2026-11-23-fan-trees"), strict=False):
        for row in rows:
            for scene, text in list(row.items())[1:]:
                yield Row(table, {"way": FAN_WAYS[row[""]], "scene": scene.split(",")[0]}, {"ratio": alone(text)})


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
    "komatsu": Source(
        komatsu, "komatsu", (5, 9, 13, 19, 21), ("studies.triangles.komatsu_tables", "studies.triangles.komatsu_packets")
    ),
    "komatsu_scenes": Source(komatsu_scenes, "2026-11-23-komatsu-bundles", (), ("studies.triangles.komatsu_tables",)),
    "pichler": Source(pichler, "pichler", (3, 7, 10, 18), ("studies.triangles.pichler_tables",)),
    "dynamic": Source(dynamic, "dynamic", (6, 8, 10, 17, 19), ("studies.moving.motion_costs",)),
    "traversal": Source(traversal, "traversal", (3,), ()),
    "kdtree_builders": Source(kdtree_builders, "kdtree_builders", (4,), ("studies.kdtrees.kdtree_comparison",)),
    "ray_distribution": Source(ray_distribution, "ray_distribution", (3,), ("studies.known_rays.ray_distribution",)),
    "leaf_sizes": Source(leaf_sizes, "2026-11-22-leaf-sizes", (), ("studies.kdtrees.leaf_sizes",)),
    "bounces": Source(bounces, "2026-11-22-bounces", (), ("studies.light.bounce_comparison", "studies.light.bounce_claims")),
    "fans": Source(fans, "2026-11-23-fan-trees", (), ("studies.triangles.fan_comparison",)),
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

"""The page of the documents: every row says what was built, names code that exists, and says so in one of three words."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest

from studies.known_rays import area_pictures, ray_distribution
from studies.triangles import komatsu_packets, komatsu_tables, pichler_tables
from wrt.builders.kdtree import KDTREE_BUILDERS
from wrt.kernels.on_demand import OnDemand
from wrt.kernels.traversal.mailbox import MAILBOXES
from wrt.kernels.traversal.packet import CULLINGS
from wrt.kernels.triangle import TRIANGLE_TESTS

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "documents.md").read_text(encoding="utf-8")

STUDIES = {
    "area_pictures": area_pictures,
    "komatsu_packets": komatsu_packets,
    "komatsu_tables": komatsu_tables,
    "pichler_tables": pichler_tables,
    "ray_distribution": ray_distribution,
}

ROWS = [
    tuple(cell.strip() for cell in line.strip("|").split(" | "))
    for line in PAGE.splitlines()
    if line.startswith("| ") and not line.startswith(("| ---", "| what"))
]

BUILDERS = {"between_medians", "spatial_median", "object_median"}
"""Builders that the chapter mentions within other rows."""


def found(name: str) -> bool:
    """Whether a dotted name leads to a module, or to something in one."""
    parts = name.split("(")[0].split(".")
    if parts[0] in STUDIES:
        return all(hasattr(STUDIES[parts[0]], part) for part in parts[1:])
    for split in range(len(parts), 0, -1):
        try:
            value = import_module(".".join(parts[:split]))
        except ModuleNotFoundError:
            continue
        for part in parts[split:]:
            value = getattr(value, part, None)
        return value is not None
    return False


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0][:40])
def test_a_row_is_complete(row):
    what, where, here = row
    status = re.match(r"\*(Built|In part|Not built)[*.,:]", here.replace("*.", "."))
    assert what, row
    assert status, f"{here!r} begins with none of the three words"
    names = re.findall(r"`([^`]+)`", where)
    if status.group(1) == "Built":
        assert names or "notebook" in where, "what is built is somewhere"
    for name in names:
        if name.startswith(("wrt ", "python -m studies ")) or name in ("pichler", "traversal", "komatsu"):
            continue  # a command, or a notebook
        assert (ROOT / name).is_file() if "/" in name else found(name), f"{name} does not exist"


def test_the_four_documents_stand_in_their_order():
    headings = re.findall(r"^## (.+)$", PAGE, re.MULTILINE)
    assert [heading.split()[0] for heading in headings] == ["On", "A", "Fast", "Ray", "Studies"]
    assert len(ROWS) > 100
    assert not found("wrt.kernels.triangle.nothing"), "a name that leads nowhere is told"
    assert found("wrt.KdTree")


def test_what_the_tables_have_is_not_said_to_be_missing():
    """Every builder, culling and mailbox of the survey is named; of what is missing, no table has an entry."""
    for name in KDTREE_BUILDERS.keys() - BUILDERS - {"lazy"}:
        build = KDTREE_BUILDERS[name].build
        module = f"classics.{build.module}" if isinstance(build, OnDemand) else f"kdtree.{name}"
        assert f"wrt.builders.{module}`" in PAGE, name
    for name in CULLINGS.keys() - {"none"}:
        assert name in PAGE.replace("interval_culling", "interval").replace("inverse_frustum", "frustum"), name
    missing = " ".join(" ".join(row[:2]) for row in ROWS if row[2].startswith("*Not built"))
    assert not {name for name in (*KDTREE_BUILDERS, *MAILBOXES, *TRIANGLE_TESTS) if f"`{name}`" in missing}

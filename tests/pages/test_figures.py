"""Figures in pages are those of the results, verdicts are the computed ones, and results are of the code that there is."""

from __future__ import annotations

import json
import re

import pytest

from studies.evidence import page_filling, results
from studies.evidence.claims import CLAIMS
from studies.evidence.page_filling import MARK, PAGES, fill, path_of
from studies.evidence.papers import DOCUMENTS, KOMATSU_2, KOMATSU_4, PICHLER_61, TABLES, Table, break_even
from studies.evidence.single_runs import STUDIES
from studies.evidence.verdicts import FAILS, HOLDS

REMEDY = "`cd notebooks; python -m studies figures` fills the pages"

HELD = results.studies_with_results()


def read(page: str) -> str:
    return path_of(page).read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES)
def test_a_page_has_the_figures_of_the_results(page):
    assert fill(read(page)) == read(page), REMEDY


def test_a_typed_figure_is_found():
    """Another number, and another verdict, between marks."""
    text = read("docs/claims.md")
    figure = re.search(r"\d+\.\d+ times", text)[0]
    assert fill(text.replace(figure, "9.99 times")) == text
    assert fill(text.replace(f"| {FAILS} ", f"| {HOLDS} ")) == text
    assert text.count(f"| {FAILS} ") > 3


def test_marks_name_claims_and_are_closed():
    for page in PAGES:
        text = read(page)
        found = MARK.findall(text)
        assert len(found) == len(re.findall(r"<!-- (?:claim|claims|table) ", text)) == text.count("<!-- end -->"), page
        assert {name for _, kind, name, *_ in found if kind == "claim"} <= CLAIMS.keys()
        assert {name for _, kind, name, *_ in found if kind == "claims"} <= DOCUMENTS.keys()
    assert {claim.document for claim in CLAIMS.values()} == DOCUMENTS.keys()


@pytest.mark.parametrize("study", HELD)
def test_results_are_of_the_code_that_there_is(study):
    sources = results.load(study).sources
    assert results.recorded_hash(study) == results.code_hash(sources), (
        f"the code behind notebooks/results/{study}.json has changed: measure it again, or say why its figures stay:"
        f" python -m studies figures --keep {study} REASON"
    )


def test_the_hash_is_of_statements():
    """It changes with them, and not with comments and docstrings."""
    import ast

    first, same, other = (ast.parse(text) for text in ('"""One."""\nx = 1\n', "# Two.\nx  =  1\n", "x = 2\n"))
    assert results.statements(first) == results.statements(same) != results.statements(other)
    assert results.code_hash(["studies.triangles.komatsu_tables"]) != results.code_hash(["studies.triangles.isolated_tests"])


def test_every_claim_has_results_or_says_that_it_has_none():
    for claim in CLAIMS.values():
        assert {*claim.needs} <= STUDIES.keys(), claim.name
        verdict, here = page_filling.judged(claim)
        assert here
        assert (verdict is None) == (not {*claim.needs} <= {*HELD}), claim.name


def test_claims_of_some_sections():
    """As notebooks show them."""
    every, some = (page_filling.claims_table(*key).splitlines() for key in (("rahikainen",), ("rahikainen", "4.1", "5")))
    assert some[:2] == every[:2]
    assert some[2:] == [line for line in every[2:] if line.split(" | ")[1].startswith(("4.1", "5"))]
    assert 2 < len(some) < len(every)


@pytest.mark.parametrize("path", sorted(results.NOTEBOOKS.glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebooks_were_stored_with_the_verdicts_that_there_are(path):
    """What a cell shows last, if it shows claims."""
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        called = re.search(r"^Markdown\(claims_table\((.*)\)\)$", "".join(cell["source"]), re.MULTILINE)
        if called:
            stored = "".join(cell["outputs"][-1]["data"]["text/markdown"])
            assert stored == page_filling.claims_table(*re.findall(r'"([^"]*)"', called[1])), "run the notebook again"


def test_quotes_of_the_papers():
    """What the texts of the papers say of their own tables."""
    gains = KOMATSU_4.ratio("Möller", "Proposed")
    assert [round(gains[name], 2) for name in KOMATSU_4.columns] == [1.03, 1.03, 1.03, 1.02, 1.43, 1.31]
    assert break_even("Proposed", "Projection") == 6
    speeds = KOMATSU_2.ratio("Möller", "Proposed").values()
    assert 1.1 < min(speeds) < max(speeds) < 1.3
    saved = [100 * a / b for a, b in zip(PICHLER_61.rows["3x, p.es."], PICHLER_61.rows["3x"], strict=True)]
    assert [round(value) for value in saved] == [84, 81, 85]
    assert all(table.document in DOCUMENTS and table.place and table.read for table in TABLES)
    with pytest.raises(ValueError, match="2 numbers, 1 columns"):
        Table("komatsu", "9", "nowhere", "none", ("one",), {"row": (1, 2)})


def test_tables_of_speed_say_what_they_are_of():
    folder = results.FOLDER / "tables"
    held = {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in folder.glob("*.json")}
    marked = {name for page in PAGES for _, kind, name, *_ in MARK.findall(read(page)) if kind == "table"}
    assert marked == held.keys()
    for name, table in held.items():
        assert "from" in table or {"commit", "measured", "note"} <= table["origin"].keys(), name


def test_tables_of_one_run_agree():
    """The bunny's row of the comparison by scene, and the first table."""
    first, scenes = (
        json.loads((results.FOLDER / "tables" / f"{name}.json").read_text()) for name in ("queries", "by-scene-zen4")
    )
    for column, row in (("Embree", "AVX-512, bunny"), ("AVX2: Embree", "AVX2, bunny")):
        mine = [values[first["columns"].index(column)] for values in first["rows"]]
        theirs = next(values[1:] for values in scenes["rows"] if values[0] == row)
        assert [f"{a:.1f}" for a in mine] == [f"{middle:.1f}" for middle, *_ in theirs]


@pytest.mark.parametrize(
    ("value", "form", "text"),
    [
        (None, ".2f", "-"), (19.2, "2gx", "19x"), (3, "2gx", "3.0x"), (1.266, "2fx", "1.27x"),
        ([4240, 9110], ",.0f", "4,240 / 9,110"),
        ([1.0, 0.9, 1.1], "range", "1.00 (0.90 to 1.10)"), ("as it is", "text", "as it is"), (13, "ms", "13 ms"),
    ],
)  # fmt: skip
def test_numbers_as_text(value, form, text):
    assert page_filling.shown(value, form) == text

"""Every study has a command, is imported by nobody in the package, and stands in one list."""

from __future__ import annotations

import ast
import json
import re
from importlib import import_module
from pathlib import Path

import pytest
from click.testing import CliRunner
from support import import_graph

from studies.__main__ import COMMANDS, studies
from studies.row_studies import ROW_STUDIES

ROOT = Path(__file__).resolve().parents[2]


def test_the_list_has_every_study():
    listed = CliRunner().invoke(studies, ["--help"]).output
    assert all(name in listed for name in (*COMMANDS, *ROW_STUDIES))
    assert not COMMANDS.keys() & ROW_STUDIES.keys()


@pytest.mark.parametrize("name", [*COMMANDS, *ROW_STUDIES])
def test_a_study_says_what_it_takes(name):
    done = CliRunner().invoke(studies, [name, "--help"])
    assert done.exit_code == 0, done.output
    assert "Usage:" in done.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["layouts", "--builder", "nothing"], "'nothing' is not one of"),
        (["layouts", "--allocations", "--compact"], "--allocations and --compact are different comparisons"),
        (["ray-aware", "--traversal", "nothing"], "'nothing' is not one of"),
    ],
)
def test_a_study_refuses_what_it_cannot_do(arguments, message):
    done = CliRunner().invoke(studies, arguments)
    assert done.exit_code != 0
    assert message in done.output
    assert "Traceback" not in done.output


@pytest.mark.parametrize(("module", "attribute"), ROW_STUDIES.values())
def test_row_studies_exist(module, attribute):
    assert callable(getattr(import_module(f"studies.{module}"), attribute))


def test_rows_are_printed_and_written(tmp_path):
    """Of a study that takes a mesh."""
    options = ["--size", "16", "--rounds", "1", "--json", str(tmp_path / "rows.json")]
    done = CliRunner().invoke(studies, ["packet-widths", "random_triangles", *options])
    assert done.exit_code == 0, done.output
    rows = json.loads((tmp_path / "rows.json").read_text())["rows"]
    assert [row["packet"] for row in rows] == [1, 16, 64, 256]
    assert all(column in done.output for column in rows[0])


def test_the_package_imports_no_study():
    for path in import_graph.modules().values():
        text = path.read_text()
        assert "from studies" not in text, path
        assert "import studies" not in text, path


def test_every_module_of_the_package_is_behind_a_command():
    """But for those that draw, which notebooks call."""
    from studies.evidence import single_runs
    from studies.evidence.results import NOTEBOOKS, imported, module_path

    waiting = [f"studies.{module}" for module, _ in (*COMMANDS.values(), *ROW_STUDIES.values())] + ["studies.__main__"]
    waiting += [source for study in single_runs.STUDIES.values() for source in study.sources]
    reached: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name not in reached:
            reached.add(name)
            waiting += imported(ast.parse(module_path(name).read_text(encoding="utf-8")))
    files = (NOTEBOOKS / "studies").rglob("*.py")
    every = {".".join(path.relative_to(NOTEBOOKS).with_suffix("").parts) for path in files if path.name != "__init__.py"}
    drawing = {"studies.kdtrees.kdtree_pictures", "studies.known_rays.area_pictures"}
    assert every - reached == drawing


def test_the_page_of_the_documents_names_every_study():
    page = (ROOT / "docs" / "documents.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"python -m studies ([\w-]+)", page)) | set(re.findall(r"`([\w-]+)`", page.split("## Studies")[1]))
    assert {*COMMANDS, *ROW_STUDIES} <= listed

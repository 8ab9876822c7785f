"""Every study has a command, is imported by nobody in the package, and stands in one list."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path

import import_graph
import pytest
from click.testing import CliRunner

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

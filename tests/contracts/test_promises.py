"""The table of promises names tests that are there, and commands that the command line knows."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from wrt.cli import main

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "promises.md"
ROWS = [
    line for line in PAGE.read_text().splitlines() if line.startswith("| ") and "---" not in line and "we promise" not in line
]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[2:40])
def test_every_promise_names_what_tests_it(row):
    tests = re.findall(r"`([^`]+)`", row.rsplit("|", 2)[1])
    assert tests, "no test is named"
    for test in tests:
        if test.startswith("wrt "):
            assert test.split()[1] in main.list_commands(None)
        elif test.startswith("python -m "):
            assert (ROOT / test.removeprefix("python -m ").replace(".", "/") / "__main__.py").is_file(), test
        else:
            assert re.search(r"^def test_", (ROOT / test).read_text(), re.MULTILINE), f"{test} has no test"


def test_the_table_is_not_empty():
    assert len(ROWS) > 20
    assert all(row.count("|") == 3 for row in ROWS)


@pytest.mark.parametrize("page", ["promises.md", "security.md"])
def test_links_lead_somewhere(page):
    for link in re.findall(r"\]\(([^)#]+)\)", (ROOT / "docs" / page).read_text()):
        assert (ROOT / "docs" / link).exists(), link

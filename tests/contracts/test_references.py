"""Docstrings cite works by keys of one table, `wrt.references`."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

from wrt.references import REFERENCES

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("wrt", "kernels", "builders", "notebooks/studies")
CITED = re.compile(r"^ *References: ((?:[^\n]|\n +(?=\S))*)", re.MULTILINE)


def citations() -> list[tuple[Path, str]]:
    """(file, what is cited), an item for each work; notes behind keys are in parentheses."""
    found = []
    for path in (path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))):
        for match in CITED.finditer(path.read_text(encoding="utf-8")):
            text = " ".join(match.group(1).replace('"""', "").split()).rstrip(".")
            found += [(path, item) for item in re.split(r"; (?![^(]*\))", text)]
    return found


FOUND = citations()


def test_what_is_cited_is_in_the_table():
    assert len(FOUND) > 400
    unknown = [
        (path.name, item) for path, item in FOUND if item.split(" ")[0] not in REFERENCES and not item.startswith("see `")
    ]
    assert not unknown


def test_what_is_in_the_table_is_cited():
    text = "\n".join(item for _, item in FOUND)
    assert not [key for key in REFERENCES if not re.search(rf"\b{re.escape(key)}(?![\w-])", text)]


def test_no_docstring_has_a_bibliography_of_its_own():
    paths = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")]
    assert not [path for path in paths if re.search(r"^ *References:\s*$", path.read_text(encoding="utf-8"), re.MULTILINE)]


def test_keys_are_those_of_the_works():
    """The year of a key is that of the work, and no work stands twice."""
    years = {key: year.group(1) for key in REFERENCES if (year := re.search(r"-(\d{4})", key))}
    assert [key for key, year in years.items() if year not in REFERENCES[key]] == []
    assert [work for work, count in Counter(REFERENCES.values()).items() if count > 1] == []

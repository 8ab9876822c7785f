"""Lists of files tell all and only what is there: in docstrings of packages, and in the table of headers."""

from __future__ import annotations

import ast
import re
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

ENTRY = re.compile(r"^(?:\* `(\w+)`(?=: )|(?: {4})?(\w+)(?:\.py|/)(?= +\S)|(\w+)(?= {2,}\S))", re.MULTILINE)
"""An entry of a list: "* `name`: what it is", "name.py   what it is", "name/   what it is" or, not indented, "name   what"."""


def listed(docstring: str) -> list[str]:
    """The files and folders that a docstring lists, if it has a list of at least two."""
    names = ["".join(forms) for forms in ENTRY.findall(docstring)]
    return names if len(names) > 1 else []


def present(folder: Path) -> list[str]:
    """Modules and packages in a package."""
    modules = [path.stem for path in folder.glob("*.py") if not path.stem.startswith("__")]
    return sorted(modules + [path.parent.name for path in folder.glob("*/__init__.py")])


DOCSTRINGS = {
    path.parent.relative_to(ROOT).as_posix(): ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    for room in ("kernels", "builders", "wrt", "tests")
    for path in sorted((ROOT / room).rglob("__init__.py"))
}
MAPS = {package: listed(text) for package, text in DOCSTRINGS.items() if listed(text)}


@pytest.mark.parametrize("package", MAPS)
def test_docstrings_list_what_is_there(package):
    assert sorted(MAPS[package]) == present(ROOT / package)


def test_lists_are_found():
    """In all forms."""
    assert {"kernels/shading", "kernels/influence", "wrt/viewer", "wrt/bench", "tests/bounds"} <= MAPS.keys()
    assert listed("Two.\n\n    one.py   first\n    two/     second") == ["one", "two"]
    assert listed("Two.\n\n* `one`: first.\n* `two`: second") == ["one", "two"]
    assert listed("None.\n\n    wrt render -o teapot.png        a picture\n\nThe end.") == []


def test_the_table_of_headers_is_complete():
    """docs/architecture.md names every header, some by a pattern, and no other."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    table = text[text.index("## C++ headers") : text.index("## Threads")]
    patterns = re.findall(r"`([\w*]+\.h)`", "\n".join(line for line in table.splitlines() if line.startswith("|")))
    headers = [path.name for path in (ROOT / "kernels" / "native").glob("*.h")]
    assert [name for name in headers if not any(fnmatch(name, pattern) for pattern in patterns)] == []
    assert [pattern for pattern in patterns if not any(fnmatch(name, pattern) for name in headers)] == []

"""What a type checker and an editor know of wrt: the stubs of tables of names, code that must pass and code that must not."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.typed.mypy_run import run_mypy
from tests.typed.stubs import ROOT, checked_imports, modules_with_stubs, modules_with_tables, stub_of, table_of

HERE = Path(__file__).parent

MARK = re.compile(r"  # mistake: ([a-z-]+)$")


def of_files(paths: list[Path]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("path", paths, ids=lambda path: path.relative_to(ROOT).as_posix())


@of_files(modules_with_stubs())
def test_stubs_are_those_of_the_tables(path):
    """A name that is added to a table is added to the stub by `python -m tests.typed.stubs`."""
    assert path.with_suffix(".pyi").read_text() == stub_of(path)


@of_files(sorted(set(modules_with_tables()) - set(modules_with_stubs())))
def test_modules_without_stubs_import_the_names_of_their_tables(path):
    """If `TYPE_CHECKING`."""
    assert checked_imports(path).items() >= table_of(path).items()


def test_no_stub_without_a_table():
    """A stub hides its module from type checkers."""
    assert set((ROOT / "wrt").rglob("*.pyi")) == {path.with_suffix(".pyi") for path in modules_with_stubs()}


def test_code_of_users(tmp_path):
    """mypy finds nothing in `user_code.py`, and in `user_mistakes.py` each marked line, by the marked code, and no other."""
    pytest.importorskip("mypy", reason="mypy is not installed: pip install 'wrt[test-all]'")
    mistakes = HERE / "user_mistakes.py"
    marked = {
        (number, found[1])
        for number, line in enumerate(mistakes.read_text().splitlines(), 1)
        if (found := MARK.search(line)) is not None
    }
    assert len(marked) > 10
    printed = run_mypy(tmp_path, ["--strict-optional", "--follow-imports=silent", str(HERE / "user_code.py"), str(mistakes)])
    errors = [line for line in printed.splitlines() if ": error:" in line]
    assert [line for line in errors if "user_mistakes.py:" not in line] == []
    numbers = {(int(line.split("user_mistakes.py:")[1].split(":")[0]), line[line.rindex("[") + 1 : -1]) for line in errors}
    assert numbers == marked, printed

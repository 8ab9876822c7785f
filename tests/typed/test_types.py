"""What a type checker and an editor know of wrt: the stubs of tables of names, code that must pass and code that must not."""

from __future__ import annotations

import re
from dataclasses import fields
from inspect import signature
from pathlib import Path

import pytest

from tests.typed.mypy_run import run_mypy
from tests.typed.stubs import ROOT, checked_imports, modules_with_stubs, modules_with_tables, stub_of, table_of
from wrt.imaging.ambient_rendering import AmbientRendering
from wrt.imaging.integrators import render_settings

HERE = Path(__file__).parent

PAGES = "README.md", "docs/start.md"
"""Pages whose first Python lines users copy."""

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


def test_options_of_pictures_are_those_that_there_are():
    shared = set(render_settings.SharedOptions.__annotations__)
    keywords = {name for name, one in signature(AmbientRendering).parameters.items() if one.kind is one.KEYWORD_ONLY}
    settings = {one.name for one in fields(render_settings.RenderSettings)}
    assert set(render_settings.AmbientOptions.__annotations__) == keywords
    assert set(render_settings.SettingOptions.__annotations__) == settings
    assert shared == keywords & settings


def test_code_of_users(tmp_path):
    """mypy finds nothing in `user_code.py` and in the lines that pages show first, and in `user_mistakes.py` each marked line,
    by the marked code, and no other."""
    pytest.importorskip("mypy", reason="mypy is not installed: pip install 'wrt[test-all]'")
    mistakes = HERE / "user_mistakes.py"
    marked = {
        (number, found[1])
        for number, line in enumerate(mistakes.read_text().splitlines(), 1)
        if (found := MARK.search(line)) is not None
    }
    assert len(marked) > 10
    files = [str(HERE / "user_code.py"), str(mistakes)]
    for page in PAGES:
        code = re.search(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)[1]
        files.append(str(tmp_path / f"{Path(page).stem.lower()}_lines.py"))
        Path(files[-1]).write_text(code)
    printed = run_mypy(tmp_path, ["--strict-optional", "--follow-imports=silent", *files])
    errors = [line for line in printed.splitlines() if ": error:" in line]
    assert [line for line in errors if "user_mistakes.py:" not in line] == []
    numbers = {(int(line.split("user_mistakes.py:")[1].split(":")[0]), line[line.rindex("[") + 1 : -1]) for line in errors}
    assert numbers == marked, printed

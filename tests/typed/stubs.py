"""What type checkers and editors read of modules whose names are loaded on first use.

A module such as `wrt` has a table `_HOME`, from public names to the modules that define them, and a `__getattr__` that reads
it, of which a type checker knows nothing. Its stub imports each name from there instead; old names are not in it.
`python -m tests.typed.stubs` writes the stubs; `test_types.py` compares them with the tables. A stub hides its module, so a
module that defines functions or classes of its own has none, and imports the names of its table if `TYPE_CHECKING`.
"""

from __future__ import annotations

import ast
import importlib
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

TABLE, BESIDE = "_HOME", "_BESIDE"

HEAD = "# Written by `python -m tests.typed.stubs` from the table of names in {source}.\n"


def has_table(path: Path) -> bool:
    """Whether a module assigns the table of names."""
    text = path.read_text()
    if TABLE not in text:  # most modules; all of them would take three seconds to parse
        return False
    targets = (
        target
        for node in ast.parse(text).body
        if isinstance(node, (ast.Assign, ast.AnnAssign))
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
    )
    return any(isinstance(target, ast.Name) and target.id == TABLE for target in targets)


@cache
def modules_with_tables() -> list[Path]:
    """Their files."""
    return [path for path in sorted((ROOT / "wrt").rglob("*.py")) if has_table(path)]


def defines_names(path: Path) -> bool:
    """Whether a module has functions or classes of its own."""
    return any(isinstance(node, (ast.FunctionDef, ast.ClassDef)) for node in ast.parse(path.read_text()).body)


def modules_with_stubs() -> list[Path]:
    """The files of modules that have nothing but a table of names, and constants."""
    return [path for path in modules_with_tables() if not defines_names(path)]


def checked_imports(path: Path) -> dict[str, str]:
    """The names that a module imports for type checkers only, and the module of each."""
    return {
        name.asname or name.name: node.module or ""
        for block in ast.parse(path.read_text()).body
        if isinstance(block, ast.If) and isinstance(block.test, ast.Name) and block.test.id == "TYPE_CHECKING"
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for name in node.names
    }


def table_of(path: Path) -> dict[str, str]:
    """The table of names of a module, with those that it does not list."""
    module = importlib.import_module(module_name(path))
    return getattr(module, TABLE) | getattr(module, BESIDE, {})


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def in_order(name: str) -> tuple[int, str]:
    """A key that sorts names as `ruff` sorts them: constants, classes, functions."""
    return (0 if name.isupper() else 1 if name[0].isupper() else 2), name


def stub_of(path: Path) -> str:
    """The text of the stub of a module with a table.

    Raises:
        ValueError: the module has a public function or class of its own, of which a stub from the table would know nothing.
    """
    module = importlib.import_module(module_name(path))
    table = table_of(path)
    lines = [HEAD.format(source=path.relative_to(ROOT).as_posix())]
    for name in sorted(table, key=lambda name: (table[name], in_order(name))):
        lines.append(f"from {table[name]} import {name} as {name}\n")
    lines.append("\n")
    names = sorted(module.__all__, key=in_order)
    for name in names:
        if name not in table:
            value = getattr(module, name)
            if type(value) not in (str, int, float, bool):
                raise ValueError(f"{module.__name__}.{name} is not in {TABLE}; move what it names to a module of its own")
            lines.append(f"{name}: {type(value).__name__}\n\n")
    lines.append("__all__ = [\n" + "".join(f'    "{name}",\n' for name in names) + "]\n")
    return "".join(lines)


def main() -> None:
    for path in modules_with_stubs():
        path.with_suffix(".pyi").write_text(stub_of(path))
        print(path.with_suffix(".pyi").relative_to(ROOT))


if __name__ == "__main__":
    main()

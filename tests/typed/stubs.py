"""Stubs of the modules whose names are loaded on first use, so that type checkers and editors see the objects.

A module such as `wrt` has a table `_HOME`, from public names to the modules that define them, and a `__getattr__` that reads
it, of which a type checker knows nothing. Its stub imports each name from there instead. `python -m tests.typed.stubs` writes
the stubs; `test_types.py` compares them with the tables.
"""

from __future__ import annotations

import ast
import importlib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

TABLE = "_HOME"

HEAD = "# Written by `python -m tests.typed.stubs` from the table of names in {source}.\n"


def has_table(path: Path) -> bool:
    """Whether a module assigns the table of names."""
    targets = (
        target
        for node in ast.parse(path.read_text()).body
        if isinstance(node, (ast.Assign, ast.AnnAssign))
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
    )
    return any(isinstance(target, ast.Name) and target.id == TABLE for target in targets)


def modules_with_tables() -> list[Path]:
    """Their files."""
    return [path for path in sorted((ROOT / "wrt").rglob("*.py")) if has_table(path)]


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def stub_of(path: Path) -> str:
    """The text of the stub of a module with a table.

    Raises:
        ValueError: the module has a public function or class of its own, of which a stub from the table would know nothing.
    """
    module = importlib.import_module(module_name(path))
    table: dict[str, str] = getattr(module, TABLE)
    lines = [HEAD.format(source=path.relative_to(ROOT).as_posix())]
    kinds = {name: 0 if name.isupper() else 1 if name[0].isupper() else 2 for name in table}
    for name in sorted(table, key=lambda name: (table[name], kinds[name], name)):
        lines.append(f"from {table[name]} import {name} as {name}\n")
    lines.append("\n")
    names = sorted(module.__all__)
    for name in names:
        if name not in table:
            value = getattr(module, name)
            if type(value) not in (str, int, float, bool):
                raise ValueError(f"{module.__name__}.{name} is not in {TABLE}; move what it names to a module of its own")
            lines.append(f"{name}: {type(value).__name__}\n\n")
    lines.append("__all__ = [\n" + "".join(f'    "{name}",\n' for name in names) + "]\n")
    return "".join(lines)


def main() -> None:
    for path in modules_with_tables():
        path.with_suffix(".pyi").write_text(stub_of(path))
        print(path.with_suffix(".pyi").relative_to(ROOT))


if __name__ == "__main__":
    main()

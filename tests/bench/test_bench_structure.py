"""The rooms of the benchmark: imports go from commands to comparisons, peers and core, and a file's name is found once."""

import ast
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BENCH = ROOT / "wrt" / "bench"
ORDER = ("core", "peers", "comparisons", "commands")
MAX_FILES = 13
"""A dozen and `__init__.py`."""


def modules_of_the_benchmark(path):
    """Names of the modules of the benchmark that a file imports, inside functions too."""
    for node in ast.walk(ast.parse(path.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        yield from (name.split(".")[2:] for name in names if name.startswith("wrt.bench."))


@pytest.mark.parametrize("room", ORDER)
def test_no_room_imports_from_one_above(room):
    below = ORDER[: ORDER.index(room) + 1]
    files = list((BENCH / room).rglob("*.py"))
    assert len(files) > 1
    for path in files:
        for module in modules_of_the_benchmark(path):
            assert module[0] in below, f"{path.relative_to(ROOT)} imports wrt.bench.{'.'.join(module)}"


def test_rooms_are_small_and_complete():
    folders = [BENCH, *(path.parent for path in BENCH.rglob("__init__.py") if path.parent != BENCH)]
    assert {path.name for path in BENCH.iterdir() if (path / "__init__.py").is_file()} == set(ORDER)
    for folder in folders:
        assert len(list(folder.glob("*.py"))) <= MAX_FILES, folder
    assert {path.parent for path in BENCH.rglob("*.py")} == set(folders)


def test_the_name_of_a_file_is_nowhere_else():
    names = Counter(path.name for room in ("kernels", "builders", "wrt") for path in (ROOT / room).rglob("*.py"))
    twice = {path.name for path in BENCH.rglob("*.py") if names[path.name] > 1}
    assert twice == {"__init__.py", "__main__.py"}

"""The rooms of the benchmark: imports go from commands to comparisons, peers and core."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BENCH = ROOT / "wrt" / "bench"
ORDER = ("core", "peers", "comparisons", "commands")


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


def test_rooms_are_complete():
    assert {path.name for path in BENCH.iterdir() if (path / "__init__.py").is_file()} == set(ORDER)

"""The house: imports go one way, `import wrt` is light, tables and public names are complete."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import wrt

ROOT = Path(__file__).resolve().parents[2]
ROOMS = {"kernels": "wrt.kernels", "builders": "wrt.builders", "wrt": "wrt"}
MAY_IMPORT = {
    "kernels": ("wrt.kernels",),
    "builders": ("wrt.kernels", "wrt.builders"),
    "wrt": ("wrt",),
}


def imported_modules(path: Path) -> set[str]:
    """Names of all modules that a file imports, inside functions too."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: import from the package's full name"
            names.add(node.module)
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
    return names


@pytest.mark.parametrize("room", ROOMS)
def test_imports_go_one_way(room):
    files = list((ROOT / room).rglob("*.py"))
    assert files
    for path in files:
        for name in imported_modules(path):
            if name == "wrt" or name.startswith("wrt."):
                allowed = any(name == prefix or name.startswith(prefix + ".") for prefix in MAY_IMPORT[room])
                assert allowed, f"{path.relative_to(ROOT)} imports {name}"


def test_builders_know_no_triangle_test_and_traversals_no_builder():
    for path in (ROOT / "builders").rglob("*.py"):
        assert not any(name.startswith("wrt.kernels.triangle") for name in imported_modules(path)), path
        assert not any(name.startswith("wrt.kernels.traversal") for name in imported_modules(path)), path


def test_every_folder_is_packaged():
    """A package that pyproject.toml does not list would be missing from the wheel."""
    if sys.version_info < (3, 11):
        pytest.skip("tomllib came with Python 3.11")
    import tomllib

    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    found = set()
    for room, package in ROOMS.items():
        for init in (ROOT / room).rglob("__init__.py"):
            parts = init.parent.relative_to(ROOT / room).parts
            found.add(".".join((package, *parts)))
    assert listed == found


def test_import_is_light():
    """`import wrt` and its first scene load neither an image, a plotting nor a command line library."""
    code = "import sys, wrt; wrt.Scene; print([m for m in HEAVY if m in sys.modules])"
    code = code.replace("HEAVY", "('trimesh', 'PIL', 'matplotlib', 'click', 'rich', 'scipy')")
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


def test_public_names():
    assert set(wrt.__all__) == set(dir(wrt))
    for name in wrt.__all__:
        value = getattr(wrt, name)
        assert name == "__version__" or value.__doc__, f"wrt.{name} has no docstring"
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = wrt.nothing


def test_public_methods_are_documented():
    for name in wrt.__all__:
        kind = getattr(wrt, name)
        if not isinstance(kind, type):
            continue
        for attribute, value in vars(kind).items():
            documented_in_class = f"{attribute}:" in (kind.__doc__ or "")
            if not attribute.startswith("_") and callable(value):
                assert value.__doc__ or documented_in_class, f"wrt.{name}.{attribute} has no docstring"


@pytest.mark.parametrize("query", ["intersect", "occluded"])
def test_classics_are_imported_on_demand(query):
    """`import wrt`, a scene of the default accelerator and a query import no classic builder; a classic builder does."""
    code = """
import sys, numpy as np, wrt
def classics(): return [name for name in sys.modules if name.startswith("wrt.builders.classics")]
mesh = wrt.scenes.build("teapot", level=2)
for accelerator in ("auto", "bvh", "kdtree"):
    wrt.Scene(mesh, accelerator, device="cpu").QUERY(np.ones((8, 3), np.float32) * 9, -np.ones((8, 3), np.float32))
before = classics()
wrt.Scene(mesh, wrt.KdTree(builder="naive"), device="cpu").complete()
print(before, "wrt.builders.classics.kdtree.naive" in classics())
"""
    result = subprocess.run([sys.executable, "-c", code.replace("QUERY", query)], capture_output=True, text=True, check=True)
    assert result.stdout.splitlines()[-1] == "[] True"

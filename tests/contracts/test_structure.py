"""The house: imports go one way, `import wrt` is light, tables and public names are complete."""

from __future__ import annotations

import argparse
import ast
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from types import SimpleNamespace

import pytest
from support import selection

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


def test_no_test_module_imports_another():
    """What several of them need is in the package `support`, which imports none of them either."""
    files = list((ROOT / "tests").rglob("*.py"))
    assert len(files) > 300
    for path in files:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in getattr(node, "names", []) if isinstance(node, ast.Import | ast.ImportFrom)]
            parts = {*".".join([getattr(node, "module", None) or "", *names]).split(".")}
            assert not [name for name in parts if name.startswith("test_") or name == "conftest"], f"{path}:{node.lineno}"


def test_builders_know_no_triangle_test_and_traversals_no_builder():
    for path in (ROOT / "builders").rglob("*.py"):
        assert not any(name.startswith("wrt.kernels.triangle") for name in imported_modules(path)), path
        assert not any(name.startswith("wrt.kernels.traversal") for name in imported_modules(path)), path


def test_the_wheel_is_complete(tmp_path):
    """Every file that git has in the three packages, in its place, and what the release adds; nothing else."""
    pytest.importorskip("hatchling", reason="hatchling is not installed: pip install 'wrt[test]'")
    listed = subprocess.run(
        ["git", "ls-files", "-z", *ROOMS, "pyproject.toml", "README.md", "LICENSE"], cwd=ROOT, capture_output=True
    )
    if listed.returncode != 0:
        pytest.skip("not a checkout")
    names = [name for name in listed.stdout.decode().split("\0") if (ROOT / name).is_file()]
    made = ["kernels/compiled/some_target/module.o", "kernels/compiled/some_target/module.meta"]
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes((ROOT / name).read_bytes())
    for name in made:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"compiled")
    (tmp_path / ".gitignore").write_bytes((ROOT / ".gitignore").read_bytes())
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path / "dist")]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    (wheel,) = (tmp_path / "dist").glob("wrt-*.whl")
    assert wheel.name.split("-")[1] == wrt.__version__
    with zipfile.ZipFile(wheel) as archive:
        found = {name for name in archive.namelist() if ".dist-info/" not in name}
    inside = [name for name in (*names, *made) if "/" in name and not name.endswith(".clang-format")]
    assert found == {name if name.startswith("wrt/") else f"wrt/{name}" for name in inside}
    assert "wrt/py.typed" in found
    assert {Path(name).suffix for name in found} >= {".py", ".h", ".json", ".typed", ".o"}


def test_import_is_light():
    """`import wrt` and its first scene load neither an image, a plotting nor a command line library."""
    code = "import sys, wrt; wrt.Scene; print([m for m in HEAVY if m in sys.modules])"
    code = code.replace("HEAVY", "('trimesh', 'PIL', 'matplotlib', 'click', 'rich', 'scipy')")
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


def test_classics_are_imported_on_demand():
    """`import wrt`, a scene of the default accelerator and its queries import no classic builder; a classic builder does."""
    code = """
import support.environment  # the flags of tests, whose kernels other tests have, too
import sys, numpy as np, wrt
def classics(): return [name for name in sys.modules if name.startswith("wrt.builders.classics")]
mesh = wrt.scenes.build("teapot", level=2)
for accelerator in ("auto", "bvh", "kdtree"):
    scene, rays = wrt.Scene(mesh, accelerator, device="cpu"), np.ones((8, 3), np.float32)
    scene.intersect(rays * 9, -rays)
    scene.occluded(rays * 9, -rays)
before = classics()
wrt.Scene(mesh, wrt.KdTree(builder="naive"), device="cpu").state.complete()
print(before, "wrt.builders.classics.kdtree.naive" in classics())
"""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")])}
    result = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert result.stdout.splitlines()[-1] == "[] True"


def test_slow_files_exist():
    assert [name for name in selection.SLOW if not (ROOT / name).is_file()] == []


class Item(SimpleNamespace):
    __hash__ = object.__hash__


def test_samples_of_turns_that_follow_each_other_have_all_cases():
    """And each sample has every file, and every test with many cases."""
    tests = {
        "one.py::test_a": 30,
        "one.py::test_b": 31,
        "one.py::test_c": 3,
        "one.py::test_d": 2,
        "one.py::test_e": 1,
        "two.py::test_f": 1,
    }
    items = [Item(nodeid=f"tests/{name}[{case}]") for name, count in tests.items() for case in range(count)]
    items.append(Item(nodeid="tests/three.py::test_g"))
    for first in (0, 7, 1042):
        drawn = [[item.nodeid for item in selection.sample(items, 3, first + turn)] for turn in range(3)]
        for nodes in drawn:
            of_tests = {node.partition("[")[0][-1] for node in nodes}
            assert {*"abcfg"} <= of_tests
            assert 24 <= len(nodes) <= 25
        assert {node for nodes in drawn for node in nodes} == {item.nodeid for item in items}
    assert selection.sample(items, 1, 5) == items


def test_samples_of_markers_have_all_other_tests():
    markers = {"a": ("slow",), "b": ("slow", "classics"), "c": ("studies",)}
    items = [Item(nodeid=f"one.py::test_{name}[{case}]", keywords=own) for name, own in markers.items() for case in range(6)]
    drawn = [selection.sample(items, 3, turn, ["classics", "studies"]) for turn in range(3)]
    assert all(own[:6] == items[:6] and len(own) == 6 + 4 for own in drawn)
    assert {item.nodeid for own in drawn for item in own} == {item.nodeid for item in items}


@pytest.mark.parametrize(
    ("chosen", "alone"),
    [
        ({}, True),
        ({"markexpr": "width"}, False),
        ({"keyword": "skip"}, False),
        ({"lf": True}, False),
        ({"args": "ARGS"}, False),
    ],
)
def test_alone_is_whoever_chooses_nothing(chosen, alone):
    """In the process that was called, and in one that pytest-xdist starts."""
    source = pytest.Config.ArgsSource[chosen.get("args", "TESTPATHS")]
    option = SimpleNamespace(**{"markexpr": "", "keyword": "", "lf": False} | chosen)
    config = SimpleNamespace(args_source=source, ArgsSource=pytest.Config.ArgsSource, option=option)
    assert selection.is_alone(config) is alone
    assert selection.is_alone(SimpleNamespace(workerinput={"is_alone": alone})) is alone


CHOOSER = """
from pathlib import Path
from support.selection import Skipped, named

def pytest_addoption(parser):
    parser.addoption("--write-skipped")
    parser.addoption("--was-skipped")

def pytest_configure(config):
    if config.option.write_skipped:
        config.pluginmanager.register(Skipped(config))

def pytest_collection_modifyitems(config, items):
    if config.option.was_skipped:
        items[:] = named(items, Path(config.option.was_skipped).read_text().splitlines())
"""

LACKING = """
import pytest

def test_a():
    pytest.importorskip("lacking_package")

@pytest.mark.xfail
def test_b():
    raise AssertionError

@pytest.mark.parametrize("case", ["one two", "x[y]"])
def test_c(case):
    if case.startswith("x"):
        pytest.importorskip("lacking_package")
"""


@pytest.mark.parametrize("processes", [[], ["-n", "2"]])
def test_what_was_skipped_runs_again(tmp_path, processes):
    """Tests, and files that skip as a whole, by whichever process; no others run when what they lacked is there."""
    if processes:
        pytest.importorskip("xdist", reason="pytest-xdist is not installed: pip install 'wrt[test]'")
    files = {
        "conftest.py": CHOOSER,
        "test_lacking.py": LACKING,
        "helper.py": "import pytest\npytest.importorskip('lacking_package')",
        "test_first.py": "import helper\ndef test_d(): pass",
        "test_second.py": "import helper\ndef test_e(): pass",
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT / "tests")])}
    command = [sys.executable, "-m", "pytest", "-q", "--rootdir", str(tmp_path)]
    options = {"cwd": tmp_path, "env": environment, "capture_output": True, "text": True, "check": True}
    subprocess.run([*command, *processes, "--write-skipped", "skipped"], **options)
    skipped = (tmp_path / "skipped").read_text().splitlines()
    assert skipped == ["test_first.py", "test_lacking.py::test_a", "test_lacking.py::test_c[x[y]]", "test_second.py"]
    (tmp_path / "lacking_package.py").write_text("")
    for again in (["--was-skipped=skipped"],) if processes else (["@skipped"], ["--was-skipped=skipped"]):
        assert subprocess.run([*command, *processes, *again], **options).stdout.splitlines()[-1].startswith("4 passed in")


def test_what_is_named_must_be_there():
    items = [Item(nodeid=f"tests/test_{name}.py::test_{name}[1]") for name in "abc"]
    assert selection.named(items, ["tests/test_b.py", "tests/test_c.py::test_c[1]"]) == items[1:]
    with pytest.raises(pytest.UsageError, match=r"no test is called tests/test_a\.py::test_b"):
        selection.named(items, ["tests/test_a.py", "tests/test_a.py::test_b"])
    assert selection.named(items, ["tests/test_a.py", "tests/test_skipped_again.py"]) == items[:1]


@pytest.mark.parametrize("text", ["", "0:1", "-1:1", "some", ":3", "1.5:1", "3", "3:some", "3:-1"])
def test_a_sample_needs_two_numbers(text):
    with pytest.raises(argparse.ArgumentTypeError, match="N is at least 1"):
        selection.as_sample(text)
    assert selection.as_sample("3:1042") == (3, 1042)

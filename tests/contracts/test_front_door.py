"""Public names: few in `wrt`, the rest in public modules, each documented; old ones warn, and nothing of ours uses them."""

from __future__ import annotations

import ast
import inspect
import json
import re
import subprocess
import sys
import warnings
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import wrt
from wrt.lazy_names import lazy_names
from wrt.scene.scene import ANALYSES

ROOT = Path(__file__).resolve().parents[2]
MOST_NAMES = 30

DOORS = [name for name in (*wrt.__all__, *wrt._BESIDE) if isinstance(getattr(wrt, name), ModuleType)]
"""Public modules."""

TABLES = ["wrt", *(f"wrt.{name}" for name in DOORS if hasattr(getattr(wrt, name), "_HOME"))]
MOVED = [(module, name, place) for module in TABLES for name, place in getattr(import_module(module), "_MOVED", {}).items()]
EVERY_NAME = ["__version__", *(name for module in TABLES for name in import_module(module).__all__)]


def test_few_names_at_the_front():
    assert len([name for name in wrt.__all__ if name != "__version__"]) <= MOST_NAMES
    assert set(wrt.__all__) == set(dir(wrt))
    assert not set(wrt._BESIDE) & set(dir(wrt))
    assert all(isinstance(getattr(wrt, name), ModuleType) for name in wrt._BESIDE)
    assert {"Scene", "TriangleMesh", "Hits", "render", "lights", "moving", "sensors"} <= set(dir(wrt))
    assert not {name for _, name, _ in MOVED} & set(dir(wrt))


@pytest.mark.parametrize("module", ["wrt", *(f"wrt.{name}" for name in DOORS)])
def test_listed_names_exist_and_are_documented(module):
    listed = import_module(module)
    assert inspect.getdoc(listed)
    assert len(set(listed.__all__)) == len(listed.__all__)
    assert set(listed.__all__) <= set(dir(listed))
    for name in listed.__all__:
        value = getattr(listed, name)
        has_own = name != "__version__" and not isinstance(value, np.dtype)
        assert not has_own or inspect.getdoc(value), f"{module}.{name} has no docstring"
        if isinstance(value, type):
            for attribute, member in vars(value).items():
                in_class = f"{attribute}:" in (value.__doc__ or "")
                if not attribute.startswith("_") and callable(member):
                    assert member.__doc__ or in_class, f"{module}.{name}.{attribute} has no docstring"
    with pytest.raises(AttributeError, match=f"module '{module}' has no attribute 'nothing'"):
        _ = listed.nothing


def test_errors_say_where_a_name_is():
    with pytest.raises(AttributeError, match=r"^module 'wrt' has no attribute 'Lidar'; it is wrt\.sensors\.Lidar$"):
        _ = wrt.Lidar
    with pytest.raises(AttributeError, match=r"^module 'wrt' has no attribute 'lidar'$"):
        _ = wrt.lidar
    scene = wrt.Scene(wrt.scenes.build("teapot", level=1), "bvh", device="cpu")
    with pytest.raises(AttributeError, match=r"; it is wrt\.analysis\.signed_distance\(scene, \.\.\.\)$"):
        _ = scene.signed_distance
    functions = [name for name in wrt.analysis.__all__ if inspect.isfunction(getattr(wrt.analysis, name))]
    of_scenes = [name for name in functions if next(iter(inspect.signature(getattr(wrt.analysis, name)).parameters)) == "scene"]
    assert ANALYSES.split() == of_scenes


def test_one_place_for_each_name():
    """No name is public in two places."""
    assert len(EVERY_NAME) == len(set(EVERY_NAME)) + 1  # __version__


@pytest.mark.parametrize("module", TABLES)
def test_tables_are_literal(module):
    """Tools read them without importing anything: a name and the module that defines it."""
    tree = ast.parse(Path(import_module(module).__file__).read_text())
    named = [node for node in tree.body if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)]
    (table,) = [node.value for node in named if node.targets[0].id == "_HOME"]
    assert ast.literal_eval(table) == import_module(module)._HOME


@pytest.mark.parametrize("module", TABLES)
def test_names_are_what_their_modules_define(module):
    """Also once submodules have been imported, which sets attributes of the package."""
    for name, home in import_module(module)._HOME.items():
        value = import_module(f"{module}.{name}") if home == module else getattr(import_module(home), name)
        assert getattr(import_module(module), name) is value


@pytest.mark.parametrize(("module", "name", "place"), MOVED)
def test_old_names_work_and_warn(module, name, place):
    old, new = import_module(module), import_module(place)
    said = re.escape(f"{module}.{name} is now {place}.{name}; the old name goes with the next release")
    with pytest.warns(DeprecationWarning, match=f"^{said}$") as caught:
        value = getattr(old, name)
    assert value is getattr(new, name)
    assert name in new.__all__
    assert name not in old.__all__
    assert [warning.filename for warning in caught] == [__file__]


def test_old_names_warn_where_they_are_imported():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        from wrt import FanScene  # noqa: F401
    assert {warning.filename for warning in caught} == {__file__}


def test_old_names_are_errors_in_our_tests():
    """By the setting in pyproject.toml."""
    with pytest.raises(DeprecationWarning, match=r"wrt\.lights\.Sky"):
        _ = wrt.Sky


def test_nothing_of_ours_uses_old_names():
    """In code, examples, notebooks and pages; records and the older part of the changelog are of their time.

    `user_mistakes.py` has what type checkers must refuse.
    """
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True)
    if listed.returncode != 0:
        pytest.skip("not a checkout")
    names = {module: "|".join(name for of, name, _ in MOVED if of == module) for module, _, _ in MOVED}
    old = re.compile("|".join(rf"(?<![\w./]){re.escape(module)}\.(?:{listed})\b(?![./])" for module, listed in names.items()))
    imported = re.compile(rf"from wrt import [^\n]*\b({'|'.join(name for module, name, _ in MOVED if module == 'wrt')})\b")
    found = []
    for path in map(Path, listed.stdout.decode().split("\0")):
        skipped = path.name in ("changelog.md", "user_mistakes.py", Path(__file__).name) or "records" in path.parts
        if path.suffix in (".py", ".md", ".ipynb", ".h", ".toml") and not skipped and (ROOT / path).is_file():
            text = (ROOT / path).read_text(encoding="utf-8")
            if path.suffix == ".ipynb":  # without the outputs: pictures are lines of a million letters
                text = "\n".join("".join(cell["source"]) for cell in json.loads(text)["cells"])
            found += [f"{path}: {match[0]}" for pattern in (old, imported) for match in pattern.finditer(text)]
    assert not found


def test_public_modules_are_light():
    """A table costs nothing: neither kernels nor scenes are imported until a name is used."""
    light = [name for name in DOORS if name not in ("device", "scenes")]
    code = f"import sys, wrt; [getattr(wrt, name) for name in {light}]; print([m for m in sys.modules if m[:4] == 'wrt.'])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert sorted(ast.literal_eval(result.stdout)) == sorted(["wrt.lazy_names", *(f"wrt.{name}" for name in light)])


def test_tables_name_submodules_by_their_package():
    module = ModuleType("wrt_tables_of_a_test")
    module.__all__ = ["Scene"]
    sys.modules[module.__name__] = module
    try:
        module.__getattr__, module.__dir__ = lazy_names(module.__name__, {"Scene": "wrt.scene.scene"}, {"Sky": "wrt.lights"})
        assert module.Scene is wrt.Scene
        assert "Scene" in vars(module)
        assert dir(module) == ["Scene"]
        with pytest.warns(DeprecationWarning, match=r"^wrt_tables_of_a_test\.Sky is now wrt\.lights\.Sky"):
            assert module.Sky is wrt.lights.Sky
        assert "Sky" not in vars(module)
    finally:
        del sys.modules[module.__name__]


INTERNALS = (
    "area_trees",
    "complete",
    "depth",
    "device_mesh",
    "exact_vertices",
    "lazy_tree",
    "parts",
    "record_bytes",
    "width",
)


def test_scenes_show_what_users_call():
    """Not what only wrt's own code needs: that is in `state`."""
    shown = {name for name in dir(wrt.Scene) if not name.startswith("_")}
    assert len(shown) <= 43
    assert {"intersect", "update", "save", "load", "tree", "bounds", "statistics"} <= shown
    assert not shown & {*INTERNALS, "of_state"}


@pytest.mark.parametrize("name", INTERNALS)
def test_old_members_of_scenes_warn(name):
    scene = wrt.Scene(wrt.scenes.build("teapot", level=1), "bvh", device="cpu")
    with pytest.warns(
        DeprecationWarning, match=rf"^wrt\.Scene\.{name} is now scene\.state\.{name}; the old name goes"
    ) as caught:
        old = getattr(scene, name)
    assert [warning.filename for warning in caught] == [__file__]
    new = getattr(scene.state, name)
    assert old == new or old is new
    with pytest.raises(AttributeError, match="'Scene' object has no attribute 'nothing'"):
        _ = scene.nothing

"""Examples in docstrings run as they stand, below the names that a reader has by then: a mesh, a scene, rays, a camera."""

from __future__ import annotations

import ast
import re
import textwrap
from collections.abc import Iterator
from functools import cached_property, reduce
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
import warp as wp
from support.docstring_names import LARGE, NEEDS, SETUPS

import wrt

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"(?:^|\n\n)((?: {4,}\S.*(?:\n|$)|\n(?= {4}))+)")
"""Lines of a docstring that stand further right, after an empty one."""

CALLED = re.compile(r"(?<![`\"'\w])(wrt|scene|hits|viewer)\.\w+[(.\]]")
"""Code, not a table or a file."""

MAY_HAVE = re.compile(r"^ {4}.*" + CALLED.pattern, re.MULTILINE)

PRIVATE = ("wrt/lazy_names.py",)
"""What no user reads."""


def blocks_of(node: ast.Module | ast.ClassDef | ast.FunctionDef, name: str) -> Iterator[tuple[str, list[str]]]:
    """The examples in the docstring of a module, class or function, and in those of what is in it, each with its name."""
    if blocks := [textwrap.dedent(one) for one in BLOCK.findall(ast.get_docstring(node) or "") if CALLED.search(one)]:
        yield name, blocks
    if not isinstance(node, ast.FunctionDef):
        for child in node.body:
            if isinstance(child, ast.ClassDef | ast.FunctionDef):
                yield from blocks_of(child, f"{name}.{child.name}" if isinstance(node, ast.ClassDef) else child.name)


def examples() -> dict[str, list[str]]:
    """The examples of docstrings of wrt by where they stand."""
    found = {}
    for path in sorted((ROOT / "wrt").rglob("*.py")):
        place, text = str(path.relative_to(ROOT)), path.read_text(encoding="utf-8")
        if place not in PRIVATE and MAY_HAVE.search(text):  # a third; parsing all would take seconds
            found |= {f"{place}:{name}": blocks for name, blocks in blocks_of(ast.parse(text), "")}
    return found


EXAMPLES = examples()


class Given:
    """What examples take as given, made when it is asked for."""

    SimpleNamespace, np, trimesh, wp, wrt = SimpleNamespace, np, trimesh, wp, wrt
    up = (0.0, 0.0, 1.0)
    mesh = cached_property(lambda self: wrt.scenes.build("teapot", level=2))
    scene = cached_property(lambda self: wrt.Scene(self.mesh))
    camera = cached_property(lambda self: wrt.PinholeCamera.framing(self.mesh, 16, 12))
    origins = cached_property(lambda self: np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32) * 5.0)
    directions = cached_property(lambda self: -self.origins)
    points = cached_property(lambda self: self.origins[:20])
    rays = cached_property(lambda self: wrt.Rays(self.origins, self.directions))
    hits = cached_property(lambda self: self.scene.intersect(self.rays))
    pose = cached_property(lambda self: trimesh.transformations.translation_matrix([0.0, -20.0, 8.0]))
    matrices = cached_property(lambda self: [np.eye(4), np.diag([2.0, 2.0, 2.0, 1.0])])
    lidar = cached_property(lambda self: wrt.sensors.Lidar.preset("velodyne_vlp16"))
    sensor = cached_property(lambda self: wrt.sensors.Camera.from_camera(self.camera)[0])
    lights = cached_property(lambda self: [wrt.lights.PointLight((0.0, -3.0, 8.0), 50.0)])


def names(code: str) -> dict[str, Any]:
    """What examples take as given, as far as its names are in the code: half of them need no scene."""
    given = Given()
    return {name: getattr(given, name) for name in {*re.findall(r"[A-Za-z]\w*", code)} if hasattr(Given, name)}


def run(code: str, path: Path, given: dict[str, Any]) -> None:
    """Runs code from a file: Warp reads the source of kernels."""
    path.write_text(code, encoding="utf-8")
    exec(compile(code, str(path), "exec"), given)


def test_there_are_examples_for_all_setups():
    assert len(EXAMPLES) > 80
    assert not [place for place in (*SETUPS, *NEEDS, *LARGE) if place not in EXAMPLES]


@pytest.mark.parametrize("place", EXAMPLES)
def test_example_runs(place, tmp_path, monkeypatch):
    """The example, after its set-up. Large numbers are made small, which is all that is changed. Names exist in those that are
    skipped, too."""
    code = "\n".join(EXAMPLES[place])
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Attribute) and re.fullmatch(r"wrt(\.\w+)+", ast.unparse(node)):
            reduce(getattr, ast.unparse(node).split(".")[1:], wrt)
    for package, extra in NEEDS.get(place, {}).items():
        pytest.importorskip(package, reason=f"{package} is not installed: pip install {extra!r}")
    monkeypatch.chdir(tmp_path)
    setup = SETUPS.get(place, "")
    given = names(f"{setup}\n{code}")
    run(setup, tmp_path / "setup.py", given)
    for large, small in LARGE.get(place, {}).items():
        assert large in code
        code = code.replace(large, small)
    run(code, tmp_path / "example.py", given)

"""Examples in docstrings run as they stand, below the names that a reader has by then: a mesh, a scene, rays, a camera."""

from __future__ import annotations

import ast
import re
import textwrap
from collections.abc import Iterator
from functools import reduce
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


def names() -> dict[str, Any]:
    """What examples take as given."""
    mesh = wrt.scenes.build("teapot", level=2)
    scene, camera = wrt.Scene(mesh), wrt.PinholeCamera.framing(mesh, 16, 12)
    origins = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32) * 5.0
    return {
        "SimpleNamespace": SimpleNamespace,
        "np": np,
        "trimesh": trimesh,
        "wp": wp,
        "wrt": wrt,
        "mesh": mesh,
        "scene": scene,
        "camera": camera,
        "origins": origins,
        "directions": -origins,
        "points": origins[:20],
        "rays": wrt.Rays(origins, -origins),
        "hits": scene.intersect(origins, -origins),
        "up": (0.0, 0.0, 1.0),
        "pose": trimesh.transformations.translation_matrix([0.0, -20.0, 8.0]),
        "matrices": [np.eye(4), np.diag([2.0, 2.0, 2.0, 1.0])],
        "lidar": wrt.sensors.Lidar.preset("velodyne_vlp16"),
        "sensor": wrt.sensors.Camera.from_camera(camera)[0],
        "lights": [wrt.lights.PointLight((0.0, -3.0, 8.0), 50.0)],
    }


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
    given = names()
    run(SETUPS.get(place, ""), tmp_path / "setup.py", given)
    for large, small in LARGE.get(place, {}).items():
        assert large in code
        code = code.replace(large, small)
    run(code, tmp_path / "example.py", given)

"""No function has more than 8 arguments: what belongs together is a struct, or a NamedTuple on the host.

Kernels are left out: their arguments are what a launch passes; and commands, whose arguments are what users write.
"""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MAX_ARGUMENTS = 8
MAKERS = ("kernel", "exact_kernel", "specialised_kernel")
"""Functions, and last names of decorators, that make a kernel of a function."""

PUBLIC = {
    "wrt/imaging/ambient_rendering.py: __init__",
    "wrt/disk/partitioned_scene.py: build",
    "wrt/query/api.py: count",
    "wrt/query/api.py: explain",
    "wrt/query/api.py: intersect",
    "wrt/query/api.py: intersect_all",
    "wrt/query/api.py: occluded",
    "wrt/query/batches/block_queries.py: closest_point_blocks",
    "wrt/query/batches/block_queries.py: count_blocks",
    "wrt/query/batches/block_queries.py: intersect_blocks",
    "wrt/query/batches/block_queries.py: occluded_blocks",
    "wrt/moving/skinned_scene.py: __init__",
    "wrt/sensors/image_sensor.py: capture",
    "wrt/sensors/lidar.py: scan",
    "wrt/viewer/live_view.py: view",
}
"""Functions with more arguments that are keywords which users write."""


def last_name(node: ast.expr) -> str:
    """The last name of a name, an attribute or a call of one."""
    node = node.func if isinstance(node, ast.Call) else node
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def kernels_of(tree: ast.Module) -> set[str]:
    """Names of functions that a file makes kernels of by a call."""
    calls = (node for node in ast.walk(tree) if isinstance(node, ast.Call) and last_name(node.func) in MAKERS)
    return {last_name(argument) for call in calls for argument in call.args[:1]}


def long_signatures(path: Path) -> set[str]:
    """`file: function` of those that have more arguments, other than kernels and commands; `self` does not count."""
    tree, found = ast.parse(path.read_text(encoding="utf-8")), set()
    kernels = kernels_of(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
            is_kernel = node.name in kernels or any(last_name(d) in MAKERS for d in node.decorator_list)
            is_command = any(last_name(d) in ("command", "option") for d in node.decorator_list)
            if len(names) - (names[:1] in (["self"], ["cls"])) > MAX_ARGUMENTS and not (is_kernel or is_command):
                found.add(f"{path.relative_to(ROOT).as_posix()}: {node.name}")
    return found


def test_functions_have_few_arguments():
    found = {
        name
        for room in ("kernels", "builders", "wrt")
        for path in (ROOT / room).rglob("*.py")
        for name in long_signatures(path)
    }
    assert found - PUBLIC == set(), "more than 8 arguments: put what belongs together into a struct"
    assert PUBLIC - found == set(), "these have few arguments now: remove them from the list"


def test_long_signatures_are_found(tmp_path, monkeypatch):
    monkeypatch.setattr(f"{__name__}.ROOT", tmp_path)
    nine, eight = ", ".join("abcdefghi"), ", ".join("abcdefgh")
    path = tmp_path / "file.py"
    path.write_text(
        f"def long({nine}): ...\ndef few({eight}): ...\ndef keywords(a, *, {nine[3:]}, j): ...\n"
        f"class C:\n    def method(self, {eight}): ...\n    def longer(self, {nine}): ...\n"
        f"@wp.kernel\ndef kernel({nine}): ...\ndef made({nine}): ...\nmade = specialised_kernel(made)\n"
        f"@native.func_native('a.h', '')\ndef native({nine}): ...\n@wp.func(inline=True)\ndef function({nine}): ...\n"
    )
    expected = {"long", "keywords", "longer", "native", "function"}
    assert long_signatures(path) == {f"file.py: {name}" for name in expected}

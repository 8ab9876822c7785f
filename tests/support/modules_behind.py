"""Which modules of the project a reader opens to understand a kernel or a build: counted from what runs.

A function is reached if it runs while a kernel is made, or while a tree is built, or if Warp compiles it into a kernel that is
reached. The modules behind a kernel are those of the functions reached, and those from which these functions import what they
name. Of a table of algorithms, only the entry that is used counts, with the table itself. What modules do when they are
imported does not count, nor do `wrt.kernels.runtime` and `compilation`, which compile and launch all kernels.

    python tests/support/modules_behind.py ray.md
    python tests/support/modules_behind.py kdtree_build.md
"""

from __future__ import annotations

import ast
import inspect
import sys
import types
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.runtime.native import with_included

MACHINERY = ("wrt.kernels.runtime", "wrt.kernels.compilation")


def names_of(code: types.CodeType) -> Iterator[str]:
    """Names that a function reads from its module, and those of functions inside it."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from names_of(constant)


@cache
def imports_of(module: str) -> dict[str, str]:
    """The module of the project from which each name of a module is imported."""
    found = {}
    for node in ast.walk(ast.parse(inspect.getsource(sys.modules[module]))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("wrt."):
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found[alias.asname or alias.name] = inner if inner in sys.modules else node.module
    return found


def is_ours(module: str | None) -> bool:
    """Whether a module is one of the project's that count."""
    return bool(module) and module.startswith(("wrt.kernels", "wrt.builders")) and not module.startswith(MACHINERY)


def called(run: Callable[[], Any]) -> tuple[list[Any], dict[types.CodeType, dict[str, Any]]]:
    """What the project's functions return that a function calls, and the globals of each of them."""
    ran: dict[types.CodeType, dict[str, Any]] = {}
    returned = []

    def see(frame: types.FrameType, event: str, value: object) -> None:
        if event in ("call", "return") and is_ours(frame.f_globals.get("__name__")) and frame.f_code.co_name != "<module>":
            ran[frame.f_code] = frame.f_globals
            if event == "return":
                returned.append(value)

    sys.setprofile(see)
    try:
        run()
    finally:
        sys.setprofile(None)
    return returned, ran


def kernels_in(values: Any) -> Iterator[wp.Kernel]:
    """The kernels among values."""
    for value in values:
        if isinstance(value, wp.Kernel):
            yield value
        elif isinstance(value, (tuple, list)):
            yield from kernels_in(value)


def modules_behind(run: Callable[[], Any]) -> tuple[set[str], set[str]]:
    """Modules behind what `run` makes or launches, and the headers of their native functions, with those that these include. It
    must not have run before in this process."""
    returned, ran = called(run)
    found, headers, reached = set(), set(), dict(ran)
    waiting: list[Any] = [kernel.func for kernel in kernels_in(returned)]
    for code, names in ran.items():
        waiting += [kernel.func for kernel in kernels_in(names.get(name) for name in names_of(code))]
    seen = set()
    while waiting:
        function = waiting.pop()
        headers |= {*getattr(function, "headers", ())}
        function = function.func if isinstance(function, wp.Function) else function
        if not isinstance(function, types.FunctionType) or function in seen or not is_ours(function.__module__):
            continue
        seen.add(function)
        reached[function.__code__] = function.__globals__
        inside = inspect.getclosurevars(function)
        for value in (*inside.nonlocals.values(), *inside.globals.values()):
            if isinstance(value, (wp.Function, types.FunctionType)):
                waiting.append(value)
            elif hasattr(value, "cls") and is_ours(value.cls.__module__):
                found.add(value.cls.__module__)
    for code, names in reached.items():
        found.add(names["__name__"])
        imports = imports_of(names["__name__"])
        found |= {imports[name] for name in names_of(code) if name in imports}
    return {module for module in found if is_ours(module)}, set(with_included(tuple(headers)))


def interleaved_rays() -> tuple[set[str], set[str]]:
    """Behind the kernel of closest hits of incoherent rays on a BVH."""
    from wrt.kernels.traversal.interleaved import interleaved_bvh
    from wrt.kernels.traversal.traversal_config import TraversalConfig

    return modules_behind(lambda: interleaved_bvh.make_interleaved_bvh_kernel(TraversalConfig("woop", 8)))


def in_place_build() -> tuple[set[str], set[str]]:
    """Behind a kd-tree that is built in place, without clipping."""
    import wrt
    from wrt.builders.kdtree import in_place
    from wrt.builders.kdtree.kdtree_config import KdTreeConfig
    from wrt.builders.triangle_boxes import triangle_boxes

    mesh = wrt.scenes.build("teapot", level=3)
    vertices = wp.array(mesh.vertices, dtype=wp.vec3, device="cpu")
    faces = wp.array(mesh.faces, dtype=wp.vec3i, device="cpu")
    boxes = triangle_boxes(vertices, faces)
    return modules_behind(lambda: in_place.build(boxes, KdTreeConfig()))


COUNTED = {"ray.md": interleaved_rays, "kdtree_build.md": in_place_build}
"""By page of docs/internals."""

if __name__ == "__main__":
    for names in COUNTED[sys.argv[1]]():
        print("\n".join(sorted(names)))

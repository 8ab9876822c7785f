"""The import graph of the package as it is installed: imports inside functions and for type checking count too."""

from __future__ import annotations

import ast
from collections.abc import Iterable
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
HOUSES = {"wrt": "wrt", "kernels": "wrt.kernels", "builders": "wrt.builders"}


@cache
def modules() -> dict[str, Path]:
    """File of each module, by its name."""
    found = {}
    for folder, package in HOUSES.items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = path.relative_to(ROOT / folder).with_suffix("").parts
            name = ".".join((package, *parts)).removesuffix(".__init__")
            found[name] = path
    return found


@cache
def imports() -> dict[str, set[str]]:
    """What each module imports of the others. All imports are absolute."""
    known = modules()
    graph = {}
    for name, path in known.items():
        used = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                used.update(alias.name for alias in node.names if alias.name in known)
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path}: import from the package's full name"
                for alias in node.names:
                    inner = f"{node.module}.{alias.name}"
                    used.update(module for module in (inner if inner in known else node.module,) if module in known)
        graph[name] = used - {name}
    return graph


def room_of(module: str) -> str:
    """The room of a module: a folder below wrt/, kernels/ or builders/, or a module that lies in one of these itself.

    `wrt` and `wrt.__main__` are the entrance: they name rooms, and are none.
    """
    parts = module.split(".")
    depth = 3 if parts[1:2] in (["kernels"], ["builders"]) else 2
    return ".".join(parts[:depth])


@cache
def room_imports() -> dict[str, set[str]]:
    """What each room imports of the others."""
    graph: dict[str, set[str]] = {}
    for module, used in imports().items():
        if module in ("wrt", "wrt.__main__"):
            continue
        room = graph.setdefault(room_of(module), set())
        room.update(room_of(other) for other in used if other != "wrt")
    return {room: used - {room} for room, used in graph.items()}


def circle(graph: dict[str, set[str]]) -> Iterable[str]:
    """A circle of a graph; empty if there is none."""
    try:
        tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        return error.args[1]
    return ()


def floors(graph: dict[str, set[str]]) -> dict[str, int]:
    """A floor for each node of a graph without circles: one above all that it imports, from 1 up."""
    result: dict[str, int] = {}
    for node in TopologicalSorter(graph).static_order():
        result[node] = 1 + max((result[other] for other in graph.get(node, ())), default=0)
    return result

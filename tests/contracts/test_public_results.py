"""Whatever public functions return, and what is in it, is public: a class that a user meets has a page."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Iterator
from functools import cached_property
from importlib import import_module
from types import ModuleType
from typing import Any, get_args

import wrt
from wrt.accelerators.accelerator import Accelerator
from wrt.builders.influence.influence_area import InfluenceArea
from wrt.lights.device_lights import Light

MODULES = ["wrt", *(f"wrt.{name}" for name in (*wrt.__all__, *wrt._BESIDE) if isinstance(getattr(wrt, name), ModuleType))]
TABLES = {module: import_module(module) for module in MODULES}
PUBLIC = {f"{module}.{name}": getattr(table, name) for module, table in TABLES.items() for name in table.__all__}
CLASSES = {value.__name__ for value in PUBLIC.values() if inspect.isclass(value)}

OF_OTHERS = {"AbstractContextManager", "Any", "Axes", "Callable", "Future", "Iterator", "Mapping", "None", "Path"}
OF_OTHERS |= {"Self", "Sequence"}
"""Python's, and matplotlib's."""

ALIASES = {"Accelerator", "Array", "ArrayT", "Color", "Direction", "InfluenceArea", "Light", "Point", "SignRule", "When"}
"""Names of arrays, of tuples of numbers, of some texts, and of what is one of several public classes."""

PLUMBING = {
    "Beams": "a struct of kernels",
    "BvhConfig": "what builders read",
    "Detector": "a struct of kernels",
    "DeviceLens": "a struct of kernels",
    "KdTreeConfig": "what builders read",
    "LazyKdTree": "a tree under way",
    "Piece": "what executors do",
    "PosePath": "a struct of kernels",
    "ProjectedConfig": "what builders read",
    "Slice": "what scans are cut into",
    "Struct": "a struct of kernels",
}
"""What only wrt's own code gets from methods that it calls."""


def own_members(kind: type) -> Iterator[tuple[str, Any]]:
    """Public functions of a class, those of properties included, also of its bases in wrt."""
    for base in kind.__mro__:
        if base.__module__.startswith("wrt"):
            for name, member in vars(base).items():
                function = getattr(member, "fget", None) or getattr(member, "__func__", member)
                function = member.func if isinstance(member, cached_property) else function
                if not name.startswith("_") and callable(function):
                    yield name, function


def promised() -> Iterator[tuple[str, str]]:
    """Annotations of what functions, methods and properties return, and of fields of dataclasses."""
    for name, value in PUBLIC.items():
        if inspect.isclass(value):
            for member, function in own_members(value):
                yield f"{name}.{member}", str(getattr(function, "__annotations__", {}).get("return", ""))
            if dataclasses.is_dataclass(value):
                yield from ((f"{name}.{field.name}", str(field.type)) for field in dataclasses.fields(value))
        elif callable(value):
            yield name, str(getattr(value, "__annotations__", {}).get("return", ""))


PROMISED = dict(promised())


def classes_in(annotation: str) -> set[str]:
    """Names of classes in an annotation, but those of Warp, NumPy and trimesh."""
    words = [word for word in re.findall(r"[A-Za-z_][\w.]*", annotation) if not word.startswith(("wp.", "np.", "trimesh."))]
    return {name for word in words if (name := word.rpartition(".")[2])[:1].isupper()}


def test_annotations_are_found():
    assert len(PROMISED) > 500
    assert PROMISED["wrt.Scene.intersect"] == "Hits"
    assert classes_in("Mapping[str, Hits | wp.array] | None") == {"Mapping", "Hits", "None"}


def test_what_is_returned_is_public():
    public = CLASSES | OF_OTHERS | ALIASES | PLUMBING.keys()
    hidden = {name: classes_in(annotation) - public for name, annotation in PROMISED.items()}
    assert {name: kinds for name, kinds in hidden.items() if kinds} == {}, "no public module has these"


def test_aliases_stand_for_public_classes():
    for alias in (Accelerator, InfluenceArea, Light):
        assert {kind.__name__ for kind in get_args(alias)} <= CLASSES


def test_no_exception_is_left_over():
    met = set().union(*(classes_in(annotation) for annotation in PROMISED.values()))
    assert not (OF_OTHERS | ALIASES | PLUMBING.keys()) - met
    assert not PLUMBING.keys() & CLASSES

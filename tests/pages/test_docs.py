"""Every public name is documented, with every argument, and the package says that it is typed."""

from __future__ import annotations

import dataclasses
import inspect
import re
from importlib.resources import files
from operator import attrgetter

import wrt

ELSEWHERE = re.compile(r"\b[Aa]s (in|there)\b")
"""What a docstring says whose arguments are explained at another place."""

ANSWERS = (
    "AllHits",
    "Hits",
    "batches.Blocks",
    "disk.PartitionedHits",
    "results.ClosestPoints",
    "results.PreciseHits",
    "results.Verification",
    "sensors.CameraImages",
    "sensors.LidarScan",
)
"""Classes that users get and do not make: what is in them is explained, not how they are made."""


def is_explained(owner: type, name: str, member: object) -> bool:
    """Whether a member of a class needs a word: public ones but constants."""
    is_field = dataclasses.is_dataclass(owner) and name in [field.name for field in dataclasses.fields(owner)]
    return not name.startswith("_") and (is_field or not isinstance(member, (str, int)))


def members_of(owner: type, name: str) -> dict[str, object]:
    """Public methods and properties of a class, by `name.member`; its bases' that are wrt's, too."""
    found: dict[str, object] = {}
    for base in owner.__mro__:
        if base.__module__.startswith("wrt"):
            own = {key: member for key, member in vars(base).items() if is_explained(base, key, member)}
            found = {f"{name}.{key}": member for key, member in own.items()} | found
    return found


def public() -> dict[str, object]:
    """Public names, those of public modules, and the public methods and properties of classes among them."""
    found: dict[str, object] = {}
    for name in (*wrt.__all__, *wrt._BESIDE):
        value = getattr(wrt, name)
        if name == "__version__":
            continue
        found[name] = value
        if inspect.isclass(value):
            found |= members_of(value, name)
        elif inspect.ismodule(value):
            for key in value.__all__:
                member = getattr(value, key)
                if callable(member):
                    found[f"{name}.{key}"] = member
                if inspect.isclass(member):
                    found |= members_of(member, f"{name}.{key}")
    return found


NAMES = public()


def owner_of(name: str) -> tuple[type | None, str]:
    """The class that a name belongs to, and the attribute; None and "" for other names."""
    *owner, attribute = name.split(".")
    value = attrgetter(".".join(owner))(wrt) if owner else None
    return (value, attribute) if inspect.isclass(value) else (None, "")


def in_class_docstring(owner: type, attribute: str) -> bool:
    """Whether an attribute is explained among those of its class."""
    text = inspect.getdoc(owner) or ""
    return re.search(rf"^\s+(\w+, )*{attribute}(, \w+)*:", text, re.MULTILINE) is not None


def test_some_names_are_public():
    assert {"Scene", "Scene.intersect", "Scene.load", "Scene.intersect_blocks", "Hits.t"} <= NAMES.keys()
    assert {"batches.Blocks.write", "moving.GroupedScene.group_updates", "lights.Sky.gradient", "device.launch"} <= NAMES.keys()
    assert set(dir(wrt)) == set(wrt.__all__)


def test_documented():
    """By a docstring of its own, whose first line is a sentence, or, for attributes, in that of the class."""
    wrong = []
    for name, member in NAMES.items():
        owner, attribute = owner_of(name)
        if owner is None or not in_class_docstring(owner, attribute):
            first = (inspect.getdoc(member) or "").split("\n\n")[0]
            if not first.endswith((".", ":", ".)")):
                wrong.append((name, first))
    assert not wrong, "docstrings that are missing, or do not begin with a sentence"


CALLED = [name for name, member in NAMES.items() if callable(member) or isinstance(member, (classmethod, staticmethod))]
BY_MODULE = [name for name in CALLED if name.startswith("device.")]
"""What a user's own kernels call: the module's docstring explains it together."""


def test_arguments_are_explained():
    """Each parameter is named in the docstring, or that refers to another; and each has a type."""
    several = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    missing, untyped = [], []
    for name in (name for name in CALLED if name not in (*ANSWERS, *BY_MODULE)):
        member = getattr(NAMES[name], "__func__", NAMES[name])
        text, parameters = inspect.getdoc(member) or "", inspect.signature(member).parameters
        own = [key for key, one in parameters.items() if key not in ("self", "cls") and one.kind not in several]
        if not ELSEWHERE.search(text):
            missing += [f"{name}({key})" for key in own if not re.search(rf"\b{key}\b", text)]
        untyped += [f"{name}({key})" for key in own if parameters[key].annotation is inspect.Parameter.empty]
    assert not missing, "arguments that the docstring does not explain"
    assert not untyped, "arguments without a type"


def test_typed():
    assert files("wrt").joinpath("py.typed").is_file()

"""Imports of `wrt.builders.classics` on demand: `import wrt`, "auto" and the default builders do not load these modules."""

from dataclasses import dataclass
from importlib import import_module
from types import ModuleType
from typing import Any


def classic_module(name: str) -> ModuleType:
    """A module of `wrt.builders.classics`, such as "kdtree.naive"."""
    return import_module(f"wrt.builders.classics.{name}")


@dataclass(frozen=True)
class Classic:
    """A function of a module of `wrt.builders.classics`, which is imported when the function is called."""

    module: str
    function: str = "build"

    def __call__(self, *arguments: Any) -> Any:
        """Calls the function."""
        return getattr(classic_module(self.module), self.function)(*arguments)

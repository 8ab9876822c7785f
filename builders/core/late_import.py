"""Imports of `wrt.builders.classics` on demand: `import wrt`, "auto" and the default builders do not load these modules."""

from importlib import import_module
from types import ModuleType

from wrt.kernels.on_demand import OnDemand

CLASSICS = "wrt.builders.classics"


def classic_module(name: str) -> ModuleType:
    """A module of the classics, such as "kdtree.naive"."""
    return import_module(f"{CLASSICS}.{name}")


def classic(module: str, function: str = "build") -> OnDemand:
    """A function of a module of the classics, which is imported when the function is called."""
    return OnDemand(module, function, CLASSICS)

"""Names of public modules: imported when they are first used, and old names, which warn.

A public module lists its names in one table, and says where each is defined:

    _HOME = {"PointLight": "wrt.lights.light_sources", ...}
    __all__ = [*_HOME]
    __getattr__, __dir__ = lazy_names(__name__, _HOME)

`import wrt` thus costs little more than `import warp`, and kernels that are not used are not compiled.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import Any

__all__ = ["lazy_names"]


def lazy_names(
    module: str, home: Mapping[str, str], moved: Mapping[str, str] | None = None
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a module.

    Args:
        module: its name.
        home: for each public name, the module that defines it; `module` itself for a submodule.
        moved: for each name that was public here, the public module that it moved to. It still works here, with a
            `DeprecationWarning`, and is not listed.
    """

    def __getattr__(name: str) -> Any:
        if name in home:
            value = _value(module, home[name], name)
            vars(sys.modules[module])[name] = value
            return value
        if moved is not None and name in moved:
            place = moved[name]
            warnings.warn(
                f"{module}.{name} is now {place}.{name}; the old name goes with the next release",
                DeprecationWarning,
                stacklevel=2,
            )
            return getattr(import_module(place), name)
        text = f"module {module!r} has no attribute {name!r}{_where(module, home, name)}"
        raise AttributeError(text, name=name, obj=sys.modules[module])

    def __dir__() -> list[str]:
        return sorted(sys.modules[module].__all__)

    return __getattr__, __dir__


def _where(module: str, home: Mapping[str, str], name: str) -> str:
    """Which public modules of a package have a name that the package itself does not have, for its error."""
    inner = [place for place, where in home.items() if where == module]
    if name.startswith("_") or not inner or find_spec(f"{module}.{name}") is not None:
        return ""
    found = [f"{module}.{place}.{name}" for place in inner if name in import_module(f"{module}.{place}").__all__]
    return f"; it is {' or '.join(found)}" if found else ""


def _value(module: str, home: str, name: str) -> Any:
    return import_module(f"{module}.{name}") if home == module else getattr(import_module(home), name)

"""Functions of `wrt.kernels.classics` that are imported when they are first called.

Tables list what "auto" never chooses beside what it may choose, but `import wrt` and queries under "auto" do not import it.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Any

CLASSICS = "wrt.kernels.classics"


@dataclass(frozen=True)
class OnDemand:
    """A function of a module that is imported at the first call.

    Attributes:
        module: name below `wrt.kernels.classics`.
        name: the function's name there.
    """

    module: str
    name: str

    def __call__(self, *arguments: Any) -> Any:
        """Calls the function."""
        return getattr(import_module(f"{CLASSICS}.{self.module}"), self.name)(*arguments)

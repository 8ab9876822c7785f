"""Functions of classics that are imported when they are called.

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
        module: name below the package.
        name: the function's name there.
        package: of the classics.
    """

    module: str
    name: str
    package: str = CLASSICS

    def __call__(self, *arguments: Any) -> Any:
        """Calls the function."""
        return getattr(import_module(f"{self.package}.{self.module}"), self.name)(*arguments)

"""The table of triangle tests, in which classics are rows until they are asked for."""

from collections.abc import Iterable, Iterator, Mapping, MutableMapping
from dataclasses import dataclass
from importlib import import_module
from types import MappingProxyType

from wrt.kernels.on_demand import CLASSICS
from wrt.kernels.triangle.support.triangle_contract import TriangleTest


@dataclass(frozen=True, kw_only=True)
class ClassicTest:
    """What the table knows of a test of `wrt.kernels.classics.triangle` without importing it.

    Attributes:
        name, paper, watertight, accurate, two_sided, needs_shared_origin: as in `TriangleTest`.
        module: name below `wrt.kernels.classics.triangle` of the module that has the test as `TEST`, or among its `TESTS`.
    """

    name: str
    paper: str
    module: str
    watertight: bool = False
    accurate: bool = False
    two_sided: bool = True
    needs_shared_origin: bool = False

    def load(self) -> TriangleTest:
        """The test itself."""
        module = import_module(f"{CLASSICS}.triangle.{self.module}")
        tests = getattr(module, "TESTS", None)
        return module.TEST if tests is None else tests[self.name]


class TriangleTestTable(MutableMapping[str, TriangleTest]):
    """Triangle tests by name. A classic is imported when it is first looked up; `rows` imports nothing."""

    def __init__(self, rows: Iterable[TriangleTest | ClassicTest]) -> None:
        self._rows = {row.name: row for row in rows}

    @property
    def rows(self) -> Mapping[str, TriangleTest | ClassicTest]:
        """Tests, and rows of those that nobody has asked for: names, papers and flags of all."""
        return MappingProxyType(self._rows)

    def __getitem__(self, name: str) -> TriangleTest:
        row = self._rows[name]
        if isinstance(row, ClassicTest):
            row = self._rows[name] = row.load()
        return row

    def __setitem__(self, name: str, test: TriangleTest) -> None:
        self._rows[name] = test

    def __delitem__(self, name: str) -> None:
        del self._rows[name]

    def __contains__(self, name: object) -> bool:
        return name in self._rows

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

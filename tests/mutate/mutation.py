"""A mutation, and the tables of this folder."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
HARNESS = ("__init__", "__main__", "mutation", "copies", "runner", "report")
"""Files of the folder that are no tables."""


@dataclass(frozen=True)
class Mutation:
    """A fault to put into a file.

    Attributes:
        path: the file, from the root of the checkout.
        old: text that occurs in it exactly once.
        new: what takes its place.
        tests: pytest ids of the tests that must fail then: the fewest and fastest.
        promise: what the mutation breaks.
    """

    path: str
    old: str
    new: str
    tests: str | tuple[str, ...]
    promise: str

    @property
    def test_ids(self) -> tuple[str, ...]:
        """The tests as a tuple, also if it is a single one."""
        return (self.tests,) if isinstance(self.tests, str) else tuple(self.tests)

    def applied_to(self, text: str) -> str:
        """The mutated text of the file.

        Raises:
            ValueError: `old` is not there exactly once, or nothing would change.
        """
        count = text.count(self.old)
        if count != 1:
            raise ValueError(f"{self.path} has the text {self.old!r} {count} times; it must be there exactly once")
        if self.old == self.new:
            raise ValueError(f"nothing changes in {self.path}: old and new are equal")
        return text.replace(self.old, self.new)


def areas() -> tuple[str, ...]:
    """Names of all tables."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.py") if path.stem not in HARNESS))


def table(area: str) -> dict[str, Mutation]:
    """The mutations of a table, named by it and their number in it, from 1.

    Raises:
        ValueError: there is no such table, or it has no MUTATIONS.
    """
    if area not in areas():
        raise ValueError(f"no table {area!r}; choose from {', '.join(areas())}")
    found = getattr(import_module(f"tests.mutate.{area}"), "MUTATIONS", None)
    if not found:
        raise ValueError(f"tests/mutate/{area}.py has no list MUTATIONS")
    return {f"{area}:{number}": mutation for number, mutation in enumerate(found, 1)}


def choose(chosen_areas: Iterable[str] = (), only: Iterable[str] = ()) -> dict[str, Mutation]:
    """Mutations by their names: of all tables, of some, or the named ones.

    Raises:
        ValueError: an unknown table or name.
    """
    names = tuple(only)
    wanted = tuple(chosen_areas) or (tuple(dict.fromkeys(name.partition(":")[0] for name in names)) if names else areas())
    found = {name: mutation for area in wanted for name, mutation in table(area).items()}
    if unknown := [name for name in names if name not in found]:
        raise ValueError(f"no mutation {unknown[0]!r}; mutations are named AREA:NUMBER, as --list shows them")
    return {name: found[name] for name in names} if names else found

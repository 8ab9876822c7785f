"""Lookup of names in tables, with errors that list the valid names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypeVar

Entry = TypeVar("Entry")


def lookup(table: Mapping[str, Entry], name: str, argument: str) -> Entry:
    """The entry called `name`.

    Raises:
        TypeError: the name is not a string.
        ValueError: there is no such entry; the message lists the existing ones.
    """
    return table[one_of(table, name, argument)]


def one_of(names: Iterable[str], name: str, argument: str) -> str:
    """The name itself, if it is one of `names`; errors as in `lookup`."""
    known = tuple(names)
    if not isinstance(name, str):
        raise TypeError(f"{argument} must be a name, not {type(name).__name__}; choose from {', '.join(known)}")
    if name not in known:
        raise ValueError(f"{argument} {name!r} is unknown; choose from {', '.join(known)}")
    return name

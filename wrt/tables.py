"""Lookup of names in tables, with errors that list the valid names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

Entry = TypeVar("Entry")


def lookup(table: Mapping[str, Entry], name: str, argument: str) -> Entry:
    """The entry called `name`.

    Raises:
        TypeError: the name is not a string.
        ValueError: there is no such entry; the message lists the existing ones.
    """
    if not isinstance(name, str):
        raise TypeError(f"{argument} must be a name, not {type(name).__name__}; choose from {', '.join(table)}")
    if name not in table:
        raise ValueError(f"{argument} {name!r} is unknown; choose from {', '.join(table)}")
    return table[name]

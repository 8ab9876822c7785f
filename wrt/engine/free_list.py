"""What one caller uses at a time, and the next one uses again: kernels with packed arguments, and memory."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Hashable, Iterator
from functools import partial
from typing import Generic, TypeVar

Item = TypeVar("Item")


class FreeList(Generic[Item]):
    """Items that no caller holds, by key. A caller takes one out, or makes one if none is free, and gives it back.

    Each step is one operation of a deque, so that threads, signal handlers and the garbage collector may interrupt it.

    Args:
        max_items: items of a key that are kept; one more drops the one that was given back first. None for no bound.

    Attributes:
        lent: items that finalizers give back, by their `id`. They must be here meanwhile: of what Python's collector finds in a
            cycle, all finalizers run before anything of it may come back to life, those of Warp's arrays, too.
    """

    __slots__ = ("_free", "lent")

    def __init__(self, max_items: int | None = None) -> None:
        self.lent: dict[int, Item] = {}
        self._free: defaultdict[Hashable, deque[Item]] = defaultdict(partial(deque, maxlen=max_items))

    def take(self, key: Hashable = None) -> Item | None:
        """An item for the caller alone until `give_back`; None if none is free."""
        try:
            return self._free[key].pop()
        except IndexError:
            return None

    def give_back(self, item: Item, key: Hashable = None) -> None:
        """Puts an item where the next caller finds it."""
        self._free[key].append(item)

    def __iter__(self) -> Iterator[Hashable]:
        """The keys of items so far."""
        return iter([*self._free])

    def items(self) -> list[Item]:
        """All items that no caller holds."""
        return [item for free in [*self._free.values()] for item in [*free]]

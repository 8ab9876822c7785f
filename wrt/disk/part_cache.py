"""Parts in memory: loaded when rays need them, within a budget.

The part unused for longest leaves first. In a round that needs each part once, those that it has not used leave first, and then
the newest: parts that stay are there for the next round, and memory that leaves is still in the processor's caches when the
next part is read into it.

A thread that loads the next part meanwhile was tried: with two cores it takes more time from tracing than it saves
(notebooks/records/2026-11-23-parts-on-disk.md).

References: pharr-1997 (a cache of geometry, least recently used first).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from wrt.disk.part_loading import Part, PartLoader
from wrt.disk.partition_files import PartList
from wrt.engine.facts.scene_settings import Settings

if TYPE_CHECKING:
    from wrt.kernels.triangle.support.record_blocks import Record


@dataclass
class Traffic:
    """What was loaded.

    Attributes:
        loads: number of parts loaded.
        bytes_read: bytes read from files.
        peak_bytes: most memory of all parts together.
    """

    loads: int = 0
    bytes_read: int = 0
    peak_bytes: int = 0


class PartCache:
    """The parts of a scene that are in memory.

    Args:
        folder: the folder of the scene.
        parts: the list of its parts.
        settings: of the scene.
        budget: most memory of all parts together, in bytes.
    """

    def __init__(self, folder: Path, parts: PartList, settings: Settings, budget: int) -> None:
        self.parts, self.settings, self.budget = parts, settings, budget
        self.traffic = Traffic()
        self._loaded: OrderedDict[int, Part] = OrderedDict()
        self._bytes: dict[int, int] = {}
        self._total = 0
        self._used: set[int] | None = None
        self._loader = PartLoader(folder, parts, settings)
        self.is_loaded = np.zeros(len(parts), dtype=bool)

    @property
    def bytes(self) -> int:
        """Memory of all loaded parts."""
        return self._total

    def clear(self) -> None:
        """Drops all parts."""
        self._loaded.clear()
        self._bytes.clear()
        self._total = 0
        self.is_loaded[:] = False

    @contextmanager
    def one_round(self) -> Iterator[None]:
        """For a `with` block in which each part is needed once at most."""
        self._used = set()
        try:
            yield
        finally:
            self._used = None

    def part(self, number: int, expected_bytes: int, record: Record) -> Part:
        """A part, loaded if it is not in memory.

        Args:
            number: of the part.
            expected_bytes: its memory with the records of the query; so much is made free first.
            record: the kind of triangle records of the query.

        Raises:
            FileNotFoundError, PermissionError: the file is gone, or may not be read.
            ValueError: it is damaged, or the part of another scene.
        """
        if number not in self._loaded:
            self.make_room(expected_bytes)
            self._loaded[number] = part = self._loader.load(number, record)
            self._bytes[number] = part.bytes
            self._total += part.bytes
            self.is_loaded[number] = True
            self.traffic.loads += 1
            self.traffic.bytes_read += self._loader.bytes_read
        self._loaded.move_to_end(number)
        if self._used is not None:
            self._used.add(number)
        return self._loaded[number]

    def make_room(self, expected_bytes: int) -> None:
        """Drops parts until so much more memory is within the budget."""
        while self._loaded and self._total + expected_bytes > self.budget:
            oldest = next(iter(self._loaded))
            newest_leaves = self._used is not None and oldest in self._used  # then so are all
            number, _ = self._loaded.popitem(last=newest_leaves)
            self._total -= self._bytes.pop(number)
            self.is_loaded[number] = False

    def note_use(self, number: int) -> None:
        """Records the memory in use, once a query has made the triangle records of a part."""
        now = self._loaded[number].bytes
        self._total += now - self._bytes[number]
        self._bytes[number] = now
        self.traffic.peak_bytes = max(self.traffic.peak_bytes, self.bytes)

"""What a build by levels works with, kept from one build to the next.

Fresh memory takes a GPU longer than a level, and a build of many triangles needs as much of it as ten levels write.
"""

from typing import Any

import warp as wp

from wrt.builders.kdtree.levelwise.grid_sums import SUMS, Grid
from wrt.kernels.runtime.workspace import HostNumbers

GROWTH = 1.5
"""How much larger an array becomes, at least."""


class LevelMemory:
    """Arrays by name, made anew where they are too small, and what launches share.

    Args:
        device: where.
        least: elements of the smallest array.
    """

    def __init__(self, device: wp.Device, least: int) -> None:
        self.device, self.least = device, least
        self.grid, self.totals = Grid(device), Totals(device)
        self.arrays: dict[str, wp.array] = {}

    def room(self, name: str, count: int, dtype: Any, keep: int = 0) -> wp.array:
        """An array of at least `count` elements, of which the first `keep` are those that it had."""
        known = self.arrays.get(name)
        if known is not None and known.size >= count:
            return known
        grown = self.least if known is None else int(GROWTH * known.size)
        made = self.arrays[name] = wp.empty(max(count, grown), dtype=dtype, device=self.device)
        if known is not None and keep:
            wp.copy(made, known, count=keep)
        return made


class Totals:
    """What a level's nodes sum up to, for kernels and for the host, which reads it while the device goes on.

    Args:
        device: where.
    """

    def __init__(self, device: wp.Device) -> None:
        self._device, self._told = device, HostNumbers(SUMS, int, device)
        self._is_told = wp.Event(device) if device.is_cuda else None
        self.found, self.told = wp.empty(SUMS, dtype=int, device=device), self._told.sent

    def mark(self) -> None:
        """After the launch that writes both."""
        if self._is_told is not None:
            self._device.stream.record_event(self._is_told)

    def read(self) -> list[int]:
        """Waits for that launch."""
        if self._is_told is not None:
            wp.synchronize_event(self._is_told)
        return self._told.values.tolist()

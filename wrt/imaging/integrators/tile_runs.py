"""The loop over the tiles of a wave: memory for one tile a thread, and the launch that follows them."""

from __future__ import annotations

import warp as wp

from wrt.engine.memory import empty
from wrt.kernels.runtime.launch import Chunks, PreparedLaunch, get_num_threads
from wrt.kernels.runtime.launch_chain import MAX_TILES, LaunchChain
from wrt.kernels.shading.ray_trees import tile_memories
from wrt.kernels.shading.wavefront import ray_queue

FIRST_SAMPLES = 1 << 17
"""Camera rays of which plans are made at most: plans depend on the number of rays, and these are as many as matter."""

STOP = 2
"""Which argument of kernels whose item is a tile memory says where the rays end, the number of the first item counted."""


def new_queue(count: int, device: wp.Device) -> ray_queue.RayQueue:
    """An uninitialised queue for this many rays."""
    queue = ray_queue.RayQueue()
    queue.origin, queue.direction, queue.weight = (empty(count, wp.vec3, device) for _ in range(3))
    queue.density, queue.slot, queue.media = (empty(count, dtype, device) for dtype in (wp.float32, wp.int32, wp.uint64))
    return queue


class TileRuns:
    """Tile memories, and the waves that are followed in them.

    Args:
        room: places of a tile for the rays of a generation.
        size: samples of a tile at most.
        device: the CPU.

    Attributes:
        memories: the state of each tile memory.
    """

    def __init__(self, room: int, size: int, device: wp.Device) -> None:
        self.room, self.size = room, size
        self.memories = tile_memories.TileMemories()
        for name in tile_memories.TileMemories.vars:  # type: ignore[attr-defined]
            setattr(self.memories, name, wp.zeros(get_num_threads(), dtype=int, device=device))
        self._launch: PreparedLaunch | None = None

    def __len__(self) -> int:
        """Number of tile memories."""
        return len(self.memories.left)

    @property
    def places(self) -> int:
        """Places for rays in all memories."""
        return self.room * len(self)

    @property
    def min_samples_together(self) -> int:
        """The fewest samples of the last wave that were tried together, because more found no place."""
        return int(self.memories.min_fitting.numpy().min())

    def run(self, chain: LaunchChain, count: int, last: int = 0) -> int:
        """Follows this many samples through the stages, and returns the number of rays; -1 if those of a single sample find no
        place.

        Args:
            chain: the stages.
            count: number of samples.
            last: how many of the stages, the last ones, are for samples, whether their rays are left or not.
        """
        memories = self.memories
        memories.fitting.fill_(self.size)
        memories.min_fitting.fill_(self.size)
        memories.total.zero_()
        memories.failed.zero_()
        inputs = [chain.stages, len(chain), last, self.room, self.size, count, memories]
        if self._launch is None:
            self._launch = PreparedLaunch(tile_memories.follow_tiles, inputs, chain.device)
        self._launch.update(inputs)
        self._launch.run(-(-count // self.size), Chunks(chunk=1, longest=MAX_TILES), self)
        return -1 if memories.failed.numpy().any() else int(memories.total.numpy().sum())

"""The triangle blocks of leaves, taken from the lists of several trees into one without gaps."""

import numpy as np


def gather_blocks(primitive: np.ndarray, width: int, first: np.ndarray, blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The blocks of leaves one after the other, and where each leaf's begin.

    Args:
        primitive: lists to take them from.
        width: triangles a block.
        first, blocks: (leaves,) first block and number of blocks of each leaf there.
    """
    starts = np.cumsum(blocks) - blocks
    source = np.repeat(first - starts, blocks) + np.arange(int(blocks.sum()))
    return primitive.reshape(-1, width)[source].ravel(), starts

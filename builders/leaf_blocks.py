"""Gathers the triangle blocks of leaves from the lists of several trees into one list without gaps."""

import numpy as np


def gather_blocks(primitive: np.ndarray, width: int, first: np.ndarray, blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Copies the blocks of leaves one after the other.

    Args:
        primitive: (blocks * width,) int32 triangle ids of all trees.
        width: triangles per block.
        first, blocks: (leaves,) first block and number of blocks of each leaf in `primitive`.

    Returns:
        The gathered ids, and (leaves,) the first block of each leaf in them.
    """
    starts = np.cumsum(blocks) - blocks
    source = np.repeat(first - starts, blocks) + np.arange(int(blocks.sum()))
    return primitive.reshape(-1, width)[source].ravel(), starts

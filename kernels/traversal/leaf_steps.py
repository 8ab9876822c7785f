"""Selects the block step for configs that need more than the closest hit in a block (`TraversalConfig.custom_leaf_step`)."""

import warp as wp

from wrt.kernels.traversal.crossings import crossing_step
from wrt.kernels.traversal.single.exact_step import exact_step
from wrt.kernels.traversal.traversal_config import EXACT, TraversalConfig


def make_custom_leaf_step(config: TraversalConfig, Tree: type) -> wp.Function:
    """A block step with the parameters of `wrt.kernels.traversal.crossings.crossing_step`."""
    return (exact_step if config.query == EXACT else crossing_step)(config, Tree)

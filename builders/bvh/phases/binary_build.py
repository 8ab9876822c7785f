"""What a builder of binary trees hands to the collapse and to what moves subtrees before it."""

from dataclasses import dataclass, field
from typing import Any

import warp as wp

from wrt.builders.bvh.phases.bin_heuristic import SURFACE, AllDirections, Heuristic
from wrt.builders.bvh.phases.binary_tree import BinaryTree
from wrt.kernels.runtime.workspace import Workspace


@dataclass
class BinaryBuild:
    """Result of a builder before the collapse.

    Attributes:
        tree: the binary tree.
        subtrees: (subtrees,) vec2i ranges of pairs, parents before children.
        top: pairs above the subtrees, parents before children; may be empty.
        space: (16 * triangles,) float32 work space, overwritten by the collapse.
        heuristic: the weight of its boxes.
        rays: the heuristic's knowledge of the rays.
        work: work space of the build; None if there is none.
    """

    tree: BinaryTree
    subtrees: wp.array
    top: wp.array | None
    space: wp.array
    heuristic: Heuristic = SURFACE
    rays: Any = field(default_factory=AllDirections)
    work: Workspace | None = None

    def __post_init__(self) -> None:
        if self.work is None:
            self.work = Workspace(self.space.device)

    def arrays(self) -> list[wp.array]:
        """The arrays that are held until the collapse is done."""
        return [self.tree.box, self.tree.range, self.tree.pair, self.tree.order, self.space]

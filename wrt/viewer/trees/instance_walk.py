"""The way of one ray through a scene of instances: the boxes of both levels in the order of its visits (`tree_walk`).

Above is a tree over the boxes of the instances, below it the tree of each mesh. At the box of an instance, the ray is taken
into the space of its mesh, where t means the same, and goes on there with what it has hit so far.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from wrt.builders.tree import Bvh
from wrt.viewer.trees.box_lines import box_corners
from wrt.viewer.trees.tree_walk import Placed, Visit, Walk, interval, nearest_first

if TYPE_CHECKING:
    from wrt.scene.instanced_state import InstancedState

__all__ = ["InstanceWalk", "upper_tree"]


def upper_tree(scene: InstancedState) -> Bvh:
    """The tree above the instances, without the depth of the trees below, which it counts as its own for traversals."""
    tree = scene.tree
    return Bvh(tree.bounds, tree.child, tree.primitive, tree.low, tree.high, tree.width, tree.level_first, tree.stats)


class InstanceWalk:
    """A walk under way, of a ray that sees the instances of all environments.

    Args:
        scene: the state of a scene of instances.
        origin, direction: (3,) of the ray in the coordinates of the scene.
    """

    def __init__(self, scene: InstancedState, origin: np.ndarray, direction: np.ndarray) -> None:
        self.scene, self.direction, self.best = scene, direction, np.inf
        self.center = np.asarray(scene.center, dtype=np.float64)
        self.origin = origin - self.center
        upper, self.tree = scene.tree, upper_tree(scene)
        self.placements = scene.device_mesh.placements.numpy()
        self.root, self.order = upper.forest.root, upper.primitive.numpy()

    def visits(self) -> Iterator[Visit]:
        """The visits in their order."""
        low, high = (np.array(corner, dtype=np.float64) for corner in (self.tree.low, self.tree.high))
        entry, leave = interval(self.origin, self.direction, low, high)
        if not entry <= leave:
            return
        none = np.empty(0, dtype=np.int32)
        for box in nearest_first(self.tree, self.origin, self.direction, self.root, entry, lambda: self.best):
            corners = self.center + box_corners(np.float64(box.low), np.float64(box.high))  # type: ignore[arg-type]
            row = int(self.order[box.first_block * self.tree.width]) if box.is_leaf else -1
            yield Visit(corners, box.depth, float(box.entry), box.is_leaf, none, -1, row, box.is_leaf)
            if box.is_leaf:
                yield from self._below(row, box.depth + 1, float(box.entry))

    def _below(self, row: int, depth: int, entry: float) -> Iterator[Visit]:
        """The visits in the tree of an instance's mesh."""
        placement = self.placements[row]
        if not placement["mask"]:
            return
        to_scene, to_object, at = (placement[name].reshape(shape) for name, shape in MAPS)
        mesh = self.scene.mesh_states[int(placement["geometry"])]
        placed = Placed(to_scene, self.center + at, depth, row, entry)
        below = Walk(mesh, to_object @ (self.origin - at), to_object @ self.direction, placed, self.best)
        yield from below.visits()
        self.best = below.best


MAPS = (("to_scene", (3, 3)), ("to_object", (3, 3)), ("origin", (3,)))
"""Fields of a `wrt.kernels.layout.instance_maps.Placement`."""

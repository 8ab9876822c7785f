"""Updates of a few instances: one call of a kernel on the CPU writes all that changes.

The arrays of the old state are copied as they are, which is the fastest thing that a processor does, and a prepared launch
writes the few elements that change. The centre of the scene usually stays (`InstanceBoxes.frame`); if it does not, what was
written is thrown away.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from wrt.builders.bvh.instance_forest import cost_of
from wrt.engine.free_list import FreeList
from wrt.instances.instance_boxes import InstanceBoxes, UpperTree, address_of
from wrt.kernels.layout.instance_maps import Placement
from wrt.kernels.runtime.launch import Chunks, PreparedLaunch
from wrt.kernels.traversal.two_level.instance_bounds import BoundedInstances, CoverPoints
from wrt.kernels.traversal.two_level.instance_moves import EXTREMES, BoxTree, Moves, move_instances

MAX_AT_ONCE = 32
"""Instances up to which one thread moves them, one after the other (notebooks/records/2026-11-23-instances.md)."""

MAX_FREE = 4

ONE_CHUNK = Chunks()


class Mover:
    """A prepared launch of `move_instances`; used by one caller at a time."""

    def __init__(self) -> None:
        device = wp.get_device("cpu")

        def none(dtype: type) -> wp.array:
            return wp.empty(0, dtype=dtype, device=device)

        structs = [kind() for kind in (Moves, CoverPoints, BoundedInstances, BoxTree)]
        for struct in structs:
            for name, variable in struct._cls.vars.items():
                if isinstance(variable.type, wp.array):
                    setattr(struct, name, none(variable.type.dtype))
        moves, cover, bounded, tree = structs
        inputs = [moves, cover, bounded, none(Placement), none(wp.vec3), none(wp.vec3), tree, none(wp.float64)]
        self._launch = PreparedLaunch(move_instances, inputs, device)
        arguments = [self._launch.argument(number) for number in range(1, len(inputs) + 1)]
        self._moves, self._cover, self._bounded, self._table, self._low, self._high, self._tree, self._extremes = arguments
        self._known: tuple[Any, Any] = (None, None)

    def run(self, state: Any, moves: dict[str, np.ndarray], boxes: InstanceBoxes, arrays: list[np.ndarray]) -> None:
        """Moves instances in copies of a state's arrays.

        Args:
            state: the old one.
            moves: rows, transforms and masks, as `Moves` names them.
            boxes: are changed.
            arrays: table, low, high, bounds of the tree, and extremes; are changed.
        """
        forest, (table, low, high, bounds, extremes) = state.tree.forest, arrays
        for name, values in moves.items():
            address(getattr(self._moves, name), values, len(values))
        self._moves.center[:], self._moves.rounding = state.boxes.frame
        count, touched = len(table), np.zeros(len(forest.child), dtype=np.uint8)
        address(self._bounded.origin, boxes.origin, count)
        address(self._bounded.corners, boxes.box, 6 * count)
        address(self._bounded.norms, boxes.norms, count)
        for field, values in ((self._table, table), (self._low, low), (self._high, high), (self._extremes, extremes)):
            address(field, values, len(values))
        address(self._tree.bounds, bounds, bounds.size)
        address(self._tree.touched, touched, len(touched))
        if self._known != (id(state.covers), id(forest)):
            for name in ("centers", "begins", "points"):
                values = getattr(state.covers.struct, name).numpy()
                address(getattr(self._cover, name), values, len(values))
            for name, values in zip(("leaf_first", "leaf_places", "above_first", "above_places"), forest.links, strict=True):
                address(getattr(self._tree, name), values, len(values))
            self._tree.width = forest.child.shape[1]
            self._known, self._kept = (id(state.covers), id(forest)), (state.covers, forest)
        self._launch.run(1, ONE_CHUNK)


def address(field: Any, values: np.ndarray, count: int) -> None:
    """Writes the address and length of an array into the packed form of a flat one."""
    field.data = address_of(values)
    field.shape[0] = count


_movers: FreeList[Mover] = FreeList(MAX_FREE)


def move_few(
    state: Any, rows: np.ndarray, transforms: np.ndarray, masks: np.ndarray
) -> tuple[InstanceBoxes, np.ndarray, UpperTree] | None:
    """Boxes, placements and upper level after some instances have moved; None if the scene's centre must move, too.

    Args:
        state: the old one, a `wrt.scene.instanced_state.InstancedState`.
        rows: (M,) numbers of the instances that moved.
        transforms: (M, 4, 4) float64, where they are now.
        masks: (M,) int64.
    """
    moves = {
        "rows": rows.astype(np.int32),
        "transforms": np.ascontiguousarray(transforms),
        "masks": masks.astype(np.uint32),
    }
    boxes, table, tree, extremes = state.boxes.copied(), state.table.copy(), state.tree, np.empty(EXTREMES + 2)
    low, high, bounds = tree.corners[0].copy(), tree.corners[1].copy(), tree.host.copy()
    mover = _movers.take() or Mover()
    mover.run(state, moves, boxes, [table, low, high, bounds, extremes])
    _movers.give_back(mover)
    *corners, nodes, of_instances = extremes.tolist()
    boxes.__dict__["extremes"] = corners
    if not boxes.are_resolved or boxes.frame != state.boxes.frame:
        return None
    return boxes, table, tree.around(low, high, bounds, cost_of(nodes, of_instances))

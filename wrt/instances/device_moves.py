"""Moves of instances whose transforms are Warp arrays on the scene's device: maps, boxes and nodes are computed there.

A launch needs the scene's centre and bounds on the host, so an update reads `Spanned.report` back, and nothing else. What
only the host needs, such as `wrt.Instance` objects with their transforms, is copied when something asks for it.

While a CUDA graph is captured nothing can be read back. Then the centre stays, and the bounds are in the graph's memory
(`InstanceTree.extent`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from functools import cached_property
from typing import Any, overload

import numpy as np
import warp as wp

from wrt.builders.bvh.instance_forest import cost_of
from wrt.engine.free_list import FreeList
from wrt.engine.memory import keep_alive
from wrt.instances.instance_boxes import InstanceBoxes, UpperTree
from wrt.kernels.layout.instance_maps import Placement
from wrt.kernels.runtime.launch import kept, launch, specialise
from wrt.kernels.traversal.two_level.instance_bounds import BoundedInstances, CoverPoints
from wrt.kernels.traversal.two_level.instance_updates import (
    BLOCK,
    REPORTED,
    SPANNED,
    TEAM,
    Spanned,
    UpperNodes,
    bound_moved,
    lay_out,
    make_place_instances,
    make_refit_levels,
    measure_nodes,
    refit_level,
    span_instances,
)
from wrt.meshes.instance import Instance

MATRICES = (wp.mat44f, wp.mat44d, wp.transformf, wp.transformd)
"""Types of arrays of transforms."""

NUMBERS = {wp.float32: wp.mat44f, wp.float64: wp.mat44d}
"""Those of arrays of numbers, (..., 4, 4)."""

CUDA_DLPACK = 2
"""The number of CUDA devices in DLPack."""

MAX_SHARES = 1 << 14
"""Threads among which sums and extremes are divided on CUDA."""

MAX_SMALL = 4096
"""Lanes of a level up to which it is refitted by one block."""

MAX_FREE = 4
"""`Reports` of callers that are kept for the next one."""

NO_ROWS = np.zeros(0, dtype=np.int64)
"""Of an update of all instances."""


def transforms_on(device: wp.Device, transforms: Any, count: int) -> wp.array | None:
    """(count,) or (1,) matrices or `wp.transform` in an array on the device; None if the transforms are not such an array, or
    must be checked on the host."""
    if not isinstance(transforms, wp.array):
        kind = getattr(transforms, "__dlpack_device__", None)
        if isinstance(transforms, np.ndarray) or kind is None or not device.is_cuda or kind() != (CUDA_DLPACK, device.ordinal):
            return None
        transforms = wp.from_dlpack(transforms)
    if transforms.device != device or not transforms.is_contiguous:
        return None
    if transforms.dtype in MATRICES:
        found = transforms if transforms.ndim == 1 else None
    elif transforms.dtype in NUMBERS and transforms.shape[-2:] == (4, 4) and transforms.ndim in (2, 3):
        dtype = NUMBERS[transforms.dtype]
        found = keep_alive(wp.array(ptr=transforms.ptr, dtype=dtype, shape=transforms.size // 16, device=device), transforms)
    else:
        return None
    is_one = found is not None and transforms.dtype in NUMBERS and transforms.ndim == 2
    return found if found is not None and (found.size == count or is_one) else None


class MovedInstances(Sequence[Instance]):
    """Instances whose transforms are on a device until something asks for an instance.

    Args:
        base: them with other transforms.
        transforms: (N,) mat44d.
    """

    def __init__(self, base: tuple[Instance, ...], transforms: wp.array) -> None:
        self.base, self.transforms = base, transforms

    @cached_property
    def on_host(self) -> tuple[Instance, ...]:
        """The instances."""
        matrices = self.transforms.numpy()
        matrices.flags.writeable = False
        return tuple(one.moved(matrix, one.mask, one.environment) for one, matrix in zip(self.base, matrices, strict=True))

    def __len__(self) -> int:
        return len(self.base)

    @overload
    def __getitem__(self, index: int) -> Instance: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Instance, ...]: ...
    def __getitem__(self, index: Any) -> Any:
        return self.on_host[index]

    def __iter__(self) -> Iterator[Instance]:
        return iter(self.on_host)


class BoxesOnDevice(InstanceBoxes):
    """Boxes whose arrays are on a device until something asks for them.

    Args:
        bounded: the arrays.
        report: `Spanned.report`; that of the state before, if a graph writes it.
        frame: as in the class, if it is that of the state before.
    """

    bounded: BoundedInstances

    def __init__(self, bounded: BoundedInstances, report: list[float], frame: Any = None) -> None:
        known: dict[str, Any] = {"bounded": bounded}
        known["extremes"] = report[:8]
        if frame is not None:
            known["frame"] = frame
        self.__dict__.update(known)

    @cached_property
    def origin(self) -> np.ndarray:  # type: ignore[override]  # in place of the constructor's
        return self.bounded.origin.numpy()

    @cached_property
    def box(self) -> np.ndarray:  # type: ignore[override]
        return self.bounded.corners.numpy().reshape(6, -1)

    @cached_property
    def norms(self) -> np.ndarray:  # type: ignore[override]
        return self.bounded.norms.numpy()


class DeviceMoves:
    """The arrays of a state whose instances move on the device, and how to write those of the next one.

    Attributes:
        transforms: (N,) mat44d.
        bounded: where the instances are.
        cover: points that cover the meshes.
        level_first: as in the forest.
        chosen: the numbers of instances that moved last, on the host and on the device.
    """

    def __init__(self, transforms: wp.array, bounded: BoundedInstances, cover: CoverPoints, level_first: wp.array) -> None:
        self.transforms, self.bounded, self.cover, self.level_first = transforms, bounded, cover, level_first
        self.chosen: tuple[np.ndarray, wp.array] | None = None

    @classmethod
    def of(cls, state: Any) -> DeviceMoves:
        """Those of a state of the host."""
        device, boxes, own = state.device, state.boxes, state.covers.struct
        bounded, cover = BoundedInstances(), CoverPoints()
        bounded.origin = wp.array(boxes.origin, dtype=wp.vec3d, device=device)
        bounded.corners = wp.array(boxes.box.reshape(-1), dtype=wp.float64, device=device)
        bounded.norms = wp.array(boxes.norms, dtype=wp.float64, device=device)
        cover.centers, cover.begins, cover.points = (values.to(device) for values in (own.centers, own.begins, own.points))
        transforms = np.array([instance.transform for instance in state.instances])
        levels = wp.array(state.tree.forest.level_first, dtype=int, device=device)
        return cls(wp.array(transforms, dtype=wp.mat44d, device=device), bounded, cover, levels)

    def copied(self, whole: bool) -> DeviceMoves:
        """Arrays of its own for what moves; whole: whether all of it will be written."""
        new: Any = wp.empty_like if whole else wp.clone
        bounded = BoundedInstances()
        bounded.origin, bounded.corners = new(self.bounded.origin), new(self.bounded.corners)
        bounded.norms = new(self.bounded.norms)
        made = DeviceMoves(new(self.transforms), bounded, self.cover, self.level_first)
        made.chosen = self.chosen
        return made

    def has_chosen(self, rows: np.ndarray) -> bool:
        """Whether these instances moved last."""
        return self.chosen is not None and np.array_equal(self.chosen[0], rows)

    def rows_on_device(self, rows: np.ndarray | None) -> wp.array:
        """(M,) numbers of instances; empty for None."""
        rows = NO_ROWS if rows is None else rows
        if not self.has_chosen(rows):
            device = self.transforms.device
            with kept(device):
                self.chosen = rows, wp.array(rows, dtype=int, device=device)
        return self.chosen[1]


class Reports:
    """Memory of one caller for what an update computes on the way, and for what the host reads of it."""

    def __init__(self, device: wp.Device) -> None:
        self.spanned = new_spanned(device)
        self.read = wp.empty(REPORTED, dtype=wp.float64, device="cpu", pinned=device.is_cuda)
        self.values = self.read.numpy()

    def fetch(self) -> list[float]:
        """`Spanned.report`, when all kernels are done."""
        wp.copy(self.read, self.spanned.report)
        if self.spanned.report.device.is_cuda:
            wp.synchronize_stream(self.spanned.report.device.stream)
        return self.values.tolist()


_reports: FreeList[Reports] = FreeList(MAX_FREE)


def new_spanned(device: wp.Device) -> Spanned:
    """Memory for what all instances span."""
    spanned = Spanned()
    spanned.found = wp.empty(SPANNED, dtype=wp.int64, device=device)
    spanned.report = wp.empty(REPORTED, dtype=wp.float64, device=device)
    spanned.extent = wp.empty(7, dtype=float, device=device)
    return spanned


def move_on_device(
    state: Any, rows: np.ndarray | None, given: wp.array, is_measured: bool
) -> tuple[DeviceMoves, InstanceBoxes, wp.array, UpperTree] | None:
    """Arrays, boxes, placements and upper level after instances have moved; None if a transform must be checked on the host.

    Args:
        state: the old one, a `wrt.scene.instanced_state.InstancedState`.
        rows: (M,) instances that move, each once; None for all.
        given: their transforms, as `transforms_on` gives them.
        is_measured: whether the cost of the upper level is computed.
    """
    device, captures = state.device, bool(state.device.is_capturing)
    old = state.device_moves
    if old is None:
        with kept(device):
            old = DeviceMoves.of(state)
    made, table = old.copied(whole=rows is None), wp.clone(state.device_mesh.placements)
    key = device.alias, None if device.is_cpu else device.stream.cuda_stream
    reports = None if captures else _reports.take(key) or Reports(device)
    spanned = new_spanned(device) if reports is None else reports.spanned
    nodes = nodes_of(state.tree, made.level_first)
    count, moving = len(table), len(table) if rows is None else len(rows)
    center = wp.vec3d(*map(float, state.center))
    team = TEAM if device.is_cuda else 1
    chosen = made.rows_on_device(rows)
    placed: list[Any] = [chosen, given, made.cover, made.bounded, made.transforms, table, spanned]
    launch(specialise(make_place_instances, given.dtype), moving, placed, device=device)
    bound: list[Any] = [team, chosen, made.cover, made.transforms, table, made.bounded]
    launch(bound_moved, moving * team, bound, device=device)
    shares = min(-(-count // 32) * 32, MAX_SHARES) if device.is_cuda else 1
    launch(span_instances, shares, [shares, made.bounded, spanned], device=device)
    laid: list[Any] = [int(captures), center, made.bounded, table, nodes, spanned]
    launch(lay_out, max(count, len(nodes.child)), laid, device=device)
    refit(state.tree.forest.level_first, nodes, device)
    if is_measured:
        lanes = len(nodes.child)
        shares = min(-(-lanes // 32) * 32, MAX_SHARES) if device.is_cuda else 1
        launch(measure_nodes, shares, [shares, nodes, spanned], device=device)
    tree = copy(state.tree)
    tree.__dict__.pop("_struct", None)
    tree.bounds, tree.corners, tree.host, tree.extent, tree.cost = nodes.bounds, None, None, None, None
    if reports is None:
        tree.extent = spanned.extent
        keep_alive(table, (state.device_mesh.placements, made, tree))  # the graph reads them whenever it is launched
        return made, BoxesOnDevice(made.bounded, state.boxes.extremes, state.boxes.frame), table, tree
    report = reports.fetch()
    _reports.give_back(reports, key)
    if report[8] < count:
        return None
    boxes = BoxesOnDevice(made.bounded, report)
    if is_measured:
        tree.cost = cost_of(report[12], report[13])
    middle, rounding = np.array(report[9:12]), boxes.frame[1]
    low, high = np.array(report[:3]) - (middle + rounding), np.array(report[3:6]) - (middle - rounding)
    tree.low = wp.vec3(*np.nextafter(low.astype(np.float32), np.float32(-np.inf)).tolist())
    tree.high = wp.vec3(*np.nextafter(high.astype(np.float32), np.float32(np.inf)).tolist())
    return made, boxes, table, tree


def nodes_of(tree: UpperTree, level_first: wp.array) -> UpperNodes:
    """The upper level, with memory for other boxes."""
    nodes = UpperNodes()
    nodes.child, nodes.order, nodes.level_first, nodes.width = tree.child, tree.primitive, level_first, tree.width
    nodes.bounds = wp.empty(tree.bounds.size, dtype=float, device=tree.bounds.device)
    return nodes


def refit(level_first: tuple[int, ...], nodes: UpperNodes, device: wp.Device) -> None:
    """The boxes of inner nodes from those of leaves: large levels one by one, those above them by one block."""
    level = len(level_first) - 2  # the last one has leaves only
    while level > 0 and (level_first[level] - level_first[level - 1]) * nodes.width > MAX_SMALL:
        level -= 1
        begin, end = level_first[level] * nodes.width, level_first[level + 1] * nodes.width
        launch(refit_level, end - begin, [begin, nodes], device=device)
    if level > 0:
        threads = BLOCK if device.is_cuda else 1
        launch(specialise(make_refit_levels, BLOCK), threads, [threads, level, nodes], device=device)


def fetched(state: Any) -> dict[str, Any]:
    """What the host holds of a state after moves on its device: values of attributes."""
    boxes, tree = InstanceBoxes(state.boxes.origin, state.boxes.box, state.boxes.norms), copy(state.tree)
    tree.corners, tree.extent = boxes.rounded(), None
    tree = tree.with_boxes(*tree.corners)
    table = state.device_mesh.placements.numpy().astype(Placement.numpy_dtype())  # type: ignore[attr-defined]
    return {"instances": tuple(state.instances), "boxes": boxes, "built_tree": tree, "table": table, "device_moves": None}

"""Moves of instances whose transforms are Warp arrays on the scene's device: maps, boxes and nodes are computed there.

A launch needs the scene's centre and bounds on the host, so an update reads `Spanned.report` back, and nothing else. What
only the host needs, such as `wrt.Instance` objects with their transforms, is copied when something asks for it.

While a CUDA graph is captured nothing can be read back. Then the centre stays, and the bounds are in the graph's memory
(`InstanceTree.extent`).
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from copy import copy
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import warp as wp

from wrt.builders.bvh.instance_forest import cost_of
from wrt.engine.free_list import FreeList
from wrt.engine.memory import keep_alive
from wrt.instances.instance_boxes import InstanceBoxes, UpperTree, on_device
from wrt.instances.instance_list import InstanceList, replaced
from wrt.kernels.layout.instance_maps import Placement
from wrt.kernels.runtime.launch import kept, launch, specialise
from wrt.kernels.runtime.recorded_launch import record
from wrt.kernels.runtime.workspace import HostNumbers
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
    mat34d,
    mat34f,
    measure_nodes,
    refit_level,
    send_report,
    span_instances,
    write_masks,
)

MIN_BY_KERNELS = 512
"""Instances that move by a NumPy array from which a CPU moves them by these kernels, too: all threads work, where NumPy has one
(notebooks/records/2026-11-28-whole-jobs.md)."""

MATRICES = (wp.mat44f, wp.mat44d, wp.transformf, wp.transformd)
"""Types of arrays of transforms."""

RIGID = (wp.transformf, wp.transformd)
"""Those of them that move and turn only."""

UNEVEN = 1e-6
"""How far the axes of a map may differ in length and from right angles, relative to their length."""

NUMBERS = {
    (wp.float32, 4): wp.mat44f,
    (wp.float64, 4): wp.mat44d,
    (wp.float32, 3): mat34f,
    (wp.float64, 3): mat34d,
}
"""Those of arrays of numbers, (..., 4, 4) or (..., 3, 4), by the type of numbers and the number of rows."""

CUDA_DLPACK = 2
"""The number of CUDA devices in DLPack."""

MAX_SHARES = 1 << 14
"""Threads among which sums and extremes are divided on CUDA."""

MAX_SMALL = 4096
"""Lanes of a level up to which it is refitted by one block."""

MAX_FREE = 4
"""`Reports` of callers that are kept for the next one."""

MAX_KEPT = 2
"""States that nobody has any more, of a scene and a stream, whose memory waits for the next ones: two take turns."""

ROWS, GIVEN = 1, 2
"""Places of arguments of `place_instances`; those of `bound_moved` are one further."""

NO_ROWS = np.zeros(0, dtype=np.int64)
"""Of an update of all instances."""


def transforms_on(device: wp.Device, transforms: Any, count: int) -> wp.array | None:
    """(count,) or (1,) matrices or `wp.transform` in an array on the device; None if the transforms are not such an array, or
    must be checked on the host. Many matrices of a NumPy array count on the CPU."""
    if type(transforms) is np.ndarray and device.is_cpu and not device.is_capturing:
        if count < MIN_BY_KERNELS or transforms.shape != (count, 4, 4) or transforms.dtype not in (np.float32, np.float64):
            return None
        return on_device(np.ascontiguousarray(transforms, dtype=np.float64), wp.mat44d, device)
    if not isinstance(transforms, wp.array):
        kind = getattr(transforms, "__dlpack_device__", None)
        if isinstance(transforms, np.ndarray) or kind is None or not device.is_cuda or kind() != (CUDA_DLPACK, device.ordinal):
            return None
        transforms = wp.from_dlpack(transforms)
    if transforms.device != device or not transforms.is_contiguous:
        return None
    if transforms.dtype in MATRICES:
        found = transforms if transforms.ndim == 1 else None
    elif transforms.ndim in (2, 3) and transforms.shape[-1] == 4 and (transforms.dtype, transforms.shape[-2]) in NUMBERS:
        dtype, size = NUMBERS[transforms.dtype, transforms.shape[-2]], transforms.size // (4 * transforms.shape[-2])
        found = keep_alive(wp.array(ptr=transforms.ptr, dtype=dtype, shape=size, device=device), transforms)
    else:
        return None
    is_one = found is not None and found is not transforms and transforms.ndim == 2
    return found if found is not None and (found.size == count or is_one) else None


def uneven_maps(table: np.ndarray) -> np.ndarray:
    """(N,) whether the map of an instance multiplies some distances more than others; not of those with mask 0.

    table: (N,) `Placement`.
    """
    linear = table["to_scene"].reshape(-1, 3, 3)
    products = np.einsum("nji,njk->nik", linear, linear)
    squares = np.trace(products, axis1=1, axis2=2) / 3.0
    is_uneven = np.abs(products / squares[:, None, None] - np.eye(3)).max(axis=(1, 2)) > UNEVEN
    return is_uneven & (table["mask"].reshape(-1) != 0)


@lru_cache(maxsize=4)
def every(count: int) -> np.ndarray:
    """(count,) True, read-only."""
    values = np.ones(count, dtype=bool)
    values.flags.writeable = False
    return values


class MovedInstances(InstanceList):
    """Instances whose transforms are on a device until something asks for them.

    Args:
        base: them with other transforms.
        moves: the arrays of their state.
        rows, mask: (M,) instances with another mask, None for all, and the mask; None for those they have.
    """

    def __init__(self, base: InstanceList, moves: DeviceMoves, rows: np.ndarray | None = None, mask: int | None = None) -> None:
        masks = replaced(base.masks, rows, mask)
        super().__init__(base.made, every(len(base)), None, masks, base.environments)
        self.moves = moves

    @cached_property
    def transforms(self) -> np.ndarray:
        """(N, 4, 4) float64, read-only; copied from the device."""
        matrices = self.moves.transforms.numpy()
        matrices.flags.writeable = False
        return matrices

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles hold instances on the host."""
        return copy, (self.detached(),)


class BoxesOnDevice(InstanceBoxes):
    """Boxes whose arrays are on a device until something asks for them.

    Args:
        moves: the arrays of their state.
        report: `Spanned.report`; that of the state before, if a graph writes it.
        frame: as in the class, if it is that of the state before.
    """

    moves: DeviceMoves

    def __init__(self, moves: DeviceMoves, report: list[float], frame: Any = None) -> None:
        known: dict[str, Any] = {"moves": moves, "extremes": report[:8]}
        if frame is not None:
            known["frame"], known["center"] = frame, frame[0]
        else:
            known["center"] = tuple(report[9:12])
        self.__dict__.update(known)

    @cached_property
    def origin(self) -> np.ndarray:  # type: ignore[override]  # in place of the constructor's
        return self.moves.bounded.origin.numpy()

    @cached_property
    def box(self) -> np.ndarray:  # type: ignore[override]
        return self.moves.bounded.corners.numpy().reshape(6, -1)

    @cached_property
    def norms(self) -> np.ndarray:  # type: ignore[override]
        return self.moves.bounded.norms.numpy()


class DeviceMoves:
    """The arrays of a state whose instances move on the device, and how to write those of the next one.

    Attributes:
        transforms: (N,) mat44d.
        bounded: where the instances are.
        cover: points that cover the meshes.
        level_first: as in the forest.
        chosen: the numbers of instances that moved last, on the host and on the device.
        kept: memory that waits for the next states, by stream.
        lease: while it lives, the arrays are this state's; None if they are nobody else's.
        are_similar: whether the host knows that all maps multiply distances alike, but those of instances with mask 0.
    """

    def __init__(self, transforms: wp.array, bounded: BoundedInstances, cover: CoverPoints, level_first: wp.array) -> None:
        self.transforms, self.bounded, self.cover, self.level_first = transforms, bounded, cover, level_first
        self.chosen: tuple[np.ndarray, wp.array] | None = None
        self.kept: FreeList[KeptMove] = FreeList(MAX_KEPT)
        self.lease: Any = None
        self.are_similar = False

    @classmethod
    def of(cls, state: Any) -> DeviceMoves:
        """Those of a state of the host."""
        device, boxes, own = state.device, state.boxes, state.covers.struct
        bounded, cover = BoundedInstances(), CoverPoints()
        bounded.origin = wp.array(boxes.origin, dtype=wp.vec3d, device=device)
        bounded.corners = wp.array(boxes.box.reshape(-1), dtype=wp.float64, device=device)
        bounded.norms = wp.array(boxes.norms, dtype=wp.float64, device=device)
        cover.centers, cover.begins, cover.points = (values.to(device) for values in (own.centers, own.begins, own.points))
        levels = wp.array(state.tree.forest.level_first, dtype=int, device=device)
        made = cls(wp.array(state.instances.transforms, dtype=wp.mat44d, device=device), bounded, cover, levels)
        made.are_similar = not uneven_maps(state.table).any()
        return made

    def copied(self, whole: bool) -> DeviceMoves:
        """Arrays of its own for what moves; whole: whether all of it will be written."""
        new: Any = wp.empty_like if whole else wp.clone
        bounded = BoundedInstances()
        bounded.origin, bounded.corners = new(self.bounded.origin), new(self.bounded.corners)
        bounded.norms = new(self.bounded.norms)
        made = DeviceMoves(new(self.transforms), bounded, self.cover, self.level_first)
        made.chosen, made.kept = self.chosen, self.kept
        return made

    def knows_similar(self, rows: np.ndarray | None, given: wp.array) -> bool:
        """`are_similar` after instances have moved by transforms; rows: as in `move_on_device`."""
        return given.dtype in RIGID and (rows is None or self.are_similar)

    def has_chosen(self, rows: np.ndarray) -> bool:
        """Whether these instances moved last."""
        return self.chosen is not None and (self.chosen[0] is rows or np.array_equal(self.chosen[0], rows))

    def rows_on_device(self, rows: np.ndarray | None) -> wp.array:
        """(M,) numbers of instances; empty for None."""
        rows = NO_ROWS if rows is None else rows
        if not self.has_chosen(rows):
            device = self.transforms.device
            with kept(device):
                self.chosen = rows, wp.array(rows, dtype=int, device=device)
        return self.chosen[1]


class KeptMove:
    """Kernels of a move on CUDA with packed arguments, and memory of its own for all that they write: of calls, allocations and
    packing took most of the time (notebooks/records/2026-11-28-gpu-graphs.md). For one state at a time.

    Args:
        state: of whose instances; not kept.
        old: its arrays.
        reports: memory on the way.
    """

    def __init__(self, state: Any, old: DeviceMoves, reports: Reports) -> None:
        self.device, self.reports, self.count = state.device, reports, len(state.device_mesh.placements)
        self.moves, self.table = old.copied(whole=True), wp.clone(state.device_mesh.placements)
        self.nodes, spanned = nodes_of(state.tree, old.level_first), reports.spanned
        self._places: dict[type, wp.Launch] = {}
        nobody = wp.empty(0, dtype=int, device=self.device)
        self._bound = self._recorded(bound_moved, 0, bound_inputs(self.moves, self.table, nobody, self.device))
        bounded, nodes, device = self.moves.bounded, self.nodes, self.device
        shares, lanes = shares_of(self.count, device), len(nodes.child)
        laid = [0, wp.vec3d(), bounded, self.table, nodes, spanned]
        self._rest = [
            self._recorded(span_instances, shares, [shares, bounded, spanned]),
            self._recorded(lay_out, max(self.count, lanes), laid),
            *(self._recorded(*step) for step in refit_steps(state.tree.forest.level_first, nodes, device)),
        ]
        shares = shares_of(lanes, device)
        self._measure = self._recorded(measure_nodes, shares, [shares, nodes, spanned])
        self._send = self._recorded(send_report, REPORTED, [spanned, reports.read.sent])
        self._views = view_of(self.table), view_of(nodes.bounds)

    def _recorded(self, kernel: wp.Kernel, items: int, inputs: Sequence[Any]) -> wp.Launch:
        made = record(kernel, inputs, self.device)
        made.set_dim(items)
        return made

    def take(self, old: DeviceMoves, placements: wp.array) -> None:
        """Copies what does not move from another state."""
        own, theirs = self.moves.bounded, old.bounded
        pairs = (own.origin, theirs.origin), (own.corners, theirs.corners), (own.norms, theirs.norms)
        for to, values in (*pairs, (self.moves.transforms, old.transforms), (self.table, placements)):
            wp.copy(to, values)

    def start(self, chosen: wp.array, given: wp.array, is_measured: bool) -> None:
        """Moves instances; arguments are those of the kernels. `reports` has what the host reads then."""
        moving = chosen.size or self.count
        place = self._places.get(given.dtype)
        if place is None:
            inputs = place_inputs(chosen, given, self.moves, self.table, self.reports.spanned)
            place = self._places[given.dtype] = self._recorded(specialise(make_place_instances, given.dtype), moving, inputs)
        for launched, items, arrays in (
            (place, moving, {ROWS: chosen, GIVEN: given}),
            (self._bound, moving * team_of(self.device), {ROWS + 1: chosen}),
        ):
            for index, values in arrays.items():
                launched.set_param_at_index_from_ctype(index, values.__ctype__())
            bounds: Any = launched.bounds
            if bounds.size != items:
                launched.set_dim(items)
            launched.launch()
        for launched in self._rest:
            launched.launch()
        if is_measured:
            self._measure.launch()
        self._send.launch()

    def leased(self, lease: Lease) -> tuple[wp.array, wp.array]:
        """The placements and the boxes of nodes, each of which keeps a lease alive."""
        table, bounds = map(twin, self._views)
        return keep_alive(table, lease), keep_alive(bounds, lease)


class Lease:
    """Gives a `KeptMove` back when no state, and no result, has its arrays any more."""

    __slots__ = ("_free", "_key", "_number")

    def __init__(self, move: KeptMove, free: FreeList[KeptMove], key: Hashable) -> None:
        self._number, self._free, self._key = id(move), free, key
        free.lent[self._number] = move

    def __del__(self) -> None:
        self._free.give_back(self._free.lent.pop(self._number), self._key)


class Reports:
    """Memory of one caller for what an update computes on the way, and for what the host reads of it."""

    def __init__(self, device: wp.Device) -> None:
        self.spanned, self.read = new_spanned(device), HostNumbers(REPORTED, wp.float64, device)

    def request(self) -> None:
        """Lets the device copy `Spanned.report` when all kernels are done."""
        wp.copy(self.read.own, self.spanned.report)

    def fetch(self) -> list[float]:
        """What was copied; waits for it."""
        return self.read.fetch().tolist()


_reports: FreeList[Reports] = FreeList(MAX_FREE)


def new_spanned(device: wp.Device) -> Spanned:
    """Memory for what all instances span."""
    spanned = Spanned()
    spanned.found = wp.empty(SPANNED, dtype=wp.int64, device=device)
    spanned.report = wp.empty(REPORTED, dtype=wp.float64, device=device)
    spanned.extent = wp.empty(7, dtype=float, device=device)
    return spanned


class StartedMove:
    """Instances that the device moves.

    Args:
        moves, table: the arrays of the next state, and its placements.
        tree: its upper level, whose box is known when `boxes` is.
        boxes: of a graph, which says nothing to the host; None where `finish` reads them.
        reports: what is read; None for `boxes`.
        is_measured: whether the cost of the upper level is computed.
        free: where `reports` are given back; None if they are kept otherwise.
    """

    def __init__(
        self,
        moves: DeviceMoves,
        table: wp.array,
        tree: UpperTree,
        boxes: InstanceBoxes | None,
        reports: Reports | None,
        is_measured: bool = False,
        free: FreeList[Reports] | None = None,
    ) -> None:
        self.moves, self.table, self.tree = moves, table, tree
        self._boxes, self._reports, self._is_measured, self._free = boxes, reports, is_measured, free

    def finish(self) -> InstanceBoxes | None:
        """Where the instances are, when all kernels are done; None if a transform must be checked on the host."""
        if self._reports is None:
            return self._boxes
        report = self._reports.fetch()
        if self._free is not None:
            self._free.give_back(self._reports, self.table.device.alias)
        if report[8] < self.table.size:
            return None
        if self._is_measured:
            self.tree.cost = cost_of(report[12], report[13])
        self.tree.low, self.tree.high = wp.vec3(*report[14:17]), wp.vec3(*report[17:20])
        return BoxesOnDevice(self.moves, report)


def move_on_device(
    state: Any, rows: np.ndarray | None, given: wp.array, is_measured: bool, mask: int | None = None
) -> StartedMove:
    """Moves instances, and does not wait for the device.

    Args:
        state: the old one, a `wrt.scene.instanced_state.InstancedState`.
        rows: (M,) instances that move, each once; None for all.
        given: their transforms, as `transforms_on` gives them.
        is_measured: whether the cost of the upper level is computed.
        mask: of all that move; None for those they have.
    """
    device, captures = state.device, bool(state.device.is_capturing)
    old = state.device_moves
    if old is None:
        with kept(device):
            old = DeviceMoves.of(state)
    if keeps_moves(device) and not captures and mask is None:
        return move_kept(state, old, rows, given, is_measured)
    made, table = old.copied(whole=rows is None), wp.clone(state.device_mesh.placements)
    made.are_similar = old.knows_similar(rows, given)
    reports = None if captures else _reports.take(device.alias) or Reports(device)
    spanned = new_spanned(device) if reports is None else reports.spanned
    nodes = nodes_of(state.tree, made.level_first)
    count, moving = len(table), len(table) if rows is None else len(rows)
    chosen = made.rows_on_device(rows)
    if mask is not None:
        made.kept = FreeList(MAX_KEPT)  # what waits has other masks
        launch(write_masks, moving, [chosen, wp.uint32(mask), table], device=device)
    placed = place_inputs(chosen, given, made, table, spanned)
    launch(specialise(make_place_instances, given.dtype), moving, placed, device=device)
    launch(bound_moved, moving * team_of(device), bound_inputs(made, table, chosen, device), device=device)
    shares = shares_of(count, device)
    launch(span_instances, shares, [shares, made.bounded, spanned], device=device)
    laid: list[Any] = [int(captures), wp.vec3d(*map(float, state.center)), made.bounded, table, nodes, spanned]
    launch(lay_out, max(count, len(nodes.child)), laid, device=device)
    for kernel, items, inputs in refit_steps(state.tree.forest.level_first, nodes, device):
        launch(kernel, items, inputs, device=device)
    if is_measured:
        shares = shares_of(len(nodes.child), device)
        launch(measure_nodes, shares, [shares, nodes, spanned], device=device)
    tree = moved_tree(state.tree, nodes.bounds)
    if reports is None:
        tree.extent = spanned.extent
        keep_alive(table, (state.device_mesh.placements, old, made, tree))  # the graph reads them whenever it is launched
        return StartedMove(made, table, tree, BoxesOnDevice(made, state.boxes.extremes, state.boxes.frame), None)
    reports.request()
    return StartedMove(made, table, tree, None, reports, is_measured, _reports)


def keeps_moves(device: wp.Device) -> bool:
    """Whether moves take memory and packed kernels of states that are gone: where Python takes longer than the kernels."""
    return device.is_cuda


def move_kept(state: Any, old: DeviceMoves, rows: np.ndarray | None, given: wp.array, is_measured: bool) -> StartedMove:
    """`move_on_device` on CUDA outside graphs, in memory of states that nobody has any more; old: the state's arrays."""
    device = state.device
    stream = device.stream.cuda_stream if device.is_cuda else None
    move = old.kept.take(stream) or KeptMove(state, old, Reports(device))
    if rows is not None:
        move.take(old, state.device_mesh.placements)
    move.start(old.rows_on_device(rows), given, is_measured)
    made = twin(move.moves)
    made.chosen, made.lease, made.are_similar = old.chosen, Lease(move, old.kept, stream), old.knows_similar(rows, given)
    table, bounds = move.leased(made.lease)
    return StartedMove(made, table, moved_tree(state.tree, bounds), None, move.reports, is_measured)


def view_of(values: wp.array) -> wp.array:
    """The same flat array, packed for kernels, which does not own its memory."""
    view = wp.array(ptr=values.ptr, dtype=values.dtype, shape=values.size, device=values.device)
    view.__ctype__()  # its copies share it
    return view


def twin(one: Any) -> Any:
    """Another object with the same attributes, without asking its class how it is copied."""
    other = object.__new__(type(one))
    other.__dict__.update(one.__dict__)
    return other


def moved_tree(tree: UpperTree, bounds: wp.array) -> UpperTree:
    """The upper level around other boxes, of which the host knows nothing."""
    moved = twin(tree)
    moved.__dict__.pop("_struct", None)
    moved.bounds, moved.corners, moved.host, moved.extent, moved.cost = bounds, None, None, None, None
    return moved


def team_of(device: wp.Device) -> int:
    """Threads that bound an instance."""
    return TEAM if device.is_cuda else 1


def shares_of(count: int, device: wp.Device) -> int:
    """Threads among which so many values are divided."""
    return min(-(-count // 32) * 32, MAX_SHARES) if device.is_cuda else 1


def place_inputs(chosen: wp.array, given: wp.array, made: DeviceMoves, table: wp.array, spanned: Spanned) -> list[Any]:
    """Arguments of `place_instances`."""
    return [chosen, given, made.cover, made.bounded, made.transforms, table, spanned]


def bound_inputs(made: DeviceMoves, table: wp.array, chosen: wp.array, device: wp.Device) -> list[Any]:
    """Arguments of `bound_moved`."""
    return [team_of(device), chosen, made.cover, made.transforms, table, made.bounded]


def nodes_of(tree: UpperTree, level_first: wp.array) -> UpperNodes:
    """The upper level, with memory for other boxes."""
    nodes = UpperNodes()
    nodes.child, nodes.order, nodes.level_first, nodes.width = tree.child, tree.primitive, level_first, tree.width
    nodes.bounds = wp.empty(tree.bounds.size, dtype=float, device=tree.bounds.device)
    return nodes


def refit_steps(
    level_first: tuple[int, ...], nodes: UpperNodes, device: wp.Device
) -> Iterator[tuple[wp.Kernel, int, list[Any]]]:
    """Launches, by kernel, items and arguments, that write the boxes of inner nodes from those of leaves: large levels one by
    one, those above them by one block."""
    level = len(level_first) - 2  # the last one has leaves only
    while level > 0 and (level_first[level] - level_first[level - 1]) * nodes.width > MAX_SMALL:
        level -= 1
        begin, end = level_first[level] * nodes.width, level_first[level + 1] * nodes.width
        yield refit_level, end - begin, [begin, nodes]
    if level > 0:
        threads = BLOCK if device.is_cuda else 1
        yield specialise(make_refit_levels, BLOCK), threads, [threads, level, nodes]


def fetched(state: Any) -> dict[str, Any]:
    """What the host holds of a state after moves on its device: values of attributes."""
    boxes, tree = InstanceBoxes(state.boxes.origin, state.boxes.box, state.boxes.norms), twin(state.tree)
    tree.extent = None
    tree = tree.around(*boxes.rounded(), tree.bounds.numpy().reshape(-1, 6, tree.width))
    table = state.device_mesh.placements.numpy().astype(Placement.numpy_dtype())  # type: ignore[attr-defined]
    return {"instances": state.instances.detached(), "boxes": boxes, "built_tree": tree, "table": table, "device_moves": None}

"""The binned build of few triangles, from vertices to the finished tree, on the calling thread.

**Problem.** With a thousand triangles most of a build is not its kernels but Python: to allocate arrays, to pack
the arguments of launches, and to describe every intermediate result (notebooks/records/2026-11-23-small-scenes.md).

**Idea.** A `FewTriangles` has everything for up to `capacity` triangles: work arrays, and the kernels of all phases with packed
arguments. A build writes what differs, which are numbers and addresses, and calls the kernels one after another. They are the
kernels of `wrt.builders.bvh.binned_bvh`, and one task builds the whole tree, as it does there. So the trees are the same.

**Steps.** A call from Python takes as long as most of the kernels, so most of them are called from compiled code: one call in
place of a dozen (`call_steps`). A step is a kernel with packed arguments
(`wrt.kernels.runtime.argument_packing.PackedKernel`): three words of 64 bits, which are its entry point, and the addresses of
its launch bounds and of its arguments.

**Limits.** On the CPU, without reinsertion. Up to `MAX_TRIANGLES` triangles, which several threads would not build faster.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from struct import Struct
from time import perf_counter

import numpy as np
import warp as wp

from wrt.builders.bvh.binned_bvh import MIN_LARGE, kernels
from wrt.builders.bvh.bvh_config import BvhConfig
from wrt.builders.bvh.phases.bin_heuristic import SURFACE, AllDirections
from wrt.builders.bvh.phases.binary_tree import Frame, empty_tree
from wrt.builders.bvh.phases.bvh_bins import make_scratch
from wrt.builders.bvh.phases.bvh_subtrees import STACK, subtree_kernels, subtree_memory
from wrt.builders.bvh.phases.collapse import empty_levels, list_children, scan_level, search_kernels, write_nodes
from wrt.builders.tree import BuildStats, Bvh
from wrt.builders.triangle_boxes import Boxes, compute_boxes
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH
from wrt.kernels.layout.mesh_placement import make_shift
from wrt.kernels.runtime import native
from wrt.kernels.runtime.argument_packing import PackedKernel
from wrt.kernels.runtime.job_queue import BOUNDS, on_cpu
from wrt.kernels.runtime.launch import load, specialise
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.runtime.workspace import give_back, host_view, take

STEP_WORDS = 3

CALLS = "(const wrt::Call*)steps.data"


@native.func_native("calls.h", on_cpu(f"for (int i = 0; i < (int)steps.shape[0] / {STEP_WORDS}; ++i) ({CALLS})[i].run();"))
def call_steps(steps: wp.array(dtype=wp.int64)) -> int:
    """Calls all steps, each for the items in its launch bounds."""


@native.func_native(
    "calls.h",
    on_cpu(
        f"static_assert(sizeof(wrt::Call) == 8 * {STEP_WORDS});\n"
        f"return wrt::collapse_steps<{BOUNDS}>({CALLS}, totals.data, level_first.data);"
    ),
)
def collapse_steps(steps: wp.array(dtype=wp.int64), totals: wp.array(dtype=int), level_first: wp.array(dtype=int)) -> int:
    """The levels of `wrt.builders.bvh.phases.collapse`: solve, and for each level pick, scan and list. Returns their number."""


@exact_kernel
def run_steps(first: int, steps: wp.array(dtype=wp.int64)):
    """One item: calls all steps."""
    call_steps(steps)


@exact_kernel
def run_collapse(
    first: int,
    steps: wp.array(dtype=wp.int64),
    totals: wp.array(dtype=int),
    level_first: wp.array(dtype=int),
    levels: wp.array(dtype=int),
):
    """One item: finds the wide nodes.

    totals: (2,) wide nodes and blocks. level_first: first node of each level, and the end. levels: (1,) their number."""
    levels[0] = collapse_steps(steps, totals, level_first)


def steps_of(kernels: Sequence[PackedKernel]) -> wp.array:
    """The steps of kernels, which the caller keeps alive."""
    words = [[one.entry, ctypes.addressof(one.bounds), ctypes.addressof(one.arguments)] for one in kernels]
    return wp.array(np.array(words, dtype=np.int64).ravel(), dtype=wp.int64, device="cpu")


MAX_TRIANGLES = MIN_LARGE
"""Most triangles of such a build."""

POINT = Struct("3f")
"""The coordinates of a vec3, unpacked from its memory at once: indexing a Warp vector is a call a coordinate."""

MIN_CAPACITY = 1024
"""Least number of triangles for which work arrays are made."""


class FewTriangles:
    """Work arrays and packed kernels of builds of up to `capacity` triangles; for one caller at a time.

    Args:
        config: of the trees, without reinsertion.
        dtype: of the vertices, vec3 or vec3d.
        capacity: most triangles.
    """

    def __init__(self, config: BvhConfig, dtype: type, capacity: int) -> None:
        device, width = wp.get_device("cpu"), config.cost.width
        shift, build, refer, solve, pick = make_kernels(dtype)
        load([shift, compute_boxes, run_steps, *kernels(config, capacity)], device)
        self.capacity, self.width = capacity, width
        boxes = Boxes()
        boxes.low, boxes.high = (wp.empty((3, capacity), dtype=float, device=device) for _ in range(2))
        references, parts = empty(16 * capacity, float), empty(16, float)
        tasks, subtrees, totals = empty(1, Frame), empty(1, wp.vec2i), empty(2, int)
        stack = wp.empty((1, STACK), dtype=Frame, device=device)
        memory = subtree_memory(references, 0, make_scratch(1, device), empty(8 * STACK, float))
        tree, wide = empty_tree(capacity, device), empty_levels(capacity + 1, width, device)
        rules, rays = config.struct(), AllDirections()
        points, given, faces, numbers, floats = (
            empty(0, wp.vec3),
            empty(0, dtype),
            empty(0, wp.vec3i),
            empty(0, int),
            empty(0, float),
        )

        def packed(kernel: wp.Kernel, *inputs: object) -> PackedKernel:
            return PackedKernel(kernel, [0, *inputs], device)

        self.shift = packed(shift, wp.vec3d(), given, points)
        self.boxes = packed(compute_boxes, points, faces, boxes)
        self.references = packed(refer, boxes, 0, 0, references, parts)
        self.subtree = packed(build, rules, rays, memory, tasks, 1, stack, tree, subtrees)
        self.solve = packed(solve, rules, rays, tree, subtrees, numbers, references)
        self.pick = packed(pick, 0, rules, rays, tree, references, wide)
        self.scan = packed(scan_level, 0, 0, wide, totals)
        self.list = packed(list_children, 0, width, wide)
        self.write = packed(write_nodes, tree, rules.cost.width_bits, wide, floats, numbers, numbers)
        level_first, levels = empty(MAX_WIDE_DEPTH + 2, int), empty(1, int)
        self.to_references = packed(run_steps, steps_of([self.shift, self.boxes, self.references]))
        searching = steps_of([self.solve, self.pick, self.scan, self.list])
        self.to_levels = packed(run_collapse, searching, totals, level_first, levels)
        self.levels = ctypes.c_int32.from_address(levels.ptr)
        self.level_first = (ctypes.c_int32 * len(level_first)).from_address(level_first.ptr)
        self.memory = self.subtree.argument(3)
        self.given, self.points = self.shift.argument(2), self.shift.argument(3)
        self.corners, self.faces = self.boxes.argument(1), self.boxes.argument(2)
        self.nodes = [self.write.argument(index) for index in (4, 5, 6)]
        self.root = (ctypes.c_float * 8).from_address(tree.box.ptr)
        self.task = (ctypes.c_int32 * 5).from_address(tasks.ptr)
        ctypes.c_int32.from_address(wide.source.ptr).value = 0  # the root, in every build
        self.totals = (ctypes.c_int32 * 2).from_address(totals.ptr)
        work = [
            boxes.low,
            boxes.high,
            references,
            tree.box,
            tree.range,
            tree.pair,
            tree.order,
            wide.source,
            wide.pick,
            wide.first,
        ]
        self.work_bytes = sum(array.capacity for array in work)

    def build(
        self, center: wp.vec3d, vertices: np.ndarray, faces: wp.array, low: wp.vec3, high: wp.vec3, relative: wp.array
    ) -> Bvh:
        """Writes `relative` and builds the tree; arguments as in `build_small_mesh`."""
        start, count = perf_counter(), len(faces)
        root, task = self.root, self.task
        root[0:3], root[4:7] = POINT.unpack(low), [-value for value in POINT.unpack(high)]
        task[0:5] = 0, 0, count, 0, 0
        self.place(center, vertices, faces, relative)
        self.to_references.call()
        referenced = perf_counter()
        self.memory.triangles = count
        self.subtree.call()
        built = perf_counter()
        bounds, child, primitive, level_first = self.collapse()
        stats = BuildStats(
            {
                "references": referenced - start,
                "top levels": 0.0,
                "subtrees": built - referenced,
                "collapse": perf_counter() - built,
            },
            self.work_bytes + bounds.capacity + child.capacity + primitive.capacity,
        )
        return Bvh(bounds, child, primitive, low, high, self.width, tuple(level_first), stats)

    def place(self, center: wp.vec3d, vertices: np.ndarray, faces: wp.array, relative: wp.array) -> None:
        """Writes what the kernels up to the references depend on: vertices relative to the centre, boxes, references."""
        points, count = len(vertices), len(faces)
        self.shift.arguments.p1 = center
        self.given.data = vertices.__array_interface__["data"][0]
        self.points.data = self.corners.data = relative.ptr
        self.given.shape[0] = self.points.shape[0] = self.corners.shape[0] = points
        self.faces.data, self.faces.shape[0] = faces.ptr, count
        for bounds, items in ((self.shift.bounds, points), (self.boxes.bounds, count)):
            bounds.shape[0] = bounds.size = items
        arguments = self.references.arguments
        arguments.p2 = arguments.p3 = count

    def collapse(self) -> tuple[wp.array, wp.array, wp.array, list[int]]:
        """Bounds, child words, leaf lists and levels of the wide tree (`wrt.builders.bvh.phases.collapse`)."""
        self.to_levels.call()
        level_first, width = self.level_first[: self.levels.value + 1], self.width
        nodes, blocks = self.totals
        lanes = nodes * width
        block = np.empty((7 * nodes + blocks) * width, dtype=np.int32)
        arrays = (
            host_view(block, wp.float32, 0, 6 * lanes),
            host_view(block, wp.int32, 24 * lanes, lanes),
            host_view(block, wp.int32, 28 * lanes, blocks * width),
        )
        for field, array in zip(self.nodes, arrays, strict=True):
            field.data, field.shape[0] = array.ptr, array.size
        self.write.call_own_range(0, nodes)
        return *arrays, level_first


def make_kernels(dtype: type) -> tuple[wp.Kernel, ...]:
    """The kernels that depend on a type or a heuristic."""
    return specialise(make_shift, dtype), *subtree_kernels(SURFACE), *search_kernels(SURFACE)


def empty(count: int, dtype: type) -> wp.array:
    """A flat array on the CPU."""
    return wp.empty(count, dtype=dtype, device="cpu")


def build_small_mesh(
    config: BvhConfig, center: wp.vec3d, vertices: np.ndarray, faces: wp.array, low: wp.vec3, high: wp.vec3, relative: wp.array
) -> Bvh:
    """Places triangles and builds their tree.

    Args:
        config: of the tree, without reinsertion.
        center: the point that the tree is relative to.
        vertices: (V, 3) float32 or float64, contiguous.
        faces: (F,) vec3i on the CPU, 1 to `MAX_TRIANGLES`.
        low, high: box of all triangles relative to the centre, rounded as the vertices are, without negative zeros.
        relative: (V,) vec3 on the CPU; receives the vertices relative to the centre.
    """
    dtype = wp.vec3 if vertices.dtype == np.float32 else wp.vec3d
    capacity = max(MIN_CAPACITY, 1 << (len(faces) - 1).bit_length())
    kind = build_small_mesh, config, dtype, capacity
    few = take(kind) or FewTriangles(config, dtype, capacity)
    tree = few.build(center, vertices, faces, low, high, relative)
    give_back(kind, few)
    return tree

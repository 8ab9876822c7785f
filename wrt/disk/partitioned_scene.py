"""A scene larger than memory: its parts on disk, the queries that load them, and what these refuse."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import warp as wp

from wrt.accelerators.tree_descriptions import Bvh
from wrt.builders.triangle_boxes import boxes_of
from wrt.disk.cycling import cycle
from wrt.disk.forwarding import forward
from wrt.disk.part_cache import PartCache
from wrt.disk.partition_build import build_parts
from wrt.disk.partition_files import PartList, read_list
from wrt.disk.queries_of_parts import CYCLE, PartQueries
from wrt.disk.ray_job import RayJob, UpperTree
from wrt.engine.device_hits import DeviceHits
from wrt.engine.facts.query_kinds import AUTO, Query
from wrt.engine.facts.scene_settings import as_settings
from wrt.engine.memory import empty
from wrt.engine.plan.plan import stack_levels
from wrt.engine.plan.plan_checks import check_culling, check_query
from wrt.engine.plan.planner import DEFAULT_TEST
from wrt.engine.rays.device_rays import DeviceRays, to_device
from wrt.engine.rays.rays import Rays
from wrt.kernels.answers import ANSWERS
from wrt.kernels.layout import bvh_nodes
from wrt.kernels.runtime.launch import refuse_capture, use_threads
from wrt.kernels.simd.lanes import native_width
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.validation import as_bool, as_int
from wrt.query.all_hits import part_of
from wrt.query.blocks import parse_memory, progress_bar
from wrt.tables import lookup

if TYPE_CHECKING:
    from wrt.engine.facts.query_kinds import Query
    from wrt.engine.plan.plan import Plan
    from wrt.kernels.layout.ray_batch import HitBatch
    from wrt.meshes.instance import Geometry

MEMORY = "1 GB"

PART_TRIANGLES = 1 << 19
"""Triangles of a part: up to 40 MB. Every visit costs a millisecond or so, and rays pass through more parts if these are small
(notebooks/records/2026-11-23-parts-on-disk.md)."""

MODES: dict[str, Any] = {CYCLE: cycle, "forward": forward}
"""How rays and parts come together, by name."""

BLOCK = 1 << 21
"""Rays that are on their way at a time; their state takes about 300 MB."""


class QueryTraffic(NamedTuple):
    """What the latest query loaded and traced.

    Attributes:
        loads: parts loaded from disk.
        bytes_read: bytes of their files, read or mapped into memory.
        visits: queues that were traced in a part.
        rays_traced: rays in all these queues.
        peak_bytes: most memory of all parts together.
    """

    loads: int
    bytes_read: int
    visits: int
    rays_traced: int
    peak_bytes: int


class PartitionedScene(PartQueries):
    """A scene whose triangles need not fit in memory: parts by space, on disk, loaded as rays need them.

        scene = wrt.disk.PartitionedScene.build(paths_of_tiles, "city", memory="2 GB")
        scene = wrt.disk.PartitionedScene("city", memory="2 GB")      # later, and in other processes
        hits = scene.intersect(origins, directions)

    Answers equal those of one `wrt.Scene` with the same meshes, bit for bit, whatever the parts, the budget and the mode. A
    query from another thread waits for the one under way.

    Args:
        folder: the folder that `build` made.
        memory: budget for all parts in memory together, in bytes or as text such as "1.5 GB". Rays and hits come on top, about
            150 bytes a ray.
        triangle_test: as in `wrt.Scene`, except tests with records for one origin.
        device: as in `wrt.Scene`.
        num_threads: as in `wrt.Scene`.

    Attributes:
        last_query: what the latest query loaded (`QueryTraffic`); None before the first.

    Raises:
        TypeError: an argument has a wrong type.
        FileNotFoundError: there is no such scene.
        ValueError: its list of parts is damaged; a budget smaller than the largest part; an unknown name; no such device.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        memory: int | str = MEMORY,
        triangle_test: str = AUTO,
        device: str | wp.Device | None = None,
        num_threads: int | None = None,
    ) -> None:
        self.folder = as_folder(folder)
        settings = as_settings(Bvh(), triangle_test, device, num_threads)
        check_test(settings.triangle_test)
        self._parts = read_list(self.folder)
        self._cache = PartCache(self.folder, self._parts, settings, parse_memory(memory))
        self._check_budget(DEFAULT_TEST if settings.triangle_test == AUTO else settings.triangle_test)
        self._upper = upper_tree(self._parts, settings.device)
        self._lock = threading.RLock()
        self.last_query: QueryTraffic | None = None

    @classmethod
    def build(
        cls,
        geometry: Geometry,
        folder: str | Path,
        *,
        part_triangles: int = PART_TRIANGLES,
        accelerator: str | Bvh = "bvh",
        store_records: bool = True,
        memory: int | str = MEMORY,
        triangle_test: str = AUTO,
        device: str | wp.Device | None = None,
        num_threads: int | None = None,
        progress: bool = False,
    ) -> PartitionedScene:
        """Writes the parts of a scene to a new folder, and opens it.

        One mesh, or one part, is in memory at a time; the disk holds the meshes twice for a while.

        Args:
            geometry: meshes, trimesh objects, paths of mesh files, or an iterable of such, which is read once. Each mesh is a
                geometry of its own, in the order given.
            folder: path of a folder that does not exist yet, or is empty.
            part_triangles: greatest number of triangles of a part, at least 1. Several parts should fit in `memory`.
            accelerator: "bvh", "auto", or a `wrt.Bvh`, the tree of each part.
            store_records: whether files hold the triangle records of `triangle_test`, at least 36 bytes a triangle more.
                Otherwise they are made whenever a part is loaded, as always on a GPU. That may be better for slow disks.
            memory, triangle_test, device, num_threads: as in the constructor.
            progress: whether to show a progress bar on stderr.

        Raises:
            TypeError: an argument has a wrong type, or an item is not a mesh.
            ValueError: no mesh, more than 2^31 - 1 triangles, triangles that spread too far (as for `wrt.Scene`), more than
                65,534 parts, or another accelerator; and as the constructor.
            FileExistsError: the folder is not empty.
            OSError: it cannot be written.
        """
        size = as_int("part_triangles", part_triangles, 1)
        store_records, progress = as_bool("store_records", store_records), as_bool("progress", progress)
        settings = as_settings(accelerator, triangle_test, device, num_threads)
        if not isinstance(settings.accelerator, Bvh):
            raise ValueError(f"accelerator is {accelerator!r}; the parts of a scene have a BVH: choose 'bvh' or a wrt.Bvh")
        check_test(settings.triangle_test)
        parse_memory(memory)
        with use_threads(settings.num_threads), progress_bar(progress, None) as advance:
            stores = store_records and settings.device.is_cpu
            build_parts(geometry, as_folder(folder), settings, size, stores, lambda count, phase: advance(int(count)))
        return cls(folder, memory=memory, triangle_test=triangle_test, device=device, num_threads=num_threads)

    def release(self) -> None:
        """Drops all parts from memory; later queries load them again."""
        with self._lock:
            self._cache.clear()

    @property
    def triangle_count(self) -> int:
        """Number of triangles of all parts."""
        return int(self._parts.first[-1])

    @property
    def part_count(self) -> int:
        """Number of parts."""
        return len(self._parts)

    @property
    def names(self) -> tuple[str | None, ...]:
        """Names of the meshes, in the order of their geometry ids."""
        return self._parts.names

    @property
    def center(self) -> np.ndarray:
        """(3,) float64; positions are held in float32, relative to this point."""
        return self._parts.center

    @property
    def bounds(self) -> np.ndarray:
        """(2, 3) float64: lower and upper corner of the bounding box of all triangles."""
        return self._parts.bounds.astype(np.float64) + self._parts.center

    @property
    def part_bounds(self) -> np.ndarray:
        """(P, 2, 3) float64: lower and upper corner of the bounding box of each part."""
        return np.stack([self._parts.low, self._parts.high], axis=1).astype(np.float64) + self._parts.center

    @property
    def part_triangles(self) -> np.ndarray:
        """(P,) int64: number of triangles of each part."""
        return self._parts.triangles

    @property
    def device(self) -> wp.Device:
        """The device on which parts are traced."""
        return self._cache.settings.device

    @property
    def num_threads(self) -> int | None:
        """Threads for queries on the CPU; None for `wrt.get_num_threads()`."""
        return self._cache.settings.num_threads

    @property
    def memory(self) -> int:
        """Budget for parts in memory, in bytes."""
        return self._cache.budget

    @property
    def bytes(self) -> int:
        """Memory of all parts with the records of the scene's triangle test, if all were loaded."""
        return int(self._expected_bytes(self._cache.settings.triangle_test).sum())

    @property
    def loaded_bytes(self) -> int:
        """Memory of the parts that are loaded."""
        return self._cache.bytes

    def __repr__(self) -> str:
        return f"PartitionedScene({self.triangle_count} triangles, {self.part_count} parts, '{self.folder}')"

    def _expected_bytes(self, triangle_test: str) -> np.ndarray:
        test = DEFAULT_TEST if triangle_test == AUTO else triangle_test
        return self._parts.bytes_with(TRIANGLE_TESTS[test].record.components)

    def _check_budget(self, triangle_test: str) -> np.ndarray:
        """(P,) memory of each part with the records of a test.

        Raises:
            ValueError: the largest part exceeds the budget.
        """
        needed = self._expected_bytes(triangle_test)
        if needed.max() > self._cache.budget:
            raise ValueError(
                f"memory is {self._cache.budget:,} bytes, and part {int(needed.argmax())} takes {int(needed.max()):,}; give "
                "more memory, or build the scene with a smaller part_triangles"
            )
        return needed

    def _answer(self, rays: Rays, query: Query, mode: str) -> tuple[DeviceRays, DeviceHits, wp.array, Plan | None]:
        """The answers of all rays: the rays on the device, the answers, the corners of triangles hit, and a plan."""
        run = lookup(MODES, mode, "mode")
        check_traversal(query)
        settings = self._cache.settings
        refuse_capture("a query of parts", settings.device)
        if query.triangle_test != AUTO:
            check_test(lookup(TRIANGLE_TESTS, query.triangle_test, "triangle_test").name)
        needed = self._check_budget(settings.triangle_test if query.triangle_test == AUTO else query.triangle_test)
        with self._lock, use_threads(settings.num_threads):
            before = replace(self._cache.traffic)
            self._cache.traffic.peak_bytes = 0
            buffers = to_device(rays, settings.device, self._parts.center)
            batch = DeviceHits.new(query.kind, buffers.count, settings.device)
            if buffers.count:
                batch.clear(query.kind)
            answer = ANSWERS[query.kind]
            corners = empty(3 * buffers.count if answer.names_triangles else 0, wp.vec3, settings.device)
            jobs, ranges = [], [(begin, min(begin + BLOCK, buffers.count)) for begin in range(0, buffers.count, BLOCK)]
            while ranges:
                begin, end = ranges.pop()
                hits = piece_of(batch, query.kind, begin, end)
                own = corners[3 * begin : 3 * end] if answer.names_triangles else corners
                block = part_of(buffers.batch, begin, end)
                job = RayJob(self._cache, self._upper, query, block, buffers.facts.coherent, hits, own, needed)
                if run(job):
                    jobs.append(job)
                else:
                    ranges += [(begin, (begin + end) // 2), ((begin + end) // 2, end)]
            now = self._cache.traffic
            self.last_query = QueryTraffic(
                loads=now.loads - before.loads,
                bytes_read=now.bytes_read - before.bytes_read,
                visits=sum(job.visits for job in jobs),
                rays_traced=sum(job.traced for job in jobs),
                peak_bytes=now.peak_bytes,
            )
        return buffers, batch, corners, jobs[0].plan if jobs else None


def piece_of(batch: DeviceHits, kind: str, begin: int, end: int) -> HitBatch:
    """The answers of the rays begin .. end - 1."""
    if end - begin == batch.count:
        return batch.struct()
    piece = DeviceHits(end - begin, batch.device)
    piece.__dict__.update({name: getattr(batch, name)[begin:end] for name in ANSWERS[kind].stored.columns})
    return piece.struct()


def upper_tree(parts: PartList, device: wp.Device) -> UpperTree:
    """The tree over the boxes of the parts; its box is that of the scene."""
    width = max(native_width(device), 2)
    tree = Bvh(width=width, max_leaf_triangles=1).build(boxes_of(parts.low, parts.high), width)
    child, part = tree.child.numpy().copy(), tree.primitive.numpy()
    leaves = np.flatnonzero((child < 0) & ((~child & 63) > 0))
    child[leaves] = ~(part[(~child[leaves] >> 6) * width] << 6 | 1)
    nodes = bvh_nodes.WideNodes()
    nodes.bounds, nodes.child = tree.bounds.to(device), wp.array(child, dtype=int, device=device)
    nodes.low, nodes.high = (wp.vec3(*corner.tolist()) for corner in parts.bounds)
    return UpperTree(nodes, width, stack_levels(tree.depth))


def as_folder(folder: str | Path) -> Path:
    """The path of a folder.

    Raises:
        TypeError: not a path.
    """
    if not isinstance(folder, (str, Path)):
        raise TypeError(f"folder must be a path, not {type(folder).__name__}")
    return Path(folder)


def check_traversal(query: Query) -> None:
    """Refuses a traversal that cannot answer a query in a part.

    Raises:
        TypeError: not a name.
        ValueError: an unknown name; it does not walk BVHs, or does not answer the query.
    """
    if not isinstance(query.traversal, str):
        raise TypeError(f"traversal must be a name, not {type(query.traversal).__name__}: a plan is for one tree")
    if query.traversal == AUTO:
        return
    traversal = lookup(TRAVERSALS, query.traversal, "traversal")
    tree = "bvh" if traversal.walks_tree else "none"
    if tree not in traversal.trees:
        able = ", ".join(name for name, entry in TRAVERSALS.items() if tree in entry.trees)
        raise ValueError(f"traversal {traversal.name!r} does not walk a bvh, the tree of each part; choose from auto, {able}")
    if traversal.needs_shared_origin:
        raise ValueError(
            f"traversal {traversal.name!r} takes rays from one point, and those in a part have their own; choose auto"
        )
    test = (
        TRIANGLE_TESTS[DEFAULT_TEST]
        if query.triangle_test == AUTO
        else lookup(TRIANGLE_TESTS, query.triangle_test, "triangle_test")
    )
    check_query(query.kind, traversal, tree, test)
    check_culling(query.cull_backfaces, traversal, tree)


def check_test(triangle_test: str) -> None:
    """Refuses tests with records for one origin.

    Raises:
        ValueError: it is one.
    """
    if triangle_test != AUTO and TRIANGLE_TESTS[triangle_test].record.per_origin:
        raise ValueError(
            f"triangle_test is {triangle_test!r}, whose records depend on the origin of all rays; a partitioned scene supports "
            "the others, such as 'woop'"
        )

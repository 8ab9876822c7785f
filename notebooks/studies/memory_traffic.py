"""Bytes that rays read from memory, by a model of the L2 cache: single rays, packets and queues.

The visits of the kernels of `single` and `queued` are logged and read through the model
(`wrt.kernels.classics.studies.cache_model`), scene and rays together, as one thread makes them. Packets are the union of the
visits of their rays: the least that a packet reads.

What is not counted: lines that are written back, the upper tree of the queued traversal, which stays in the cache, and the
lists that are sorted between generations (8 bytes per ray and generation).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.bench.core.workloads import WorkloadMaker
from wrt.engine.device_hits import DeviceHits
from wrt.engine.executor import on_device
from wrt.engine.facts.query_kinds import CLOSEST, QUERIES
from wrt.engine.launch import queued_tracing
from wrt.engine.launch.traversal_launch import no_work
from wrt.engine.launch.triangle_records import records_of
from wrt.engine.plan.choices import make_plan
from wrt.engine.plan.plan import traversal_config, traversal_of
from wrt.engine.rays.rays import as_rays
from wrt.kernels.classics.studies.cache_model import LINE, count_misses
from wrt.kernels.classics.studies.visit_log import make_log_kernel
from wrt.kernels.compilation.cache_size import l2_bytes
from wrt.kernels.runtime.launch import launch, specialise
from wrt.kernels.traversal.capabilities import Capabilities
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

if TYPE_CHECKING:
    from wrt.engine.plan.plan import Plan

WAYS = 8
"""Ways of the modelled cache, as in current L2 caches."""

RAY_FIELDS = (12, 12, 4, 4, 8, 8)
"""Bytes of a ray's origin, direction, t and triangle of the best hit, weights, and place in the queues: an array each."""


@dataclass(frozen=True)
class MemoryTraffic:
    """What rays read from memory.

    Attributes:
        name: how they were traced.
        visits: nodes and leaves visited per ray.
        scene_bytes: bytes of nodes and triangle records read from memory per ray.
        ray_bytes: bytes of rays and their hits read from memory per ray.
    """

    name: str
    visits: float
    scene_bytes: float
    ray_bytes: float

    @property
    def bytes(self) -> float:
        """All bytes read from memory per ray."""
        return self.scene_bytes + self.ray_bytes


@dataclass
class Reads:
    """Ranges of bytes in the order in which they are read.

    Attributes:
        first, size: byte and length of each range.
        is_ray: whether it belongs to a ray.
    """

    first: np.ndarray
    size: np.ndarray
    is_ray: np.ndarray

    def misses(self, cache_bytes: int) -> int:
        """Lines that are read from memory."""
        sets = max(1, cache_bytes // (LINE * WAYS))
        tags, missed = wp.full(sets * WAYS, -1, dtype=wp.int64, device="cpu"), wp.zeros(1, dtype=wp.int64, device="cpu")
        first = wp.array(self.first.astype(np.int64), dtype=wp.int64, device="cpu")
        size = wp.array(self.size.astype(np.int32), dtype=int, device="cpu")
        launch(count_misses, 1, [first, size, sets, WAYS, tags, missed], device=wp.get_device("cpu"))
        return int(missed.numpy()[0])


def memory_traffic(
    scene: Scene, origins: Any, directions: Any, packet: int = 32, cache_bytes: int | None = None
) -> list[MemoryTraffic]:
    """Traffic of single rays, of packets of this many rays, and of queues; for closest hits in a scene with a BVH on the CPU.

    Args:
        scene: the scene.
        origins, directions: of the rays.
        packet: rays of a packet.
        cache_bytes: of the modelled cache; None for the machine's L2.
    """
    cache_bytes = cache_bytes or l2_bytes()
    whole, queued = log_of(scene, origins, directions, 1 << 62), log_of(scene, origins, directions, cache_bytes)
    count = int(np.prod(np.shape(directions)[:-1]))
    results = []
    for name, log in (("single", whole), (f"packets of {packet}", in_packets(whole, packet)), ("queued", queued)):
        reads = reads_of(scene, log, count)
        alone = replace(reads, first=reads.first[~reads.is_ray], size=reads.size[~reads.is_ray])
        scene_lines, lines = alone.misses(cache_bytes), reads.misses(cache_bytes)
        visits = len(log[1]) / count
        results.append(MemoryTraffic(name, visits, LINE * scene_lines / count, LINE * (lines - scene_lines) / count))
    return results


def compare_traffic(mesh: TriangleMesh, *, size: int = 128, packet: int = 32) -> list[MemoryTraffic]:
    """Bytes that rays of a view read, one by one, in packets and in queues (Navratil et al. 2007)."""
    (view,) = WorkloadMaker(mesh, size=size).make(["far"])
    return memory_traffic(Scene(mesh, "bvh", device="cpu", num_threads=1), view.origins, view.directions, packet)


Log = tuple[np.ndarray, np.ndarray]
"""(visits,) ray of each visit, and (visits,) node number, or child word of a leaf, in order."""


def log_of(scene: Scene, origins: Any, directions: Any, cache_bytes: int) -> Log:
    """The visits of the queued traversal for a cache of a size; with a huge one, those of single rays."""
    state = scene.state
    buffers = on_device(state, as_rays(origins, directions, 0.0, float("inf")), QUERIES[CLOSEST])
    plan = queued_plan(scene, buffers)
    config = traversal_config(plan, state, CLOSEST, False)
    kernel, records = specialise(make_log_kernel, config), records_of(state, plan, None)
    hits, idle = DeviceHits.new(CLOSEST, buffers.count, state.device), no_work(traversal_of(plan).counters, state.device.alias)
    upper = queued_tracing.upper_nodes(state, plan, cache_bytes)
    numbers, words = [], []
    for tree, waiting in queued_tracing.generations(state, plan, buffers.batch, hits, CLOSEST, idle, False, upper):
        ends, none = wp.zeros(waiting, dtype=int, device="cpu"), wp.empty(0, dtype=int, device="cpu")
        inputs = [tree, records, buffers.batch, hits.struct()]
        launch(kernel, waiting, [*inputs, none, ends], device=state.device)
        counts = ends.numpy().copy()
        log = wp.empty(int(counts.sum()), dtype=int, device="cpu")
        begins = wp.array(np.cumsum(counts) - counts, dtype=int, device="cpu")
        launch(kernel, waiting, [*inputs, log, begins], device=state.device)
        numbers.append(np.repeat(tree.order.numpy()[:waiting], counts))
        words.append(log.numpy())
    return np.concatenate(numbers), np.concatenate(words)


def queued_plan(scene: Scene, buffers: Any) -> Plan:
    """A plan for the traversal whose rays wait in queues."""
    from wrt.kernels.traversal import TRAVERSALS

    name = next(name for name, entry in TRAVERSALS.items() if Capabilities.QUEUED in entry.capabilities)
    return make_plan(scene.state, buffers, name, "auto", CLOSEST)


def in_packets(log: Log, packet: int) -> Log:
    """Each node and leaf once per packet, at its first visit."""
    rays, words = log
    keys = (rays.astype(np.int64) // packet << 32) + words.astype(np.int64)
    _, first = np.unique(keys, return_index=True)
    first.sort()
    return rays[first], words[first]


def reads_of(scene: Scene, log: Log, rays: int) -> Reads:
    """The ranges that visits read: of each node or leaf, and, where another ray comes, of that ray."""
    numbers, words = log
    tree, plan_records = scene.state.tree, next(iter(scene.state.cache.records.values()))[1].records
    width, is_leaf = tree.width, words < 0
    block = plan_records.capacity // (len(tree.primitive) // width)
    box_bytes, word_bytes = 24 * width, 4 * width
    starts = np.cumsum([0, tree.bounds.capacity, tree.child.capacity, plan_records.capacity])
    leaf_first, triangles = ~words >> 6, ~words & 63
    first = np.where(is_leaf, starts[2] + leaf_first.astype(np.int64) * block, words.astype(np.int64) * box_bytes)
    size = np.where(is_leaf, -(-triangles // width) * block, box_bytes)
    children = np.where(is_leaf, -1, starts[1] + words.astype(np.int64) * word_bytes)
    comes = np.flatnonzero(np.diff(numbers, prepend=-1))
    columns, sizes, places, kinds = [first, children], [size, np.full(len(words), word_bytes)], [], []
    order = np.arange(len(words), dtype=np.float64)
    places, kinds = [order, order + 0.25], [np.zeros(len(words), dtype=bool)] * 2
    begin = int(starts[3])
    for part, field in enumerate(RAY_FIELDS):
        columns.append(begin + numbers[comes].astype(np.int64) * field)
        sizes.append(np.full(len(comes), field))
        places.append(comes - 0.5 + 0.01 * part)
        kinds.append(np.ones(len(comes), dtype=bool))
        begin += rays * field
    first, size, place, is_ray = (np.concatenate(parts) for parts in (columns, sizes, places, kinds))
    used = np.flatnonzero(first >= 0)
    used = used[np.argsort(place[used], kind="stable")]
    return Reads(first[used], size[used], is_ray[used])

"""Two-level traversal for many incoherent rays: rays that reach the same instance are grouped and traced as a batch.

**Problem.** Streams are fast because many rays do the same work at the same time. Rays that leave the upper tree one by one no
longer form a stream, and only a few rays of one stream reach the same instance.

**Idea.** Rounds. First each ray lists the nearest instances whose boxes it meets, up to `MAX_LISTED` of them, with the t of
entry. In round k every ray whose k-th entry is not beyond its best hit goes to its k-th instance: rays are counted by instance,
the counts are scanned, and the transformed rays are copied to the positions of their instance. There they are an ordinary
batch, and streams traverse the tree of the mesh. The hits shorten the rays for later rounds. Rays that meet more than
`MAX_LISTED` boxes list the next ones when they have finished the first. Each ray therefore visits instances front to back, and
stops as early as a single ray would.

**Cost.** A round copies 32 bytes per ray to the instances and 16 bytes back, and reads the state of all rays. When few rays are
left, they are traced one by one (`wrt.kernels.traversal.two_level.instance_single`). If the instances of a scene are disjoint,
most rays are done after two rounds.

References: pharr-1997 (rays queued at the parts of a scene).
"""

from functools import cache

import warp as wp

from wrt.kernels.answers import ANSWERS, batch_kinds
from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.instance_maps import Placement, centered_origin, object_ray, ray_environment, ray_mask
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch, load_ray
from wrt.kernels.layout.unchecked import load_int, store_int
from wrt.kernels.runtime.options import exact_kernel, named_kernel, specialised_kernel
from wrt.kernels.simd.box_lanes import intersected_boxes
from wrt.kernels.simd.boxes import INFINITY, ray_slabs, reach
from wrt.kernels.simd.lanes import lanes, lowest_bit
from wrt.kernels.traversal.stream import stream_bvh
from wrt.kernels.traversal.stream.stream_candidates import StreamHits
from wrt.kernels.traversal.stream.stream_kernel import LIST_LANES, StreamCounterRows, StreamCounters, store_stream, stream_ray
from wrt.kernels.traversal.stream.stream_leaves import NodeList
from wrt.kernels.traversal.traversal_config import TraversalConfig
from wrt.kernels.traversal.two_level.instance_single import BvhPart, InstanceTree, root_of

MAX_LISTED = wp.constant(8)
"""Greatest number of instances in the list of a ray."""


@wp.struct
class Search:
    """Search state of N consecutive rays of a batch. The list of a ray is sorted by entry, then by instance."""

    begin: int
    """Number of the first ray."""
    bound: wp.array(dtype=float)
    """(N,) t of the best hit, or t_max; -inf for a ray that is done."""
    size: wp.array(dtype=int)
    """(N,) length of the list."""
    instance: wp.array(dtype=int)
    """(MAX_LISTED * N,) k-th instances of all rays from element k N on."""
    entry: wp.array(dtype=float)
    """(MAX_LISTED * N,) t of entry into their boxes, rounded down."""


@wp.struct
class Sorted:
    """The rays of a round in the spaces of the geometries, ordered by instance."""

    rays: RayBatch
    order: wp.array(dtype=int)
    """Number of each ray in the batch."""
    instance: wp.array(dtype=int)


@wp.func
def precedes(entry: float, instance: int, other_entry: float, other: int):
    """Whether an instance precedes another one in a list."""
    return entry < other_entry or (entry == other_entry and instance < other)


@wp.func
def insert(entries: wp.array(dtype=float), instances: wp.array(dtype=int), size: int, entry: float, instance: int):
    """Inserts an instance into a sorted list of at most MAX_LISTED; a full list drops its last element.

    Returns the new size.
    """
    place = int(size)
    if size == MAX_LISTED:
        place = MAX_LISTED - 1
        if not precedes(entry, instance, entries[place], instances[place]):
            return size
    while place > 0 and precedes(entry, instance, entries[wp.max(place - 1, 0)], instances[wp.max(place - 1, 0)]):
        entries[place] = entries[place - 1]
        instances[place] = instances[place - 1]
        place -= 1
    entries[place] = entry
    instances[place] = instance
    return wp.min(size + 1, MAX_LISTED)


@cache
def make_list_instances(width: int, levels: int) -> wp.Kernel:
    """The kernel that lists the next instances of each ray of a block; width, levels: of the upper tree.

    Nodes are visited in any order, which is cheaper than finding the nearest: most boxes that a ray meets are listed.
    """
    test_boxes, Lanes, stack_size = intersected_boxes(width), lanes(width), levels * (width - 1) + 1

    def list_instances(first: int, top: InstanceTree, rays: RayBatch, resume: bool, search: Search):
        place = first + wp.tid()
        count = search.size.shape[0]
        i = search.begin + place
        ray = load_ray(rays, i)
        passed = float(-INFINITY)
        passed_instance = int(-1)
        waiting = wp.zeros(shape=(stack_size,), dtype=int)
        root = root_of(top, ray_environment(rays, i))
        store_int(waiting, 0, root)
        left = wp.where(ray.valid and root >= 0, 1, 0)
        bound = wp.where(ray.valid, ray.t_max, -INFINITY)
        if resume:
            last = (MAX_LISTED - 1) * count + place
            bound = search.bound[place]
            if search.size[place] == MAX_LISTED and search.entry[last] <= bound:
                passed = search.entry[last]
                passed_instance = search.instance[last]
            else:
                left = int(0)
        else:
            search.bound[place] = bound
        mask = ray_mask(rays, i)
        slabs = ray_slabs(ray.origin, ray.direction, top.slack_scale * reach(ray.origin, top.tree.low, top.tree.high))
        entries = wp.zeros(shape=(MAX_LISTED,), dtype=float)
        instances = wp.zeros(shape=(MAX_LISTED,), dtype=int)
        size = int(0)
        while left > 0:
            left -= 1
            node = load_int(waiting, left)
            entry = Lanes()
            lanes_hit = test_boxes(top.tree.bounds, node, slabs, ray.t_min, bound, entry)
            while lanes_hit != wp.uint32(0):
                lane = lowest_bit(lanes_hit)
                lanes_hit = lanes_hit & (lanes_hit - wp.uint32(1))
                child = load_int(top.tree.child, node * wp.static(width) + lane)
                if child >= 0:
                    store_int(waiting, left, child)
                    left += 1
                else:
                    instance = load_int(top.order, bvh.first_block(child) * wp.static(width))
                    is_seen = (top.placements[instance].mask & mask) != wp.uint32(0)
                    if is_seen and precedes(passed, passed_instance, entry[lane], instance):
                        size = insert(entries, instances, size, entry[lane], instance)
                        if size == MAX_LISTED:
                            bound = wp.min(bound, entries[MAX_LISTED - 1])
        for k in range(size):
            search.instance[k * count + place] = instances[k]
            search.entry[k * count + place] = entries[k]
        search.size[place] = size

    return specialised_kernel(list_instances)


@wp.func
def next_instance(search: Search, turn: int, place: int):
    """The instance that the ray at a place visits in this turn; -1 if there is none, or if its best hit is nearer."""
    instance = int(-1)
    at = turn * search.size.shape[0] + place
    if turn < search.size[place] and search.entry[at] <= search.bound[place]:
        instance = search.instance[at]
    return instance


@exact_kernel
def count_instances(first: int, chunk: int, turn: int, search: Search, counts: wp.array2d(dtype=int)):
    """Counts the rays of a chunk by instance. Item: a chunk of rays. counts: (chunks, instances), initially 0."""
    item = first + wp.tid()
    row = counts[item]
    for place in range(item * chunk, wp.min(search.size.shape[0], (item + 1) * chunk)):
        instance = next_instance(search, turn, place)
        if instance >= 0:
            row[instance] += 1


@exact_kernel
def sort_by_instance(
    first: int,
    top: InstanceTree,
    rays: RayBatch,
    chunk: int,
    turn: int,
    search: Search,
    places: wp.array2d(dtype=int),
    sorted_rays: Sorted,
):
    """Transforms the rays of a chunk and copies them to the positions of their instances. Item: a chunk of rays."""
    item = first + wp.tid()
    row = places[item]
    for place in range(item * chunk, wp.min(search.size.shape[0], (item + 1) * chunk)):
        instance = next_instance(search, turn, place)
        if instance >= 0:
            i = search.begin + place
            to = row[instance]
            row[instance] = to + 1
            local_ray = object_ray(top.placements[instance], centered_origin(rays, i), load_ray(rays, i), search.bound[place])
            sorted_rays.order[to] = i
            sorted_rays.instance[to] = instance
            sorted_rays.rays.origins[to] = local_ray.origin
            sorted_rays.rays.directions[to] = local_ray.direction
            sorted_rays.rays.t_min[to] = local_ray.t_min
            sorted_rays.rays.t_max[to] = local_ray.t_max


@cache
def make_stream_kernel(config: TraversalConfig) -> wp.Kernel:
    """The kernel by which streams trace a round; an item is a segment of one instance's rays."""
    StreamRay = stream_ray(config.triangle_test)
    size, trace = config.stream.rays, stream_bvh.make_trace(config)
    load, store = stream_bvh.stream_loader(config), store_stream(config)
    key_room, stack_size = config.stack.levels * config.width, (config.stack.levels + 1) * size + LIST_LANES

    def streams_of_instances(
        first: int,
        segments: wp.array(dtype=wp.vec3i),
        placements: wp.array(dtype=Placement),
        parts: wp.array(dtype=BvhPart),
        rays: RayBatch,
        hits: HitBatch,
        counters: StreamCounterRows,
    ):
        segment = segments[first + wp.tid()]
        part = parts[placements[segment[0]].geometry]
        stream = wp.zeros(shape=(size,), dtype=StreamRay)
        words = wp.zeros(shape=(stack_size,), dtype=int)
        keys = wp.zeros(shape=(key_room,), dtype=int)
        begin = segment[1]
        found = StreamHits()
        found.hits = hits
        while begin < segment[2]:
            work = StreamCounters()
            kept = int(0)
            root = NodeList()
            count = load(rays, wp.vec2i(begin, segment[2]), part.tree, stream, words, keys, root.leaves, kept)
            root.size = kept
            found.begin = begin
            trace(part.tree, part.triangles, stream, words, keys, root, found, work)
            store(stream, kept, begin, count, hits)
            begin += count

    return specialised_kernel(streams_of_instances)


@cache
def make_round_merge(query: str) -> wp.Kernel:
    """The kernel that merges what a ray was answered in a round, and shortens the ray. Item: a ray of the round."""
    answer = ANSWERS[query]
    merge, bound_of, names_triangles = answer.stored.merge, answer.stored.bound, answer.names_triangles

    def merge_round(
        first: int, placements: wp.array(dtype=Placement), sorted_rays: Sorted, found: HitBatch, search: Search, hits: HitBatch
    ):
        k = first + wp.tid()
        i = sorted_rays.order[k]
        changed = bool(False)
        if wp.static(names_triangles):
            if found.primitive[k] >= 0:
                primitive = placements[sorted_rays.instance[k]].first + found.primitive[k]
                changed = merge(found, k, primitive, hits, i)
        else:
            changed = merge(found, k, -1, hits, i)
        if changed:
            search.bound[i - search.begin] = bound_of(hits, i, search.bound[i - search.begin])

    return named_kernel(merge_round, f"merge_round_{query}")


for merged in batch_kinds():
    if merged.stored.merge is not None:
        make_round_merge(merged.name)

"""A BVH walked by a queue and by stacks, with counts: Falcone 2024, section 5.1.2, has a queue.

What waits is a child of a visited node. It is taken from one end, its box is tested, and it is visited if the ray meets the
box before its closest hit so far. A visited node costs tests of all of its boxes, a visited leaf those of its triangles.
Without an end at hits, the order of visits changes no count.

    queue    what waits longest is next: level by level
    stack    what came last is next: the last child first
    sorted   the same, children put there by the entry into their boxes: the nearest is next, as in the engine
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import RayBatch, load_ray
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.simd.boxes import ray_slabs, reach, slab_interval
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks
from wrt.kernels.triangle.support.triangle_contract import TriangleTest

ORDERS = ("queue", "stack", "sorted")

EMPTY, LEAF, INNER = 0, 1, 2


@wp.struct
class Walked:
    """Counts of one ray."""

    boxes: int
    """Tested boxes."""
    triangles: int
    """Tested triangles."""
    most: int
    """Largest number of children that waited."""
    t: float
    """Closest hit; infinite for a miss."""


@wp.struct
class Lanes:
    """The children of all nodes, lane by lane: child i is lane i % W of node i / W."""

    kind: wp.array(dtype=int)
    """`EMPTY`, `LEAF` or `INNER`."""
    first: wp.array(dtype=int)
    """First slot of a leaf; number of an inner node."""
    count: wp.array(dtype=int)
    """Triangles of a leaf."""
    low: wp.array(dtype=wp.vec3)
    """Corners of the child's box."""
    high: wp.array(dtype=wp.vec3)
    """The opposite corners."""


@cache
def make_kernel(order: str, width: int, test: TriangleTest, stops: bool) -> wp.Kernel:
    """Walks a tree of `width` children a node. An item is a ray, with a row of `waiting` for as many children as there are.

    stops: whether a child behind the closest hit so far is left out.
    """
    prepare, intersect, load = test.prepare, test.intersect, test.record.load
    is_queue, is_sorted = order == "queue", order == "sorted"

    def walk(
        first: int,
        lanes: Lanes,
        triangles: TriangleBlocks,
        scene_low: wp.vec3,
        scene_high: wp.vec3,
        rays: RayBatch,
        waiting: wp.array2d(dtype=int),
        found: wp.array(dtype=Walked),
    ):
        i = first + wp.tid()
        ray = load_ray(rays, i)
        result = Walked()
        result.t = wp.inf
        if ray.valid:
            slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, scene_low, scene_high))
            state = prepare(ray.origin, ray.direction)
            node = int(-1)
            root = slab_interval(slabs, scene_low, scene_high)
            if root[0] <= root[1] and root[1] >= ray.t_min and root[0] <= ray.t_max:
                node = int(0)
            head = int(0)
            tail = int(0)
            best = float(ray.t_max)
            while node >= 0 or head < tail:
                if node >= 0:
                    result.boxes += wp.static(width)
                    first_child = int(tail)
                    for lane in range(wp.static(width)):
                        child = node * wp.static(width) + lane
                        if lanes.kind[child] != wp.static(EMPTY):
                            place = int(tail)
                            if wp.static(is_sorted):
                                entry = slab_interval(slabs, lanes.low[child], lanes.high[child])[0]
                                while place > first_child:
                                    below = waiting[i, place - 1]
                                    if slab_interval(slabs, lanes.low[below], lanes.high[below])[0] >= entry:
                                        break
                                    waiting[i, place] = below
                                    place -= 1
                            waiting[i, place] = child
                            tail += 1
                    result.most = wp.max(result.most, tail - head)
                    node = int(-1)
                else:
                    taken = int(0)
                    if wp.static(is_queue):
                        taken = waiting[i, head]
                        head += 1
                    else:
                        tail -= 1
                        taken = waiting[i, tail]
                    span = slab_interval(slabs, lanes.low[taken], lanes.high[taken])
                    end = ray.t_max
                    if wp.static(stops):
                        end = best
                    if span[0] <= span[1] and span[1] >= ray.t_min and span[0] <= end:
                        if lanes.kind[taken] == wp.static(INNER):
                            node = lanes.first[taken]
                        else:
                            result.triangles += lanes.count[taken]
                            for slot in range(lanes.first[taken], lanes.first[taken] + lanes.count[taken]):
                                hit = intersect(state, load(triangles.records, slot, wp.static(width)))
                                if hit[0] >= ray.t_min and hit[0] <= best:
                                    best = hit[0]
                                    result.t = hit[0]
        found[i] = result

    return specialised_kernel(walk)

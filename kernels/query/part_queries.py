"""Rays of a queue, as a batch of their own, and what a part of a scene answers them.

A part has the triangles of the whole scene that lie in it, relative to the centre of the whole scene, and numbers them from 0
on. `ids` gives the numbers that they have in the whole scene; it ascends, so ties in a part go to the same triangle as in the
whole scene. The corners of a ray's triangle are kept with its hit: the part may have left memory when they are needed.
"""

from functools import cache

import warp as wp

from wrt.kernels.answers import ANSWERS, batch_kinds
from wrt.kernels.layout.ray_batch import HitBatch, RayBatch, load_ray
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import named_kernel, specialised_kernel

AHEAD = wp.constant(16)
"""Rays by which a kernel is ahead of itself when it fetches what it will read: rays of a queue are far apart in memory."""


@native.func_native("part_queries.h", "wrt::fetch_ray(rays, hits, i);")
def fetch_ray(rays: RayBatch, hits: HitBatch, i: int):
    """Fetches a ray and its best hit into the caches of a core. An address without an array does no harm."""


@native.func_native(
    "part_queries.h",
    f"wrt::fetch_merged<{AHEAD}>(order.data, order.shape[0], mesh, ids.data, found.primitive.data, hits, corners.data, place);",
)
def fetch_merged(
    order: wp.array(dtype=int),
    mesh: SceneMesh,
    ids: wp.array(dtype=int),
    found: HitBatch,
    hits: HitBatch,
    corners: wp.array(dtype=wp.vec3),
    place: int,
):
    """Fetches what merging a closest hit reads and writes into the caches of a core: the corners half as far ahead as the face
    that names them."""


@cache
def make_gather(query: str) -> wp.Kernel:
    """The kernel that copies the rays of a queue, relative to the scene's centre and shortened to their best hits.

    Item: a place in the queue; its ray must be valid.
    """
    bound_of = ANSWERS[query].stored.bound

    def gather_queue(first: int, rays: RayBatch, hits: HitBatch, order: wp.array(dtype=int), queue: RayBatch):
        place = first + wp.tid()
        i = order[place]
        ray = load_ray(rays, i)
        queue.origins[place] = ray.origin
        queue.directions[place] = ray.direction
        queue.t_min[place] = ray.t_min
        queue.t_max[place] = bound_of(hits, i, ray.t_max)

    return specialised_kernel(gather_queue)


@cache
def make_gather_live(query: str) -> wp.Kernel:
    """The kernel that copies the rays listed in slices (`wrt.kernels.traversal.queued.queue_lists.make_list_live`), one slice
    after the other without gaps, as `make_gather`.

    Item: a slice of `size` places of `live`, of which begins[item + 1] - begins[item] are used. `order` receives the rays.
    """
    bound_of = ANSWERS[query].stored.bound

    def gather_live(
        first: int,
        size: int,
        rays: RayBatch,
        hits: HitBatch,
        live: wp.array(dtype=int),
        begins: wp.array(dtype=int),
        order: wp.array(dtype=int),
        queue: RayBatch,
    ):
        item = first + wp.tid()
        begin = begins[item]
        for place in range(begin, begins[item + 1]):
            at = item * size + place - begin
            if place + AHEAD < begins[item + 1]:
                fetch_ray(rays, hits, live[at + AHEAD])
            i = live[at]
            order[place] = i
            ray = load_ray(rays, i)
            queue.origins[place] = ray.origin
            queue.directions[place] = ray.direction
            queue.t_min[place] = ray.t_min
            queue.t_max[place] = bound_of(hits, i, ray.t_max)

    return specialised_kernel(gather_live)


@cache
def make_part_merge(query: str) -> wp.Kernel:
    """The kernel that merges what a part has answered to a ray. Item: a place in the queue. corners: (3 N,) by ray."""
    merge, names_triangles = ANSWERS[query].stored.merge, ANSWERS[query].names_triangles

    def merge_part(
        first: int,
        order: wp.array(dtype=int),
        mesh: SceneMesh,
        ids: wp.array(dtype=int),
        found: HitBatch,
        hits: HitBatch,
        corners: wp.array(dtype=wp.vec3),
    ):
        place = first + wp.tid()
        i = order[place]
        if wp.static(names_triangles):
            fetch_merged(order, mesh, ids, found, hits, corners, place + AHEAD)
            local = found.primitive[place]
            if local >= 0:  # noqa: SIM102  (Warp evaluates both operands of `and`)
                if merge(found, place, ids[local], hits, i):
                    face = mesh.faces[local]
                    for corner in range(3):
                        corners[3 * i + corner] = mesh.vertices[face[corner]]
        else:
            merge(found, place, -1, hits, i)

    return named_kernel(merge_part, f"merge_part_{query}")


for merged in batch_kinds():
    if merged.stored.merge is not None:
        make_part_merge(merged.name)

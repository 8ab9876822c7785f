"""Rays of a queue, as a batch of their own, and what a part of a scene answers them.

A part has the triangles of the whole scene that lie in it, relative to the centre of the whole scene, and numbers them from 0
on. `ids` gives the numbers that they have in the whole scene; it ascends, so ties in a part go to the same triangle as in the
whole scene. The corners of a ray's triangle are kept with its hit: the part may have left memory when they are needed.
"""

from functools import cache

import warp as wp

from wrt.kernels.layout.ray_batch import HitBatch, RayBatch, load_ray
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.kernels.runtime.options import exact_module, specialised_kernel
from wrt.kernels.traversal.queued.next_queue import make_bound
from wrt.kernels.traversal.traversal_config import ANY, CLOSEST, COUNT

exact_module(__name__)

AHEAD = wp.constant(16)
"""Rays by which a kernel is ahead of itself when it fetches what it will read: rays of a queue are far apart in memory."""


@wp.func_native("""
#if !defined(__CUDA_ARCH__)
    __builtin_prefetch(rays.origins.data + (size_t)i * rays.origin_stride);
    __builtin_prefetch(rays.directions.data + (size_t)i * rays.direction_stride);
    __builtin_prefetch(rays.t_max.data + (size_t)i * rays.t_max_stride);
    __builtin_prefetch(hits.t.data + i);
#endif
""")
def fetch_ray(rays: RayBatch, hits: HitBatch, i: int):
    """Fetches a ray and its best hit into the caches of a core. An address without an array does no harm."""
    ...


@wp.func_native(
    f"constexpr int AHEAD = {AHEAD};"
    + """
#if !defined(__CUDA_ARCH__)
    if (place >= order.shape[0]) return;
    const int local = found.primitive.data[place];
    if (local >= 0) {
        const int i = order.data[place];
        const char* const corner = (const char*)(corners.data + 3 * (size_t)i);
        __builtin_prefetch(hits.t.data + i, 1);
        __builtin_prefetch(hits.primitive.data + i, 1);
        __builtin_prefetch(hits.uv.data + i, 1);
        __builtin_prefetch(corner, 1);
        __builtin_prefetch(corner + 35, 1);
        __builtin_prefetch(mesh.faces.data + local);
        __builtin_prefetch(ids.data + local);
    }
    const int nearer = found.primitive.data[place - AHEAD / 2];
    if (place < AHEAD || nearer < 0) return;
    const wp::vec3i face = mesh.faces.data[nearer];  // fetched before
    for (int c = 0; c < 3; ++c) __builtin_prefetch(mesh.vertices.data + face.c[c]);
#endif
"""
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
    ...


@cache
def make_gather(query: str) -> wp.Kernel:
    """The kernel that copies the rays of a queue, relative to the scene's centre and shortened to their best hits.

    Item: a place in the queue; its ray must be valid.
    """
    bound_of = make_bound(query)

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
    bound_of = make_bound(query)

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


@wp.kernel
def merge_closest(
    first: int,
    order: wp.array(dtype=int),
    mesh: SceneMesh,
    ids: wp.array(dtype=int),
    found: HitBatch,
    hits: HitBatch,
    corners: wp.array(dtype=wp.vec3),
):
    """Merges the closest hit that a part found for a ray. Item: a place in the queue. corners: (3 N,) by ray."""
    place = first + wp.tid()
    fetch_merged(order, mesh, ids, found, hits, corners, place + AHEAD)
    i = order[place]
    local = found.primitive[place]
    if local >= 0:
        t = found.t[place]
        primitive = ids[local]
        if t < hits.t[i] or (t == hits.t[i] and primitive < hits.primitive[i]):
            hits.t[i] = t
            hits.primitive[i] = primitive
            hits.uv[i] = found.uv[place]
            face = mesh.faces[local]
            for corner in range(3):
                corners[3 * i + corner] = mesh.vertices[face[corner]]


@wp.kernel
def merge_any(
    first: int,
    order: wp.array(dtype=int),
    mesh: SceneMesh,
    ids: wp.array(dtype=int),
    found: HitBatch,
    hits: HitBatch,
    corners: wp.array(dtype=wp.vec3),
):
    """Merges the any-hit result of a part. Item: a place in the queue."""
    place = first + wp.tid()
    if found.occluded[place]:
        hits.occluded[order[place]] = True


@wp.kernel
def merge_crossings(
    first: int,
    order: wp.array(dtype=int),
    mesh: SceneMesh,
    ids: wp.array(dtype=int),
    found: HitBatch,
    hits: HitBatch,
    corners: wp.array(dtype=wp.vec3),
):
    """Adds the crossings in a part. Item: a place in the queue."""
    place = first + wp.tid()
    i = order[place]
    hits.counts[i] = hits.counts[i] + found.counts[place]


MERGES = {CLOSEST: merge_closest, ANY: merge_any, COUNT: merge_crossings}
"""Kernel that merges what a part found, for each query."""

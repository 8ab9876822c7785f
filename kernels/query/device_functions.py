"""Ray queries inside kernels that are not ours: what a `@wp.kernel` of a user's calls, ray by ray.

**Problem.** A query of a whole batch takes arrays and leaves arrays. Ambient occlusion, a path, a sensor model or a search that
depends on what was hit want to go on with the ray where it is, inside one kernel, on the CPU and on CUDA.

**Idea.** The walks of the single-ray traversals are functions already. What they need of a scene travels in one struct, the
handle. They are specialised for a kind of tree, its width and its depth, and Warp picks functions by the types of their
arguments: so each specialisation has a type of handle of its own, and the four `search_*` functions below one overload for each
type. What a user calls takes any of them (`typing.Any`). A kernel that does so too serves every scene on every device; Warp
compiles it for each type of handle that it meets.

**Differences from the batch queries.** None in the hits: the same walks, the default triangle test, and the same rounding of
rays (`wrt.kernels.layout.ray_batch`), to the bit. Waiting children lie in local memory: a block of threads that somebody else
launches may have any size, so its shared memory cannot be planned. Lists of hits have no place to go: `next_hit` finds the one
that follows a given one, by t, then by triangle, in a search of its own from there on.

**Limits.** Such kernels must be compiled without gradients and without fused multiply-add, as ours are: Warp has no adjoints of
the walks, and with fused multiply-add hits may differ and rays may slip between triangles. Others are refused while they are
compiled, by the one function that all queries call.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.layout.ray_batch import Ray, checked_ray
from wrt.kernels.query.hit_attributes import SceneMesh, geometry_of, hit_normal, hit_position
from wrt.kernels.query.spawn import spawn_origin
from wrt.kernels.traversal.leaf import Candidate, Counters, start
from wrt.kernels.traversal.search_results import Passed, results_of
from wrt.kernels.traversal.single.walk_table import WALKS
from wrt.kernels.traversal.traversal_config import ANY, CLOSEST, COUNT, NEXT, TraversalConfig
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

TRIANGLE_TEST = "woop"
"""Watertight, and one of those that count crossings exactly."""


@wp.struct
class Hit:
    """Where a ray meets a triangle."""

    t: float
    """In units of the direction's length; inf for a miss."""
    primitive_id: int
    """Index of the triangle within its geometry; -1 for a miss."""
    geometry_id: int
    """Index of the mesh within the scene; -1 for a miss."""
    uv: wp.vec2
    """Weights of the triangle's second and third vertex; 0 for a miss."""
    triangle: int
    """Index of the triangle within the scene; -1 for a miss."""


@wp.struct
class NoScene:
    """The handle of no scene: it holds a place in the functions below until there are scenes."""

    nothing: int


@wp.func
def search_closest(scene: NoScene, ray: Ray, after: int):
    """The closest hit of a valid ray. One overload for each type of handle, as for the next three."""
    return start(ray.t_max)


@wp.func
def search_any(scene: NoScene, ray: Ray, after: int):
    """A hit, if there is one."""
    return start(ray.t_max)


@wp.func
def search_count(scene: NoScene, ray: Ray, after: int):
    """A candidate whose primitive is the number of crossings, less one."""
    return start(ray.t_max)


@wp.func
def search_next(scene: NoScene, ray: Ray, after: int):
    """The first crossing that comes after that of triangle number `after` at t_min; the other three ignore it."""
    return start(ray.t_max)


SEARCHES = {CLOSEST: search_closest, ANY: search_any, COUNT: search_count, NEXT: search_next}


_handles: set[type] = set()
"""The structs of `handle_type`."""


def is_handle(value: Any) -> bool:
    """Whether a kernel's argument is a scene's handle."""
    return getattr(value, "_cls", None) in _handles


@cache
def handle_type(kind: str, width: int, levels: int) -> type:
    """The struct that a scene with such a tree hands to kernels; the functions above have an overload for it from then on.

    Args:
        kind: key in `WALKS`.
        width, levels: as in `TraversalConfig`.
    """
    Tree, make_walk = WALKS[kind]

    class Handle:
        tree: Tree
        triangles: TriangleBlocks
        mesh: SceneMesh

    Handle.__qualname__ = f"Handle_{kind}_{width}_{levels}"
    handle = wp.struct(Handle)
    _handles.add(handle)
    for query, search in SEARCHES.items():
        config = TraversalConfig(TRIANGLE_TEST, width, query, coherent=False, levels=levels)
        search.add_overload(make_search(handle, make_walk(config), results_of(config)))
    return handle


def make_search(handle: type, walk: wp.Function, Results: type) -> wp.Function:
    """`wp.func(scene, ray, after) -> best`."""
    passing = Results is Passed

    @wp.func
    def search(scene: handle, ray: Ray, after: int):
        hits = Results()
        if wp.static(passing):
            hits.t = ray.t_min
            hits.primitive = after
        work = Counters()
        return walk(scene.tree, scene.triangles, ray, hits, 0, work)

    return search


@wp.func
def ray_in(scene: Any, origin: Any, direction: Any, t_min: float, t_max: float):
    """A ray of the caller's, relative to the scene's centre: a float64 origin is rounded only there."""
    return checked_ray(wp.vec3(wp.vec3d(origin) - scene.mesh.center), wp.vec3(direction), t_min, t_max)


class QueryFunction(wp.Function):
    """A function that refuses to become part of a kernel that ray queries cannot be in."""

    def build(self, builder: Any, default_builder_options: Any = None) -> None:
        """Warp's, for kernels with the right options.

        Raises:
            ValueError: other options.
        """
        if builder is not None:
            name = f"a kernel of the module {builder.module.name!r}"
            # a function's own mark outlives a build that failed, so a kernel of this module must have it, too
            backward = any(kernel.adj.used_by_backward_kernel for kernel in builder.kernels)
            check_options(name, backward and self.adj.used_by_backward_kernel, builder.options["fuse_fp"])
        super().build(builder, default_builder_options)


def check_options(name: str, enable_backward: bool, fuse_fp: bool) -> None:
    """Refuses options with which ray queries do not compile or may give other hits.

    Args:
        name: what has them, for the message.
        enable_backward, fuse_fp: as Warp knows them.

    Raises:
        ValueError: one of them is on.
    """
    on = [option for option, is_on in (("gradients", enable_backward), ("fused multiply-add", fuse_fp)) if is_on]
    if on:
        raise ValueError(
            f"{name} calls ray queries of wrt.device and is compiled with {' and '.join(on)}; decorate it with "
            "@wrt.device.kernel in place of @wp.kernel"
        )


ray_in.__class__ = QueryFunction  # wp.func makes a wp.Function, and Warp copies that with its class for each type of scene


@wp.func
def hit_of(scene: Any, best: Candidate):
    """What a caller gets to see of a search's result."""
    hit = Hit()
    hit.t = wp.inf
    hit.primitive_id = -1
    hit.geometry_id = -1
    hit.triangle = -1
    if best.primitive >= 0:
        hit.t = best.t
        hit.triangle = best.primitive
        hit.uv = wp.vec2(best.u, best.v)
        hit.geometry_id = geometry_of(scene.mesh, best.primitive)
        hit.primitive_id = best.primitive - scene.mesh.geometry_first[hit.geometry_id]
    return hit


# -- what users call ---------------------------------------------------------------------------------------------------


@wp.func
def closest_hit(scene: Any, origin: Any, direction: Any, t_min: float, t_max: float):
    """The closest `Hit` of a ray, what `Scene.intersect` finds for it.

    Args:
        scene: `Scene.handle()`.
        origin, direction: vec3 or vec3d, in the scene's coordinates; the direction has any length from 2^-126 on. A ray with a
            NaN or an infinity, or with a shorter direction, misses.
        t_min, t_max: a hit counts if t_min <= t <= t_max; 0 <= t_min.
    """
    ray = ray_in(scene, origin, direction, t_min, t_max)
    best = start(t_max)
    if ray.valid:
        best = search_closest(scene, ray, -1)
    return hit_of(scene, best)


@wp.func
def any_hit(scene: Any, origin: Any, direction: Any, t_min: float, t_max: float):
    """Whether a ray hits anything, as `Scene.occluded` says. Arguments as in `closest_hit`."""
    ray = ray_in(scene, origin, direction, t_min, t_max)
    best = start(t_max)
    if ray.valid:
        best = search_any(scene, ray, -1)
    return best.primitive >= 0


@wp.func
def count_hits(scene: Any, origin: Any, direction: Any, t_min: float, t_max: float):
    """How often a ray crosses a surface, as `Scene.count` says. Arguments as in `closest_hit`."""
    ray = ray_in(scene, origin, direction, t_min, t_max)
    best = start(t_max)
    if ray.valid:
        best = search_count(scene, ray, -1)
    return best.primitive + 1


@wp.func
def first_hit(scene: Any, origin: Any, direction: Any, t_min: float, t_max: float):
    """The first of all hits of a ray, in the order of `Scene.intersect_all`; `next_hit` has the others.

    Each crossing of a surface is one hit. (`closest_hit` may name another of the triangles at an edge.) Arguments as there.
    """
    ray = ray_in(scene, origin, direction, t_min, t_max)
    best = start(t_max)
    if ray.valid:
        best = search_next(scene, ray, -1)
    return hit_of(scene, best)


@wp.func
def next_hit(scene: Any, origin: Any, direction: Any, hit: Hit, t_max: float):
    """The `Hit` that follows one of `first_hit` or `next_hit` on the same ray; after a miss, a miss."""
    ray = ray_in(scene, origin, direction, hit.t, t_max)
    best = start(t_max)
    if ray.valid and hit.triangle >= 0:
        best = search_next(scene, ray, hit.triangle)
    return hit_of(scene, best)


@wp.func
def position(scene: Any, hit: Hit):
    """(vec3d) the point of a hit in the scene's coordinates; NaN for a miss."""
    return hit_position(scene.mesh, hit.triangle, hit.uv)


@wp.func
def normal(scene: Any, hit: Hit):
    """(vec3) unit normal of the triangle, by its winding; 0 for a miss and for a triangle without area."""
    return hit_normal(scene.mesh, hit.triangle)


@wp.func
def spawn(scene: Any, hit: Hit, direction: wp.vec3):
    """(vec3d) where a ray of this direction starts that leaves a hit, as `Hits.spawn` does it; NaN for a miss."""
    return spawn_origin(scene.mesh, hit.triangle, hit.uv, direction)

"""Ray queries inside user kernels: functions that a `@wp.kernel` calls ray by ray.

**Problem.** A batch query reads and writes arrays. Ambient occlusion, path tracing, a sensor model or a search that depends on
the hit continue with the ray inside one kernel, on the CPU and on CUDA.

**Idea.** The walks of the single-ray traversals are functions already. The part of a scene that they need is one struct, the
handle. A walk is specialised for the kind of tree, its width and its depth, and Warp selects overloads by the types of the
arguments. So each specialisation has its own handle type, and the four `search_*` functions below have one overload per handle
type. The public functions accept any handle (`typing.Any`), and so may a user kernel: it then serves every scene on every
device, and Warp compiles it once for each handle type that it is launched with.

**Differences from the batch queries.** The hits are the same to the bit: the same walks, the default triangle test and the same
rounding of rays (`wrt.kernels.layout.ray_batch`). The stack of children is in local memory, because the block size of a user
kernel is unknown and its shared memory cannot be planned. There is no list of all hits: `next_hit` finds the hit that follows a
given one, by t, then by triangle, in a new search from there on.

**Limits.** Kernels that call these functions must be compiled without gradients and without fused multiply-add, like the
kernels of this package. Warp has no adjoints of the walks; with fused multiply-add hits may differ and rays may pass between
triangles. Kernels with other options are refused when they are compiled, by the one function that all queries call.
"""

from functools import cache
from typing import Any

import warp as wp

from wrt.kernels.answers import any_hit as any_kind
from wrt.kernels.answers import closest_hit as closest_kind
from wrt.kernels.answers import crossing_count, next_crossing
from wrt.kernels.answers.answer_kind import BestHit, start
from wrt.kernels.answers.next_crossing import PreviousCrossing
from wrt.kernels.layout.instance_maps import SceneRay
from wrt.kernels.layout.ray_batch import Ray, checked_ray
from wrt.kernels.query.hit_attributes import SceneMesh, geometry_of, hit_normal, hit_position
from wrt.kernels.query.spawn import faces_front, spawn_origin
from wrt.kernels.traversal.leaf import Counters
from wrt.kernels.traversal.single.walk_table import WALKS
from wrt.kernels.traversal.traversal_config import StackConfig, TraversalConfig
from wrt.kernels.traversal.two_level.instance_single import PARTS, InstanceTree, make_instance_walk
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks

TRIANGLE_TEST = "woop"
"""The test that handles use: watertight, and one of those that count crossings exactly."""


@wp.struct
class Hit:
    """The hit of a ray with a triangle."""

    t: float
    """In units of the length of the direction; inf for a miss."""
    primitive_id: int
    """Index of the triangle within its geometry; -1 for a miss."""
    geometry_id: int
    """Index of the mesh within the scene; -1 for a miss."""
    uv: wp.vec2
    """Weights of the triangle's second and third vertex; 0 for a miss."""
    triangle: int
    """Index of the triangle within the scene; -1 for a miss."""
    instance_id: int
    """Index of the instance, or of the mesh in a scene without instances; -1 for a miss."""


@wp.struct
class NoScene:
    """A handle type without a scene, for which the generic functions below are declared."""

    nothing: int


@wp.func
def search_closest(scene: NoScene, ray: Ray, origin: wp.vec3d, after: int):
    """The closest hit of a valid ray, whose origin relative to the scene's centre is also given in float64.

    Each handle type adds an overload, as for the next three functions.
    """
    return start(ray.t_max)


@wp.func
def search_any(scene: NoScene, ray: Ray, origin: wp.vec3d, after: int):
    """Any hit, if there is one."""
    return start(ray.t_max)


@wp.func
def search_count(scene: NoScene, ray: Ray, origin: wp.vec3d, after: int):
    """A candidate whose `primitive` is the number of crossings minus one."""
    return start(ray.t_max)


@wp.func
def search_next(scene: NoScene, ray: Ray, origin: wp.vec3d, after: int):
    """The first crossing that follows the one with triangle `after` at t_min. The other three functions ignore `after`."""
    return start(ray.t_max)


SEARCHES = {
    closest_kind.KIND: search_closest,
    any_kind.KIND: search_any,
    crossing_count.KIND: search_count,
    next_crossing.KIND: search_next,
}
"""The overloaded search function of each kind of answer."""


_handles: set[type] = set()
"""The structs of handles that were made."""


def register_handle(made: type) -> type:
    """The struct of a class of handles, which `is_handle` knows from now on."""
    handle = wp.struct(made)
    _handles.add(handle)
    return handle


def is_handle(value: Any) -> bool:
    """Whether a kernel argument is the handle of a scene."""
    return getattr(value, "_cls", None) in _handles


@cache
def handle_type(kind: str, width: int, levels: int, shared_leaves: bool = False) -> type:
    """The handle struct for a kind of tree; adds an overload of each `search_*` function for it.

    Args:
        kind: key in `WALKS`.
        width, shared_leaves: as in `TraversalConfig`.
        levels: as in `StackConfig`.
    """
    Tree, make_walk = WALKS[kind]

    class Handle:
        tree: Tree
        triangles: TriangleBlocks
        mesh: SceneMesh

    Handle.__qualname__ = f"Handle_{kind}_{width}_{levels}" + ("_shared" if shared_leaves else "")
    handle = register_handle(Handle)
    for answer, search in SEARCHES.items():
        shared = shared_leaves and answer.rules.once
        config = TraversalConfig(TRIANGLE_TEST, width, answer.name, False, shared_leaves=shared, stack=StackConfig(levels))
        search.add_overload(make_search(handle, make_walk(config), answer.search.State))
    return handle


@cache
def instances_handle_type(kind: str, width: int, levels: int) -> type:
    """The handle struct of a scene of instances; as `handle_type`.

    Args:
        kind: of the trees of meshes, key in `PARTS`.
        width: as in `TraversalConfig`.
        levels: as in `StackConfig`, for both levels.
    """
    Part = PARTS[kind]

    class InstancesHandle:
        top: InstanceTree
        parts: wp.array(dtype=Part)
        mesh: SceneMesh
        mask: wp.uint32
        environment: int

    InstancesHandle.__qualname__ = f"InstancesHandle_{kind}_{width}_{levels}"
    handle = register_handle(InstancesHandle)
    for answer, search in SEARCHES.items():
        config = TraversalConfig(TRIANGLE_TEST, width, answer.name, coherent=False, stack=StackConfig(levels))
        search.add_overload(make_search(handle, make_instance_walk(config, kind, levels), answer.search.State))
    add_seeing(handle)
    return handle


def make_search(handle: type, walk: wp.Function, Results: type) -> wp.Function:
    """`wp.func(scene, ray, origin, after) -> best`: the overload of a `search_*` function for a handle type.

    Args:
        handle: the type.
        walk: of one ray, on one level or through instances.
        Results: `State` of `wrt.kernels.answers.answer_kind.Search`.
    """
    follows_crossing, two_level = Results is PreviousCrossing, "top" in handle.vars

    @wp.func
    def search(scene: handle, ray: Ray, origin: wp.vec3d, after: int):
        hits = Results()
        if wp.static(follows_crossing):
            hits.t = ray.t_min
            hits.primitive = after
        work = Counters()
        best = start(ray.t_max)
        if wp.static(two_level):
            seen = SceneRay()
            seen.ray = ray
            seen.origin = origin
            seen.mask = scene.mask
            seen.environment = scene.environment
            best = walk(scene.top, scene.parts, seen, hits, 0, work)
        else:
            best = walk(scene.tree, scene.triangles, ray, hits, 0, work)
        return best

    return search


def add_seeing(handle: type) -> None:
    """Adds the overload of `seeing` for the handle type of a scene of instances."""

    @wp.func
    def with_sight(scene: handle, mask: wp.uint32, environment: int):
        other = scene  # a copy
        other.mask = mask
        other.environment = environment
        return other

    seeing.add_overload(with_sight)


@wp.func
def centered(scene: Any, origin: wp.vec3):
    """The origin of a caller's ray relative to the scene's centre."""
    return wp.vec3d(origin) - scene.mesh.center


@wp.func
def centered(scene: Any, origin: wp.vec3d):  # noqa: F811  (an overload)
    """A float64 origin is rounded to float32 there, as in batch queries."""
    return wp.vec3d(wp.vec3(origin - scene.mesh.center))


@wp.func
def ray_in(origin: wp.vec3d, direction: Any, t_min: float, t_max: float):
    """A ray of the caller; its origin is relative to the scene's centre."""
    return checked_ray(wp.vec3(origin), wp.vec3(direction), t_min, t_max)


class QueryFunction(wp.Function):
    """A Warp function that raises an error if it is compiled into a kernel with unsuitable options."""

    def build(self, builder: Any, default_builder_options: Any = None) -> None:
        """Builds the function as Warp does, after a check of the options of the kernel.

        Raises:
            ValueError: gradients or fused multiply-add are enabled.
        """
        if builder is not None:
            name = f"a kernel of the module {builder.module.name!r}"
            # a function stays marked after a failed build, so the kernels of this module are checked as well
            backward = any(kernel.adj.used_by_backward_kernel for kernel in builder.kernels)
            check_options(name, backward and self.adj.used_by_backward_kernel, builder.options["fuse_fp"])
        super().build(builder, default_builder_options)


def check_options(name: str, enable_backward: bool, fuse_fp: bool) -> None:
    """Rejects options with which ray queries do not compile or may give other hits.

    Args:
        name: name of the kernel or module, for the message.
        enable_backward, fuse_fp: Warp's options of these names.

    Raises:
        ValueError: one of them is enabled.
    """
    on = [option for option, is_on in (("gradients", enable_backward), ("fused multiply-add", fuse_fp)) if is_on]
    if on:
        raise ValueError(
            f"{name} calls ray queries of wrt.device and is compiled with {' and '.join(on)}; decorate it with "
            "@wrt.device.kernel in place of @wp.kernel"
        )


ray_in.__class__ = QueryFunction  # Warp copies the function, with its class, for each handle type


@wp.func
def hit_of(scene: Any, best: BestHit):
    """Converts the result of a search to a `Hit`."""
    hit = Hit()
    hit.t = wp.inf
    hit.primitive_id = -1
    hit.geometry_id = -1
    hit.triangle = -1
    hit.instance_id = -1
    if best.primitive >= 0:
        hit.t = best.t
        hit.triangle = best.primitive
        hit.uv = wp.vec2(best.u, best.v)
        hit.instance_id = geometry_of(scene.mesh, best.primitive)
        hit.geometry_id = hit.instance_id
        if scene.mesh.placements.shape[0] > 0:
            hit.geometry_id = scene.mesh.placements[hit.instance_id].geometry
        hit.primitive_id = best.primitive - scene.mesh.geometry_first[hit.instance_id]
    return hit


# -- public functions ---------------------------------------------------------------------------------------------------


@wp.func
def closest_hit(scene: Any, origin: Any, direction: Any, t_min: float, t_max: float):
    """The closest `Hit` of a ray, the same as `Scene.intersect` finds.

    Args:
        scene: `Scene.handle()`.
        origin, direction: vec3 or vec3d, in the scene's coordinates. The direction need not be normalised. A ray with a NaN or
            an infinity, or whose direction has no component of at least 2^-126, misses.
        t_min, t_max: closed range: a hit counts if t_min <= t <= t_max. t_min must be at least 0.
    """
    start_point = centered(scene, origin)
    ray = ray_in(start_point, direction, t_min, t_max)
    best = start(t_max)
    if ray.valid:
        best = search_closest(scene, ray, start_point, -1)
    return hit_of(scene, best)


@wp.func
def any_hit(scene: Any, origin: Any, direction: Any, t_min: float, t_max: float):
    """Whether a ray has any hit, as `Scene.occluded`. Arguments as in `closest_hit`."""
    start_point = centered(scene, origin)
    ray = ray_in(start_point, direction, t_min, t_max)
    best = start(t_max)
    if ray.valid:
        best = search_any(scene, ray, start_point, -1)
    return best.primitive >= 0


@wp.func
def count_hits(scene: Any, origin: Any, direction: Any, t_min: float, t_max: float):
    """Number of surface crossings of a ray, as `Scene.count`. Arguments as in `closest_hit`."""
    start_point = centered(scene, origin)
    ray = ray_in(start_point, direction, t_min, t_max)
    best = start(t_max)
    if ray.valid:
        best = search_count(scene, ray, start_point, -1)
    return best.primitive + 1


@wp.func
def first_hit(scene: Any, origin: Any, direction: Any, t_min: float, t_max: float):
    """The first of all hits of a ray, in the order of `Scene.intersect_all`; `next_hit` returns the others.

    Each crossing of the surface is one hit. At an edge `closest_hit` may return another of the triangles that share it.
    Arguments as in `closest_hit`.
    """
    start_point = centered(scene, origin)
    ray = ray_in(start_point, direction, t_min, t_max)
    best = start(t_max)
    if ray.valid:
        best = search_next(scene, ray, start_point, -1)
    return hit_of(scene, best)


@wp.func
def next_hit(scene: Any, origin: Any, direction: Any, hit: Hit, t_max: float):
    """The `Hit` that follows a result of `first_hit` or `next_hit` on the same ray.

    It is a miss if there is no further hit up to t_max, or if `hit` is a miss.
    """
    start_point = centered(scene, origin)
    ray = ray_in(start_point, direction, hit.t, t_max)
    best = start(t_max)
    if ray.valid and hit.triangle >= 0:
        best = search_next(scene, ray, start_point, hit.triangle)
    return hit_of(scene, best)


@wp.func
def position(scene: Any, hit: Hit):
    """(vec3d) point of a hit in the scene's coordinates; NaN for a miss."""
    return hit_position(scene.mesh, hit.triangle, hit.uv)


@wp.func
def normal(scene: Any, hit: Hit):
    """(vec3) unit normal of the triangle by its winding; 0 for a miss and for a degenerate triangle."""
    return hit_normal(scene.mesh, hit.triangle)


@wp.func
def spawn(scene: Any, hit: Hit, direction: wp.vec3):
    """(vec3d) origin for a ray of this direction that leaves a hit, as computed by `Hits.spawn`; NaN for a miss."""
    return spawn_origin(scene.mesh, hit.triangle, hit.uv, direction, 0)


@wp.func
def faces(scene: Any, hit: Hit, direction: wp.vec3):
    """(bool) whether a direction points to the front of a hit, as `Hits.faces`; False for a miss."""
    return faces_front(scene.mesh, hit.triangle, direction)


@wp.func
def seeing(scene: NoScene, mask: wp.uint32, environment: int):
    """The handle of a scene of instances, for rays of another mask and environment than `Scene.handle` was given.

    Args:
        scene: `Scene.handle()` of a scene of instances.
        mask: a ray sees the instances whose masks have a bit in common with it.
        environment: a ray sees the instances of this environment and those that all share; -1 for those of all.
    """
    return scene

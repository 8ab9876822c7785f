"""Handles of scenes whose trees have two children a node: rays of users' kernels walk the layout of persistent threads.

A thread of a user's kernel traces its own ray, so it cannot fetch others; it takes the steps of
`wrt.kernels.traversal.persistent` alone. Its stack is a word for each level, in local memory.
"""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import AnswerKind, BestHit, start
from wrt.kernels.answers.next_crossing import PreviousCrossing
from wrt.kernels.layout.binary_nodes import BinaryNodes, BinaryPart, PackedTriangles
from wrt.kernels.layout.ray_batch import Ray
from wrt.kernels.query.device_functions import SEARCHES, register_handle, seeing
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.kernels.runtime import native
from wrt.kernels.traversal.persistent.persistent_bvh import ANSWER_CLASSES
from wrt.kernels.traversal.two_level.instance_single import InstanceTree


@cache
def binary_handle_type(levels: int) -> type:
    """The handle struct of a scene of one level; as `wrt.kernels.query.device_functions.handle_type`."""

    class BinaryHandle:
        tree: BinaryNodes
        triangles: PackedTriangles
        mesh: SceneMesh

    BinaryHandle.__qualname__ = f"BinaryHandle_{levels}"
    handle = register_handle(BinaryHandle)
    for answer, search in SEARCHES.items():
        search.add_overload(make_binary_search(handle, answer, levels))
    return handle


@cache
def binary_instances_handle_type(levels: int) -> type:
    """The handle struct of a scene of instances; as `wrt.kernels.query.device_functions.instances_handle_type`."""

    class BinaryInstancesHandle:
        top: InstanceTree
        parts: wp.array(dtype=BinaryPart)
        mesh: SceneMesh
        mask: wp.uint32
        environment: int

    BinaryInstancesHandle.__qualname__ = f"BinaryInstancesHandle_{levels}"
    handle = register_handle(BinaryInstancesHandle)
    for answer, search in SEARCHES.items():
        search.add_overload(make_instances_search(handle, answer, levels))
    seeing.add_overload(make_seeing(handle))
    return handle


def make_binary_search(handle: type, answer: AnswerKind, levels: int) -> wp.Function:
    """`wp.func(scene, ray, origin, after) -> best`: the overload of a `search_*` function for a handle type."""
    space, options = "wrt::one_tree(tree, triangles)", f"{levels + 1}, wrt::{ANSWER_CLASSES[answer.name]}"

    @native.func_native("persistent.h", f"wrt::walk_one<{options}>({space}, ray, previous, origin, ~0u, -1, best);")
    def walk(
        tree: BinaryNodes,
        triangles: PackedTriangles,
        ray: Ray,
        previous: PreviousCrossing,
        origin: wp.vec3d,
        best: wp.ref[BestHit],
    ): ...

    @wp.func
    def search(scene: handle, ray: Ray, origin: wp.vec3d, after: int):
        previous = PreviousCrossing()
        previous.t = ray.t_min
        previous.primitive = after
        best = start(ray.t_max)
        walk(scene.tree, scene.triangles, ray, previous, origin, best)
        return best

    return search


def make_instances_search(handle: type, answer: AnswerKind, levels: int) -> wp.Function:
    """The same through instances."""
    space, options = "wrt::instance_trees(top, parts)", f"{2 * levels + 2}, wrt::{ANSWER_CLASSES[answer.name]}"

    @native.func_native("persistent.h", f"wrt::walk_one<{options}>({space}, ray, previous, origin, mask, environment, best);")
    def walk(
        top: InstanceTree,
        parts: wp.array(dtype=BinaryPart),
        ray: Ray,
        previous: PreviousCrossing,
        origin: wp.vec3d,
        mask: wp.uint32,
        environment: int,
        best: wp.ref[BestHit],
    ): ...

    @wp.func
    def search(scene: handle, ray: Ray, origin: wp.vec3d, after: int):
        previous = PreviousCrossing()
        previous.t = ray.t_min
        previous.primitive = after
        best = start(ray.t_max)
        walk(scene.top, scene.parts, ray, previous, origin, scene.mask, scene.environment, best)
        return best

    return search


def make_seeing(handle: type) -> wp.Function:
    """`wrt.kernels.query.device_functions.seeing` for a handle type."""

    @wp.func
    def with_sight(scene: handle, mask: wp.uint32, environment: int):
        other = handle()
        other.top = scene.top
        other.parts = scene.parts
        other.mesh = scene.mesh
        other.mask = mask
        other.environment = environment
        return other

    return with_sight

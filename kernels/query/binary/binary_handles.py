"""Handles of scenes whose trees have two children a node: rays of users' kernels walk the layout of persistent threads.

A thread of a user's kernel traces its own ray, so it cannot fetch others; it takes the steps of
`wrt.kernels.traversal.persistent` alone. Its stack is a word for each level, in local memory.
"""

from functools import cache

import warp as wp

from wrt.kernels.answers.answer_kind import BestHit, start
from wrt.kernels.answers.next_crossing import PreviousCrossing
from wrt.kernels.layout.binary_nodes import BinaryNodes, BinaryPart, PackedTriangles
from wrt.kernels.layout.ray_batch import Ray
from wrt.kernels.query.device_functions import SEARCHES, add_seeing, register_handle
from wrt.kernels.query.hit_attributes import SceneMesh
from wrt.kernels.runtime import native
from wrt.kernels.traversal.persistent.persistent_bvh import ANSWER_CLASSES, upper_places
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
    add_searches(handle, "wrt::one_tree(scene.tree, scene.triangles)", levels + 1, "~0u, -1")
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
    space = "wrt::instance_trees(scene.top, scene.parts)"
    add_searches(handle, space, levels + upper_places(levels), "scene.mask, scene.environment")
    add_seeing(handle)
    return handle


def add_searches(handle: type, space: str, places: int, sight: str) -> None:
    """Adds an overload of each `search_*` function for a handle type.

    Args:
        handle: the type.
        space: the space of `persistent.h` that its rays go through, of a handle `scene`.
        places: of the stack.
        sight: mask and environment of its rays.
    """
    for answer, search in SEARCHES.items():
        options = f"{places}, wrt::{ANSWER_CLASSES[answer.name]}"
        search.add_overload(make_search(handle, f"wrt::walk_one<{options}>({space}, ray, previous, origin, {sight}, best);"))


def make_search(handle: type, snippet: str) -> wp.Function:
    """`wp.func(scene, ray, origin, after) -> best`, by a call of `walk_one`."""

    @native.func_native("persistent.h", snippet)
    def walk(scene: handle, ray: Ray, previous: PreviousCrossing, origin: wp.vec3d, best: wp.ref[BestHit]): ...

    @wp.func
    def search(scene: handle, ray: Ray, origin: wp.vec3d, after: int):
        previous = PreviousCrossing()
        previous.t = ray.t_min
        previous.primitive = after
        best = start(ray.t_max)
        walk(scene, ray, previous, origin, best)
        return best

    return search

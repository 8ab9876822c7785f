"""How much of a tree the rays of a packet share: a sample of packets, traced ray by ray, that decides how the batch is traced.

**Problem.** Packets are fast where their rays visit the same nodes, and slow where they part. Directions alone do not tell:
what counts is how far rays lie apart where they hit something, against the size of the triangles there. In a room with a finely
tessellated statue, most triangles are small, and most rays hit large ones.

**Idea.** Some packets, evenly spread over the batch, are traced: of each, a few rays, one by one. The overlap is the number of
different steps (nodes and leaves visited by at least one of a packet's rays) over the number of all steps of the rays: 1 /
`SAMPLED_RAYS` if all rays of a packet take the same way, 1 if each takes its own. Hits are found with Möller and Trumbore's
test, without care for edges, since nothing depends on them but this estimate.

**Cost.** notebooks/records/2026-11-22-auto.md.
"""

from functools import cache
from typing import NamedTuple

import warp as wp

from wrt.kernels.layout import bvh_nodes as bvh
from wrt.kernels.layout.bvh_nodes import MAX_WIDE_DEPTH, WideNodes
from wrt.kernels.layout.instance_maps import Placement, object_ray, ray_environment
from wrt.kernels.layout.ray_batch import Ray, RayBatch, load_ray
from wrt.kernels.runtime.options import specialised_kernel
from wrt.kernels.simd.box_lanes import NO_CHILD, entry_of, nearest_child, ray_boxes
from wrt.kernels.simd.boxes import ray_slabs, reach
from wrt.kernels.traversal.packet.rays.ray_numbers import ray_at
from wrt.kernels.traversal.two_level.instance_single import InstanceTree, root_of

SAMPLED_PACKETS, SAMPLED_RAYS = 16, 8
"""Packets of the sample, and rays of each that are traced."""

GOLDEN = wp.constant(wp.float64(0.6180339887498949))
"""Multiples of the golden ratio, modulo 1, are evenly spread at any number, and keep step with no picture's columns."""

INSTANCE_SALT = wp.constant(1000003)
"""Tells steps in the trees of different instances apart, all but surely."""

HASH = wp.constant(wp.uint32(2654435769))
"""2^32 times the golden ratio (Knuth's multiplicative hashing)."""

SEEN_SLOTS = wp.constant(1024)
"""Slots of the table of steps, a power of two. Steps that share a slot are counted again; a packet has some hundred."""


@wp.struct
class SampledTree:
    """A tree and its triangles."""

    tree: WideNodes
    primitive: wp.array(dtype=int)
    vertices: wp.array(dtype=wp.vec3)
    faces: wp.array(dtype=wp.vec3i)


@wp.struct
class SampledScene:
    """A scene of one level, or of two."""

    part: SampledTree
    """The tree of a scene of one level; of two levels, the upper tree. Its `primitive` then has the instance of each leaf, at
    the first element of its block, and there are no vertices and faces."""
    placements: wp.array(dtype=Placement)
    """(instances,); (0,) in a scene of one level."""
    parts: wp.array(dtype=SampledTree)
    """The geometries of the placements."""
    top: InstanceTree
    """Of two levels: the roots of the environments."""


@wp.func
def first_visit(seen: wp.array(dtype=int), step: int):
    """1 if no ray of the packet has taken a step before, which is not 0; else 0."""
    slot = int((wp.uint32(step) * HASH) >> wp.uint32(22))
    new = wp.where(seen[slot] == step, 0, 1)
    seen[slot] = step
    return new


@wp.func
def hit_distance(a: wp.vec3, b: wp.vec3, c: wp.vec3, ray: Ray, t_max: float):
    """The t at which a ray hits a triangle before t_max, else t_max."""
    edge, other = b - a, c - a
    p = wp.cross(ray.direction, other)
    inverse = 1.0 / wp.dot(edge, p)
    s = ray.origin - a
    q = wp.cross(s, edge)
    u = wp.dot(s, p) * inverse
    v = wp.dot(ray.direction, q) * inverse
    t = wp.dot(other, q) * inverse
    return wp.where(u >= 0.0 and v >= 0.0 and u + v <= 1.0 and t >= ray.t_min and t < t_max, t, t_max)


@cache
def visit_triangles(width: int) -> wp.Function:
    """`wp.func(scene, part, child, salt, ray, any_hit, seen, steps) -> t`: tests the triangles of a leaf."""

    @wp.func
    def visit(
        scene: SampledScene,
        part: SampledTree,
        child: int,
        salt: int,
        ray: Ray,
        any_hit: int,
        seen: wp.array(dtype=int),
        steps: wp.ref[wp.vec2i],
    ):
        best = ray.t_max
        begin = bvh.first_block(child) * wp.static(width)
        for place in range(begin, begin + bvh.leaf_triangles(child)):
            face = part.faces[part.primitive[place]]
            a, b, c = part.vertices[face[0]], part.vertices[face[1]], part.vertices[face[2]]
            best = hit_distance(a, b, c, ray, best)
        return best

    return visit


@cache
def visit_instance(width: int) -> wp.Function:
    """The same for a leaf of the upper tree: walks the tree of an instance."""
    walk = make_overlap_walk(width, visit_triangles(width))

    @wp.func
    def visit(
        scene: SampledScene,
        part: SampledTree,
        child: int,
        salt: int,
        ray: Ray,
        any_hit: int,
        seen: wp.array(dtype=int),
        steps: wp.ref[wp.vec2i],
    ):
        instance = part.primitive[bvh.first_block(child) * wp.static(width)]
        placement = scene.placements[instance]
        own = object_ray(placement, wp.vec3d(ray.origin), ray, ray.t_max)
        best = ray.t_max
        if own.valid:
            best = walk(scene, scene.parts[placement.geometry], 0, (instance + 1) * INSTANCE_SALT, own, any_hit, seen, steps)
        return best

    return visit


@cache
def make_overlap_walk(width: int, visit: wp.Function) -> wp.Function:
    """`wp.func(scene, part, root, salt, ray, any_hit, seen, steps) -> t`: walks the tree below node `root` up to the closest
    hit, or to any.

    Args:
        width: children of a node.
        visit: what happens at a leaf; it returns the t of a hit, or `ray.t_max`.
    """
    test_boxes, nearest, row = ray_boxes(width), nearest_child(width), MAX_WIDE_DEPTH * width

    @wp.func
    def walk_sample(
        scene: SampledScene,
        part: SampledTree,
        root: int,
        salt: int,
        ray: Ray,
        any_hit: int,
        seen: wp.array(dtype=int),
        steps: wp.ref[wp.vec2i],
    ):
        keys = wp.zeros(shape=(row,), dtype=int)
        path = wp.zeros(shape=(MAX_WIDE_DEPTH,), dtype=int)
        slabs = ray_slabs(ray.origin, ray.direction, reach(ray.origin, part.tree.low, part.tree.high))
        end = ray.t_max
        level = int(0)
        path[0] = root
        key = test_boxes(part.tree.bounds, root, slabs, ray.t_min, ray.t_max, keys, 0)
        steps += wp.vec2i(1, first_visit(seen, salt + root + 1))
        while level >= 0:
            if entry_of(key, wp.static(width)) <= ray.t_max:
                lane = key & wp.static(width - 1)
                keys[level * wp.static(width) + lane] = NO_CHILD
                child = part.tree.child[path[level] * wp.static(width) + lane]
                steps += wp.vec2i(1, first_visit(seen, salt + wp.where(child >= 0, child + 1, child)))
                if child >= 0:
                    level += 1
                    path[level] = child
                    key = test_boxes(part.tree.bounds, child, slabs, ray.t_min, ray.t_max, keys, level * wp.static(width))
                else:
                    ray.t_max = visit(scene, part, child, salt, ray, any_hit, seen, steps)
                    key = nearest(keys, level * wp.static(width))
                    level = wp.where(any_hit != 0 and ray.t_max < end, -1, level)
            else:
                level -= 1
                if level >= 0:
                    key = nearest(keys, level * wp.static(width))
        return ray.t_max

    return walk_sample


class SampleConfig(NamedTuple):
    """The specialisation: children of a node, and whether the scene has two levels."""

    width: int
    instances: bool


@cache
def make_overlap_kernel(config: SampleConfig) -> wp.Kernel:
    """The kernel for one specialisation."""
    width = config.width
    walk = make_overlap_walk(width, visit_instance(width) if config.instances else visit_triangles(width))

    @specialised_kernel
    def measure_overlap(
        first: int,
        scene: SampledScene,
        rays: RayBatch,
        packet: int,
        packets: int,
        sampled: int,
        any_hit: int,
        result: wp.array(dtype=int),
    ):
        """Counts the steps of the sampled rays and, packet by packet, the different ones. Item: the whole sample.

        packets, sampled: `SAMPLED_PACKETS` and `SAMPLED_RAYS`, as arguments, since Warp unrolls loops over constants.
        """
        steps = wp.vec2i(0, 0)
        rays_met = int(0)
        for number in range(packets):
            place = wp.mod(wp.float64(number + 1) * GOLDEN, wp.float64(1.0))
            begin = int(wp.float64(rays.count / packet) * place) * packet
            seen = wp.zeros(shape=(SEEN_SLOTS,), dtype=int)
            for k in range(sampled):
                i = ray_at(rays, begin + k * packet / sampled, packet)
                ray = load_ray(rays, i)
                root = int(0)
                if wp.static(config.instances):
                    root = root_of(scene.top, ray_environment(rays, i))
                if ray.valid and root >= 0:
                    walk(scene, scene.part, root, 0, ray, any_hit, seen, steps)
                    rays_met += 1
        result[0] = steps[0]
        result[1] = steps[1]
        result[2] = rays_met

    return measure_overlap

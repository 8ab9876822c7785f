"""Interleaved walks: batches about the number of slots and of rays loaded at a time, ties, deep trees, sorted children."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import warp as wp
from conftest import assert_same_hits, brute_force, mixed_rays

import wrt
from wrt.kernels.simd.lanes import BITS, FOR_LANES
from wrt.kernels.traversal.interleaved.child_order import push_sorted
from wrt.kernels.traversal.interleaved.interleaved_bvh import LOADED
from wrt.kernels.traversal.interleaved.ray_slots import SLOTS

pytestmark = pytest.mark.width

NAME = "interleaved"
WIDTHS = (2, 4, 8, 16)


def assert_same_lists(lists: wrt.AllHits, expected: wrt.AllHits) -> None:
    """All hits, which are sorted by t."""
    for name in ("ray_id", "primitive_id", "t"):
        np.testing.assert_array_equal(getattr(lists, name), getattr(expected, name))


def assert_equals_brute_force(scene: wrt.Scene, rays: wrt.Rays) -> wrt.Hits:
    """Closest hit, any hit and all hits."""
    expected = brute_force(scene, rays)
    assert_same_hits(scene.intersect(rays, traversal=NAME), expected)
    np.testing.assert_array_equal(scene.occluded(rays, traversal=NAME), expected.is_hit)
    assert_same_lists(scene.intersect_all(rays, traversal=NAME), scene.intersect_all(rays, traversal="brute"))
    return expected


def test_ray_counts():
    """None, one, and counts about the slots and the rays that are loaded at a time."""
    mesh = wrt.scenes.build("teapot", level=3)
    scene = wrt.Scene(mesh, device="cpu")
    for count in (0, 1, SLOTS - 1, SLOTS, SLOTS + 1, LOADED - 1, LOADED, LOADED + 1, 4 * LOADED + SLOTS + 1):
        assert_equals_brute_force(scene, wrt.Rays(*mixed_rays(mesh, count, seed=count)))


def test_only_bad_rays():
    """No slot ever gets a ray."""
    mesh = wrt.scenes.build("teapot", level=2)
    rays = wrt.Rays(np.full((3 * SLOTS, 3), np.nan), np.ones((3 * SLOTS, 3)))
    assert not assert_equals_brute_force(wrt.Scene(mesh, device="cpu"), rays).is_hit.any()


@pytest.mark.parametrize("width", WIDTHS)
def test_widths(width):
    mesh = wrt.scenes.build("teapot", level=4)
    scene = wrt.Scene(mesh, wrt.Bvh(width=width), device="cpu")
    assert_equals_brute_force(scene, wrt.Rays(*mixed_rays(mesh, 2000, seed=width)))


@pytest.mark.parametrize("width", [8, 16])
def test_ties_at_the_start_of_a_ray(width):
    """Rays start on triangles that are there three times, so t is 0 or -0.

    A key has a lane in its low bits. Compared as it is with the t of the best hit, the key of a child that is entered at that
    very t was greater, and the child with the smaller primitive was skipped. A t of -0, as an integer, is less than any key.
    """
    once = wrt.scenes.build("teapot", level=3)
    order = np.random.default_rng(0).permutation(np.repeat(np.arange(len(once.faces)), 3))
    mesh = wrt.TriangleMesh(once.vertices, once.faces[order])
    scene = wrt.Scene(mesh, wrt.Bvh(width=width, max_leaf_triangles=1), device="cpu")
    rng = np.random.default_rng(1)
    origins = np.asarray(mesh.vertices)[rng.integers(len(mesh.vertices), size=3000)]
    expected = assert_equals_brute_force(scene, wrt.Rays(origins, rng.normal(size=(3000, 3))))
    assert (expected.t == 0).mean() > 0.5


def test_a_deep_tree():
    """Triangles whose sizes and distances double: the tree is deep, and rays along it push children on every level."""
    scales = 2.0 ** np.arange(34)[:, None, None]
    corners = np.array([[1.0, -1.0, -1.0], [1.0, 2.0, -1.0], [1.0, -1.0, 2.0]]) * scales
    mesh = wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(102).reshape(-1, 3))
    for width in (2, 8):
        scene = wrt.Scene(mesh, wrt.Bvh(width=width, max_leaf_triangles=1), device="cpu")
        origins = np.random.default_rng(2).uniform(-0.2, 0.2, (200, 3))
        directions = np.random.default_rng(3).normal((1.0, 0.0, 0.0), 0.1, (200, 3))
        assert assert_equals_brute_force(scene, wrt.Rays(origins, directions)).is_hit.mean() > 0.9


@cache
def push_kernel(width: int) -> wp.Kernel:
    """A kernel that pushes the children of node i to row i."""
    row, depth = 16 + width, 16
    constants = f"{FOR_LANES}{BITS}    constexpr int W = {width}, DEPTH = {depth};\n"

    @wp.func_native(
        constants
        + push_sorted(width)
        + f"return wrt_push(keys.data + i * W, mask, children.data + i * W, stack.data + i * {depth + row});"
    )
    def push(
        keys: wp.array(dtype=int), mask: wp.uint32, children: wp.array(dtype=int), stack: wp.array(dtype=int), i: int
    ) -> int: ...

    def push_all(
        keys: wp.array(dtype=int),
        masks: wp.array(dtype=wp.uint32),
        children: wp.array(dtype=int),
        stack: wp.array(dtype=int),
        counts: wp.array(dtype=int),
    ):
        i = wp.tid()
        counts[i] = push(keys, masks[i], children, stack, i)

    return wp.kernel(push_all, module="unique", enable_backward=False)


@pytest.mark.parametrize("width", WIDTHS)
def test_children_are_sorted(width):
    """All numbers of children, equal entries, and entries of every size: as NumPy sorts them."""
    rng = np.random.default_rng(width)
    nodes = 2000
    met = rng.random((nodes, width)) < rng.random((nodes, 1))
    entries = np.where(rng.random((nodes, width)) < 0.3, 1.0, 10.0 ** rng.uniform(-38, 38, (nodes, width))).astype(np.float32)
    keys = np.where(met, entries.view(np.int32) & -width | np.arange(width), -1).astype(np.int32)
    masks = (met << np.arange(width)).sum(axis=1).astype(np.uint32)
    children = rng.integers(-1000, 1000, (nodes, width)).astype(np.int32)
    row = 32 + width
    stack, counts = wp.zeros(nodes * row, dtype=int, device="cpu"), wp.zeros(nodes, dtype=int, device="cpu")
    inputs = [wp.array(values.ravel(), device="cpu") for values in (keys, masks, children)]
    wp.launch(push_kernel(width), nodes, [*inputs, stack, counts], device="cpu")
    np.testing.assert_array_equal(counts.numpy(), met.sum(axis=1))
    for i, written in enumerate(stack.numpy().reshape(nodes, row)):
        order = np.argsort(-keys[i].astype(np.int64))[: met[i].sum()]
        np.testing.assert_array_equal(written[: len(order)], keys[i, order])
        np.testing.assert_array_equal(written[16 : 16 + len(order)], children[i, order])

"""Trees: the packing of nodes, invariants, equality with the reference, independence of threads."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.built_kdtrees import boxes_of, build, hard_meshes, leaf_references, scattered_soup
from support.meshes import SCENES, snapped_soup

import wrt
from wrt.builders.classics.kdtree import streaming
from wrt.builders.classics.kdtree.nested import nested
from wrt.builders.core import levels as levels_engine
from wrt.builders.core import subtrees
from wrt.builders.kdtree import KDTREE_BUILDERS, binned, in_place
from wrt.builders.kdtree.events.event_sort import sorted_events
from wrt.builders.kdtree.kdtree_statistics import kdtree_statistics, unpack
from wrt.builders.kdtree.update.kdtree_update import subtree_end
from wrt.kernels.layout import kdtree_nodes as kdtree
from wrt.kernels.runtime.launch import use_threads

EXACT = ("in_place", "nested", "sweep", "naive")
"""Builders that evaluate every plane at which a box begins or ends."""

PARALLEL = ("binned", "streaming")
"""Builders that scan references, on all threads."""


@wp.kernel(enable_backward=False)
def pack_and_unpack(
    axis: wp.array(dtype=int),
    position: wp.array(dtype=float),
    index: wp.array(dtype=int),
    packed: wp.array2d(dtype=wp.vec2i),
    unpacked: wp.array2d(dtype=int),
    positions: wp.array(dtype=float),
):
    i = wp.tid()
    inner = kdtree.inner_node(axis[i], position[i], index[i])
    leaf = kdtree.leaf_node(axis[i], index[i])
    packed[i, 0] = inner
    packed[i, 1] = leaf
    positions[i] = kdtree.split_position(inner)
    unpacked[i, 0] = kdtree.split_axis(inner)
    unpacked[i, 1] = kdtree.right_child(inner)
    unpacked[i, 2] = kdtree.split_axis(leaf)
    unpacked[i, 3] = kdtree.first_block(leaf)
    unpacked[i, 4] = kdtree.leaf_triangles(leaf)


def test_node_packing():
    """8 bytes a node; every field comes back, up to the largest index; the bits are where the layout says."""
    axis = np.tile([0, 1, 2], 4).astype(np.int32)
    position = np.array([0.0, -0.0, 1.5, -1e38, 1e-40, 3.0] * 2, dtype=np.float32)
    index = np.array([0, 1, 2, 12345, kdtree.MAX_INDEX, 7] * 2, dtype=np.int32)
    inputs = [wp.array(a, device="cpu") for a in (axis, position, index)]
    packed = wp.zeros((12, 2), dtype=wp.vec2i, device="cpu")
    unpacked = wp.zeros((12, 5), dtype=int, device="cpu")
    positions = wp.zeros(12, dtype=float, device="cpu")
    wp.launch(pack_and_unpack, 12, inputs=[*inputs, packed, unpacked, positions], device="cpu")
    np.testing.assert_array_equal(unpacked.numpy(), np.stack([axis, index, np.full(12, 3), axis, index], axis=1))
    np.testing.assert_array_equal(positions.numpy().view(np.int32), position.view(np.int32))
    words = packed.numpy()
    assert words.itemsize * words.shape[-1] == 8
    np.testing.assert_array_equal(words[:, 0], np.stack([position.view(np.int32), index << 2 | axis], axis=1))
    np.testing.assert_array_equal(words[:, 1], np.stack([axis, index << 2 | 3], axis=1))


def test_events_are_sorted():
    """By position, then end, planar, start, then triangle; one event for a flat box, two for any other."""
    mesh = snapped_soup(5000, seed=1)
    boxes = boxes_of(mesh)
    events = sorted_events(boxes)
    corners = mesh.vertices[mesh.faces]
    for axis in range(3):
        low, high = corners[:, :, axis].min(1), corners[:, :, axis].max(1)
        flat = low == high
        count = events.count[axis]
        assert count == 2 * len(low) - flat.sum()
        position, value = events.position.numpy()[axis, :count], events.value.numpy()[axis, :count]
        order = np.lexsort((value >> 2, value & 3, position))
        np.testing.assert_array_equal(order, np.arange(count))
        for kind, expected, where in ((0, high, ~flat), (1, low, flat), (2, low, ~flat)):
            of_kind = (value & 3) == kind
            assert sorted(value[of_kind] >> 2) == np.flatnonzero(where).tolist()
            np.testing.assert_array_equal(position[of_kind], expected[value[of_kind] >> 2])


@pytest.mark.parametrize("builder", KDTREE_BUILDERS)
@pytest.mark.parametrize("width", [1, 8])
def test_invariants(scene_mesh, builder, width):
    """Leaves tile the root's box; every triangle is in every leaf whose inside its box meets, and in at least one leaf."""
    if scene_mesh.triangle_count > KDTREE_BUILDERS[builder].max_triangles:
        pytest.skip("too many triangles for this builder")
    tree, config = build(scene_mesh, builder, width=width, block_cost=1.5 if width == 1 else 0.5)
    flat = unpack(tree)
    leaf = flat.is_leaf
    volume = np.prod(flat.high - flat.low, axis=1)
    assert volume[leaf].sum() == pytest.approx(volume[0])
    inner = np.flatnonzero(~leaf)
    position = flat.position[inner]
    assert (flat.low[inner, flat.axis[inner]] < position).all()
    assert (position < flat.high[inner, flat.axis[inner]]).all()
    assert flat.depth.max() <= config.stop.limits(scene_mesh.triangle_count).depth <= kdtree.MAX_TREE_DEPTH
    corners = scene_mesh.vertices.astype(np.float32)[scene_mesh.faces].astype(np.float64)
    low, high = np.ascontiguousarray(corners.min(axis=1).T), np.ascontiguousarray(corners.max(axis=1).T)
    leaves, (owner, triangle) = np.flatnonzero(leaf), leaf_references(tree)
    for node in leaves[:: max(1, len(leaves) // 400)]:
        ends = list(zip(low, flat.high[node], high, flat.low[node], strict=True))
        inside = np.logical_and.reduce([(a < b) & (c > d) for a, b, c, d in ends])
        touches = np.logical_and.reduce([(a <= b) & (c >= d) for a, b, c, d in ends])
        listed = np.zeros_like(inside)
        listed[triangle[slice(*np.searchsorted(owner, [node, node + 1]))]] = True
        assert listed[inside].all()
        assert touches[listed].all()
    assert ((np.diff(owner) > 0) | (np.diff(triangle) > 0)).all()  # none twice in a leaf
    assert (np.bincount(triangle, minlength=scene_mesh.triangle_count) > 0).all()
    left = np.flatnonzero(~leaf)
    np.testing.assert_array_equal(flat.left[left], left + 1)  # depth-first order


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"width": 1, "block_cost": 1.5},
        {"bad_splits": 5},
        {"empty_factor": 1.0},
        {"max_depth": 6},
    ],
)
def test_exact_builders_equal_the_reference(scene_mesh, options):
    """They make the sorting sweep's tree: the same nodes to the bit, the same leaf lists, the same cost."""
    reference, config = build(scene_mesh, "sorting_sweep", **options)
    cost = kdtree_statistics(reference, scene_mesh.triangle_count, config.cost).sah_cost
    for builder in EXACT:
        if scene_mesh.triangle_count > KDTREE_BUILDERS[builder].max_triangles:
            continue
        tree, _ = build(scene_mesh, builder, **options)
        np.testing.assert_array_equal(tree.nodes.numpy(), reference.nodes.numpy())
        np.testing.assert_array_equal(leaf_references(tree), leaf_references(reference))
        assert kdtree_statistics(tree, scene_mesh.triangle_count, config.cost).sah_cost == cost


@pytest.mark.parametrize(
    "options",
    [
        {"mailbox": True},
        {"mailbox": True, "width": 1, "block_cost": 1.5},
        {"termination": "automatic"},
        {"termination": "fixed", "leaf_triangles": 20, "least_size": 0.05, "max_depth": 12},
    ],
)
@pytest.mark.parametrize("name", ["stadium", "grid", "degenerate"])
def test_exact_builders_equal_the_reference_with_options(name, options):
    test_exact_builders_equal_the_reference(SCENES[name](), options)


@pytest.mark.width
def test_exact_builders_equal_the_reference_on_the_bunny(bunny):
    reference, _ = build(bunny, "sorting_sweep", width=16)
    for builder in ("in_place", "nested", "sweep"):
        tree, _ = build(bunny, builder, width=16)
        np.testing.assert_array_equal(tree.nodes.numpy(), reference.nodes.numpy())
        np.testing.assert_array_equal(leaf_references(tree), leaf_references(reference))


@pytest.mark.parametrize("soup", [snapped_soup, scattered_soup])
def test_exact_builders_equal_the_reference_where_chunks_are_left_out(soup, monkeypatch):
    """The levels search few of the chunks of a large mesh; in none of the others is a best plane, or one of equals."""
    mesh = soup(10_000, seed=4)
    reference, _ = build(mesh, "sorting_sweep")
    use_tasks(monkeypatch, 256)
    with use_threads(4):
        tree, _ = build(mesh)
    np.testing.assert_array_equal(tree.nodes.numpy(), reference.nodes.numpy())
    np.testing.assert_array_equal(leaf_references(tree), leaf_references(reference))


def use_tasks(monkeypatch, tasks):
    """Has the levels go on until there are so many tasks."""
    monkeypatch.setattr(in_place, "task_target", lambda count, device: in_place.TaskTarget(tasks, count))


def test_levels_leave_out_no_chunk_for_a_plane_that_is_no_event_of_the_node():
    """Levels once took the cost of a plane just above flat ground, where a chunk began but no event of the node lay, for one
    that the node could have. It was less than the node's best, so the chunk with the best was left out: another tree with 12
    threads than with one."""
    mesh = wrt.scenes.build("teapot", level=40)
    with use_threads(1):
        reference, _ = build(mesh)
    with use_threads(16):
        tree, _ = build(mesh)
    np.testing.assert_array_equal(tree.nodes.numpy(), reference.nodes.numpy())
    np.testing.assert_array_equal(tree.primitive.numpy(), reference.primitive.numpy())


@pytest.mark.width
@pytest.mark.parametrize("threads", [1, 2, 3, 8])
def test_threads_and_tasks_do_not_show(threads, monkeypatch):
    """Bit for bit the same tree, whatever the threads, the chunks, and the level at which subtrees take over."""
    mesh = wrt.scenes.build("wood", trees=3)
    reference, _ = build(mesh)
    for tasks, levels in ((16, 12), (1, 12), (500, 12), (8000, 3)):
        use_tasks(monkeypatch, tasks)
        monkeypatch.setattr(in_place, "MAX_LEVELS", levels)
        with use_threads(threads):
            tree, _ = build(mesh)
        np.testing.assert_array_equal(tree.nodes.numpy(), reference.nodes.numpy())
        np.testing.assert_array_equal(tree.primitive.numpy(), reference.primitive.numpy())


@pytest.mark.parametrize("builder", PARALLEL)
def test_threads_and_chunks_do_not_show(builder, monkeypatch):
    """Bit for bit the same tree with one thread and with several, whatever the chunks and the tasks."""
    mesh = scattered_soup(6000, seed=2)
    monkeypatch.setattr(binned, "SAMPLED", 1000)
    monkeypatch.setattr(streaming, "EXACT", 500)
    with use_threads(1):
        reference, _ = build(mesh, builder)
    for threads, chunk, least in ((2, 8192, 4096), (3, 100, 64), (8, 7, 1000)):
        monkeypatch.setattr(levels_engine, "CHUNK", chunk)
        monkeypatch.setattr(binned, "MIN_LARGE", least)
        with use_threads(threads):
            tree, _ = build(mesh, builder)
        np.testing.assert_array_equal(tree.nodes.numpy(), reference.nodes.numpy())
        np.testing.assert_array_equal(tree.primitive.numpy(), reference.primitive.numpy())


@pytest.mark.parametrize("soup", [snapped_soup, scattered_soup])
def test_nested_chunks_do_not_show(soup, monkeypatch):
    """The nested build makes the sequential build's tree bit for bit, wherever its levels end and chunks begin: also between
    events at one position, of which the snapped soup has many."""
    mesh = soup(6000, seed=5)
    reference, _ = build(mesh, "sweep")
    for threads, chunk, least in ((2, 8192, 2000), (3, 100, 64), (8, 7, 1000)):
        monkeypatch.setattr(levels_engine, "CHUNK", chunk)
        monkeypatch.setattr(nested, "MIN_LARGE", least)
        with use_threads(threads):
            tree, _ = build(mesh, "nested")
        np.testing.assert_array_equal(tree.nodes.numpy(), reference.nodes.numpy())
        np.testing.assert_array_equal(tree.primitive.numpy(), reference.primitive.numpy())


@pytest.mark.parametrize("builder", ["in_place", "nested", "binned", "streaming"])
def test_small_shares_are_enlarged(builder, monkeypatch):
    """A build that runs out of memory in a task starts over with more, and ends with the same tree."""
    mesh = wrt.scenes.build("teapot_in_stadium", level=4)
    reference, _ = build(mesh, builder)
    monkeypatch.setattr(subtrees, "SPARE_MEMORY", 0.4 if builder == "streaming" else 0.01)
    tree, _ = build(mesh, builder)
    np.testing.assert_array_equal(tree.nodes.numpy(), reference.nodes.numpy())
    np.testing.assert_array_equal(tree.primitive.numpy(), reference.primitive.numpy())


@pytest.mark.width
@pytest.mark.parametrize("axes", ["longest", "mixed"])
def test_searched_axes(axes):
    """Large nodes are split along their longest axis, and small ones along any; the hits are those of brute force."""
    soup = scattered_soup(4000, seed=3)
    upper = np.repeat(soup.vertices[::3, 1] > 20, 3)  # above an empty slab, at which the longest axis is not the best one
    mesh = wrt.TriangleMesh(soup.vertices * [1.4, 1, 1] + np.outer(upper, [0, 15, 0]), soup.faces)
    tree, _ = build(mesh, "adaptive_sampling", searched_axes=axes)
    flat = unpack(tree)
    size = flat.high - flat.low
    owner, inner = leaf_references(tree)[0], np.flatnonzero(~flat.is_leaf)
    ends = np.array([subtree_end(flat, int(node)) for node in inner])
    held = np.searchsorted(owner, ends) - np.searchsorted(owner, inner)  # at least the node's triangles
    along_longest = size[inner, flat.axis[inner]] == size[inner].max(axis=1)
    assert along_longest[held > 1500].all()
    assert not along_longest[held < 36].all()
    every, _ = build(mesh, "adaptive_sampling")
    assert (unpack(every).axis[0], flat.axis[0]) == (1, 0)
    rng = np.random.default_rng(1)
    origins, directions = rng.random((200, 3)) * 55, rng.normal(size=(200, 3))
    scene = wrt.Scene(mesh, wrt.KdTree(builder="adaptive_sampling", searched_axes=axes), device="cpu")
    hits, brute = (scene.intersect(origins, directions, traversal=way) for way in ("single", "brute"))
    np.testing.assert_array_equal(hits.t, brute.t)
    np.testing.assert_array_equal(hits.primitive_id, brute.primitive_id)
    assert brute.is_hit.any()


@pytest.mark.parametrize("builder", KDTREE_BUILDERS)
@pytest.mark.parametrize("count", [1, 2, 3, 7, 8, 9])
def test_tiny_and_flat_meshes(builder, count):
    """One triangle, a few, all in one plane, all in one point."""
    rng = np.random.default_rng(count)
    corners = rng.random((count, 3, 3))
    for flatten in (None, 0, 1, 2, "point"):
        shaped = corners.copy()
        if flatten == "point":
            shaped[:] = 0.5
        elif flatten is not None:
            shaped[:, :, flatten] = 0.25
        mesh = wrt.TriangleMesh(shaped.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
        tree, _ = build(mesh, builder, width=1, block_cost=3.0)
        assert set(leaf_references(tree)[1]) == set(range(count))


@pytest.mark.parametrize("builder", KDTREE_BUILDERS)
def test_hard_meshes(builder):
    """The same hits as by brute force, and a bounded number of references."""
    rng = np.random.default_rng(8)
    for name, mesh in hard_meshes().items():
        tree, _ = build(mesh, builder)
        assert leaf_references(tree).shape[1] <= 64 * mesh.triangle_count, name
        scene = wrt.Scene(mesh, wrt.KdTree(builder=builder, width=8), device="cpu")
        corners = mesh.vertices[mesh.faces[rng.integers(0, mesh.triangle_count, 300)]]
        targets = (rng.dirichlet([1, 1, 1], 300)[:, :, None] * corners).sum(axis=1)
        origins = targets + rng.normal(size=(300, 3))
        hits = scene.intersect(origins, targets - origins, traversal="single")
        brute = scene.intersect(origins, targets - origins, traversal="brute")
        np.testing.assert_array_equal(hits.t, brute.t, err_msg=name)
        np.testing.assert_array_equal(hits.primitive_id, brute.primitive_id, err_msg=name)
        assert brute.is_hit.mean() > 0.5, name


@pytest.mark.parametrize("axis", ["longest", "round_robin"])
def test_medians(axis):
    """Boxes in a row along y: the first planes are those of the definition, worked out in NumPy."""
    middle = np.array([0.0, 1.0, 2.0, 3.0, 50.0, 60.0, 70.0, 80.0, 90.0])
    corners = np.zeros((9, 3, 3))
    corners[:, :, 1] = middle[:, None] + [-0.25, 0.25, 0.0]
    corners[:, 1, 0] = 5.0
    corners[:, 2, 2] = np.arange(9) + 1.0
    mesh = wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(27).reshape(-1, 3))
    low, high = corners.min((0, 1)), corners.max((0, 1))
    centers = (corners.min(1) + corners.max(1)) / 2
    for builder in ("spatial_median", "object_median"):
        tree, _ = build(mesh, builder, width=1, block_cost=10.0, bad_splits=9, max_depth=2, axis=axis)
        flat = unpack(tree)
        first = 0 if axis == "round_robin" else 1
        assert flat.axis[0] == first
        expected = np.median(centers[:, first]) if builder == "object_median" else (low[first] + high[first]) / 2
        assert flat.position[0] == pytest.approx(expected)
        assert flat.axis[flat.left[0]] == 1


@pytest.mark.width
def test_memory_of_the_tree(bunny):
    """The tree with its records stays within 120 bytes a triangle on the bunny."""
    statistics = wrt.Scene(bunny, device="cpu").statistics()
    assert 20 < statistics.tree_bytes_per_triangle <= 120

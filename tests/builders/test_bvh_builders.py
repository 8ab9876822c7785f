"""Bounding volume hierarchies: invariants, quality against the reference, independence of threads, refit, limits."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import warp as wp
from support.built_bvhs import arrays_of, assert_same_tree, build, check, mesh_of
from support.meshes import SCENES

import wrt
from wrt.builders import triangle_boxes as boxes_module
from wrt.builders.bvh import BVH_BUILDERS, hploc
from wrt.builders.bvh import binned_bvh as binned
from wrt.builders.bvh.bvh_config import BvhConfig
from wrt.builders.bvh.bvh_statistics import bvh_statistics, unpack
from wrt.builders.bvh.phases import collapse as collapse_phase
from wrt.builders.bvh.update.bvh_update import refit, refit_upward, upward_links
from wrt.builders.cost import SurfaceAreaCost
from wrt.builders.triangle_boxes import corner_bounds, triangle_boxes
from wrt.kernels.layout.bvh_nodes import MAX_BLOCKS, MAX_WIDE_DEPTH, check_blocks
from wrt.kernels.runtime.launch import launch, use_threads

WIDTHS = (2, 4, 8, 16)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("builder", BVH_BUILDERS)
def test_invariants(scene_mesh, builder, width):
    tree, config = build(scene_mesh, builder, width)
    check(tree, scene_mesh.vertices, scene_mesh.faces, config)


@pytest.mark.width
@pytest.mark.parametrize("width", [2, 8, 16])
def test_threads_and_tasks_do_not_show(width, monkeypatch):
    """Bit for bit the same tree, whatever the threads, the chunks, and the size at which subtrees take over."""
    mesh = wrt.scenes.build("wood", trees=4)
    with use_threads(1):
        reference, _ = build(mesh, width=width)
    for threads, large, chunk, levels in ((2, 4096, 2048, 32), (2, 200, 64, 32), (5, 70, 33, 32), (5, 64, 1000, 3)):
        monkeypatch.setattr(binned, "MIN_LARGE", large)
        monkeypatch.setattr(binned, "TASKS_PER_THREAD", mesh.triangle_count // large)
        monkeypatch.setattr(binned, "MIN_CHUNK", chunk)
        monkeypatch.setattr(binned, "CHUNKS_PER_THREAD", mesh.triangle_count // chunk)
        monkeypatch.setattr(binned, "MAX_LEVELS", levels)
        with use_threads(threads):
            tree, _ = build(mesh, width=width)
        assert_same_tree(tree, reference)


@pytest.mark.parametrize("width", WIDTHS)
def test_binned_is_nearly_as_good_as_the_reference(scene_mesh, width):
    """By the cost that both minimise, so without the rules for large boxes. Most scenes differ by a few percent; in the atrium
    the size axis makes the binned tree the better one."""
    costs = {}
    for builder in ("binned", "sweep"):
        tree, config = build(scene_mesh, builder, width, large=float("inf"))
        costs[builder] = bvh_statistics(tree, scene_mesh.triangle_count, config.cost).sah_cost
    assert costs["binned"] <= {2: 1.25, 4: 1.12, 8: 1.08, 16: 1.08}[width] * costs["sweep"]


def test_binned_is_nearly_as_good_as_the_reference_on_the_bunny(bunny):
    statistics = {}
    for builder in ("binned", "sweep"):
        tree, config = build(bunny, builder, 16)
        statistics[builder] = bvh_statistics(tree, bunny.triangle_count, config.cost)
    assert statistics["binned"].sah_cost <= 1.02 * statistics["sweep"].sah_cost
    assert statistics["binned"].node_fill > 0.8
    assert statistics["binned"].block_fill > 0.8


def best_cost(tree, rules, cost, node: int, lanes: int) -> float:
    """F(n, lanes) of the collapse, straight from its definition, in float64."""
    box, sizes, pairs = tree.box.numpy().reshape(-1, 8), tree.range.numpy(), tree.pair.numpy()

    def area(n: int) -> float:
        x, y, z = -(box[n, :3].astype(float) + box[n, 4:7])
        return x * y + y * z + z * x

    def flat(n: int) -> bool:
        sides = -(box[n, :3].astype(float) + box[n, 4:7])
        return sides.min() <= sides.max() * 2.0**-10

    @functools.cache
    def holds_large(n: int) -> bool:
        children = (2 * int(pairs[n]), 2 * int(pairs[n]) + 1) if pairs[n] else ()
        return (flat(n) and area(n) > rules.large * area(0)) or any(map(holds_large, children))

    @functools.cache
    def best(n: int, j: int) -> float:
        blocks = -(-int(sizes[n, 1]) // cost.width)
        may_be_leaf = sizes[n, 1] <= rules.max_leaf and (pairs[n] == 0 or flat(n) or not holds_large(n))
        least = area(n) * cost.block * blocks if may_be_leaf else np.inf
        if pairs[n] != 0:
            least = min(least, area(n) * cost.traversal + divided(n, cost.width))
            if j > 1:
                least = min(least, divided(n, j))
        return least

    def divided(n: int, j: int) -> float:
        left, right = 2 * int(pairs[n]), 2 * int(pairs[n]) + 1
        return min(best(left, k) + best(right, j - k) for k in range(1, j))

    return (area(node) * cost.traversal + divided(node, lanes)) / area(node)


@pytest.mark.width
@pytest.mark.parametrize("width", [2, 4, 16])
@pytest.mark.parametrize("block", [0.3, 1.0])
@pytest.mark.parametrize("name", ["teapot", "stadium", "degenerate"])
def test_collapse_is_optimal(name, width, block, monkeypatch):
    """The finished tree costs what the dynamic programme, worked out again from its definition, says is the least."""
    mesh = SCENES[name]()
    binary = []
    collapse = collapse_phase.collapse
    monkeypatch.setattr(collapse_phase, "collapse", lambda *args: binary.append(args[0]) or collapse(*args))
    tree, config = build(mesh, width=width, block=block)
    expected = best_cost(binary[0].tree, config.struct(), config.cost, 0, width)
    cost = bvh_statistics(tree, mesh.triangle_count, config.cost).sah_cost
    assert cost == pytest.approx(expected, rel=1e-4)


@pytest.mark.width
@pytest.mark.parametrize("builder", BVH_BUILDERS)
@pytest.mark.parametrize("width", [2, 8, 16])
def test_large_flat_triangles_are_not_in_leaves_that_are_not_flat(builder, width):
    """A ray that leaves the ground is not in the box of its leaf. Without the rule, it often is."""
    mesh = SCENES["atrium"]()
    mixed = {}
    for large in (1.0 / 32.0, float("inf")):
        tree, _ = build(mesh, builder, width, large=large)
        flat = unpack(tree)
        size = np.ptp(mesh.vertices.astype(np.float32)[mesh.faces], axis=1).astype(float)
        area, root = (x * y + y * z + z * x for x, y, z in (size.T, np.array(tree.high) - np.array(tree.low)))
        is_large = (size.min(axis=1) <= size.max(axis=1) * 2.0**-10) & (area > root / 32.0)
        assert is_large.sum() >= 8
        mixed[large] = 0
        for node, lane in zip(*np.nonzero(flat.is_leaf), strict=True):
            sides = flat.high[node, lane] - flat.low[node, lane]
            begin = flat.first_block[node, lane] * width
            ids = tree.primitive.numpy()[begin : begin + flat.triangles[node, lane]]
            mixed[large] += sides.min() > sides.max() * 2.0**-10 and is_large[ids].any()
    assert mixed[1.0 / 32.0] == 0
    assert mixed[float("inf")] > 0


@pytest.mark.parametrize("builder", BVH_BUILDERS)
def test_surface_area_cost_of_a_known_tree(builder):
    """Two far-apart clusters of four triangles: two leaves, and the cost is the textbook's, worked out by hand."""
    cluster = np.array([[[0, 0, 0], [1, 1, 0], [1, 0, 1]]] * 4)
    tree, config = build(
        mesh_of(np.concatenate([cluster, cluster + np.array([9, 0, 0])])), builder, 4, traversal=1.0, block=2.0
    )
    statistics = bvh_statistics(tree, 8, config.cost)
    assert (statistics.nodes, statistics.leaves) == (1, 2)
    assert (statistics.node_fill, statistics.block_fill) == (0.5, 1.0)
    assert statistics.depth_histogram.tolist() == [0, 2]
    assert statistics.leaf_size_histogram.tolist() == [0, 0, 0, 0, 2]
    assert statistics.sah_cost == pytest.approx(1.0 + 2 * 2.0 * (1 * 1 + 2 * 1) / (1 * 1 + 2 * 10))


@pytest.mark.parametrize("builder", BVH_BUILDERS)
@pytest.mark.parametrize("count", [1, 2, 3, 8, 9, 49])
def test_tiny_and_flat_meshes(builder, count):
    """One triangle, a few, all in one plane, on one line, in one point; the root is a node even if one leaf would do."""
    rng = np.random.default_rng(count)
    corners = rng.random((count, 3, 3))
    flat, line, point, huge = corners.copy(), corners.copy(), np.full_like(corners, 0.5), corners * 1e37
    flat[:, :, 1] = 0.25
    line[:, :, :2] = 0.75
    for shaped in (corners, flat, line, point, huge, -corners):
        mesh = mesh_of(shaped)
        for width in (2, 16):
            tree, config = build(mesh, builder, width)
            check(tree, mesh.vertices, mesh.faces, config)
    if count == 1:
        assert (tree.level_first, tree.child.numpy()[0]) == ((0, 1), ~1)


@pytest.mark.parametrize("leaf", [1, 2])
def test_clusters_need_no_collapse(scene_mesh, leaf, monkeypatch):
    """With two children and leaves of at most two triangles, the short way makes the tree that the collapse makes."""
    tree, _ = build(scene_mesh, "hploc", 2, max_leaf_triangles=leaf)
    monkeypatch.setattr(hploc, "needs_no_collapse", lambda _: False)
    collapsed, _ = build(scene_mesh, "hploc", 2, max_leaf_triangles=leaf)
    assert_same_tree(tree, collapsed)


@pytest.mark.parametrize("width", [2, 16])
def test_threads_do_not_show_in_clusters(width):
    """Threads meet in the hierarchy in any order. Work spaces of larger meshes are used again."""
    meshes = [wrt.scenes.build("wood", trees=4), wrt.scenes.build("random_triangles", count=20_000, size=0.1, seed=3)]
    with use_threads(1):
        expected = [build(mesh, "hploc", width, max_leaf_triangles=2)[0] for mesh in meshes]
    for threads in (2, 5, 8) * 3:
        with use_threads(threads):
            for mesh, tree in zip(meshes, expected, strict=True):
                assert_same_tree(build(mesh, "hploc", width, max_leaf_triangles=2)[0], tree)


def test_equal_clusters_are_halved():
    """Of pairs of equal area those that make the tree flat are merged first: by places alone, a chain would come of them."""
    tree, _ = build(
        mesh_of(np.repeat(np.random.default_rng(1).random((1, 3, 3)), 1000, axis=0)), "hploc", 2, max_leaf_triangles=1
    )
    assert tree.depth == 10


def test_clusters_that_would_make_a_tree_too_deep_are_merged_by_place(monkeypatch):
    small = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 1]], dtype=np.float64)
    corners = small * 2.0 ** np.arange(-60, 60)[:, None, None]
    ways, merge = [], hploc.merge
    monkeypatch.setattr(hploc, "merge", lambda *given: ways.append(given[2]) or merge(*given))
    for width in (2, 16):
        tree, config = build(mesh_of(corners), "hploc", width, max_leaf_triangles=2)
        check(tree, mesh_of(corners).vertices, mesh_of(corners).faces, config)
    assert ways == [True, False, True, False]


def test_corner_bounds():
    """The box of what triangles use, in float32; zeros are positive; NaN is refused."""
    vertices = np.random.default_rng(2).normal(size=(400, 3)).astype(np.float32)
    vertices[7], vertices[8], vertices[399] = -50.0, [0.0, -0.0, 80.0], 1e9
    faces = np.random.default_rng(3).integers(0, 399, (300, 3)).astype(np.int32)
    faces[0] = 7, 8, 9
    low, high = corner_bounds(*(wp.array(a, dtype=t, device="cpu") for a, t in ((vertices, wp.vec3), (faces, wp.vec3i))))
    np.testing.assert_array_equal([low, high], [vertices[faces].min(axis=(0, 1)), vertices[faces].max(axis=(0, 1))])
    flat = wp.zeros(3, dtype=wp.vec3, device="cpu")
    flat.assign(np.full((3, 3), -0.0, np.float32))
    assert not np.signbit(corner_bounds(flat, wp.array([[0, 1, 2]], dtype=wp.vec3i, device="cpu"))).any()
    for bad in (np.nan, np.inf):
        vertices[8, 1] = bad
        with pytest.raises(ValueError, match="NaN or infinite"):
            corner_bounds(*(wp.array(a, dtype=t, device="cpu") for a, t in ((vertices, wp.vec3), (faces, wp.vec3i))))


def test_hploc_within_corners_that_are_searched_for_meanwhile(monkeypatch):
    """As where they are known, also of a plane; NaN, and boxes that are too large, are refused before anything is merged."""
    config = BvhConfig(cost=SurfaceAreaCost(width=2), max_leaf_triangles=2)
    for mesh in (SCENES["teapot"](), wrt.scenes.shapes.plane((-5.0, -5.0), (5.0, 5.0), z=-1.0)):
        vertices, faces = (wp.array(a, dtype=t, device="cpu") for a, t in ((mesh.vertices, wp.vec3), (mesh.faces, wp.vec3i)))
        known = hploc.build(triangle_boxes(vertices, faces), config)
        with monkeypatch.context() as patch:
            patch.setattr(boxes_module, "searches_bounds", lambda device: True)
            found = hploc.build(triangle_boxes(vertices, faces), config)
            for name in ("bounds", "child", "primitive"):
                np.testing.assert_array_equal(getattr(found, name).numpy(), getattr(known, name).numpy())
            assert (found.low, found.high) == (known.low, known.high)
            for bad, message in ((np.nan, "NaN"), (1e38, "trees can be built")):
                broken = mesh.vertices.astype(np.float32)
                broken[mesh.faces[0, 0]] = bad
                with pytest.raises(ValueError, match=message):
                    hploc.build(triangle_boxes(wp.array(broken, dtype=wp.vec3, device="cpu"), faces), config)


@pytest.mark.parametrize("builder", BVH_BUILDERS)
@pytest.mark.parametrize("width", [2, 16])
def test_depth_is_bounded(builder, width):
    """Geometry that the surface area heuristic would peel off one triangle at a time."""
    small = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 1]], dtype=np.float64)
    series = small * 2.0 ** np.arange(-120, 120)[:, None, None] / 2.0**60
    duplicates = np.repeat(small[None], 5000, axis=0)
    nested = (small - 0.25) * 1.5 ** np.arange(140)[:, None, None]
    both = np.concatenate([np.repeat(series, 20, axis=0), duplicates * 0.0])
    for corners in (series, duplicates, nested, both):
        mesh = mesh_of(corners)
        tree, config = build(mesh, builder, width, max_leaf_triangles=2)
        check(tree, mesh.vertices, mesh.faces, config)


def test_depth_bound_is_reached():
    """Without the rule that halves nodes, the series above would make a tree deeper than traversals have stack for."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 1]]) * 2.0 ** np.arange(-60, 60)[:, None, None]
    tree, _ = build(mesh_of(corners), width=2, max_leaf_triangles=1, bins=2)
    assert tree.depth == MAX_WIDE_DEPTH


def test_duplicates_fill_their_blocks():
    """A node that no plane splits is divided at whole blocks."""
    tree, _ = build(mesh_of(np.repeat(np.random.default_rng(1).random((1, 3, 3)), 5000, axis=0)), width=16)
    assert len(tree.primitive) == -(-5000 // 16) * 16
    assert tree.depth <= 4


@pytest.mark.parametrize("width", [2, 16])
def test_refit(scene_mesh, width):
    """Unmoved vertices give the same boxes to the bit; moved ones give the exact union of the moved triangles."""
    tree, config = build(scene_mesh, width=width)
    vertices, faces = arrays_of(scene_mesh)
    again = refit(tree, vertices, faces)
    assert_same_tree(again, tree)
    assert again.bounds.ptr != tree.bounds.ptr
    before = tree.bounds.numpy().copy()
    moved = scene_mesh.vertices + 0.3 * np.sin(7.0 * scene_mesh.vertices[:, ::-1])
    other = refit(tree, wp.array(moved.astype(np.float32), dtype=wp.vec3, device="cpu"), faces)
    check(other, moved, scene_mesh.faces, config)
    np.testing.assert_array_equal(tree.bounds.numpy(), before)


@pytest.mark.parametrize("width", [2, 16])
def test_refit_upward(scene_mesh, width):
    """The kernel for CUDA, on one thread of the CPU: the boxes of the levels, to the bit, again and again."""
    tree, _ = build(scene_mesh, width=width)
    vertices, faces = arrays_of(scene_mesh)
    links = upward_links(tree)
    for step in (0.0, 0.3, 0.5):
        moved = (scene_mesh.vertices + step * np.sin(7.0 * scene_mesh.vertices[:, ::-1])).astype(np.float32)
        vertices.assign(moved)
        bounds = wp.empty(len(tree.bounds), dtype=float, device="cpu")
        inputs = [tree.width, vertices, faces, tree.child, tree.primitive, links, bounds]
        with use_threads(1):
            launch(refit_upward, tree.level_first[-1], inputs, device=vertices.device)
        expected = refit(tree, vertices, faces)
        np.testing.assert_array_equal(bounds.numpy().view(np.int32), expected.bounds.numpy().view(np.int32))
        assert not links.arrived.numpy().any()


def test_refit_knows_one_zero():
    """Where the boxes of triangles are made, -0 becomes +0; so it does in a refit."""
    first = [[-0.0, -0.0, -0.0], [1, -0.0, -0.0], [-0.0, 1, -0.0]]
    second = [[-1, -0.0, -1], [-0.0, -1, -0.0], [-1, -1, -1]]
    mesh = mesh_of(np.array([first, second]))
    tree, _ = build(mesh, width=2, max_leaf_triangles=1)
    assert_same_tree(refit(tree, *arrays_of(mesh)), tree)


@pytest.mark.parametrize("limit", [1, 3, 16, 63])
def test_leaf_limit(limit):
    """Free nodes make no leaf larger than need be; free triangles make leaves as large as allowed."""
    mesh = wrt.scenes.build("teapot", level=6)
    tree, config = build(mesh, width=4, traversal=100.0, max_leaf_triangles=limit)
    check(tree, mesh.vertices, mesh.faces, config)
    assert unpack(tree).triangles.max() > limit // 2


def test_memory(bunny):
    """Peak of what is reserved, and the size of the tree without records, in bytes a triangle."""
    tree, _ = build(bunny, width=16)
    assert tree.stats.peak_bytes <= 200 * bunny.triangle_count
    assert tree.bytes <= 12 * bunny.triangle_count


def test_report_names_the_phases():
    tree, _ = build(wrt.scenes.build("teapot", level=6))
    assert list(tree.stats.seconds) == ["references", "top levels", "subtrees", "collapse"]


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: BvhConfig(bins=1), "bins"),
        (lambda: BvhConfig(bins=41), "bins"),
        (lambda: BvhConfig(max_leaf_triangles=0), "max_leaf_triangles"),
        (lambda: BvhConfig(max_leaf_triangles=64), "max_leaf_triangles"),
        (lambda: BvhConfig(large=-0.1), "large"),
        (lambda: BvhConfig(large=float("nan")), "large"),
        (lambda: BvhConfig(cost=SurfaceAreaCost(width=1)), "width"),
    ],
)
def test_bad_configurations(make, name):
    with pytest.raises(ValueError, match=name):
        make()


def test_more_triangles_than_a_tree_can_have_are_refused():
    """Before anything is allocated: numbers of words of boxes, and of blocks in child words, would overflow."""
    hploc.check_count(hploc.MAX_TRIANGLES, 16)
    hploc.check_count(2 * MAX_BLOCKS, 2)
    for count, width in ((hploc.MAX_TRIANGLES + 1, 16), (2 * MAX_BLOCKS + 1, 2)):
        with pytest.raises(ValueError, match=r"into several.* wrt\.Instance"):
            hploc.check_count(count, width)
    with pytest.raises(ValueError, match="33,554,433 blocks of 8"):
        check_blocks(MAX_BLOCKS + 1, 8)

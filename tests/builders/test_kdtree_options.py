"""Options of kd-trees that the survey of Rahikainen (2013, section 4.1) names: costs of rays that end, tests of triangles
against cells, early and late cutting of empty space."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from support.built_kdtrees import boxes_of, build, leaf_references, meets
from support.meshes import SCENES

import wrt
from wrt import scenes
from wrt.builders.core import levels as levels_engine
from wrt.builders.core.clip import PAD
from wrt.builders.cost import Split, SplitCost, SurfaceAreaCost, axis_frame, cheaper_split, no_split
from wrt.builders.kdtree import KDTREE_BUILDERS, BuilderCapabilities, binned
from wrt.builders.kdtree.kdtree_statistics import kdtree_statistics, unpack
from wrt.builders.kdtree.update.kdtree_update import subtree_end
from wrt.kernels.runtime.launch import use_threads

CLASSIC = {"width": 1, "block_cost": 1.5}

OPTIONS = {
    "post-processing": {"cell_tests": "leaves"},
    "tests in nodes": {"cell_tests": "nodes"},
    "early cutting": {"empty_space": "early"},
    "late cutting": {"empty_space": "late", "leaf_triangles": 30},
    "both, of clipped triangles": {"empty_space": "both", "split_clipping": True, "leaf_triangles": 30},
    "rays that end": {"cost_model": "blocking"},
    "medians first": {"median_levels": 3},
}


def described(mesh: wrt.TriangleMesh, builder: str, **options):
    """The tree of a description, with the passes of the end."""
    return wrt.KdTree(builder=builder, **options).build(boxes_of(mesh), 8)


def rays_at(mesh: wrt.TriangleMesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays from around a mesh at points near its surface."""
    rng = np.random.default_rng(8)
    corners = mesh.vertices[mesh.faces[rng.integers(0, mesh.triangle_count, count)]]
    targets = (rng.dirichlet([1, 1, 1], count)[:, :, None] * corners).sum(axis=1)
    origins = mesh.center + mesh.extent * rng.normal(size=(count, 3)) * rng.choice([0.2, 2.0], (count, 1))
    return origins, targets - origins


@wp.kernel(enable_backward=False)
def evaluate(cost: SplitCost, low: wp.vec3, high: wp.vec3, position: float, counts: wp.vec2i, result: wp.array(dtype=Split)):
    along = axis_frame(cost, 0, low, high, counts[0] + counts[1])
    result[0] = cheaper_split(cost, along, position, counts[0], counts[1], False, no_split())


def small_triangles(rng, low, high, count: int, size: float) -> np.ndarray:
    """(count, 3, 3) triangles of random directions, with their centres in a box."""
    corners = rng.normal(size=(count, 3, 3))
    corners *= size / np.linalg.norm(corners, axis=2, keepdims=True)
    return low + (high - low) * rng.random((count, 1, 3)) + corners


def hit_by(origins: np.ndarray, directions: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(lines,) whether a line meets one of the triangles."""
    found = np.zeros(len(origins), dtype=bool)
    for a, b, c in corners:
        volumes = [np.einsum("ij,ij->i", directions, np.cross(p - origins, q - origins)) for p, q in ((a, b), (b, c), (c, a))]
        found |= (np.sign(volumes[0]) == np.sign(volumes[1])) & (np.sign(volumes[1]) == np.sign(volumes[2]))
    return found


def crosses(origins: np.ndarray, directions: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(lines,) whether a line meets a box."""
    with np.errstate(divide="ignore"):
        ends = (np.stack([low, high])[:, None] - origins) / directions
    return ends.min(axis=0).max(axis=1) < ends.max(axis=0).min(axis=1)


@pytest.mark.parametrize(("position", "counts"), [(1.0, (400, 400)), (1.3, (600, 200))])
def test_the_cost_of_rays_that_end(position, counts):
    """The formula gives what uniform lines through two cells of random triangles test; without the ends it gives more."""
    rng = np.random.default_rng(1)
    low, high, size = np.zeros(3), np.array([2.0, 1.0, 1.0]), 0.07
    cells = ((low, np.array([position, 1, 1])), (np.array([position, 0, 0]), high))
    tested, all_tests, areas, lines = [], [], [], 3000
    for _ in range(4):
        parts = [small_triangles(rng, *cell, count, size) for cell, count in zip(cells, counts, strict=True)]
        areas += [0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) for p in parts]
        directions = rng.normal(size=(lines, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        across = rng.normal(size=(lines, 3))
        across -= np.einsum("ij,ij->i", across, directions)[:, None] * directions
        # a ball of radius 1.3 contains the box: lines through a disc of it
        across *= 1.3 * np.sqrt(rng.random((lines, 1))) / np.linalg.norm(across, axis=1, keepdims=True)
        origins = high / 2 + across
        passes = [crosses(origins, directions, *cell) for cell in cells]
        ends = [met & hit_by(origins, directions, part) for met, part in zip(passes, parts, strict=True)]
        either = passes[0] | passes[1]
        left_first = directions[:, 0] > 0
        left, right = counts
        all_tests.append((passes[0] * left + passes[1] * right)[either])
        visits = [passes[0] & (left_first | ~ends[1]), passes[1] & (~left_first | ~ends[0])]
        tested.append((visits[0] * left + visits[1] * right)[either])
    found = {}
    for occluder in (0.0, float(np.concatenate(areas).mean())):
        cost = SurfaceAreaCost(traversal=0.0, block=1.0, width=1, empty_factor=1.0, occluder=occluder)
        result = wp.zeros(1, dtype=Split, device="cpu")
        inputs = [cost.struct(), wp.vec3(*low), wp.vec3(*high), position, wp.vec2i(*counts), result]
        wp.launch(evaluate, 1, inputs=inputs, device="cpu")
        found[occluder > 0] = float(result.numpy()["cost"][0])
    tested, all_tests = (np.concatenate(values).mean() for values in (tested, all_tests))
    assert found[False] == pytest.approx(all_tests, rel=0.03)
    assert found[False] - found[True] == pytest.approx(all_tests - tested, rel=0.2)  # some stick out of their cell
    assert all_tests - tested > 0.03 * all_tests


SMALL = {name: make for name, make in SCENES.items() if name not in ("stadium", "atrium", "wood")}


@pytest.mark.parametrize("options", [{}, CLASSIC], ids=["lanes", "one"])
@pytest.mark.parametrize("name", SMALL)
def test_sorted_scanned_and_naive_builds_make_one_tree(name, options):
    """The same nodes to the bit and the same leaves, by independent builds: two of them without presorted events."""
    mesh = SMALL[name]()
    for option in ({"cell_tests": "nodes"}, {"empty_space": "early"}, {"cost_model": "blocking"}):
        reference = described(mesh, "sorting_sweep", **options, **option)
        for builder in ("naive", "sweep"):
            if builder == "sweep" and "cost_model" in option:
                continue
            tree = described(mesh, builder, **options, **option)
            np.testing.assert_array_equal(tree.nodes.numpy(), reference.nodes.numpy())
            np.testing.assert_array_equal(leaf_references(tree), leaf_references(reference))


@pytest.mark.parametrize("option", OPTIONS)
@pytest.mark.parametrize("builder", ["in_place", "binned", "sorting_sweep"])
@pytest.mark.parametrize("name", ["random_triangles", "degenerate", "wood"])
def test_hits_are_those_of_brute_force(name, builder, option):
    """Closest hits of any option, with one thread and with three, which make the same tree."""
    mesh, options = SCENES[name](), OPTIONS[option]
    able = KDTREE_BUILDERS[builder]
    needed = BuilderCapabilities.ANY_COST if "cost_model" in options else BuilderCapabilities.NONE
    needed |= BuilderCapabilities.CLUSTERS if "median_levels" in options else BuilderCapabilities.NONE
    if options.get("empty_space") in ("early", "both"):
        needed |= BuilderCapabilities.CUTS_EARLY
    if needed not in able.capabilities:
        pytest.skip("an option that this builder does not have")
    origins, directions = rays_at(mesh, 300)
    trees = []
    for threads in (1, 3):
        scene = wrt.Scene(mesh, wrt.KdTree(builder=builder, **options), device="cpu", num_threads=threads)
        hits, brute = (scene.intersect(origins, directions, traversal=way) for way in ("single", "brute"))
        np.testing.assert_array_equal(hits.t.view(np.int32), brute.t.view(np.int32))
        np.testing.assert_array_equal(hits.primitive_id, brute.primitive_id)
        trees.append(scene.tree)
    assert brute.is_hit.any()
    for array in ("nodes", "primitive"):
        np.testing.assert_array_equal(getattr(trees[0], array).numpy(), getattr(trees[1], array).numpy())


@pytest.mark.parametrize("tests", ["leaves", "nodes"])
@pytest.mark.parametrize("name", ["random_triangles"])
def test_leaves_list_what_they_meet(name, tests):
    """Every triangle that meets the inside of a leaf, and none that is further away than what cells are enlarged by. Tests in
    nodes come before planes are chosen, and tests of leaves after it, with the planes of the tree without tests."""
    mesh = SCENES[name]()
    corners = mesh.vertices.astype(np.float32)[mesh.faces]
    pad = PAD * float((corners.max((0, 1)) - corners.min((0, 1))).max())
    tree, (plain, config) = described(mesh, "sweep", cell_tests=tests), build(mesh, "sweep")
    flat, (leaf, triangle) = unpack(tree), leaf_references(tree)
    low, high = corners.min(axis=1), corners.max(axis=1)
    checked = 0
    for node in np.flatnonzero(flat.is_leaf)[::5]:
        cell = flat.low[node], flat.high[node]
        near = np.flatnonzero(((low <= cell[1]) & (high >= cell[0])).all(axis=1))
        must = {i for i in near if meets(corners[i], cell[0] + 1e-7, cell[1] - 1e-7)}
        own = triangle[leaf == node]
        assert must <= set(own)
        assert all(meets(corners[i], cell[0] - 3 * pad, cell[1] + 3 * pad) for i in own)
        checked += len(must)
    assert checked > 100
    before = unpack(plain)
    if tests == "leaves":
        planes = {(depth, axis, at) for depth, axis, at in zip(before.depth, before.axis, before.position, strict=True)}
        assert {(d, a, p) for d, a, p in zip(flat.depth, flat.axis, flat.position, strict=True) if a < 3} <= planes
    costs = [kdtree_statistics(found, mesh.triangle_count, config.cost) for found in (tree, plain)]
    assert costs[0].references < 0.95 * costs[1].references
    assert costs[0].sah_cost < costs[1].sah_cost


def test_nothing_is_left_above_empty_leaves():
    """An inner node whose leaves lost all their triangles is an empty leaf; its cells still fill the root's box."""
    mesh = scenes.build("random_triangles", count=1500, size=0.4, seed=3)
    flat = unpack(described(mesh, "sweep", cell_tests="leaves", **CLASSIC))
    before = unpack(build(mesh, "sweep", **CLASSIC)[0])
    inner = np.flatnonzero(~flat.is_leaf)
    empty = flat.is_leaf & (flat.triangles == 0)
    assert not (empty[flat.left[inner]] & empty[flat.right[inner]]).any()
    assert len(flat.axis) < 0.95 * len(before.axis)
    assert np.prod(flat.high - flat.low, axis=1)[flat.is_leaf].sum() == pytest.approx(np.prod(flat.high[0] - flat.low[0]))


@pytest.mark.parametrize("clipped", [False, True])
@pytest.mark.parametrize("name", ["degenerate", "random_triangles"])
def test_late_cuts_lower_the_cost(name, clipped):
    """Of leaves that were not split: every cut saves; leaves keep their triangles, and hold their boxes or clipped parts."""
    mesh = SCENES[name]()
    rules = {"split_clipping": clipped, "termination": "fixed", "leaf_triangles": 12, **CLASSIC}
    plain, config = build(mesh, "in_place", **rules)
    tree = described(mesh, "in_place", empty_space="late", **rules)
    flat, before = unpack(tree), unpack(plain)
    assert len(flat.axis) > len(before.axis)
    np.testing.assert_array_equal(leaf_references(tree)[1], leaf_references(plain)[1])
    np.testing.assert_array_equal(np.sort(flat.triangles[flat.triangles > 0]), np.sort(before.triangles[before.triangles > 0]))
    costs = [kdtree_statistics(found, mesh.triangle_count, config.cost).sah_cost for found in (tree, plain)]
    assert costs[0] < costs[1]
    volume = np.prod(flat.high - flat.low, axis=1)
    assert volume[flat.is_leaf].sum() == pytest.approx(volume[0])
    corners = mesh.vertices.astype(np.float32)[mesh.faces]
    listed = leaf_references(plain)
    for node in np.flatnonzero(before.is_leaf & (before.triangles > 0))[::20]:
        own = np.flatnonzero(flat.is_leaf & (flat.first_block == before.first_block[node]) & (flat.triangles > 0))
        (rest,) = own
        ids = listed[1][listed[0] == node]
        if not clipped:
            low = np.maximum(corners[ids].min(axis=(0, 1)), before.low[node])
            high = np.minimum(corners[ids].max(axis=(0, 1)), before.high[node])
            assert (flat.low[rest] <= low).all()
            assert (flat.high[rest] >= high).all()


def test_early_cuts_come_first():
    """A slab of a fifth of the box is cut off at the root, where the cheapest plane would divide the triangles."""
    rng = np.random.default_rng(2)
    corners = rng.random((400, 1, 3)) * [0.5, 1, 1] + 0.03 * rng.random((400, 3, 3))
    corners[:200, :, 2] += 4
    corners[0, :, 0] += 0.9
    mesh = wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(1200).reshape(-1, 3))
    for builder in ("sweep", "naive", "sorting_sweep", "adaptive_sampling", "spatial_median"):
        flat, plain = (unpack(described(mesh, builder, empty_space=way)) for way in ("early", "priced"))
        found = []
        for tree in (flat, plain):
            upper = tree.right[0]
            cut = np.array(
                [tree.is_leaf[child] and tree.triangles[child] == 0 for child in (tree.left[upper], tree.right[upper])]
            )
            found.append(bool(cut.any()) and tree.axis[0] == 2)
        assert found[0] or (flat.triangles[flat.is_leaf] == 0).sum() > (plain.triangles[plain.is_leaf] == 0).sum(), builder


def test_options_that_do_not_go_together():
    for options, message in (
        ({"cost_model": "none such"}, "cost_model 'none such' is unknown; choose from surface_area"),
        ({"cell_tests": "none such"}, "cell_tests is 'none such'; choose from none, leaves, nodes"),
        ({"empty_space": "none such"}, "empty_space is 'none such'; choose from priced, early, late, both"),
        (
            {"cost_model": "blocking"},
            "'in_place' does not support cost_model='blocking'; choose from binned, adaptive_sampling",
        ),
        ({"empty_space": "early"}, "'in_place' does not support empty_space='early'; choose from adaptive_sampling, sweep"),
        ({"builder": "binned", "resamplings": 2}, "'binned' does not support resamplings; choose from adaptive_sampling"),
        ({"builder": "adaptive_sampling", "resamplings": 5}, "resamplings is 5; it must be from 1 to 4"),
        ({"median_levels": 2}, "'in_place' does not support median_levels; choose from binned"),
        ({"builder": "binned", "median_levels": -1}, "median_levels is -1; it must be from 0 to 12"),
        ({"builder": "lazy", "cell_tests": "leaves"}, "'lazy' does not support cell_tests='leaves'"),
        ({"builder": "lazy", "empty_space": "late"}, "'lazy' does not support empty_space='late'"),
        ({"split_clipping": True, "cell_tests": "leaves"}, "leave cell_tests out, or clipping off"),
        ({"builder": "binned", "cost_model": "blocking", "mailbox": True}, "does not know mailboxes"),
    ):
        with pytest.raises(ValueError, match=message):
            wrt.KdTree(**options)
    with pytest.raises(ValueError, match="choose one of them"):
        SurfaceAreaCost(mailbox=True, occluder=1.0)
    boxes = replace(boxes_of(SCENES["grid"]()), vertices=None, faces=None)
    with pytest.raises(ValueError, match="areas need triangles"):
        wrt.KdTree(builder="binned", cost_model="blocking").build(boxes, 8)


def test_more_samples_approach_the_least_cost():
    """With every scan, the tree's cost comes nearer to that of the exact build; the root's plane costs no more than before."""
    mesh = SCENES["random_triangles"]()
    costs = []
    for scans in (1, 2, 3, 4):
        tree, config = build(mesh, "adaptive_sampling", resamplings=scans, **CLASSIC)
        costs.append(kdtree_statistics(tree, mesh.triangle_count, config.cost).sah_cost)
        assert set(leaf_references(tree)[1]) == set(range(mesh.triangle_count))
    exact = kdtree_statistics(build(mesh, "sweep", **CLASSIC)[0], mesh.triangle_count, config.cost).sah_cost
    gaps = np.abs(np.array(costs) / exact - 1.0)
    assert gaps[3] < 0.5 * gaps[0]
    assert gaps[1] < gaps[0]


@pytest.mark.parametrize("levels", [2, 5])
def test_the_first_levels_are_medians(levels, monkeypatch):
    """Nodes of these levels have children of nearly equal numbers; the tree does not depend on threads and chunks."""
    rng = np.random.default_rng(5)
    corners = rng.random((6000, 1, 3)) ** 3 + 0.01 * rng.random((6000, 3, 3))  # many in one corner
    mesh = wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(18000).reshape(-1, 3))
    with use_threads(1):
        reference, _ = build(mesh, "binned", median_levels=levels)
    monkeypatch.setattr(levels_engine, "CHUNK", 100)
    monkeypatch.setattr(binned, "MIN_LARGE", 500)
    with use_threads(3):
        tree, _ = build(mesh, "binned", median_levels=levels)
    np.testing.assert_array_equal(tree.nodes.numpy(), reference.nodes.numpy())
    np.testing.assert_array_equal(tree.primitive.numpy(), reference.primitive.numpy())
    flat, owner = unpack(tree), leaf_references(tree)[0]
    held = [np.ptp(np.searchsorted(owner, [node, subtree_end(flat, int(node))])) for node in range(len(flat.axis))]
    upper = np.flatnonzero((flat.depth < levels) & ~flat.is_leaf)
    shares = np.array([held[flat.left[node]] / held[node] for node in upper])
    assert len(upper) == 2**levels - 1
    assert (np.abs(shares - 0.5) < 0.15).all()
    plain = unpack(build(mesh, "binned")[0])
    assert plain.position[0] != flat.position[0]


@pytest.mark.parametrize("options", [{"cell_tests": "leaves"}, {"builder": "sweep", "empty_space": "both"}])
def test_moved_triangles_are_found(options):
    """A tree whose leaves were tested is built anew when its triangles move; one with cut slabs may keep its planes."""
    mesh = SCENES["random_triangles"]()
    scene = wrt.Scene(mesh, wrt.KdTree(**options), device="cpu")
    moved = wrt.TriangleMesh(mesh.vertices + 0.3 * np.sin(7 * mesh.vertices[:, [1, 2, 0]]), mesh.faces)
    scene.update(0, vertices=moved.vertices)
    origins, directions = rays_at(moved, 300)
    with use_threads(2):
        hits, brute = (scene.intersect(origins, directions, traversal=way) for way in ("single", "brute"))
    np.testing.assert_array_equal(hits.t, brute.t)
    np.testing.assert_array_equal(hits.primitive_id, brute.primitive_id)

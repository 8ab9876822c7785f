"""Vertices that move: the hits of a fresh tree whatever is done to the old one, what is done, and when."""

from __future__ import annotations

import threading

import numpy as np
import pytest
import trimesh
import warp as wp
from support.hits import assert_same_hits, mixed_rays
from support.meshes import degenerate_soup, snapped_soup

import wrt
from wrt.builders.bvh.update.bvh_grafting import merge_lanes
from wrt.builders.kdtree.kdtree_statistics import unpack
from wrt.builders.kdtree.update import refill as refilling
from wrt.builders.rebuild_heuristic import MAX_SUBTREES, degraded_subtrees
from wrt.builders.triangle_boxes import triangle_boxes
from wrt.kernels.layout.bvh_nodes import EMPTY_LANE

pytestmark = pytest.mark.width

KINDS = ("bvh", "kdtree")
BALL = wrt.TriangleMesh.from_trimesh(trimesh.creation.icosphere(3))


def assert_as_fresh(scene: wrt.Scene, count: int = 1200) -> None:
    """The scene answers, for rays of every kind, as one that was made of its meshes just now."""
    fresh = wrt.Scene(scene.meshes, scene.accelerator, device="cpu")
    origins, directions = mixed_rays(scene.flattened(), count)
    found = scene.intersect(origins, directions, traversal="single")
    assert found.is_hit.mean() > 0.2
    assert_same_hits(found, fresh.intersect(origins, directions, traversal="single"))
    np.testing.assert_array_equal(
        scene.count(origins, directions, traversal="single"), fresh.count(origins, directions, traversal="single")
    )


def motions(vertices: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    """Still, a little noise, turned, far away, flat, all in disorder, and back on the planes that once split it."""
    turn = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    noise = vertices + rng.normal(0, 0.01, vertices.shape)
    flat = vertices * [1.0, 1.0, 0.0]
    return [vertices, noise, vertices @ turn.T, 3.0 * vertices + [40.0, -7.0, 1e3], flat, rng.permutation(vertices), vertices]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("rebuild", ["auto", "never", "always"])
@pytest.mark.parametrize("make", [lambda: snapped_soup(300, 7), degenerate_soup, lambda: BALL], ids=["grid", "odd", "ball"])
def test_as_a_fresh_tree(kind, rebuild, make):
    """Equal planes, planar triangles, ties: the planes of a refilled kd-tree come to lie anywhere."""
    mesh, rng = make(), np.random.default_rng(1)
    scene = wrt.Scene([BALL, mesh], kind, device="cpu")
    for vertices in motions(mesh.vertices.astype(np.float64), rng):
        scene.update(1, vertices=vertices, rebuild=rebuild)
        assert_as_fresh(scene, 400)
        if rebuild != "auto":
            assert scene.last_update.action == {"never": "kept", "always": "built"}[rebuild]
        else:
            np.testing.assert_allclose(scene.last_update.cost, scene.statistics().tree.sah_cost, rtol=1e-5)


def cluster_scene(kind: str, width: int) -> tuple[wrt.Scene, np.ndarray]:
    """Balls that stand apart, the last of which is to move; and its vertices."""
    balls = [BALL.transformed(trimesh.transformations.translation_matrix([3.0 * k, 0, 0])) for k in range(24)]
    accelerator = {"bvh": wrt.Bvh, "kdtree": wrt.KdTree}[kind](width=width)
    return wrt.Scene(balls, accelerator, device="cpu"), balls[-1].vertices.astype(np.float64)


@pytest.mark.parametrize("width", [4, 8, 16])
@pytest.mark.parametrize("kind", KINDS)
def test_only_the_worn_subtree_is_built(kind, width):
    """With 8 triangles a block, eight overlapping cells of the one ball were built, 6,790 triangles in all, and all three balls
    of a node of the BVH. With 16 it was right by chance: there were more than `MAX_SUBTREES` cells.
    """
    scene, vertices = cluster_scene(kind, width)
    scene.update(23, vertices=vertices)
    assert scene.last_update.action == "kept"
    assert scene.last_update.rebuilt_triangles == 0
    disorder = np.random.default_rng(0).permutation(vertices)
    disorder = vertices[0] + 0.999 * (disorder - vertices[0])  # the box of the last ball stays within what it was
    scene.update(23, vertices=disorder, rebuild=wrt.moving.UpdatePolicy(tolerance=1.2))
    report = scene.last_update
    assert report.action == "subtrees"
    assert 256 <= report.rebuilt_triangles <= BALL.triangle_count + 20
    assert_as_fresh(scene)
    if kind == "kdtree":
        flat = unpack(scene.tree)
        inner = ~flat.is_leaf
        np.testing.assert_array_equal(flat.left[inner], np.flatnonzero(inner) + 1)
        assert np.unique(np.concatenate([[0], flat.left[inner], flat.right[inner]])).size == len(flat.axis)
    fresh = wrt.Scene(scene.meshes, scene.accelerator, device="cpu").statistics().tree.sah_cost
    assert report.cost <= 1.01 * fresh
    again = wrt.moving.UpdatePolicy(tolerance=1.2, subtrees=False)
    scene, _ = cluster_scene(kind, width)
    scene.update(23, vertices=disorder, rebuild=again)
    assert scene.last_update.action != "subtrees"


@pytest.mark.parametrize("kind", KINDS)
def test_a_worn_tree_is_built_once(kind):
    """What it costs then is the measure of what follows."""
    scene = wrt.Scene(BALL, kind, device="cpu")
    disorder = np.random.default_rng(0).permutation(BALL.vertices)
    scene.update(0, vertices=disorder)
    report = scene.last_update
    assert report.action == "built"
    assert report.cost < report.cost_kept > 1.3 * report.cost_built
    assert report.rebuilt_triangles == scene.triangle_count
    scene.update(0, vertices=1.001 * disorder)
    assert scene.last_update.action == "kept"
    assert scene.last_update.cost_built == report.cost
    scene.update(0, vertices=BALL.vertices, rebuild="never")
    assert np.isnan(scene.last_update.cost)


@pytest.mark.parametrize("kind", KINDS)
def test_small_changes_add_up(kind):
    """A tree that is kept is compared with itself as it was built, not as it was last."""
    scene, reports = wrt.Scene(BALL, kind, device="cpu"), []
    for squeezed, rebuild in (
        (0.9, wrt.moving.UpdatePolicy(tolerance=9.0)),
        (0.8, "never"),
        (0.7, wrt.moving.UpdatePolicy(tolerance=9.0)),
    ):
        scene.update(0, vertices=BALL.vertices * [1.0, 1.0, squeezed], rebuild=rebuild)
        reports.append(scene.last_update)
    assert [report.action for report in reports] == ["kept"] * 3
    assert reports[0].cost_built == reports[2].cost_built != reports[0].cost_kept


@pytest.mark.parametrize("kind", KINDS)
def test_moved_and_scaled_trees_cost_the_same(kind):
    """A kd-tree's planes move along with most of the vertices, but do nothing else; here nothing is rounded on the way."""
    vertices = np.round(BALL.vertices * 1024.0) / 1024.0
    scene = wrt.Scene(wrt.TriangleMesh(vertices, BALL.faces), kind, device="cpu")
    scene.update(0, vertices=(2.0 if kind == "bvh" else 1.0) * vertices + [5.0, 6.0, 7.0])
    report = scene.last_update
    assert report.action == "kept"
    np.testing.assert_allclose(report.cost_kept, report.cost_built, rtol=0.02)


def test_degraded_subtrees():
    """A tree of 31 nodes, both children met by two thirds of the rays; nodes of level n have cost 5 - n."""
    built = np.array([5.0 - int(np.log2(k)) for k in range(1, 32)])

    def children(node: int) -> tuple[np.ndarray, np.ndarray]:
        below = np.array([2 * node + 1, 2 * node + 2]) if node < 15 else np.empty(0, int)
        return below, np.full(len(below), 2 / 3)

    def chosen(costs: dict[int, float], tolerance: float = 1.3) -> list[int]:
        now = built.copy()
        now[list(costs)] = list(costs.values())
        return [node for (node,) in degraded_subtrees(now, built, children, tolerance)]

    assert chosen({}) == []
    assert chosen({0: 10.0}) == [0]  # by itself
    assert chosen({0: 8.0, 1: 9.0}) == [1]  # its child's fault
    assert chosen({0: 8.0, 1: 9.0}, tolerance=2.0) == [1]  # the root is good; its child is not
    assert chosen({0: 9.0, 1: 8.0, 2: 8.0, 6: 9.0}) == [1, 6]
    assert chosen({20: 2.0}) == [20]
    assert chosen(dict.fromkeys(range(15, 31), 2.0)) == list(range(15, 31))
    assert MAX_SUBTREES == 16


def test_worn_siblings_are_built_together():
    """A node of four children, three of which are one thing that has moved: by now a ray that meets one meets all three."""
    built = np.array([6.0, 4.0, 4.0, 4.0, 4.0])
    asked = []

    def chosen(estimate: float, costs: tuple[float, ...] = (30.0, 9.0, 9.0, 9.0, 4.0), tolerance: float = 1.3) -> list[tuple]:
        def children(node: int) -> tuple[np.ndarray, np.ndarray]:
            return (np.arange(1, 5), np.array([1.0, 1.0, 1.0, 0.25])) if node == 0 else (np.empty(0, int), np.empty(0))

        def joined_cost(node: int, siblings: np.ndarray, costs: np.ndarray) -> float:
            asked.append((node, siblings.tolist(), costs.tolist()))
            return estimate

        return degraded_subtrees(np.array(costs), built, children, tolerance, joined_cost=joined_cost)

    assert chosen(4.0) == [(1, 2, 3)]  # 30 - 27 + 4 is below 1.3 x 6
    assert chosen(5.0) == [(0,)]
    assert asked == [(0, [1, 2, 3], [4.0, 4.0, 4.0])] * 2
    assert chosen(0.0, costs=(20.0, 4.0, 4.0, 9.0, 4.0)) == [(0,)]  # one child alone is not asked for
    assert chosen(0.0, costs=(30.0, 9.0, 9.0, 9.0, 4.0), tolerance=2.6) == [(0,)]  # no child is worn: it is the node's fault
    assert len(asked) == 2


def test_parts_with_more_triangles_than_the_whole_are_not_built():
    """Cells of a kd-tree that share long triangles."""
    built, now = np.array([9.0, 4.0, 4.0]), np.array([20.0, 9.5, 9.5])

    def children(node: int) -> tuple[np.ndarray, np.ndarray]:
        return (np.array([1, 2]), np.ones(2)) if node == 0 else (np.empty(0, int), np.empty(0))

    lists = {0: np.arange(10), 1: np.arange(7), 2: np.arange(3, 10)}
    assert degraded_subtrees(now, built, children, 1.3) == [(1,), (2,)]
    assert degraded_subtrees(now, built, children, 1.3, triangles=lists.get) == [(0,)]
    lists[2] = np.arange(7, 10)
    assert degraded_subtrees(now, built, children, 1.3, triangles=lists.get) == [(1,), (2,)]


def test_lanes_of_siblings_become_one():
    """The first of them has the box of all; the others go, and unused lanes stay last."""
    child = np.array([[1, ~(5 << 6 | 3), 2, 3], [EMPTY_LANE] * 4, [EMPTY_LANE] * 4, [EMPTY_LANE] * 4])
    bounds = np.arange(96.0).reshape(4, 24)
    corners = bounds[0].reshape(2, 3, 4).copy()
    others = bounds[1:].copy()
    merge_lanes(child, bounds, (2, 3))
    np.testing.assert_array_equal(child[0], [1, ~(5 << 6 | 3), 2, EMPTY_LANE])
    united = bounds[0].reshape(2, 3, 4)
    np.testing.assert_array_equal(united[..., :2], corners[..., :2])
    np.testing.assert_array_equal(united[0, :, 2], corners[0, :, 2:].min(axis=1))
    np.testing.assert_array_equal(united[1, :, 2], corners[1, :, 2:].max(axis=1))
    np.testing.assert_array_equal(united[..., 3], [[np.inf] * 3, [-np.inf] * 3])
    np.testing.assert_array_equal(bounds[1:], others)
    merge_lanes(child, bounds, (1, 2))
    np.testing.assert_array_equal(child[0], [1, ~(5 << 6 | 3), EMPTY_LANE, EMPTY_LANE])


def test_refill_knows_when_to_stop():
    """Triangles that lie across every plane would make lists without end."""
    scene = wrt.Scene(BALL, "kdtree", device="cpu")
    host = wp.get_device("cpu")
    wide = wp.array(BALL.vertices[np.random.default_rng(0).permutation(BALL.vertex_count)].astype(np.float32), dtype=wp.vec3)
    boxes = triangle_boxes(wide.to(host), scene.state.device_mesh.faces)
    assert refilling.refill(scene.tree, boxes, np.zeros(3), scene.triangle_count) is None
    filled = refilling.refill(scene.tree, boxes, np.zeros(3), 1 << 30)
    sizes = unpack(filled).triangles
    assert sizes.sum() == (filled.primitive.numpy() >= 0).sum() > 10 * scene.triangle_count


def test_bad_input():
    scene = wrt.Scene(BALL, device="cpu")
    with pytest.raises(ValueError, match="rebuild 'often' is unknown; choose from auto, always, never"):
        scene.update(0, vertices=BALL.vertices, rebuild="often")
    with pytest.raises(TypeError, match=r"wrt\.moving\.UpdatePolicy, not bool"):
        scene.update(0, vertices=BALL.vertices, rebuild=True)
    with pytest.raises(ValueError, match=r"tolerance is 0\.5; it must be at least 1"):
        wrt.moving.UpdatePolicy(tolerance=0.5)
    assert scene.last_update is None


def test_instances_share_what_was_kept():
    scene = wrt.Scene([wrt.Instance(BALL), wrt.Instance(BALL, trimesh.transformations.translation_matrix([4, 0, 0]))])
    scene.update(0, vertices=1.5 * BALL.vertices, rebuild="always")
    assert scene.last_update.action == "built"
    scene.update(1, mask=3)
    assert scene.last_update is None


@pytest.mark.parametrize("make", [lambda: BALL, lambda: [wrt.Instance(BALL), BALL]], ids=["mesh", "instances"])
def test_building_while_tracing(make):
    """The block sees the old frame, on other threads than the builder's; afterwards it is the new one."""
    scene, rays = wrt.Scene(make(), device="cpu", num_threads=3), mixed_rays(BALL, 500)
    before, expected = scene.intersect(*rays, traversal="single"), wrt.Scene(make(), device="cpu")
    expected.update(0, vertices=2.0 * BALL.vertices)
    with scene.updating(0, vertices=2.0 * BALL.vertices, threads=2):
        assert scene.num_threads == 1
        for _ in range(5):
            assert_same_hits(scene.intersect(*rays, traversal="single"), before)
    assert scene.num_threads == 3
    assert_same_hits(scene.intersect(*rays, traversal="single"), expected.intersect(*rays, traversal="single"))
    assert scene.last_update.action == "kept"


@pytest.mark.parametrize("make", [lambda: BALL, lambda: [wrt.Instance(BALL), BALL]], ids=["mesh", "instances"])
def test_queries_during_updates(make):
    """A query under way sees the scene before an update or after it, and never a mixture."""
    scene, rays = wrt.Scene(make(), device="cpu"), mixed_rays(BALL, 400)
    few = [part[:9] for part in rays]
    frames, expected = (BALL.vertices, 1.5 * BALL.vertices), []
    for vertices in frames:
        scene.update(0, vertices=vertices)
        expected.append((scene.intersect(*rays, traversal="single").t, scene.occluded(*few)))
    assert (expected[0][0] != expected[1][0]).any()
    ended, answers = threading.Event(), []

    def query() -> None:
        while not ended.is_set():
            answers.append((scene.intersect(*rays, traversal="single").t, scene.occluded(*few)))

    threads = [threading.Thread(target=query) for _ in range(2)]
    for thread in threads:
        thread.start()
    for number in range(40):
        scene.update(0, vertices=frames[number % 2])
    ended.set()
    for thread in threads:
        thread.join()
    assert answers
    for t, dark in answers:
        assert any(np.array_equal(t, one) for one, _ in expected)
        assert any(np.array_equal(dark, one) for _, one in expected)


def test_a_failed_update_in_the_background_changes_nothing():
    scene, rays = wrt.Scene(BALL, device="cpu"), mixed_rays(BALL, 300)
    before, tree = scene.intersect(*rays, traversal="single"), scene.tree
    with pytest.raises(ValueError, match="5 points"), scene.updating(0, vertices=np.zeros((5, 3))):
        assert scene.tree is tree
    with pytest.raises(KeyError), scene.updating(0, vertices=2.0 * BALL.vertices):
        raise KeyError
    with pytest.raises(ValueError, match="threads is 0"), scene.updating(0, vertices=BALL.vertices, threads=0):
        pass
    assert scene.tree is tree
    assert scene.num_threads is None
    assert_same_hits(scene.intersect(*rays, traversal="single"), before)

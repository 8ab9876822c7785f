"""Lazy kd-trees that start from the meshes of a scene, or from the clusters of the previous frame: the hits of brute force,
and no sort of what is given."""

from __future__ import annotations

import numpy as np
import pytest
from support.built_kdtrees import boxes_of
from support.lazy_scenes import assert_brute, lazy_scene, random_rays

import wrt
from wrt import scenes
from wrt.builders.kdtree.kdtree_config import HIERARCHIES, MESHES, PREVIOUS
from wrt.builders.kdtree.lazy import given_clusters, lazy_kdtree

pytestmark = pytest.mark.width


@pytest.fixture(autouse=True)
def small_cells(monkeypatch):
    """Cells of some dozen triangles, divided again and again."""
    monkeypatch.setattr(lazy_kdtree, "LARGE", 60)


@pytest.fixture
def sorts(monkeypatch) -> list[int]:
    """The numbers of triangles that are sorted, sort after sort."""
    counts: list[int] = []
    sort = lazy_kdtree.sort_into_clusters

    def counted(boxes, ids, low, high):
        counts.append(len(ids))
        return sort(boxes, ids, low, high)

    monkeypatch.setattr(lazy_kdtree, "sort_into_clusters", counted)
    return counts


def several(count: int, apart: float, seed: int = 3) -> list[wrt.TriangleMesh]:
    """Meshes of random triangles, of different sizes, at random places."""
    rng = np.random.default_rng(seed)
    meshes = []
    for number in range(count):
        mesh = scenes.build("random_triangles", count=40 + 30 * number, size=0.1, seed=number)
        meshes.append(wrt.TriangleMesh(mesh.vertices + apart * rng.random(3), mesh.faces))
    return meshes


@pytest.mark.parametrize("hierarchy", HIERARCHIES)
@pytest.mark.parametrize("apart", [0.2, 6.0])
def test_hits(hierarchy, apart):
    """Meshes that overlap and meshes that do not; three frames, on one thread, on two and on one again."""
    meshes = several(8, apart)
    rays = random_rays(wrt.TriangleMesh.concatenate(meshes), 300, seed=1)
    scene = lazy_scene(meshes, hierarchy)
    for frame in range(3):
        assert scene.state.lazy_tree.current.unbuilt > 1
        assert_brute(scene, *rays)
        scene.update(5, vertices=scene.meshes[5].vertices + 0.1 * (frame + 1))


@pytest.mark.parametrize("hierarchy", HIERARCHIES)
def test_the_tree_is_that_of_any_number_of_threads(hierarchy):
    """The same nodes and lists on one thread and on three, in the first frame and in the next."""
    meshes, trees = several(8, 3.0), []
    for threads in (1, 3):
        scene = lazy_scene(meshes, hierarchy, num_threads=threads)
        scene.update(2, vertices=meshes[2].vertices * np.float32(1.01))
        scene.state.complete()
        trees.append(scene.tree)
    for name in ("nodes", "primitive"):
        np.testing.assert_array_equal(*(getattr(tree, name).numpy() for tree in trees))
    ids = trees[0].primitive.numpy()
    assert set(ids[ids >= 0]) == set(range(scene.triangle_count))


def test_meshes_are_not_sorted(sorts):
    """Meshes apart from each other: the top comes from their boxes, and only the mesh that a ray reaches is sorted."""
    meshes = several(8, 60.0)
    scene = lazy_scene(meshes, MESHES)
    assert sorts == []
    tree = scene.state.lazy_tree
    assert tree.current.unbuilt == len(meshes)
    last = meshes[-1]
    corner = last.vertices[last.faces[0]].mean(axis=0)
    hits = scene.intersect(corner[None] - [[1e-3, 2e-3, 3e-3]], [[1.0, 2.0, 3.0]])
    assert hits.is_hit.all()
    assert sum(sorts) > 0
    assert sorts[0] <= last.triangle_count
    ids = tree.current.tree.primitive.numpy()
    assert ids[ids >= 0].min() >= sum(mesh.triangle_count for mesh in meshes[:-1])


def test_meshes_that_overlap_are_sorted(sorts):
    """Eight meshes in one place: their boxes do not divide the scene, so its triangles are sorted as without them."""
    meshes = [wrt.TriangleMesh(m.vertices, m.faces) for m in several(8, 0.0)]
    scene = lazy_scene(meshes, MESHES)
    assert sorts[0] == scene.triangle_count
    lazy_scene(meshes[-1], MESHES)
    assert sorts[1] == meshes[-1].triangle_count  # one mesh


def test_boxes_of_meshes_contain_their_triangles():
    """Rounded like vertices: far from the origin, where float32 is coarse, no triangle is outside the box of its mesh."""
    far = [wrt.TriangleMesh(m.vertices.astype(np.float64) + 1e6 / 3, m.faces) for m in several(4, 3.0)]
    tree = lazy_scene(far, MESHES).state.lazy_tree
    clusters, boxes = tree.presort, tree.triangles.boxes
    assert clusters.are_meshes
    for number, (begin, end) in enumerate(zip(clusters.first, clusters.first[1:], strict=False)):
        own = clusters.order.numpy()[begin:end]
        assert (boxes.low.numpy()[:, own].min(axis=1) > clusters.low[number]).all()
        assert (boxes.high.numpy()[:, own].max(axis=1) < clusters.high[number]).all()


def test_the_previous_frame_is_not_sorted(sorts):
    """Small motion keeps the clusters, frame after frame; when triangles have changed places they are sorted once more."""
    mesh = scenes.build("random_triangles", count=3000, size=0.05, seed=4)
    scene, rng = lazy_scene(mesh, PREVIOUS), np.random.default_rng(2)
    assert sorts == [mesh.triangle_count]
    for _ in range(3):
        order = scene.state.lazy_tree.presort.order
        scene.update(0, vertices=scene.meshes[0].vertices + rng.normal(size=mesh.vertices.shape) * 1e-4)
        assert scene.state.lazy_tree.presort.order is order
        assert sorts == [mesh.triangle_count]
    assert_brute(scene, *random_rays(mesh, 200, seed=6))
    sorts.clear()
    scene.update(0, vertices=rng.permutation(scene.meshes[0].vertices.reshape(-1, 3, 3)).reshape(-1, 3))
    assert sorts[0] == mesh.triangle_count
    assert_brute(scene, *random_rays(mesh, 200, seed=6))


def test_clusters_at_rest_have_the_boxes_of_the_sort():
    """Nothing moves: the same boxes; cores lie within the cells of the grid, so they do not overlap."""
    mesh = scenes.build("random_triangles", count=3000, size=0.05, seed=4)
    tree = lazy_scene(mesh, PREVIOUS).state.lazy_tree
    old = tree.presort
    new = given_clusters.moved_clusters(old, tree.triangles)
    for name in ("low", "high"):
        np.testing.assert_array_equal(getattr(new, name), getattr(old, name))
    assert (new.core_low >= old.core_low).all()
    assert (new.core_high <= old.core_high).all()
    assert (new.core_low <= new.core_high).all()
    assert given_clusters.moved_clusters(old, boxes_of(scenes.build("random_triangles", count=10))) is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"builder": "lazy", "hierarchy": "graph"}, "hierarchy is 'graph'; choose from grid, meshes, previous"),
        ({"hierarchy": "meshes"}, "'in_place' does not support hierarchy='meshes'; choose from lazy"),
    ],
)
def test_bad_options(options, message):
    with pytest.raises(ValueError, match=message):
        wrt.KdTree(**options)

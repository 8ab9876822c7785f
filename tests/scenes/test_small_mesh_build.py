"""Scenes of few triangles: built by kept, packed kernels, and asked by prepared queries of scenes that are gone."""

from __future__ import annotations

import gc
import weakref
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import warp as wp

import wrt
from wrt.builders.bvh import small_mesh_build
from wrt.builders.triangle_boxes import triangle_boxes
from wrt.engine.free_list import FreeList
from wrt.engine.launch import prepared
from wrt.engine.launch.prepared import PreparedQuery
from wrt.kernels.runtime import workspace
from wrt.kernels.simd.lanes import native_width
from wrt.meshes.placement import MAX_EXTENT, place_meshes
from wrt.scene import mesh_state

CPU = wp.get_device("cpu")


@pytest.fixture(autouse=True)
def nothing_kept():
    """Nothing is kept before a test, nor after it."""
    workspace.release()
    yield
    workspace.release()


def soup(count: int, seed: int = 0, dtype: type = np.float32, scale: float = 1.0, shift: float = 0.0) -> wrt.TriangleMesh:
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1.0, 1.0, (count, 1, 3)) + 0.1 * rng.normal(size=(count, 3, 3))
    return wrt.TriangleMesh((shift + scale * corners.reshape(-1, 3)).astype(dtype), np.arange(3 * count).reshape(-1, 3))


def contents(tree, mesh) -> list[bytes]:
    arrays = tree.bounds, tree.child, tree.primitive, mesh.vertices, mesh.faces, mesh.geometry_first
    boxes = [np.array([*values], dtype=np.float64) for values in (tree.low, tree.high, mesh.low, mesh.high, mesh.center)]
    return [array.numpy().tobytes() for array in arrays] + [box.tobytes() for box in boxes] + [bytes(tree.level_first)]


def built_generally(meshes: tuple[wrt.TriangleMesh, ...]) -> list[bytes]:
    """The same from the builder that takes any number of triangles."""
    placed = place_meshes(meshes, CPU)
    boxes = triangle_boxes(placed.vertices, placed.faces, placed.center, placed.bounds)
    tree = wrt.Bvh().build(boxes, native_width(CPU))
    return contents(tree, placed.fill_in(tree.low, tree.high))


def is_built_as_few(monkeypatch, geometry) -> bool:
    """Whether a scene of the geometry is built as one of few triangles."""
    calls = []
    with monkeypatch.context() as patched:
        patched.setattr(mesh_state, "build_few_state", lambda *given: calls.append(given))
        wrt.Scene(geometry, device="cpu")
    return bool(calls)


def test_the_trees_are_those_of_the_general_builder():
    """Whatever was built before with the same work arrays: larger, smaller, in float64, or of equal triangles."""
    flat, one = np.zeros((300, 3), dtype=np.float32), soup(1)
    unused = wrt.TriangleMesh(np.concatenate([soup(50).vertices, [[1e30, 0.0, 0.0]]]), soup(50).faces)
    geometries = [
        *[soup(count, count) for count in (small_mesh_build.MAX_TRIANGLES, 1, 2, 17, 1025, 700, 3)],
        soup(500, 1, np.float64, 1e3, 1e6),
        soup(700, 2, np.float64, 1e-6),
        soup(300, 3, np.float32, 1e9),
        wrt.TriangleMesh(flat, np.arange(300).reshape(-1, 3)),
        wrt.TriangleMesh(one.vertices, np.repeat(one.faces, 900, axis=0)),
        [soup(100), soup(50, 4, np.float64), soup(7)],
        unused,
    ]
    for geometry in geometries:
        scene = wrt.Scene(geometry, device="cpu")
        assert contents(scene.tree, scene.state.device_mesh) == built_generally(scene.meshes), scene
        assert list(scene.tree.stats.seconds) == ["references", "top levels", "subtrees", "collapse"]
        assert scene.tree.stats.peak_bytes > scene.tree.bytes


def test_the_limits_of_small_meshes(monkeypatch):
    assert is_built_as_few(monkeypatch, soup(small_mesh_build.MAX_TRIANGLES))
    assert not is_built_as_few(monkeypatch, soup(small_mesh_build.MAX_TRIANGLES + 1))
    assert not is_built_as_few(monkeypatch, [soup(small_mesh_build.MAX_TRIANGLES), soup(1)])


def test_geometry_that_spreads_too_far_is_refused():
    with pytest.raises(ValueError, match="within which float32 can hold"):
        wrt.Scene(wrt.TriangleMesh([[0.0, 0, 0], [1, 0, 0], [0, 2 * MAX_EXTENT, 0]], [[0, 1, 2]]), device="cpu")
    with pytest.raises(ValueError, match="is beyond"):
        wrt.Scene(wrt.TriangleMesh([[0.0, 0, 0], [1, 0, 0], [0, 1e37, 0]], [[0, 1, 2]]), device="cpu")


def test_too_little_memory_is_reported(monkeypatch):
    def fail(*given):
        raise MemoryError("no more")

    monkeypatch.setattr(small_mesh_build, "build_small_mesh", fail)
    with pytest.raises(MemoryError, match="the tree of 7 triangles"):
        wrt.Scene(soup(7), device="cpu")


def test_threads_that_build_at_the_same_time():
    """Each has work arrays of its own."""
    meshes = [soup(100 + 37 * seed, seed) for seed in range(24)]

    def build(mesh: wrt.TriangleMesh) -> list[bytes]:
        scene = wrt.Scene(mesh, device="cpu")
        return contents(scene.tree, scene.state.device_mesh)

    with ThreadPoolExecutor(6) as pool:
        found = list(pool.map(build, meshes))
    assert found == [built_generally((mesh,)) for mesh in meshes]


def answers(scene: wrt.Scene, dtype: type) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangles that a few rays hit and where, and which rays meet any."""
    origins, directions = _rays(scene, dtype)
    hits = scene.intersect(origins, directions)
    return hits.primitive_id, hits.t, scene.occluded(origins, directions)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_prepared_query_serves_the_next_scene(dtype, monkeypatch):
    """A query that was prepared for a scene that is gone finds the triangles of the next one, elsewhere and more of them."""
    made, prepare = [], PreparedQuery.__init__
    monkeypatch.setattr(PreparedQuery, "__init__", lambda self, *given: (made.append(given[2:]), prepare(self, *given))[1])
    monkeypatch.setattr(prepared, "_retired", FreeList(prepared.MAX_FREE))
    for seed in range(4):
        mesh = soup(200 + 300 * seed, seed, dtype, 1.0 + seed, 10.0 * seed)
        scene = wrt.Scene(mesh, device="cpu")
        found = answers(scene, dtype)
        alone = wrt.Scene(mesh, device="cpu")  # with queries of its own: the other scene's are not free
        for own, expected in zip(found, answers(alone, dtype), strict=True):
            np.testing.assert_array_equal(own, expected)
        brute = alone.intersect(*_rays(alone, dtype), traversal="brute")
        np.testing.assert_array_equal(found[0], brute.primitive_id)
        del scene, alone, brute
    assert len([layout for _, layout in made if isinstance(layout, str)]) == 4  # of two kinds, for two scenes at a time


def _rays(scene: wrt.Scene, dtype: type) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(7)
    low, high = scene.bounds
    return rng.uniform(low, high, (20, 3)).astype(dtype), rng.normal(size=(20, 3)).astype(dtype)


def test_retired_queries_keep_no_scene_alive():
    for _ in range(2):  # the second scene gets the query of the first
        scene = wrt.Scene(soup(300), device="cpu")
        answers(scene, np.float32)
        watched = [weakref.ref(value) for value in (scene.tree, scene.tree.bounds, scene.state.device_mesh, scene.state)]
        del scene
        gc.collect()
        assert [value() for value in watched] == [None] * 4


def test_scenes_of_other_kinds_have_plans_of_their_own():
    """Plans of few rays are shared by scenes of a kind only."""
    scenes = [wrt.Scene(soup(200), accelerator, device="cpu") for accelerator in ("bvh", "kdtree", "bvh")]
    rays = _rays(scenes[0], np.float32)
    hits = [scene.intersect(*rays) for scene in scenes]
    assert [one.plan.accelerator for one in hits] == ["bvh", "kdtree", "bvh"]
    assert hits[0].plan is hits[2].plan
    for other in hits[1:]:
        np.testing.assert_array_equal(other.primitive_id, hits[0].primitive_id)


def test_a_query_in_a_cycle_of_garbage_does_not_come_back():
    """The collector gave its memory for rays to another query first; two threads then wrote to the same rays."""
    from wrt.engine.launch import prepared

    for _ in range(3):
        scene = wrt.Scene(wrt.scenes.build("teapot", level=1), device="cpu")
        scene.intersect([9.0, 9.0, 9.0], [-1.0, -1.0, -0.9])
        cycle = [scene]
        cycle.append(cycle)
        del scene, cycle
        gc.collect()
    retired = [query._staging for query in prepared._retired.items()]
    together = [*map(id, retired), *map(id, prepared._stagings.items())]
    assert len(set(together)) == len(together), "no memory is in two places"

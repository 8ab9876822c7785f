"""Trees with leaves of fans: the bits of brute force over the same fans; starts of closed meshes; files of fans."""

from __future__ import annotations

import numpy as np
import pytest
from support.hits import mixed_rays
from support.selection import slow

import wrt
from wrt.builders.triangle_fans import build_fans
from wrt.classics.fan_arrays import closest_by_fans
from wrt.classics.fan_files import load_fans, save_fans
from wrt.kernels.compilation import module_compiler
from wrt.kernels.traversal.fan_brute_force import FAN_FORMS, NORMALS, PLANES

MESHES = {
    "teapot": lambda: wrt.scenes.build("teapot", level=3),
    "random": lambda: wrt.scenes.build("random_triangles", count=300, size=0.4, seed=3),
    "far away": lambda: replace_vertices(wrt.scenes.build("teapot", level=2), [1e3, -50.0, 20.0]),
}

CASES = [("bvh", NORMALS), *slow(("bvh", PLANES), ("kdtree", NORMALS), ("bvh", "vertices"))]


def replace_vertices(mesh: wrt.TriangleMesh, shift: list[float]) -> wrt.TriangleMesh:
    return wrt.TriangleMesh(mesh.vertices + np.asarray(shift), mesh.faces)


@pytest.mark.parametrize(("tree", "form"), CASES)
def test_as_brute_force_over_fans(tree, form):
    """To the bit in t, triangle and weights; and nearly always what single triangles give."""
    for make in MESHES.values():
        mesh = make()
        scene = wrt.classics.FanScene(mesh, tree, form=form, device="cpu")
        origins, directions = mixed_rays(mesh, 800)
        hits = scene.intersect(origins, directions)
        t, primitive, uv = closest_by_fans(scene, scene.tree.fans, wrt.Rays(origins, directions), form)
        np.testing.assert_array_equal(hits.t, t)
        np.testing.assert_array_equal(hits.primitive_id, primitive)
        np.testing.assert_array_equal(hits.uv[hits.is_hit], uv[hits.is_hit])
        assert hits.is_hit.mean() > 0.1
        np.testing.assert_array_equal(scene.occluded(origins, directions), hits.is_hit)
        rng, (low, high) = np.random.default_rng(1), mesh.bounds
        begin = rng.uniform(low - (high - low), high + (high - low), (800, 3))
        rays = wrt.Rays(begin, rng.uniform(low, high, (800, 3)) - begin)
        alone = wrt.Scene(mesh, device="cpu").intersect(rays, triangle_test="moeller_trumbore")
        assert (alone.primitive_id == scene.intersect(rays).primitive_id).mean() > 0.99


def test_fewer_objects_than_triangles():
    """A leaf of fans lists a fourth as many objects; a form with more numbers takes more memory."""
    mesh = MESHES["teapot"]()
    scenes = {form: wrt.classics.FanScene(mesh, form=form, device="cpu") for form in FAN_FORMS}
    scene = scenes[NORMALS]
    assert len(scene.fans) < 0.3 * mesh.triangle_count
    ids = scene.tree.tree.primitive.numpy()
    assert sorted(ids[ids >= 0]) == list(range(len(scene.fans)))
    assert scenes["vertices"].bytes < scenes[NORMALS].bytes < scenes[PLANES].bytes
    work = scene.intersect(*mixed_rays(mesh, 300), counters=True).counters
    assert work["triangles"].sum() > work["leaves"].sum() > 0


BAD = {
    "form": (lambda mesh: wrt.classics.FanScene(mesh, form="strips"), ValueError, "vertices, vertices_normals, edges"),
    "lazy": (lambda mesh: wrt.classics.FanScene(mesh, wrt.KdTree(builder="lazy")), TypeError, "neither clips nor is lazy"),
    "count": (
        lambda mesh: wrt.classics.FanScene(mesh, device="cpu").count([[0, 0, 0]], [[0, 0, 1]]),
        ValueError,
        "any-hit queries",
    ),
    "test": (
        lambda mesh: wrt.classics.FanScene(mesh, device="cpu").intersect([[0, 0, 0]], [[0, 0, 1]], triangle_test="woop"),
        ValueError,
        "leave triangle_test out",
    ),
    "backfaces": (
        lambda mesh: wrt.classics.FanScene(mesh, device="cpu").intersect([[0, 0, 0]], [[0, 0, 1]], cull_backfaces=True),
        ValueError,
        "of both sides",
    ),
    "update": (lambda mesh: wrt.classics.FanScene(mesh, device="cpu").update(0, vertices=mesh.vertices), ValueError, "fixed"),
    "save": (lambda mesh: wrt.classics.FanScene(mesh, device="cpu").save("fans.npz"), ValueError, "cannot be saved"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input(case):
    call, error, message = BAD[case]
    with pytest.raises(error, match=message):
        call(wrt.scenes.build("teapot", level=2))


@pytest.mark.parametrize("query", ["contains", "visible", "count", "intersect_all"])
def test_queries_that_count_are_refused_at_once(query, monkeypatch):
    """`contains` compiled kernels for ten seconds, and refused then."""
    scene, points = wrt.classics.FanScene(wrt.scenes.build("teapot", level=2), device="cpu"), np.zeros((2, 3))
    monkeypatch.setattr(module_compiler, "load_modules", lambda *modules: pytest.fail("a kernel is compiled"))
    with pytest.raises(ValueError, match=rf"{query}.* use wrt\.Scene\(scene\.meshes\)"):
        getattr(scene, query)(*((points,) if query == "contains" else (points, points + 1)))


def test_start_of_a_closed_mesh():
    """The first fan is that of the given vertex, and all triangles are in fans, those of other parts too."""
    mesh = wrt.scenes.build("teapot", level=2)
    _, same = np.unique(mesh.vertices, axis=0, return_inverse=True)
    ball = np.array([(a, b, c) for a in (0, 1) for b in (2, 3) for c in (4, 5)])
    two = np.concatenate([ball, ball + 6])
    for faces in (same.ravel()[mesh.faces], two):
        for start in (int(faces[0, 0]), int(faces[-1, 2])):
            fans = build_fans(faces, start=start)
            proper = np.isin(fans.primitive[: fans.sizes[0]], np.flatnonzero((faces == fans.centre[0]).any(axis=1)))
            assert proper.all()
            assert start in fans.centre[:4]
            np.testing.assert_array_equal(np.sort(fans.primitive), np.arange(len(faces)))
            assert len(fans) < 1.3 * len(build_fans(faces))
    with pytest.raises(ValueError, match="start is 99"):
        build_fans(ball, start=99)


def test_files_of_fans(tmp_path):
    """The same triangles, M + 2 vertices each in place of 3 M."""
    mesh = MESHES["teapot"]()
    scene = wrt.classics.FanScene(mesh, device="cpu")
    positions = np.unique(scene.state.device_mesh.vertices.numpy(), axis=0)
    save_fans(tmp_path / "fans.npz", scene.fans, positions)
    loaded = load_fans(tmp_path / "fans.npz")
    assert loaded.vertex_count == mesh.triangle_count + 2 * len(scene.fans)
    corners = np.sort(scene.state.device_mesh.vertices.numpy()[scene.state.device_mesh.faces.numpy()].reshape(-1, 9), axis=1)
    found = np.sort(loaded.vertices[loaded.faces].reshape(-1, 9), axis=1)
    np.testing.assert_array_equal(found, corners[scene.fans.primitive])
    np.savez(tmp_path / "other.npz", vertices=np.eye(3))
    with pytest.raises(ValueError, match="does not hold fans"):
        load_fans(tmp_path / "other.npz")
    np.savez(tmp_path / "damaged.npz", vertices=np.eye(3), rims=np.array([5]))
    with pytest.raises(ValueError, match="damaged"):
        load_fans(tmp_path / "damaged.npz")

"""Few rays in NumPy arrays, staged by prepared queries: what many rays would get, to the bit, in memory of the caller's own."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.hits import assert_same_hits, mixed_rays

import wrt
from wrt.engine.executor import may_stage
from wrt.engine.facts.facts import RayFacts
from wrt.engine.facts.query_kinds import CLOSEST, FEW_RAYS, MANY_TRIANGLES, Query
from wrt.engine.plan.planner import choose_plan

pytestmark = pytest.mark.width

ATTRIBUTES = ("t", "uv", "primitive_id", "geometry_id", "is_hit", "position", "normal")


@pytest.fixture(scope="module", params=["bvh", "kdtree"])
def scene(request) -> wrt.Scene:
    """Two meshes, far from the origin."""
    teapot = wrt.scenes.build("teapot", level=3)
    far = teapot.vertices + np.array([3e4, -1e4, 2e4])
    meshes = [wrt.TriangleMesh(far, teapot.faces), wrt.TriangleMesh(far + 0.4, teapot.faces)]
    return wrt.Scene(meshes, request.param, device="cpu")


def was_staged(hits: wrt.Hits) -> bool:
    """Whether hits are in NumPy arrays, as prepared queries leave those of staged rays."""
    return any(type(values) is np.ndarray for values in hits.batch._host.values())


def assert_as_many(scene: wrt.Scene, *rays) -> None:
    """The same as by the way of many rays, which a traversal by name takes."""
    few, many = scene.intersect(*rays), scene.intersect(*rays, traversal="single")
    assert was_staged(few)
    assert not was_staged(many)
    assert few.shape == many.shape
    assert few.plan.traversal == "single"
    assert_same_hits(few, many)
    for name in ATTRIBUTES:
        one, other = getattr(few, name), getattr(many, name)
        assert (one.shape, one.dtype, type(one)) == (other.shape, other.dtype, type(other))
        np.testing.assert_array_equal(one, other, err_msg=name)
    for query in (scene.occluded, scene.count):
        one, other = query(*rays), query(*rays, traversal="single")
        assert (one.shape, one.dtype, type(one)) == (other.shape, other.dtype, type(other))
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.int32])
@pytest.mark.parametrize("count", [1, 7, FEW_RAYS])
def test_as_many_rays(scene, dtype, count):
    mesh = wrt.TriangleMesh.concatenate(scene.meshes)
    origins, directions = mixed_rays(mesh, count)
    with np.errstate(all="ignore"):
        assert_as_many(scene, origins.astype(dtype), directions)
        assert_as_many(scene, origins.astype(np.float64), directions.astype(dtype), 0.01, 3.0)


def test_shapes_and_ranges(scene):
    origins, directions = (a.reshape(4, 5, 3) for a in mixed_rays(scene.meshes[0], 20, seed=1))
    bounds = np.linspace(0.2, 9.0, 5)
    for rays in (
        (origins[0, 0], directions[0, 0]),
        (origins[0, 0].tolist(), directions[1].tolist(), 0, 5),
        (origins[:, :1], directions[0], 0.0, bounds),
        (origins[0, 0], directions[::2, ::-1], bounds / 9, np.float32(4.0)),
        (tuple(scene.center), directions),
        (wrt.Rays(origins, [1.0, 0, 0], bounds, np.inf),),
        (origins, directions, 0.0, 1e300),
        (np.full(3, 1e300), directions.astype(np.float64) * 1e-60),
    ):
        assert_as_many(scene, *rays)


def test_shapes_in_turns(scene):
    """One prepared query serves rays of other shapes, types and numbers, and its answers of one do not show in another's."""
    origins, directions = mixed_rays(scene.meshes[0], 24, seed=7)
    expected = scene.intersect(origins, directions, traversal="single").t
    for _ in range(2):
        for dtype in (np.float32, np.float64, np.dtype(np.float32, metadata={"unit": "m"})):
            for shape in ((24,), (4, 6), (1, 24), (3, 1, 8)):
                t = scene.intersect(origins.astype(dtype).reshape(*shape, 3), directions.reshape(*shape, 3)).t
                np.testing.assert_array_equal(t, expected.reshape(shape))
            for count in (1, 5, 2):
                part = slice(3, 3 + count)
                np.testing.assert_array_equal(scene.intersect(origins[part].astype(dtype), directions[part]).t, expected[part])
                np.testing.assert_array_equal(scene.occluded(origins[part], directions[part]), np.isfinite(expected[part]))


@pytest.mark.filterwarnings("error")
def test_numbers_beyond_float32(scene):
    """They miss, or bound nothing, and NumPy's warnings about them do not reach the caller."""
    origins, directions = (a.astype(np.float32) for a in mixed_rays(scene.meshes[0], 4, seed=8))
    expected = scene.intersect(origins, directions).t
    for bound in (1e300, 3.4028235e38, 3.41e38, np.inf, np.float64(1e300), 10**40):
        np.testing.assert_array_equal(scene.intersect(origins, directions, 0.0, bound).t, expected)
    assert np.isinf(scene.intersect(origins, directions, 1e300).t).all()
    assert np.isinf(scene.intersect(np.full((4, 3), np.finfo(np.float32).max), directions).t).all()
    for far in (1e300, np.inf, np.nan):
        assert np.isinf(scene.intersect(np.full((4, 3), far), directions).t).all()
        assert np.isinf(scene.intersect(origins, np.full((4, 3), far)).t).all()


def test_only_few(scene):
    """Many rays, Warp's and a way that is asked for go as ever; none at all too."""
    origins, directions = mixed_rays(scene.meshes[0], FEW_RAYS + 1)
    assert was_staged(scene.intersect(origins[1:], directions[1:]))
    assert not was_staged(scene.intersect(origins, directions))
    assert may_stage(scene.state, Query(CLOSEST))
    assert not may_stage(scene.state, Query(CLOSEST, "single"))
    assert scene.explain(origins[1:], directions[1:]).traversal == "single" != scene.explain(origins, directions).traversal
    on_device = [wp.array(a[:5], dtype=wp.vec3, device="cpu") for a in (origins, directions)]
    assert isinstance(scene.intersect(*on_device).t, wp.array)
    assert not was_staged(scene.intersect(origins[:5], directions[:5], precise=True))
    assert scene.intersect(origins[:0], directions[:0]).t.shape == (0,)


def test_answers_are_the_callers_own(scene):
    origins, directions = mixed_rays(scene.meshes[0], 50, seed=3)
    first = scene.intersect(origins, directions)
    dark, before = scene.occluded(origins, directions), first.t.copy()
    scene.intersect(origins[::-1] + 1, directions)
    scene.occluded(origins[::-1], -directions)
    np.testing.assert_array_equal(first.t, before)
    np.testing.assert_array_equal(dark, np.isfinite(before))
    np.testing.assert_array_equal(first.position, scene.intersect(origins, directions, traversal="brute").position)
    np.testing.assert_array_equal(
        first.spawn(directions), scene.intersect(origins, directions, traversal="brute").spawn(directions)
    )
    with pytest.raises(ValueError, match="counters=True"):
        _ = first.counters


def test_nothing_stale():
    """What was kept ready for a tree is not used for another."""
    mesh = wrt.scenes.build("teapot", level=3)
    scene, moved = (wrt.Scene(wrt.TriangleMesh(mesh.vertices * scale, mesh.faces), device="cpu") for scale in (1.0, 0.5))
    origins, directions = mixed_rays(mesh, 50)
    scene.intersect(origins, directions)
    scene.state = moved.state
    assert_same_hits(scene.intersect(origins, directions), moved.intersect(origins, directions))


@pytest.mark.parametrize("name", ["komatsu", "woop"])
def test_a_triangle_test_of_the_scene(name):
    mesh = wrt.scenes.build("teapot", level=3)
    scene = wrt.Scene(mesh, triangle_test=name, device="cpu")
    _, directions = mixed_rays(mesh, 60)
    assert scene.intersect([4.0, 3, 2], directions).plan.triangle_test == name


def test_refused(scene):
    for rays, message in (
        (([0, 0, 0], [1, 0]), "directions must have shape"),
        (([0, 0, 0], [1, 0, 0], -1.0), "t_min must not be negative"),
        (([0, 0, 0], [1, 0, 0], np.inf), "t_min is infinite"),
        (([0, 0, 0], [1, 0, 0], 0.0, np.nan), "t_max must not be negative or NaN"),
        ((np.zeros((3, 3)), np.ones((4, 3))), "do not broadcast"),
    ):
        for query in (scene.intersect, scene.occluded, scene.count):
            with pytest.raises(ValueError, match=message):
                query(*rays)
    with pytest.raises(TypeError, match="real numbers"):
        scene.intersect(["a", "b", "c"], [1, 0, 0])


def test_rays_after_an_update():
    """Prepared queries belong to a state: an update leaves them behind."""
    mesh = wrt.scenes.build("teapot", level=2, ground=False)
    scene = wrt.Scene(mesh, device="cpu")
    down = ((0.2, 0.1, 9.0), (0.0, 0.0, -1.0))
    before = scene.intersect(*down).t
    assert scene.occluded(*down)
    scene.update(0, vertices=np.add(mesh.vertices, (0.0, 0.0, 1.0)))
    assert scene.intersect(*down).t == pytest.approx(before - 1.0, abs=1e-4)
    scene.update(0, vertices=np.add(mesh.vertices, (50.0, 0.0, 0.0)))
    assert not scene.occluded(*down)
    assert scene.count(*down) == 0


@pytest.mark.parametrize("origin", [(3e4, -1e4, 2e4 - 5.0), (3e4 + 1e-5, -1e4, 2e4 - 5.0), (1e300, 0, 0), (np.nan, 0, 0)])
def test_a_shared_float64_origin(scene, origin):
    """Subtracting the scene's centre from one origin on the host gives the bits that the kernel gives for many."""
    _, directions = mixed_rays(wrt.TriangleMesh.concatenate(scene.meshes), 3000)
    shared, spread = np.array(origin), np.tile(origin, (len(directions), 1))
    spread[-1] += 1.0  # not to be detected as shared
    one, many = scene.intersect(shared, directions), scene.intersect(spread, directions)
    for name in ("t", "uv", "primitive_id", "geometry_id"):
        np.testing.assert_array_equal(getattr(one, name)[:-1], getattr(many, name)[:-1], err_msg=name)
    assert one.is_hit[:-1].any() == (abs(origin[0]) < 1e5)


def test_rays_that_take_long_are_few_only_up_to_512():
    """850 rays of a dragon of 810,080 triangles took 1.7 times as long one by one as in the best other way."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(161.0), np.arange(161.0), indexing="ij"))
    corner = (np.arange(160)[:, None] * 161 + np.arange(160)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 161, corner + 1], 1), np.stack([corner + 1, corner + 161, corner + 162], 1)]
    )
    vertices = np.stack([x, y, np.sin(x)], axis=1)

    def chosen(count, faces, accelerator="bvh"):
        state = wrt.Scene(wrt.TriangleMesh(vertices, faces), accelerator, device="cpu").state
        return choose_plan(state, RayFacts(count, (count,), coherent=False), Query(CLOSEST)).traversal

    assert len(faces) >= MANY_TRIANGLES
    assert chosen(512, faces) == "single" != chosen(513, faces)
    assert chosen(1024, faces[::2]) == "single" != chosen(1025, faces[::2])
    assert chosen(1024, faces, "kdtree") == "single"

"""The public surface: what goes in, what comes out, what is refused and how."""

from __future__ import annotations

import threading

import numpy as np
import pytest
import trimesh
import warp as wp
from support.hits import assert_same_hits, mixed_rays

import wrt


@pytest.fixture(scope="module")
def teapot() -> wrt.TriangleMesh:
    return wrt.scenes.build("teapot", level=4)


@pytest.fixture(scope="module")
def scene(teapot) -> wrt.Scene:
    return wrt.Scene(teapot, device="cpu")


@pytest.fixture(scope="module")
def cube() -> wrt.Scene:
    """The unit cube around the origin."""
    return wrt.Scene(trimesh.creation.box(), device="cpu")


def test_known_hit(cube):
    """Everything about one hit, worked out by hand: the ray meets the face x = -0.5 at (-0.5, 0.1, 0.2)."""
    hits = cube.intersect([-2.5, 0.1, 0.2], [2.0, 0.0, 0.0])
    assert hits.shape == ()
    assert hits.t == pytest.approx(1.0)
    assert bool(hits.is_hit)
    np.testing.assert_allclose(hits.position, [-0.5, 0.1, 0.2], atol=1e-6)
    np.testing.assert_allclose(hits.normal, [-1, 0, 0], atol=1e-6)
    assert int(hits.geometry_id) == 0
    a, b, c = cube.meshes[0].vertices[cube.meshes[0].faces[int(hits.primitive_id)]]
    u, v = hits.uv
    np.testing.assert_allclose((1 - u - v) * a + u * b + v * c, [-0.5, 0.1, 0.2], atol=1e-6)
    assert (cube.intersect([-2.5, 0.1, 0.2], [-2.0, 0.0, 0.0]).primitive_id) == -1


def test_miss_values(cube):
    hits = cube.intersect([[5.0, 5, 5]], [[1.0, 0, 0]])
    assert np.isinf(hits.t).all()
    assert hits.primitive_id.tolist() == [-1]
    assert hits.geometry_id.tolist() == [-1]
    assert (hits.uv == 0).all()
    assert (hits.normal == 0).all()
    assert np.isnan(hits.position).all()


@pytest.mark.parametrize("shape", [(), (1,), (7,), (2, 3), (4, 1, 5), (0,), (3, 0)])
def test_leading_shapes(scene, shape):
    origins = np.random.default_rng(0).normal(size=(*shape, 3)).astype(np.float32)
    hits = scene.intersect(origins, -origins)
    assert hits.t.shape == hits.primitive_id.shape == hits.geometry_id.shape == hits.is_hit.shape == shape
    assert hits.uv.shape == (*shape, 2)
    assert hits.position.shape == hits.normal.shape == (*shape, 3)
    assert scene.occluded(origins, -origins).shape == shape
    assert hits.t.dtype == np.float32
    assert hits.primitive_id.dtype == hits.geometry_id.dtype == np.int32
    assert hits.is_hit.dtype == scene.occluded(origins, -origins).dtype == bool


def test_broadcasting(scene):
    """A shared origin, a shared direction, and ranges broadcast as NumPy does."""
    origins, directions = mixed_rays(scene.meshes[0], 12)
    origins, directions = np.nan_to_num(origins[:3]), np.nan_to_num(directions[:4])
    grid = scene.intersect(origins[:, None], directions[None], t_min=np.zeros((3, 1)), t_max=np.full(4, 9.0))
    assert grid.shape == (3, 4)
    each = scene.intersect(np.repeat(origins, 4, axis=0), np.tile(directions, (3, 1)), 0.0, 9.0)
    np.testing.assert_array_equal(grid.t.ravel(), each.t)
    one = scene.intersect(origins[0], directions)
    np.testing.assert_array_equal(one.t, scene.intersect(np.broadcast_to(origins[0], (4, 3)), directions).t)
    three = [scene.intersect(origin, directions[0]).t for origin in origins]
    np.testing.assert_array_equal(scene.intersect(origins, directions[0]).t, three)


def test_dtypes(scene):
    """float64, float16, integers and lists are taken; positions and normals follow the rays' type."""
    origins, directions = [0.0, -20.0, 1.0], [0.0, 1.0, 0.0]
    expected = scene.intersect(np.array(origins, np.float32), np.array(directions, np.float32))
    assert expected.is_hit
    assert expected.position.dtype == np.float32
    for dtype in (np.float64, np.float16, np.int32, np.int64):
        assert scene.intersect(np.array(origins).astype(dtype), np.array(directions).astype(dtype)).t == expected.t
    double = scene.intersect(np.array(origins), np.array(directions))
    assert double.position.dtype == double.normal.dtype == np.float64
    assert scene.intersect(origins, directions).t == expected.t


def test_no_needless_copy(scene):
    """Contiguous float32 arrays are read where they are."""
    from wrt.engine.rays.device_rays import to_device

    origins, directions = (np.ascontiguousarray(a) for a in mixed_rays(scene.meshes[0], 50))
    buffers = to_device(wrt.Rays(origins, directions), scene.device, scene.center)
    assert buffers.batch.origins.ptr == origins.ctypes.data
    assert buffers.batch.directions.ptr == directions.ctypes.data
    shared = to_device(wrt.Rays(np.broadcast_to(origins[0], (50, 3)), directions), scene.device, scene.center)
    assert shared.batch.origin_stride == 0
    assert len(shared.batch.origins) == 1


def test_strided_and_read_only_arrays(scene):
    origins, directions = mixed_rays(scene.meshes[0], 100)
    expected = scene.intersect(origins, directions)
    wide = np.concatenate([origins, directions], axis=1)
    assert_same_hits(scene.intersect(wide[:, :3], wide[:, 3:]), expected)
    assert_same_hits(scene.intersect(np.asfortranarray(origins), np.asfortranarray(directions)), expected)
    origins.flags.writeable = False
    assert_same_hits(scene.intersect(origins, directions), expected)


def test_far_from_the_origin(teapot):
    """Geometry ten million units away: float64 rays lose nothing, because both are taken relative to its centre."""
    offset = np.array([1e7, -2e7, 3e7])
    rng = np.random.default_rng(1)
    origins, targets = rng.uniform(*teapot.bounds, (2, 4000, 3))
    near = wrt.Scene(teapot, device="cpu").intersect(origins, targets - origins)
    moved = wrt.TriangleMesh(teapot.vertices.astype(np.float64) + offset, teapot.faces)
    far = wrt.Scene(moved, device="cpu").intersect(origins + offset, targets - origins)
    assert (near.primitive_id == far.primitive_id).mean() > 0.999
    both = near.is_hit & (near.primitive_id == far.primitive_id)
    np.testing.assert_allclose(far.t[both], near.t[both], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(far.position[both] - offset, near.position[both], atol=1e-4)


def test_warp_arrays(scene, teapot, device):
    """Warp arrays in, Warp arrays out on the same device."""
    scene = wrt.Scene(teapot, device=device)
    origins, directions = mixed_rays(teapot, 200)
    expected = scene.intersect(origins, directions)
    for dtype in (wp.vec3f, wp.float32):
        o, d = (wp.array(a, dtype=dtype, device=device) for a in (origins, directions))
        hits = scene.intersect(o, d)
        for name in ("t", "primitive_id", "geometry_id", "uv", "is_hit", "normal", "position"):
            value = getattr(hits, name)
            assert isinstance(value, wp.array)
            assert str(value.device) == device
            np.testing.assert_array_equal(value.numpy(), getattr(expected, name), err_msg=name)
        dark = scene.occluded(o, d)
        assert isinstance(dark, wp.array)
        np.testing.assert_array_equal(dark.numpy(), expected.is_hit)
    double = scene.intersect(
        wp.array(origins, dtype=wp.vec3d, device=device), wp.array(directions, dtype=wp.vec3d, device=device)
    )
    assert double.position.dtype is wp.vec3d
    shaped = scene.intersect(o.reshape((10, 20, 3)), d.reshape((10, 20, 3)))
    assert shaped.t.shape == (10, 20)
    bounded = scene.intersect(o, d, t_max=wp.full(200, 0.5, dtype=float, device=device))
    np.testing.assert_array_equal(bounded.t.numpy(), scene.intersect(origins, directions, t_max=0.5).t)


class Exported:
    """An array that only speaks DLPack."""

    def __init__(self, array: np.ndarray) -> None:
        self.array = array

    def __dlpack__(self, **options):
        return self.array.__dlpack__()

    def __dlpack_device__(self):
        return self.array.__dlpack_device__()


def test_dlpack(scene):
    origins, directions = mixed_rays(scene.meshes[0], 30)
    hits = scene.intersect(Exported(origins), Exported(directions))
    assert isinstance(hits.t, wp.array)
    np.testing.assert_array_equal(hits.t.numpy(), scene.intersect(origins, directions).t)


def test_rays_object(scene):
    origins, directions = mixed_rays(scene.meshes[0], 24)
    rays = wrt.Rays(origins.reshape(4, 6, 3), directions.reshape(4, 6, 3), t_min=0.25, t_max=2.0)
    assert rays.shape == (4, 6)
    assert len(rays) == 24
    hits = scene.intersect(rays)
    assert hits.shape == (4, 6)
    np.testing.assert_array_equal(hits.t.ravel(), scene.intersect(origins, directions, 0.25, 2.0).t)
    with pytest.raises(TypeError, match="not both"):
        scene.intersect(rays, directions)


def test_many_meshes():
    """Ids are of the geometry and within it; ties go to the earlier geometry; positions are in common coordinates."""
    first = wrt.TriangleMesh.from_trimesh(trimesh.creation.box())
    second = first.transformed(trimesh.transformations.translation_matrix([3, 0, 0]))
    scene = wrt.Scene([first, second, first], device="cpu")
    hits = scene.intersect([[0, 0, 5.0], [3, 0, 5.0], [9, 0, 5.0]], [0, 0, -1.0])
    assert hits.geometry_id.tolist() == [0, 1, -1]
    assert (hits.primitive_id[:2] < 12).all()
    assert hits.primitive_id[2] == -1
    normals = [mesh.face_normals[hits.primitive_id[i]] for i, mesh in enumerate((first, second))]
    np.testing.assert_allclose(normals, [[0, 0, 1]] * 2)
    np.testing.assert_allclose(scene.bounds, [[-0.5, -0.5, -0.5], [3.5, 0.5, 0.5]])


def test_trimesh_objects():
    box = trimesh.creation.box()
    graph = trimesh.Scene()
    graph.add_geometry(box, transform=trimesh.transformations.translation_matrix([0, 0, 10]))
    for geometry, height in ((box, 0.5), (graph, 10.5)):
        hits = wrt.Scene(geometry, device="cpu").intersect([0.1, 0.2, 20.0], [0, 0, -1.0])
        assert 20 - hits.t == pytest.approx(height, abs=1e-5)


def test_used_from_many_threads(scene):
    """Queries and builds at the same time from several threads, each with its own number of threads."""
    origins, directions = mixed_rays(scene.meshes[0], 5000)
    expected = scene.intersect(origins, directions)
    problems = []

    def work(number: int) -> None:
        try:
            own = wrt.Scene(scene.meshes[0], device="cpu", num_threads=1 + number % 3)
            for _ in range(5):
                assert_same_hits(own.intersect(origins, directions), expected)
                np.testing.assert_array_equal(scene.occluded(origins, directions), expected.is_hit)
        except BaseException as problem:
            problems.append(problem)

    threads = [threading.Thread(target=work, args=(number,)) for number in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not problems


@pytest.mark.parametrize("accelerator", ["bvh", "kdtree"])
def test_repr_and_statistics(teapot, accelerator):
    scene = wrt.Scene(teapot, accelerator, device="cpu")
    assert "triangles" in repr(scene)
    assert "Hits" in repr(scene.intersect([0, 0, 9.0], [0, 0, -1.0]))
    statistics = scene.statistics()
    assert statistics.triangles == teapot.triangle_count
    values = statistics.to_dict()
    assert values["tree"]["leaves"] == sum(values["leaves by depth"]) == sum(values["leaves by triangles"])
    references = sum(n * count for n, count in enumerate(values["leaves by triangles"]))
    assert values["tree"].get("references", teapot.triangle_count) == references
    assert values["build"]["seconds"]["total"] > 0
    assert values["build"]["peak bytes"] > statistics.tree_bytes
    if accelerator == "kdtree":
        assert values["tree"]["nodes"] == 2 * values["tree"]["leaves"] - 1
    else:
        assert 0 < values["tree"]["nodes"] < values["tree"]["leaves"]


ORIGIN, DIRECTION = [0.0, 0.0, 9.0], [0.0, 0.0, -1.0]
BAD_QUERIES = {
    "no directions": (lambda s: s.intersect(ORIGIN), TypeError, "directions is missing"),
    "two components": (lambda s: s.intersect([[0.0, 1.0]], DIRECTION), ValueError, r"origins must have shape \(\.\.\., 3\)"),
    "scalar": (lambda s: s.intersect(ORIGIN, 1.0), ValueError, "directions must have shape"),
    "strings": (lambda s: s.intersect([["a", "b", "c"]], DIRECTION), TypeError, "origins must hold real numbers"),
    "complex": (lambda s: s.intersect(np.zeros(3, complex), DIRECTION), TypeError, "origins must hold real numbers"),
    "bool": (lambda s: s.intersect(np.zeros(3, bool), DIRECTION), TypeError, "convert it to float32"),
    "ragged": (lambda s: s.intersect([[0.0, 1.0, 2.0], [1.0]], DIRECTION), TypeError, "origins is not an array"),
    "shapes": (lambda s: s.intersect(np.zeros((4, 3)), np.ones((5, 3))), ValueError, "do not broadcast"),
    "negative t_min": (lambda s: s.intersect(ORIGIN, DIRECTION, t_min=-1.0), ValueError, "t_min must not be negative"),
    "NaN t_min": (lambda s: s.intersect(ORIGIN, DIRECTION, t_min=np.nan), ValueError, "t_min must not be negative or NaN"),
    "infinite t_min": (lambda s: s.intersect(ORIGIN, DIRECTION, t_min=np.inf), ValueError, "t_min is infinite"),
    "negative t_max": (lambda s: s.occluded(ORIGIN, DIRECTION, t_max=-1.0), ValueError, "t_max must not be negative"),
    "NaN t_max": (lambda s: s.occluded(ORIGIN, DIRECTION, t_max=[np.nan]), ValueError, "t_max must not be negative or NaN"),
    "traversal": (lambda s: s.intersect(ORIGIN, DIRECTION, traversal="x"), ValueError, "choose from brute, single"),
    "triangle test": (lambda s: s.intersect(ORIGIN, DIRECTION, triangle_test="x"), ValueError, "choose from woop"),
    "name type": (lambda s: s.occluded(ORIGIN, DIRECTION, traversal=3), TypeError, "traversal must be a name"),
    "list of names": (lambda s: s.count(ORIGIN, DIRECTION, triangle_test=["woop"]), TypeError, "triangle_test must be a name"),
    "Warp dtype": (
        lambda s: s.intersect(wp.zeros(3, dtype=wp.vec2, device="cpu"), wp.zeros(3, dtype=wp.vec3, device="cpu")),
        TypeError,
        "origins must hold vec3f",
    ),
}


@pytest.mark.parametrize("case", BAD_QUERIES)
def test_bad_queries(scene, case):
    call, error, message = BAD_QUERIES[case]
    with pytest.raises(error, match=message):
        call(scene)


BAD_SCENES = {
    "nothing": (lambda: wrt.Scene([]), ValueError, "empty sequence"),
    "a number": (lambda: wrt.Scene(3), TypeError, "geometry must be"),
    "a path": (lambda: wrt.Scene("bunny.ply"), TypeError, "TriangleMesh.load"),
    "accelerator": (lambda: wrt.Scene(trimesh.creation.box(), "octree"), ValueError, "choose from auto, bvh, kdtree"),
    "accelerator type": (lambda: wrt.Scene(trimesh.creation.box(), 7), TypeError, "accelerator must be"),
    "device": (lambda: wrt.Scene(trimesh.creation.box(), device="cuda:99"), ValueError, "does not exist"),
    "device name": (lambda: wrt.Scene(trimesh.creation.box(), device="tpu"), ValueError, "choose from cpu"),
    "threads": (lambda: wrt.Scene(trimesh.creation.box(), num_threads=0), ValueError, "num_threads is 0"),
    "threads type": (lambda: wrt.Scene(trimesh.creation.box(), num_threads=1.5), TypeError, "num_threads must be an int"),
}


@pytest.mark.parametrize("case", BAD_SCENES)
def test_bad_scenes(case):
    call, error, message = BAD_SCENES[case]
    with pytest.raises(error, match=message):
        call()


def test_the_scene_has_a_triangle_test_of_its_own():
    """Queries that ask for none use it, those that count use one that can, and a wrong name is refused at once."""
    mesh = wrt.scenes.build("teapot", level=3)
    scene = wrt.Scene(mesh, triangle_test="moeller_trumbore")
    origins, directions = mixed_rays(mesh, 100)
    assert scene.explain(origins, directions).triangle_test == "moeller_trumbore"
    assert scene.explain(origins, directions, triangle_test="woop").triangle_test == "woop"
    assert scene.explain(origins, directions, query="count").triangle_test == "woop"
    expected = wrt.Scene(mesh).intersect(origins, directions, triangle_test="moeller_trumbore")
    np.testing.assert_array_equal(scene.intersect(origins, directions).t, expected.t)
    shared = wrt.Scene(mesh, triangle_test="komatsu")
    assert shared.intersect(origins[0], directions).shape == (100,)
    with pytest.raises(ValueError, match=r"share their origin"):
        shared.intersect(origins, directions)
    with pytest.raises(ValueError, match=r"triangle_test.*moller.*woop"):
        wrt.Scene(mesh, triangle_test="moller")

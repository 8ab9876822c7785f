"""Ray queries inside a user's kernels: the hits of the batch queries, to the bit, on every kind of tree."""

from __future__ import annotations

import re
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import warp as wp
from support.environment import DEVICES
from support.hits import mixed_rays
from support.meshes import degenerate_soup
from support.ptx import assert_fuses_boxes_alone, compile_to_ptx

import wrt
from wrt.kernels.points.device_points import add_point_search
from wrt.kernels.query.binary.binary_handles import binary_handle_type, binary_instances_handle_type
from wrt.kernels.query.device_functions import handle_type

TREES = {"keys": wrt.Bvh(), "stack": wrt.Bvh(width=4), "kdtree": wrt.KdTree()}
"""The three walks: a BVH's with a row of keys a level, that with a stack, which is CUDA's, and the kd-tree's."""

ROOM = 200
"""More hits than any ray has here."""


@wrt.device.kernel
def ask_everything(
    first: int,
    scene: wrt.device.SceneHandle,
    origins: wp.array(dtype=wp.vec3d),
    directions: wp.array(dtype=wp.vec3),
    t_max: wp.array(dtype=float),
    closest: wp.array(dtype=wrt.device.Hit),
    positions: wp.array(dtype=wp.vec3d),
    normals: wp.array(dtype=wp.vec3),
    spawned: wp.array(dtype=wp.vec3d),
    faces: wp.array(dtype=wp.bool),
    occluded: wp.array(dtype=wp.bool),
    counts: wp.array(dtype=int),
    lists: wp.array2d(dtype=wrt.device.Hit),
):
    """Item: a ray. Every function there is."""
    i = first + wp.tid()
    hit = wrt.device.closest_hit(scene, origins[i], directions[i], 0.1, t_max[i])
    closest[i] = hit
    positions[i] = wrt.device.position(scene, hit)
    normals[i] = wrt.device.normal(scene, hit)
    spawned[i] = wrt.device.spawn(scene, hit, -directions[i])
    faces[i] = wrt.device.faces(scene, hit, -directions[i])
    occluded[i] = wrt.device.any_hit(scene, origins[i], directions[i], 0.1, t_max[i])
    counts[i] = wrt.device.count_hits(scene, origins[i], directions[i], 0.1, t_max[i])
    hit = wrt.device.first_hit(scene, origins[i], directions[i], 0.1, t_max[i])
    number = int(0)
    while hit.primitive_id >= 0 and number < lists.shape[1]:
        lists[i, number] = hit
        number += 1
        hit = wrt.device.next_hit(scene, origins[i], directions[i], hit, t_max[i])


@wrt.device.kernel
def open_sky(
    first: int,
    scene: wrt.device.SceneHandle,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    samples: int,
    light: wp.array(dtype=float),
):
    """Item: a ray. Ambient occlusion where it hits: the share of cosine-distributed rays from there that meet nothing."""
    i = first + wp.tid()
    hit = wrt.device.closest_hit(scene, origins[i], directions[i], 0.0, wp.inf)
    normal = wrt.device.normal(scene, hit)
    normal *= -wp.sign(wp.dot(normal, directions[i]))
    random = wp.rand_init(7, i)
    clear = int(0)
    if hit.primitive_id >= 0:
        for _ in range(samples):
            towards = normal + wp.sample_unit_sphere_surface(random)
            if not wrt.device.any_hit(scene, wrt.device.spawn(scene, hit, towards), towards, 0.0, wp.inf):
                clear += 1
    light[i] = float(clear) / float(samples)


def two_meshes(center: float) -> list[wrt.TriangleMesh]:
    """Degenerate triangles and duplicates as one geometry, a teapot around them as another, far from the origin."""
    soup, teapot = degenerate_soup(), wrt.scenes.build("teapot", level=3)
    fitted = (teapot.vertices - teapot.center) / teapot.extent * 2.0 + 0.5
    return [wrt.TriangleMesh(v.astype(np.float64) + center, m.faces) for v, m in ((soup.vertices, soup), (fitted, teapot))]


@pytest.fixture(scope="module", params=DEVICES)
def scenes(request: pytest.FixtureRequest) -> Iterator[dict[str, wrt.Scene]]:
    """A scene with each tree. Their handles are made first, so that the kernel is compiled once for all of them."""
    made = {name: wrt.Scene(two_meshes(1e7), tree, device=request.param) for name, tree in TREES.items()}
    for scene in made.values():
        types = ask_everything.infer_argument_types([0, scene.handle(), *outputs(0, request.param).values()])
        ask_everything.add_overload(types)
    return made


def outputs(count: int, device: str) -> dict[str, wp.array]:
    """The kernel's arrays, in its order."""
    kinds = {"origins": wp.vec3d, "directions": wp.vec3, "t_max": float, "closest": wrt.device.Hit, "positions": wp.vec3d}
    kinds |= {"normals": wp.vec3, "spawned": wp.vec3d, "faces": wp.bool, "occluded": wp.bool, "counts": int}
    arrays = {name: wp.zeros(count, dtype=kind, device=device) for name, kind in kinds.items()}
    return arrays | {"lists": wp.zeros((count, ROOM), dtype=wrt.device.Hit, device=device)}


def answers(scene: wrt.Scene, origins: np.ndarray, directions: np.ndarray, t_max: np.ndarray, **sight: int) -> SimpleNamespace:
    """What the kernel finds, as NumPy arrays."""
    arrays = outputs(len(origins), str(scene.device))
    for name, values in (("origins", origins), ("directions", directions), ("t_max", t_max)):
        arrays[name].assign(values)
    wrt.device.launch(ask_everything, len(origins), [scene.handle(**sight), *arrays.values()], device=scene.device)
    return SimpleNamespace(**{name: values.numpy() for name, values in arrays.items()})


def assert_equal_hits(found: np.ndarray, expected: wrt.Hits | wrt.AllHits) -> None:
    """Equal to the bit."""
    for name in ("t", "uv"):
        np.testing.assert_array_equal(found[name].view(np.int32), getattr(expected, name).view(np.int32))
    np.testing.assert_array_equal(found["primitive_id"], expected.primitive_id)
    np.testing.assert_array_equal(found["geometry_id"], expected.geometry_id)


@pytest.mark.parametrize("tree", TREES)
def test_same_as_batch_queries(scenes, tree):
    """Rays of every kind, bad ones too, in float64 at 1e7 from the origin, in ranges of t of their own."""
    scene = scenes[tree]
    origins, directions = mixed_rays(wrt.TriangleMesh.concatenate(two_meshes(0.0)), 3001, seed=4)
    origins = origins.astype(np.float64) + 1e7
    t_max = np.where(np.arange(3001) % 3, np.inf, 0.9).astype(np.float32)
    t_max[:2] = np.nan, 0.05
    origins[:2], directions[:2] = 1e7 - 2.0, 1.0
    found = answers(scene, origins, directions, t_max)
    t_max[0] = 0.05  # a NaN is refused in a batch; here it makes the ray miss, as an empty range does
    rays, batch = wrt.Rays(origins, directions, 0.1, t_max), scenes["keys"]
    hits, lists = batch.intersect(rays), batch.intersect_all(rays)
    assert 0.3 < hits.is_hit.mean() < 0.95
    assert lists.count.max() > 20
    assert_equal_hits(found.closest, hits)
    np.testing.assert_array_equal(found.occluded, batch.occluded(rays))
    np.testing.assert_array_equal(found.counts, lists.count)
    listed = np.concatenate([row[:count] for row, count in zip(found.lists, lists.count, strict=True)])
    assert_equal_hits(listed, lists)
    np.testing.assert_array_equal(found.positions, hits.position)
    np.testing.assert_array_equal(found.normals, hits.normal.astype(np.float32))
    np.testing.assert_array_equal(found.spawned, hits.spawn(-directions))
    np.testing.assert_array_equal(found.faces, hits.faces(-directions))


def test_ambient_occlusion(device):
    """On a floor beneath half a ceiling, in closed form; and the same whatever the number of threads."""
    floor = np.array([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], dtype=np.float32)
    ceiling = np.array([[0, -300, 1], [300, -300, 1], [300, 300, 1], [0, 300, 1]], dtype=np.float32)
    square = [[0, 1, 2], [0, 2, 3]]
    mesh = wrt.TriangleMesh(np.concatenate([floor, ceiling]), np.concatenate([square, np.add(square, 4)]))
    scene = wrt.Scene(mesh, device=device)
    x = np.array([-3.0, -1.0, 0.0, 1.0, 3.0, 20.0])
    origins = wp.array(np.stack([x, 0 * x, 0 * x + 0.5], axis=1), dtype=wp.vec3, device=device)
    down = wp.array(np.tile([0.0, 0.0, -1.0], (6, 1)), dtype=wp.vec3, device=device)
    light = [wp.zeros(6, dtype=float, device=device) for _ in range(2)]
    for threads, out in zip((1, 2), light, strict=True):
        inputs = [scene.handle(), origins, down, 20_000, out]
        wrt.device.launch(open_sky, 6, inputs, device=device, num_threads=threads, chunk=1)
    share = (1 - x / np.sqrt(1 + x * x)) / 2  # of the projected hemisphere, the part left of the ceiling's edge
    np.testing.assert_allclose(light[0].numpy()[:5], share[:5], atol=0.015)
    assert light[0].numpy()[5] == 0.0
    np.testing.assert_array_equal(*(out.numpy() for out in light))


def test_cuda(tmp_path):
    """As a scene on CUDA asks for it: compiled without memory of the block, which belongs to whoever launches."""
    kernel = wrt.device.kernel(ask_everything.func)
    kernel.add_overload(kernel.infer_argument_types([0, handle_type("bvh", 2, 24)(), *outputs(0, "cpu").values()]))
    text = compile_to_ptx(kernel.module, tmp_path)
    assert ".entry" in text
    assert "fma.rn.f32" not in text
    assert not re.search(r"\.shared.*words", text)


@pytest.mark.parametrize(("make", "steps"), [(binary_handle_type, 1), (binary_instances_handle_type, 2)])
def test_binary_nodes_on_cuda(make, steps, tmp_path):
    """Nothing but the boxes of nodes fuses, in five walks; of instances, also those of an environment's list."""
    kernel = wrt.device.kernel(ask_everything.func)
    kernel.add_overload(kernel.infer_argument_types([0, make(24)(), *outputs(0, "cpu").values()]))
    text = compile_to_ptx(kernel.module, tmp_path)
    assert ".entry" in text
    assert_fuses_boxes_alone(text, walks=5 * steps)


@wrt.device.kernel
def ask_rays_and_points(scene: Any, points: wp.array(dtype=wp.vec3), found: wp.array(dtype=float)):
    """Both in one kernel."""
    i = wp.tid()
    hit = wrt.device.closest_hit(scene, points[i], wp.vec3(0.0, 0.0, 1.0), 0.0, wp.inf)
    found[i] = wp.min(hit.t, wrt.device.closest_point(scene, points[i], wp.inf).t)


@pytest.mark.parametrize("make", [binary_handle_type, binary_instances_handle_type])
def test_rays_and_points_in_one_kernel_on_cuda(make, tmp_path):
    """The headers of both go together."""
    add_point_search(make(24), "binary", 2, make is binary_instances_handle_type)
    kernel = wrt.device.kernel(ask_rays_and_points.func)
    points, found = wp.empty(0, dtype=wp.vec3, device="cpu"), wp.empty(0, dtype=float, device="cpu")
    kernel.add_overload(kernel.infer_argument_types([make(24)(), points, found]))
    assert ".entry" in compile_to_ptx(kernel.module, tmp_path)


@pytest.mark.parametrize("placed", [False, True], ids=["meshes", "instances"])
def test_binary_nodes(placed, monkeypatch):
    """The layout of CUDA gives the answers of the wide tree, here walked on the CPU."""
    meshes, tree, rng = two_meshes(0.0 if placed else 1e7), wrt.Bvh(width=2, max_leaf_triangles=2), np.random.default_rng(3)
    instances = []
    for number in range(6):
        place = np.eye(4)
        place[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0] * rng.uniform(0.5, 2.0, 3)
        place[:3, 3] = rng.uniform(-2.0, 2.0, 3)
        sight = {"mask": int(rng.integers(1, 4)), "environment": int(rng.integers(-1, 2))}
        instances.append(wrt.Instance(meshes[number % 2], place, **sight))
    scene = wrt.Scene(instances if placed else meshes, tree, device="cpu")
    origins, directions = mixed_rays(wrt.TriangleMesh.concatenate(two_meshes(0.0)), 3001, seed=4)
    origins = origins.astype(np.float64) + (0.0 if placed else 1e7)
    t_max = np.where(np.arange(3001) % 3, np.inf, 0.9).astype(np.float32)
    t_max[:2] = np.nan, 0.05
    for sight in ({}, {"mask": 1}, {"environment": 1}) if placed else ({},):
        found = []
        for binary in (False, True):
            monkeypatch.setattr(wrt.device, "walks_binary", lambda _, binary=binary: binary)
            found.append(answers(scene, origins, directions, t_max, **sight))
        assert found[0].occluded.mean() > 0.1
        assert found[0].counts.max() > 1
        for name, expected in vars(found[0]).items():
            assert getattr(found[1], name).tobytes() == expected.tobytes(), name


@wp.kernel(enable_backward=False)
def no_first(item: int, out: wp.array(dtype=int)):
    out[item + wp.tid()] = item


def test_bad_launches():
    out = wp.zeros(4, dtype=int, device="cpu")
    with pytest.raises(TypeError, match="kernel must be made by"):
        wrt.device.launch(print, 4, [out])
    with pytest.raises(TypeError, match="first: int"):
        wrt.device.launch(no_first, 4, [out], device="cpu")
    with pytest.raises(ValueError, match="num_threads"):
        wrt.device.launch(open_sky, 4, [], num_threads=0)
    with pytest.raises(ValueError, match="cuda:99"):
        wrt.device.launch(open_sky, 4, [], device="cuda:99")


@wrt.device.kernel
def distances(
    first: int,
    scene: wrt.device.SceneHandle,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    out: wp.array(dtype=float),
):
    """Item: a ray."""
    i = first + wp.tid()
    out[i] = wrt.device.closest_hit(scene, origins[i], directions[i], 0.0, wp.inf).t


def unsuitable_kernels(module: str) -> tuple[wp.Kernel, wp.Kernel, wp.Kernel]:
    """Two kernels whose decorators do not fit, and one without ray queries in the first one's module.

    Warp compiles a module as a whole, for each device: once `wp.launch` has added a refused kernel to it, none of its kernels
    can be compiled for a further device. So each caller has modules of its own.
    """

    @wp.kernel(module=f"{module}_with_gradients")
    def distances_with_gradients(
        first: int,
        scene: wrt.device.SceneHandle,
        origins: wp.array(dtype=wp.vec3),
        directions: wp.array(dtype=wp.vec3),
        out: wp.array(dtype=float),
    ):
        """Item: a ray."""
        i = first + wp.tid()
        out[i] = wrt.device.closest_hit(scene, origins[i], directions[i], 0.0, wp.inf).t

    @wp.kernel(enable_backward=False, module=f"{module}_fused")
    def distances_fused(
        first: int,
        scene: wrt.device.SceneHandle,
        origins: wp.array(dtype=wp.vec3),
        directions: wp.array(dtype=wp.vec3),
        out: wp.array(dtype=float),
    ):
        """Item: a ray; this compiles and would give other hits."""
        i = first + wp.tid()
        out[i] = wrt.device.closest_hit(scene, origins[i], directions[i], 0.0, wp.inf).t

    @wp.kernel(module=f"{module}_with_gradients")
    def fill(numbers: wp.array(dtype=float)):
        """Item: a number."""
        numbers[wp.tid()] = 3.0

    return distances_with_gradients, distances_fused, fill


@wp.kernel(module="unique")
def square(first: int, x: wp.array(dtype=float), y: wp.array(dtype=float)):
    """Item: a number."""
    i = first + wp.tid()
    y[i] = x[i] * x[i]


@wp.struct
class Numbers:
    values: wp.array(dtype=float)


@wrt.device.kernel
def double(first: int, numbers: Numbers, out: wp.array(dtype=float)):
    """Item: a number."""
    i = first + wp.tid()
    out[i] = 2.0 * numbers.values[i]


def few_rays(scene: wrt.Scene, count: int = 50) -> list[wp.array]:
    """Rays to the middle of a scene."""
    origins = scene.center + np.ptp(scene.bounds, axis=0).max() * np.random.default_rng(0).normal(size=(count, 3))
    return [wp.array(values, dtype=wp.vec3, device=scene.device) for values in (origins, scene.center - origins)]


def test_kernels_with_other_options_are_told_the_decorator(device):
    """A plain `@wp.kernel` failed with an error about wp.ref, and no kernel of its module could be launched any more."""
    scene = wrt.Scene(wrt.scenes.build("teapot", level=2), device=device)
    inputs = [scene.handle(), *few_rays(scene), wp.zeros(50, dtype=float, device=device)]
    numbers = wp.ones(5, dtype=float, device=device)
    distances_with_gradients, distances_fused, fill = unsuitable_kernels("refused_on_" + device.replace(":", "_"))
    for kernel, why in (
        (distances_with_gradients, "gradients and fused multiply-add"),
        (distances_fused, "fused multiply-add"),
    ):
        with pytest.raises(
            ValueError, match=rf"kernel '{kernel.key}' calls .* with {why}; decorate it with @wrt\.device\.kernel"
        ):
            wrt.device.launch(kernel, 50, inputs, device=device)
    wp.launch(fill, 5, [numbers], device=device)
    assert numbers.numpy().sum() == 15.0
    for kernel in (distances_fused, distances_with_gradients):
        with pytest.raises(ValueError, match=r"decorate it with @wrt\.device\.kernel"):
            wp.launch(kernel, 50, [0, *inputs], device=device)


def test_launches_inside_a_tape(device):
    """A launch with arrays that take gradients is recorded if its kernel has some, and refused if not; it was neither."""
    scene = wrt.Scene(wrt.scenes.build("teapot", level=2), device=device)
    rays, out = few_rays(scene), wp.zeros(50, dtype=float, device=device)
    moving = wp.clone(rays[0], requires_grad=True)
    x = wp.array(np.arange(5000.0), dtype=float, device=device, requires_grad=True)
    y, numbers = wp.zeros_like(x, requires_grad=True), Numbers()
    numbers.values = x
    with wp.Tape() as tape:
        with pytest.raises(
            ValueError, match=r"kernel '.*distances' is compiled without gradients, .* wrt\.device\.differentiable_hits"
        ):
            wrt.device.launch(distances, 50, [scene.handle(), moving, rays[1], out], device=device)
        with pytest.raises(ValueError, match="compiled without gradients"):
            wrt.device.launch(double, 5000, [numbers, wp.zeros(5000, dtype=float, device=device)], device=device)
        wrt.device.launch(distances, 50, [scene.handle(), *rays, out], device=device)
        wp.launch(distances, 50, [0, scene.handle(), *rays, out], device=device)
        wrt.device.launch(square, 5000, [x, y], device=device)
    tape.backward(grads={y: wp.ones_like(y)})
    np.testing.assert_array_equal(x.grad.numpy(), 2.0 * np.arange(5000.0))
    assert np.isfinite(out.numpy()).any()


class Elsewhere(wp.array):
    """An array that says it is on another device."""

    device = "elsewhere"


def test_arrays_on_another_device(monkeypatch):
    """Also at the second launch, which is packed without Warp's checks: it would read memory of the other device."""
    x, y = (wp.zeros(4, dtype=float, device="cpu") for _ in range(2))
    wrt.device.launch(square, 4, [x, y], device="cpu")
    monkeypatch.setattr(wp, "can_access", lambda device, array: False)
    y = object.__new__(Elsewhere)
    with pytest.raises(ValueError, match=r"argument 'y' of kernel 'square' is on elsewhere, and the launch on cpu"):
        wrt.device.launch(square, 4, [x, y], device="cpu")


@pytest.mark.cuda
@pytest.mark.skipif(not wp.is_cuda_available(), reason="needs CUDA")
def test_host_arrays_in_a_launch_on_cuda():
    """They are refused, or their memory can be read there."""
    x, y = (wp.ones(4, dtype=float, device="cuda:0") for _ in range(2))
    host = wp.full(4, 3.0, dtype=float, device="cpu")
    wrt.device.launch(square, 4, [x, y], device="cuda:0")
    if wp.can_access("cuda:0", host):
        wrt.device.launch(square, 4, [host, y], device="cuda:0")
        np.testing.assert_array_equal(y.numpy(), 9.0)
    else:
        with pytest.raises(ValueError, match="argument 'x' of kernel 'square' is on cpu"):
            wrt.device.launch(square, 4, [host, y], device="cuda:0")

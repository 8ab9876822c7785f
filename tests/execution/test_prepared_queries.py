"""Rays in arrays on the device, answered by prepared queries: what batches give, to the bit, and in graphs."""

from __future__ import annotations

import gc
import weakref
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext

import numpy as np
import pytest
import warp as wp
from support.hits import mixed_rays

import wrt
from wrt.engine.facts.query_cache import MAX_PLANS, QueryCache
from wrt.engine.facts.query_kinds import FEW_RAYS
from wrt.engine.launch.prepared import PreparedQuery
from wrt.engine.rays.device_rays import lay_out
from wrt.engine.rays.rays import Rays
from wrt.kernels.runtime.launch import use_threads

ATTRIBUTES = ("t", "uv", "primitive_id", "geometry_id", "instance_id", "is_hit", "position", "normal")
COUNT = 60


def teapot() -> wrt.TriangleMesh:
    return wrt.scenes.build("teapot", level=2, ground=False)


def scene_of(kind: str, device: str) -> wrt.Scene:
    """Two meshes far from the origin, or two instances of one."""
    mesh = teapot()
    if kind == "instances":
        moved = np.eye(4)
        moved[:3, 3] = (0.5, 0.2, 0.1)
        return wrt.Scene([wrt.Instance(mesh), wrt.Instance(mesh, moved)], device=device)
    far = mesh.vertices + np.array([300.0, -100.0, 200.0])
    return wrt.Scene([wrt.TriangleMesh(far, mesh.faces), wrt.TriangleMesh(far + 0.4, mesh.faces)], device=device)


@pytest.fixture(scope="module")
def scene() -> wrt.Scene:
    return scene_of("meshes", "cpu")


def on_device(array: np.ndarray, dtype: type = wp.vec3, device: str = "cpu") -> wp.array:
    return wp.array(array, dtype=dtype, device=device)


def device_rays(scene: wrt.Scene, count: int = COUNT, seed: int = 0) -> tuple[wp.array, wp.array]:
    return tuple(on_device(a, device=scene.device) for a in mixed_rays(scene.flattened(), count, seed=seed))


def layouts(scene: wrt.Scene) -> dict[str, tuple]:
    """Rays in every layout."""
    origins, directions = mixed_rays(scene.flattened(), COUNT)
    own, toward = on_device(origins), on_device(directions)
    near, far = np.linspace(0.0, 1.0, COUNT), np.linspace(1.0, 90.0, COUNT)
    eye = on_device(scene.center[None] + 3.0)
    return {
        "own": (own, toward),
        "bounds for all": (own, toward, 0.5, 40.0),
        "one ray": (own[:1], toward[:1]),
        "one origin": (eye, toward),
        "one direction": (own, toward[:1], 0, 7),
        "bounds": (own, toward, on_device(near, float), on_device(far, float)),
        "bounds of NumPy": (own, toward, near, far),
        "floats": (on_device(origins, float), on_device(directions, float)),
        "doubles": (on_device(origins, wp.vec3d), toward),
        "doubles toward": (own, on_device(directions, wp.vec3d)),
        "a grid": (own.reshape((6, 10)), toward.reshape((6, 10)), 0.0, np.inf),
    }


def assert_same(hits: wrt.Hits, expected: wrt.Hits) -> None:
    for attribute in ATTRIBUTES:
        one, other = getattr(hits, attribute), getattr(expected, attribute)
        assert isinstance(one, wp.array)
        assert (one.shape, one.dtype, one.device) == (other.shape, other.dtype, other.device)
        np.testing.assert_array_equal(one.numpy(), other.numpy(), err_msg=attribute)


LAYOUTS = list(layouts(scene_of("meshes", "cpu")))


@pytest.mark.parametrize("name", LAYOUTS)
def test_as_the_ordinary_way(scene, name):
    rays = layouts(scene)[name]
    recorded, ordinary = scene.intersect(*rays), scene.intersect(*rays, traversal="single")
    assert lay_out(Rays(*rays), scene.device, scene.center).layout in layouts_of(scene)
    assert recorded.shape == ordinary.shape
    assert str(recorded.plan).split(":")[0] == str(ordinary.plan).split(":")[0]
    assert_same(recorded, ordinary)
    for query in (scene.occluded, scene.count):
        one, other = query(*rays), query(*rays, traversal="single")
        assert (one.shape, one.dtype) == (other.shape, other.dtype)
        np.testing.assert_array_equal(one.numpy(), other.numpy())


def prepared_by(scene: wrt.Scene) -> list[PreparedQuery]:
    """The prepared queries of a scene that no caller holds."""
    return [one for chosen in scene.state.cache.plans for one in chosen.prepared.items()]


def layouts_of(scene: wrt.Scene) -> set:
    """Layouts of rays that queries are prepared for."""
    return {layout for chosen in scene.state.cache.plans for layout in chosen.prepared}


def test_who_comes_here(scene):
    """A query is prepared for each kind and layout, and used again; not where it counts work, nor for no rays."""
    scene.state.cache.clear()
    own, toward = device_rays(scene, FEW_RAYS + 1)
    scene.intersect(own[:9], toward[:9], traversal="single", counters=True)
    scene.intersect(own[:0], toward[:0])
    assert not prepared_by(scene)
    for count in (7, 9, FEW_RAYS, 7):
        scene.intersect(own[:count], toward[:count])
        scene.occluded(own[:count], toward[:count])
    assert len(prepared_by(scene)) == 2


def test_answers_are_the_callers_own(scene):
    """Later calls, of the same length and of another, leave an answer as it is, also the part that is asked for late."""
    own, toward = device_rays(scene)
    first, dark = scene.intersect(own, toward), scene.occluded(own, toward)
    expected = scene.intersect(own, toward, traversal="single")
    for other in (on_device(-toward.numpy()), toward[:20]):
        scene.intersect(own[: len(other)], other)
        scene.occluded(own[: len(other)], other)
    assert_same(first, expected)
    np.testing.assert_array_equal(dark.numpy(), expected.is_hit.numpy())
    only = scene.intersect(own, toward).t  # its hits, and the memory's other parts, are gone
    scene.intersect(own, on_device(-toward.numpy()))
    np.testing.assert_array_equal(only.numpy(), expected.t.numpy())


@pytest.mark.parametrize("kind", ["meshes", "instances"])
def test_after_an_update(kind, device):
    scene = scene_of(kind, device)
    own, toward = device_rays(scene)
    before = scene.intersect(own, toward)
    assert len(prepared_by(scene)) == 1
    if kind == "instances":
        scene.update(0, transform=np.diag([2.0, 2.0, 2.0, 1.0]))
    else:
        scene.update(0, vertices=scene.meshes[0].vertices * 0.999, rebuild="always")
    after, expected = scene.intersect(own, toward), scene.intersect(own, toward, traversal="single")
    assert_same(after, expected)
    assert (after.t.numpy() != before.t.numpy()).any()


def test_packets_through_instances():
    """A query is prepared for rays from one point and one for others, and serves where instances have moved, too, and where
    their tree was built again."""
    scene = scene_of("instances", "cpu")
    own, toward = device_rays(scene, 500)
    eye = on_device(scene.center[None] + 3.0)
    for scale, rebuild in ((1.0, "auto"), (2.0, "auto"), (0.5, "always")):
        scene.update(0, transform=np.diag([scale, scale, scale, 1.0]), rebuild=rebuild)
        for origins in (own, eye, own):
            packets, alone = (scene.intersect(origins, toward, traversal=name) for name in ("packet", "single"))
            assert_same(packets, alone)
            np.testing.assert_array_equal(
                scene.occluded(origins, toward, traversal="packet").numpy(), alone.is_hit.numpy(), err_msg=str(scale)
            )
        in_packets = [chosen for chosen in scene.state.cache.plans if chosen.plan.traversal == "packet"]
        assert sum(len(chosen.prepared.items()) for chosen in in_packets) == 4
    few = scene.intersect(own[:5], toward[:5], traversal="packet")
    assert_same(few, scene.intersect(own[:5], toward[:5], traversal="single"))


def test_nothing_stale():
    """What was recorded for a tree is not used for another."""
    mesh = teapot()
    scene, moved = (wrt.Scene(wrt.TriangleMesh(mesh.vertices * scale, mesh.faces), device="cpu") for scale in (1.0, 0.5))
    own, toward = device_rays(scene)
    scene.intersect(own, toward)
    scene.state = moved.state
    np.testing.assert_array_equal(scene.intersect(own, toward).t.numpy(), moved.intersect(own, toward).t.numpy())


def test_nothing_outlives_its_owner():
    """Neither hits nor the scene hold rays, and recordings go with the scene."""
    scene = wrt.Scene(teapot(), device="cpu")
    own, toward = device_rays(scene)
    hits, dark = scene.intersect(own, toward), scene.occluded(own, toward)
    kept = [weakref.ref(array) for array in (own, toward)]
    recording = weakref.ref(prepared_by(scene)[0])
    del own, toward
    gc.collect()
    assert [ref() for ref in kept] == [None, None]
    assert recording() is not None
    del scene
    gc.collect()
    assert recording() is None
    assert np.isfinite(hits.t.numpy()).sum() == dark.numpy().sum() > 0


def test_many_threads(scene):
    """Each call has a launch to itself, whatever the lengths that threads ask for side by side."""
    own, toward = device_rays(scene, 300)
    expected = scene.intersect(own, toward, traversal="single").t.numpy()

    def ask(number: int) -> bool:
        first, count = number % 200, 1 + number * 7 % 100
        part = own[first : first + count], toward[first : first + count]
        found, dark = scene.intersect(*part).t.numpy(), scene.occluded(*part).numpy()
        wanted = expected[first : first + count]
        return np.array_equal(found, wanted) and np.array_equal(dark, np.isfinite(wanted))

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(ask, range(400)))


def test_streams(device):
    """The first stream makes what the others use without waiting for it."""
    scene = scene_of("meshes", device)
    own, toward = device_rays(scene)
    wp.synchronize_device(device)
    found = []
    for _ in range(4):
        stream = wp.Stream(device) if scene.device.is_cuda else None
        with nullcontext() if stream is None else wp.ScopedStream(stream, sync_enter=False):
            found.append(scene.intersect(own, toward))
    wp.synchronize_device(device)
    expected = scene.intersect(own, toward, traversal="single")
    for hits in found:
        assert_same(hits, expected)


def test_refused(scene):
    own, toward = device_rays(scene)
    for rays, message in (
        ((own, toward[:7]), "do not broadcast"),
        ((own.reshape((6, 10)), toward[:10]), "broadcast only from one element"),
        ((own, toward, -1.0), "t_min must not be negative"),
        ((own, toward, 0.0, on_device(np.ones(7), float)), "do not broadcast"),
    ):
        for query in (scene.intersect, scene.occluded, scene.count):
            with pytest.raises(ValueError, match=message):
                query(*rays)
    with pytest.raises(TypeError, match="origins must hold"):
        scene.intersect(wp.zeros(COUNT, dtype=wp.vec4, device="cpu"), toward)


@pytest.mark.parametrize("count", [COUNT, 20_000])
def test_graphs(device, count):
    """A graph answers the rays that are in the arrays when it is launched; many rays on the CPU too, whatever the threads."""
    scene = scene_of("meshes", device)
    own, toward = device_rays(scene, count)
    plan = scene.intersect(own[:2], toward[:2]).plan
    options = {"traversal": plan if count > FEW_RAYS else "auto"}  # packets and streams are slow to compile
    scene.intersect(own, toward, **options).position.numpy()
    scene.occluded(own, toward, **options)
    with use_threads(4), wp.ScopedCapture(device=device) as capture:
        hits = scene.intersect(own, toward, 0.0, 33.25, **options)  # bounds may be new
        found, dark = [getattr(hits, name) for name in ATTRIBUTES], scene.occluded(own, toward, **options)
    expected = scene.intersect(own, toward, 0.0, 33.25, **options)
    wanted, lit = [getattr(expected, name).numpy() for name in ATTRIBUTES], scene.occluded(own, toward, **options).numpy()
    for bound in range(100):
        scene.occluded(own[:1], toward[:1], 0.0, float(bound))  # what is kept for bounds is that of others now
    for step in (slice(None), slice(None, None, -1)):
        for array in (own, toward):
            array.assign(np.ascontiguousarray(array.numpy()[step]))
        wp.capture_launch(capture.graph)
        for array, value in zip(found, wanted, strict=True):
            np.testing.assert_array_equal(array.numpy(), value[step])
        np.testing.assert_array_equal(dark.numpy(), lit[step])


def test_graphs_of_a_cold_scene(device):
    """What a graph would take along is refused: records that later queries use, and rays that are not on the device."""
    scene = scene_of("meshes", device)
    own, toward = device_rays(scene)
    with wp.ScopedCapture(device=device), pytest.raises(RuntimeError, match="once before the capture"):
        scene.intersect(own, toward)
    expected = scene.intersect(own, toward).t.numpy()
    assert np.isfinite(expected).any()
    for rays in ((own.numpy(), toward), (own, toward, 0.0, np.ones(COUNT))):
        with wp.ScopedCapture(device=device), pytest.raises(RuntimeError, match="must be Warp arrays"):
            scene.intersect(*rays)
    np.testing.assert_array_equal(scene.intersect(own, toward).t.numpy(), expected)


def test_layout(scene):
    rays = Rays(on_device(scene.center[None], wp.vec3d), device_rays(scene)[1], 0.0, on_device(np.ones(COUNT), float))
    arrays = lay_out(rays, scene.device, scene.center)
    assert arrays.layout == (0, 1, 0, 1, True, scene.device.is_cuda)
    assert arrays.shape == (COUNT,)
    np.testing.assert_array_equal(arrays.origins.numpy(), [[0.0, 0.0, 0.0]])


def test_plans_are_bounded():
    """A cache holds so many plans and no more: with one more it begins anew, and a caller keeps what it looked up."""
    cache = QueryCache()
    for number in range(2 * MAX_PLANS):
        assert cache.plan(number) is None
        assert cache.keep_plan(number, f"plan {number}") == f"plan {number}"
        assert cache.plan(number) == f"plan {number}"
        assert len(cache.plans) <= MAX_PLANS


def test_batches_of_many_lengths_share_what_is_prepared():
    """A plan is chosen for each length, but batches with equal plans use one prepared query after the other."""
    scene = wrt.Scene(teapot(), device="cpu")
    origins, directions = mixed_rays(scene.flattened(), 3000)
    for count in range(1200, 1240):
        scene.intersect(origins[:count], directions[:count], traversal="single")
    assert len(prepared_by(scene)) == 1

"""Work space that is kept from one job to the next: results as of fresh work space, and nothing of a job stays behind."""

from __future__ import annotations

import gc
import threading
import weakref

import numpy as np
import pytest
import warp as wp

import wrt
from wrt.builders.bvh import binned_bvh
from wrt.engine import memory
from wrt.kernels.runtime import workspace
from wrt.kernels.runtime.launch import use_threads
from wrt.kernels.runtime.launch_loop import Step
from wrt.kernels.runtime.workspace import Workspace, host_view, kept_workspace, read_ints, set_flat, write
from wrt.kernels.triangle.support.record_blocks import TriangleBlocks


@pytest.fixture(autouse=True)
def empty():
    """Nothing is kept before a test, nor after it."""
    workspace.release()
    yield
    workspace.release()


@wp.kernel(enable_backward=False)
def add_to(first: int, values: wp.array(dtype=int), amount: int, sums: wp.array(dtype=int)):
    i = first + wp.tid()
    sums[i] = values[i] + amount


@wp.kernel(enable_backward=False)
def halve(first: int, limit: int, numbers: wp.array(dtype=int)):
    numbers[1] = numbers[1] + numbers[0]
    numbers[0] = wp.where(numbers[0] > limit, numbers[0] / 2, 0)


def soup(count: int, seed: int = 0) -> wrt.TriangleMesh:
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1.0, 1.0, (count, 1, 3)) + 0.05 * rng.normal(size=(count, 3, 3))
    return wrt.TriangleMesh(corners.reshape(-1, 3).astype(np.float32), np.arange(3 * count).reshape(-1, 3))


def bytes_of(tree) -> list[bytes]:
    return [array.numpy().tobytes() for array in (tree.bounds, tree.child, tree.primitive)]


@pytest.mark.parametrize("is_kept", [False, True])
def test_launches_see_the_arguments_of_their_call(is_kept):
    """Kept launches pack only what is another object: other arrays, other numbers, and the same ones again."""
    work, cpu = Workspace(wp.get_device("cpu"), is_kept), "cpu"
    first, second = (wp.array(np.arange(5000) * factor, dtype=int, device=cpu) for factor in (1, 3))
    for threads in (1, 2):
        with use_threads(threads):
            for count, values, amount in ((5, first, 1000), (5000, second, 1000), (5000, second, 70_000), (3, first, 70_000)):
                sums = work.empty("sums", count, int)
                work.launch(add_to, count, [values, amount, sums], chunk=256)
                np.testing.assert_array_equal(sums.numpy()[:count], values.numpy()[:count] + amount)
    work.launch(add_to, 0, [first, 1, first])
    assert first.numpy()[4] == 4, "no item, no launch"


def test_a_kept_launch_refuses_an_argument_of_another_type():
    work = Workspace(wp.get_device("cpu"), True)
    values = wp.zeros(4, dtype=int, device="cpu")
    work.launch(add_to, 4, [values, 1, values])
    with pytest.raises(TypeError, match="argument 2 is a float"):
        work.launch(add_to, 4, [values, 1.5, values])


@pytest.mark.parametrize("is_kept", [False, True])
@pytest.mark.parametrize("threads", [1, 2])
def test_loops_run_again_with_other_arguments(is_kept, threads):
    work = Workspace(wp.get_device("cpu"), is_kept)
    with use_threads(threads):
        for limit, total in ((1, 31), (4, 28), (1, 31)):
            numbers = work.empty("numbers", 2, int)
            write(numbers, np.array([16, 0], dtype=np.int32))
            work.loop("halve", [[Step(halve, [limit, numbers], count=1)]], numbers)
            assert read_ints(numbers, 2) == [0, total]


def test_arrays_grow_and_are_those_of_before():
    work = Workspace(wp.get_device("cpu"), True)
    small = work.empty("a", 100, float)
    assert 100 <= small.size <= 102
    assert work.empty("a", 60, float) is small
    large = work.empty("a", small.size + 1, float)
    assert large.size > small.size
    assert work.empty("a", 100, float) is large
    assert Workspace(wp.get_device("cpu")).empty("a", 100, float).size == 100, "of one job: as many as asked for"


def test_jobs_at_the_same_time_do_not_share():
    cpu = wp.get_device("cpu")
    with kept_workspace("kind", cpu) as outer, kept_workspace("kind", cpu) as inner:
        assert inner is not outer
    with kept_workspace("other", cpu) as other:
        assert other not in (outer, inner)
    for number in range(10):
        with kept_workspace(number, cpu):
            pass
    assert len(workspace._kept) == workspace.MAX_KEPT


def test_nothing_is_kept_after_an_exception():
    """Helpers may still work on its arrays after a Ctrl-C."""
    cpu = wp.get_device("cpu")
    with pytest.raises(KeyboardInterrupt), kept_workspace("kind", cpu):
        raise KeyboardInterrupt
    assert not workspace._kept


def test_small_builds_make_the_trees_of_fresh_work_space(monkeypatch):
    """Sizes up and down, so that arrays hold more than a build needs, and what another one left there."""
    meshes = [soup(count, seed) for seed, count in enumerate((40, 9000, 1, 700, 20_000, 9000, 3))]
    for threads in (1, 2, 5):
        kept = [bytes_of(wrt.Scene(mesh, "bvh", device="cpu", num_threads=threads).tree) for mesh in meshes]
        assert workspace._kept
        with monkeypatch.context() as fresh:
            fresh.setattr(binned_bvh, "MAX_KEPT", 0)
            assert kept == [bytes_of(wrt.Scene(mesh, "bvh", device="cpu", num_threads=threads).tree) for mesh in meshes]


def test_trees_live_on_when_the_work_space_is_used_again():
    scenes = [wrt.Scene(soup(3000, seed), "bvh", device="cpu") for seed in range(2)]
    before = bytes_of(scenes[0].tree)
    del scenes[1]
    wrt.Scene(soup(3500, 5), "bvh", device="cpu")
    assert bytes_of(scenes[0].tree) == before


def test_work_space_keeps_nothing_of_a_scene():
    scene = wrt.Scene(soup(6000), "bvh", device="cpu", num_threads=2)
    gone = [weakref.ref(array) for array in (scene.tree.bounds, scene.tree.primitive, scene.state.device_mesh.vertices)]
    assert workspace._kept
    del scene
    gc.collect()
    assert [ref() for ref in gone] == [None] * 3


def test_threads_build_at_the_same_time():
    meshes = [soup(count, count) for count in (300, 5000, 8000)]
    expected = [bytes_of(wrt.Scene(mesh, "bvh", device="cpu").tree) for mesh in meshes]
    wrong = []

    def build():
        for _ in range(10):
            for mesh, tree in zip(meshes, expected, strict=True):
                if bytes_of(wrt.Scene(mesh, "bvh", device="cpu", num_threads=2).tree) != tree:
                    wrong.append(mesh)

    threads = [threading.Thread(target=build) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_memory_can_be_released():
    wrt.Scene(soup(500), "bvh", device="cpu")
    assert workspace._kept
    memory.release()
    assert not workspace._kept


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_known_box_of_a_scene_is_that_of_its_triangles(dtype):
    """Builders got the box of all triangles from a pass over all boxes; now the mesh's bounds, rounded as vertices are."""
    rng = np.random.default_rng(2)
    for scale, offset in ((1.0, 0.0), (1e-30, 0.0), (1e5, 1e9), (3.0, -7e4)):
        vertices = (rng.uniform(-1.0, 1.0, (900, 3)) * scale + offset * rng.uniform(0.5, 1.0, 3)).astype(dtype)
        vertices[-1] = 100.0 * scale + offset  # no triangle uses it
        parts = [wrt.TriangleMesh(vertices, rng.integers(0, 899, (50, 3))) for _ in range(2)]
        for geometry in (parts[0], parts):
            tree = wrt.Scene(geometry, "bvh", device="cpu").tree
            placed = wrt.Scene(geometry, "bvh", device="cpu").state.device_mesh
            used = placed.vertices.numpy()[placed.faces.numpy().ravel()]
            np.testing.assert_array_equal(np.array(tree.low, np.float32), used.min(axis=0))
            np.testing.assert_array_equal(np.array(tree.high, np.float32), used.max(axis=0))


@pytest.mark.parametrize("dtype", [wp.float32, wp.int32, wp.vec3, wp.vec3i])
def test_views_of_host_memory_are_those_of_warp(dtype, monkeypatch):
    """They are made without Warp's own code, as long as that makes no others than today."""
    values = np.arange(60, dtype=np.int32)
    size = wp.types.type_size_in_bytes(dtype)

    def attributes(view: wp.array) -> dict:
        return {name: value for name, value in vars(view).items() if name != "used"}

    expected = wp.array(ptr=values.ctypes.data + 8, dtype=dtype, shape=3, device="cpu")
    view = workspace.host_view(values, dtype, 8, 3)
    assert workspace._attributes(dtype)[0] is not None, "Warp's views differ in ways that are not known: they are made slowly"
    assert attributes(view) == attributes(expected)
    with monkeypatch.context() as patched:
        patched.setattr(workspace, "_attributes", lambda dtype: (None, size))
        assert attributes(workspace.host_view(values, dtype, 8, 3)) == attributes(expected)
    assert bytes(view.__ctype__()) == bytes(expected.__ctype__())
    assert view.numpy().tobytes() == values.tobytes()[8 : 8 + 3 * size]


def test_a_field_of_a_struct_is_set_as_by_warp():
    values = host_view(np.arange(5, dtype=np.float32), wp.float32)
    ours, warps = TriangleBlocks(), TriangleBlocks()
    set_flat(ours, "records", values)
    warps.records = values
    assert ours.records is values
    assert bytes(ours.__ctype__()) == bytes(warps.__ctype__())

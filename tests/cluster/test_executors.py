"""Blocks answered by executors: the bits of one process, few blocks at a time, and again if a worker dies."""

from __future__ import annotations

import os
import signal
import threading
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import pytest
from support.hits import mixed_rays

import wrt
from wrt.query.batches import workers
from wrt.query.batches.array_files import MappedArray, mapped_array
from wrt.query.batches.block_outputs import StoreRows, TakeAttributes, for_workers
from wrt.query.batches.shared_files import share_scene
from wrt.query.batches.workers import task_threads
from wrt.query.blocks import BYTES_PER_RAY

COUNT = 3000
MEMORY = 700 * BYTES_PER_RAY
ATTRIBUTES = ("t", "primitive_id", "geometry_id", "uv", "is_hit", "position", "normal")


@pytest.fixture(scope="module")
def scene() -> wrt.Scene:
    mesh = wrt.scenes.build("teapot", level=4)
    return wrt.Scene([mesh, wrt.TriangleMesh(mesh.vertices + 0.3, mesh.faces)], device="cpu")


@pytest.fixture(scope="module")
def rays(scene) -> tuple[np.ndarray, np.ndarray]:
    return mixed_rays(scene.meshes[0], COUNT, seed=4)


@pytest.fixture(scope="module")
def processes():
    with wrt.cluster.ProcessPool(2, threads=1) as pool:
        yield pool


@pytest.fixture(scope="module")
def threads():
    with ThreadPoolExecutor(2) as pool:
        yield pool


@pytest.fixture(params=["processes", "threads"])
def executor(request):
    return request.getfixturevalue(request.param)


def test_same_bits(scene, rays, executor):
    """Hits with all attributes, in order; occlusion and counts."""
    whole = scene.intersect(*rays, 0.01, 5.0)
    blocks = scene.intersect_blocks(*rays, 0.01, 5.0, memory=MEMORY, executor=executor)
    answers = list(blocks)
    assert [rows.start for rows, _ in answers] == list(range(0, COUNT, 700))
    assert blocks.done == COUNT
    for name in ATTRIBUTES:
        together = np.concatenate([getattr(hits, name) for _, hits in answers])
        np.testing.assert_array_equal(together, getattr(whole, name))
    dark = scene.occluded_blocks(*rays, memory=MEMORY, executor=executor).result()
    np.testing.assert_array_equal(dark, scene.occluded(*rays))
    count = scene.count_blocks(*rays, memory=MEMORY, executor=executor, reduce="mean").result()
    assert count == scene.count(*rays).mean()


def test_masks_and_skipped_triangles(scene, rays, processes):
    """Cut with the rays, here and elsewhere; hits of several meshes say which triangles of all."""
    hits = scene.intersect(*rays)
    expected = scene.count(*rays, skip=hits)
    assert (expected < scene.count(*rays)).any()
    for executor in (None, processes):
        found = scene.count_blocks(*rays, memory=MEMORY, skip=hits, executor=executor).result()
        np.testing.assert_array_equal(found, expected)
    alone = wrt.Scene(scene.meshes[0], device="cpu")
    ids = alone.intersect(*rays).primitive_id
    expected = alone.occluded(*rays, skip=ids)
    for executor in (None, processes):
        found = alone.occluded_blocks(*rays, memory=MEMORY, skip=ids, executor=executor).result()
        np.testing.assert_array_equal(found, expected)
    with pytest.raises(ValueError, match="another scene"):
        alone.count_blocks(*rays, skip=hits)
    with pytest.raises(ValueError, match="skip must be one number"):
        alone.count_blocks(iter([rays]), skip=ids)
    with pytest.raises(ValueError, match=r"skip must be from -1 to \d+, but ranges from"):
        alone.count_blocks(*rays, skip=ids + 10**6, executor=processes).result()


def test_instances_travel_too(scene, rays, processes):
    """Rays see the instances of their masks and environments."""
    mesh = scene.meshes[0]
    forest = wrt.Scene([wrt.Instance(mesh, mask=1), wrt.Instance(mesh, np.diag([2.0, 2, 2, 1]), mask=2)], device="cpu")
    masks = np.arange(COUNT) % 4
    found = forest.occluded_blocks(*rays, memory=MEMORY, mask=masks, executor=processes).result()
    np.testing.assert_array_equal(found, forest.occluded(*rays, mask=masks))
    assert 0 < found.sum() < forest.occluded(*rays).sum()
    worlds = wrt.Scene([wrt.Instance(mesh, environment=0), wrt.Instance(mesh, environment=1)], device="cpu")
    numbers = np.arange(COUNT) % 3
    found = worlds.count_blocks(*rays, memory=MEMORY, environment=numbers, executor=processes).result()
    np.testing.assert_array_equal(found, worlds.count(*rays, environment=numbers))
    assert found[numbers < 2].any()
    assert not found[numbers == 2].any()


def test_pictures_and_what_rows_share(scene, rays, processes):
    """Several leading axes; directions that all rows share go with the batch, large ones in a file."""
    origins, directions = rays[0].reshape(50, 60, 3), rays[1][:60]
    for some in (directions, np.broadcast_to(rays[1][:1], (7000, 3))):
        point = origins[: 50 if len(some) == 60 else 9, :1]
        blocks = scene.occluded_blocks(
            point, some, memory=7 * len(some) * BYTES_PER_RAY, reduce="sum", axis=1, executor=processes
        )
        np.testing.assert_array_equal(blocks.result(), scene.occluded(point, some).sum(axis=1))


def by_number(first: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays that depend on nothing but their numbers."""
    number = np.arange(first, first + count)[:, None]
    return np.float64([0.1, 0.2, 3.0]), np.sin(number * [1.0, 1.7, 2.3] + 0.5)


def test_generated_rays(scene, executor):
    expected = scene.count(*by_number(0, COUNT))
    generated = wrt.batches.GeneratedRays(by_number, COUNT)
    for who in (None, executor):
        found = scene.count_blocks(generated, memory=MEMORY, executor=who)
        assert found.shape == (COUNT,)
        np.testing.assert_array_equal(found.result(), expected)
    near = scene.count_blocks(generated, t_max=1.0, memory=MEMORY, executor=executor).result()
    np.testing.assert_array_equal(near, scene.count(*by_number(0, COUNT), t_max=1.0))
    assert (near < expected).any()


def test_generated_rays_are_checked(scene):
    with pytest.raises(ValueError, match=r"function\(0, 5\) returned rays of shape \(3000,\)"):
        scene.count_blocks(wrt.batches.GeneratedRays(lambda first, count: by_number(0, COUNT), 5)).result()
    with pytest.raises(TypeError, match=r"function\(0, 5\) must be"):
        scene.count_blocks(wrt.batches.GeneratedRays(lambda first, count: 3, 5)).result()
    with pytest.raises(TypeError, match="function"):
        wrt.batches.GeneratedRays("rays", 5)
    for shape in (-1, (), (3, -1)):
        with pytest.raises(ValueError, match="shape"):
            wrt.batches.GeneratedRays(by_number, shape)
    with pytest.raises(TypeError, match="not both"):
        scene.count_blocks(wrt.batches.GeneratedRays(by_number, 5), np.ones((5, 3)))


def test_iterators_and_memory(scene, rays, executor):
    items = [(rays[0][part], rays[1][part]) for part in (slice(0, 10), slice(10, 2000), slice(2000, COUNT))]
    t = np.zeros(COUNT + 3, dtype=np.float32)
    assert scene.intersect_blocks(iter(items), memory=MEMORY, executor=executor).write({"t": t}) == COUNT
    np.testing.assert_array_equal(t[:COUNT], scene.intersect(*rays).t)


def test_workers_read_and_write_mapped_files(scene, rays, processes, tmp_path):
    """Columns of one file, from the middle of it, to files that only workers write."""
    lines = np.concatenate([np.zeros((5, 6), np.float32), np.concatenate(rays, axis=1)])
    np.save(tmp_path / "rays.npy", lines)
    mapped = np.load(tmp_path / "rays.npy", mmap_mode="r")[5:]
    whole = scene.intersect(*rays)
    out = {
        name: np.lib.format.open_memmap(tmp_path / f"{name}.npy", "w+", dtype, shape)
        for name, dtype, shape in (("t", np.float32, (COUNT,)), ("position", np.float64, (COUNT, 3)))
    }
    assert isinstance(for_workers(out), StoreRows)
    assert isinstance(for_workers({**out, "t": np.zeros(COUNT)}), TakeAttributes)
    blocks = scene.intersect_blocks(mapped[:, :3], mapped[:, 3:], memory=MEMORY, executor=processes)
    assert blocks.write(out) == COUNT
    for name in out:
        np.testing.assert_array_equal(np.load(tmp_path / f"{name}.npy"), getattr(whole, name))
    np.testing.assert_array_equal(mapped_array(mapped[3::2, 4:1:-1]).open(), mapped[3::2, 4:1:-1])


def test_a_file_that_changes_is_refused(rays, tmp_path):
    np.save(tmp_path / "rays.npy", rays[0])
    opened = mapped_array(np.load(tmp_path / "rays.npy", mmap_mode="r"))
    assert isinstance(opened, MappedArray)
    np.save(tmp_path / "rays.npy", rays[1])
    os.utime(tmp_path / "rays.npy", ns=(0, 0))
    with pytest.raises(ValueError, match="changed"):
        opened.open()
    (tmp_path / "rays.npy").unlink()
    with pytest.raises(FileNotFoundError, match="all workers share"):
        opened.open()


def test_another_file_in_the_place_of_the_scene(scene, tmp_path):
    """A worker would trace rays in another scene; it compares the hash instead."""
    shared = share_scene(scene, tmp_path)
    assert share_scene(scene, tmp_path) is shared
    wrt.Scene(scene.meshes[0], device="cpu").save(shared.path)
    with pytest.raises(ValueError, match="not the scene"):
        shared.get(None)
    Path(shared.path).unlink()
    with pytest.raises(FileNotFoundError, match="folder="):
        shared.get(None)
    np.testing.assert_array_equal(share_scene(scene, tmp_path).get(None).bounds, scene.bounds)


class DiesOnce:
    """Rays by number; the process that makes those of the middle is killed, as often as there are files to remove."""

    def __init__(self, marks: list[str]):
        self.marks = marks

    def __call__(self, first: int, count: int):
        if first <= COUNT // 2 < first + count:
            for mark in self.marks:
                if Path(mark).exists():
                    Path(mark).unlink()
                    os.kill(os.getpid(), signal.SIGKILL)
        return by_number(first, count)


def marks(folder: Path, number: int) -> list[str]:
    paths = [folder / f"mark{i}" for i in range(number)]
    for path in paths:
        path.touch()
    return [str(path) for path in paths]


def test_a_worker_that_is_killed(scene, tmp_path):
    """Its blocks are computed by others, which the pool starts; a block that kills each worker ends the batch."""
    with wrt.cluster.ProcessPool(2, threads=1) as pool:
        dying = wrt.batches.GeneratedRays(DiesOnce(marks(tmp_path, 1)), COUNT)
        found = scene.count_blocks(dying, memory=MEMORY, executor=pool).result()
        np.testing.assert_array_equal(found, scene.count(*by_number(0, COUNT)))
        again = wrt.batches.GeneratedRays(DiesOnce(marks(tmp_path, 3)), COUNT)
        workers = wrt.cluster.Workers(pool, retries=1)
        with pytest.raises(RuntimeError, match="died"):
            scene.count_blocks(again, memory=MEMORY, executor=workers).result()


def test_a_pool_that_does_not_replace_processes(scene, tmp_path):
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        dying = wrt.batches.GeneratedRays(DiesOnce(marks(tmp_path, 1)), COUNT)
        with pytest.raises(RuntimeError, match="ProcessPool"):
            scene.count_blocks(dying, memory="10 MB", executor=pool).result()


class LateExecutor(Executor):
    """Runs what is submitted in the reverse order, and notes how much waits."""

    def __init__(self, most: int):
        self._max_workers, self.most, self.waiting, self.lock = most, 0, [], threading.Lock()
        self.ended = False
        self.thread = threading.Thread(target=self.serve)
        self.thread.start()

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        with self.lock:
            self.waiting.append((future, fn, args, kwargs))
            self.most = max(self.most, len(self.waiting))
        return future

    def serve(self):
        while not self.ended:
            sleep(0.005)
            with self.lock:
                some, self.waiting[:] = self.waiting[::-1], []
            for future, fn, args, kwargs in some:
                if future.set_running_or_notify_cancel():
                    try:
                        future.set_result(fn(*args, **kwargs))
                    except BaseException as error:
                        future.set_exception(error)

    def shutdown(self, wait=True, *, cancel_futures=False):
        self.ended = True
        self.thread.join()


def test_the_window(scene, rays):
    """No more blocks wait than the window holds, and answers come in order though they were computed in another."""
    with LateExecutor(1) as executor:
        workers = wrt.cluster.Workers(executor, window=3)
        blocks = list(scene.occluded_blocks(*rays, memory=50 * BYTES_PER_RAY, executor=workers))
        assert [rows.start for rows, _ in blocks] == list(range(0, COUNT, 50))
        np.testing.assert_array_equal(np.concatenate([answer for _, answer in blocks]), scene.occluded(*rays))
        assert executor.most <= 3
        assert wrt.cluster.Workers(executor).window_size() == 4


def test_what_a_task_raises(scene, rays, executor):
    """Is raised here, and the executor goes on."""
    bad = np.full(COUNT, -1.0)
    with pytest.raises(ValueError, match="t_min must not be negative"):
        scene.occluded_blocks(*rays, t_min=bad, memory=MEMORY, executor=executor).result()
    assert scene.occluded_blocks(*rays, executor=executor).result().any()


def test_threads_are_shared():
    """By the tasks that run at a time; a process of a pool has those that it was told."""
    until = monotonic() + 60.0
    while workers._running and monotonic() < until:  # tasks of a batch that failed come to their end
        sleep(0.01)
    with task_threads(8):
        assert wrt.get_num_threads() == 8
        found = []

        def second():
            with task_threads(8):
                found.append(wrt.get_num_threads())

        thread = threading.Thread(target=second)
        thread.start()
        thread.join()
        assert found == [4]
    with task_threads(1):
        assert wrt.get_num_threads() == 1


def test_processes_have_the_threads_and_devices_they_were_told(processes):
    assert processes.submit(threads_of_a_task).result() == 1
    with wrt.cluster.ProcessPool(1, threads=3, devices=["cpu"]) as pool:
        assert pool.submit(threads_of_a_task).result() == 3
        assert "devices=('cpu',)" in repr(pool)


def threads_of_a_task() -> int:
    with task_threads(None):
        return wrt.get_num_threads()


def test_refused(scene, rays, threads):
    for executor, error, message in (
        (3, TypeError, "Executor, not int"),
        (type("Client", (), {"get_executor": None})(), TypeError, "get_executor"),
    ):
        with pytest.raises(error, match=message):
            scene.occluded_blocks(*rays, executor=executor)
    for options, error in (({"threads": 0}, ValueError), ({"window": 0}, ValueError), ({"retries": 1.5}, TypeError)):
        with pytest.raises(error, match=next(iter(options))):
            wrt.cluster.Workers(threads, **options)
    with pytest.raises(ValueError, match="workers"):
        wrt.cluster.ProcessPool(0)

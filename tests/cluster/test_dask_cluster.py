"""A cluster of Dask: real workers in processes of this machine, which talk through its loopback device."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import pytest
import warp as wp
from support.hits import mixed_rays

import wrt
from wrt.cluster.job_folder import JobFolder
from wrt.query.batches import shared_files
from wrt.query.batches.dask_futures import submit_to_dask
from wrt.query.blocks import BYTES_PER_RAY

distributed = pytest.importorskip("distributed", reason="Dask is not installed: pip install 'wrt[cluster-dask]'")

COUNT = 3000
ROWS = 250
MEMORY = ROWS * BYTES_PER_RAY
PATHS = [str(Path(__file__).parents[2]), str(Path(__file__).parents[1])]


@pytest.fixture(scope="module")
def client():
    """Two workers of one thread, which are ended when they use more than 1.2 GB."""
    import dask

    options = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": ":0"}
    quiet = {"distributed.worker.memory.terminate": 0.9, "distributed.worker.memory.pause": False}
    with (
        dask.config.set(quiet | {"distributed.scheduler.allowed-failures": 1}),
        distributed.LocalCluster(**options, memory_limit="1.2GB", silence_logs=50) as cluster,
        distributed.Client(cluster) as client,
    ):
        client.run(sys.path.extend, PATHS)
        yield client


@pytest.fixture(scope="module")
def executor(client):
    return client.get_executor()


@pytest.fixture(scope="module")
def scene() -> wrt.Scene:
    return wrt.Scene(wrt.scenes.build("teapot", level=4), device="cpu")


@pytest.fixture(scope="module")
def rays(scene) -> tuple[np.ndarray, np.ndarray]:
    return mixed_rays(scene.meshes[0], COUNT, seed=4)


def by_number(first: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays that depend on nothing but their numbers."""
    number = np.arange(first, first + count)[:, None]
    return np.float64([0.1, 0.2, 3.0]), np.sin(number * [1.0, 1.7, 2.3] + 0.5)


class Once:
    """Rays by number; the first process that makes those of the middle does something else before."""

    def __init__(self, mark: Path, action):
        mark.touch()
        self.mark, self.action = str(mark), action

    def __call__(self, first: int, count: int):
        if first <= COUNT // 2 < first + count:
            try:
                os.unlink(self.mark)
            except FileNotFoundError:
                return by_number(first, count)
            self.action()
        return by_number(first, count)


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def fill_memory() -> None:
    """Until the worker is ended for it."""
    held, end = [], monotonic() + 60.0
    while monotonic() < end:
        held.append(np.ones(4_000_000 if len(held) < 40 else 1))  # 32 MB, of which 1.3 GB are taken
        sleep(0.02)


def wait_for_workers(client) -> None:
    """Those that died have been replaced."""
    client.wait_for_workers(2, timeout=60)


def test_same_bits(scene, rays, executor):
    whole = scene.intersect(*rays)
    answers = [hits for _, hits in scene.intersect_blocks(*rays, memory=MEMORY, executor=executor)]
    for name in ("t", "primitive_id", "uv", "position", "normal"):
        np.testing.assert_array_equal(np.concatenate([getattr(one, name) for one in answers]), getattr(whole, name))
    shaded = scene.occluded_blocks(rays[0][:50, None], rays[1][:60], memory=MEMORY, reduce="sum", axis=1, executor=executor)
    np.testing.assert_array_equal(shaded.result(), scene.occluded(rays[0][:50, None], rays[1][:60]).sum(axis=1))
    t = scene.intersect_blocks(
        wrt.batches.GeneratedRays(by_number, COUNT), t_max=9.0, memory=MEMORY, executor=executor, reduce={"t": "sum"}
    )
    here = scene.intersect_blocks(wrt.batches.GeneratedRays(by_number, COUNT), t_max=9.0, reduce={"t": "sum"})
    assert t.result() == here.result()


def test_workers_use_the_threads_they_have(scene, rays, executor):
    def threads(dark, axes):
        return np.full(len(dark), wrt.get_num_threads())

    for told, expected in ((None, 1), (3, 3)):
        workers = wrt.cluster.Workers(executor, threads=told)
        found = scene.occluded_blocks(rays[0][:, None], rays[1][:, None], reduce=threads, axis=1, executor=workers).result()
        assert set(found) == {expected}


def test_the_scene_is_sent_where_no_folder_is_shared(scene, rays, client, executor, monkeypatch):
    """Once to each worker, also to those that come later."""
    other = wrt.Scene(wrt.TriangleMesh(scene.meshes[0].vertices * np.float32(1.5), scene.meshes[0].faces), device="cpu")
    monkeypatch.setattr(shared_files, "is_visible", lambda path: False)
    blocks = other.occluded_blocks(*rays, memory=MEMORY, executor=executor)
    np.testing.assert_array_equal(blocks.result(), other.occluded(*rays))
    places = client.run(lambda: list(__import__("wrt.query.batches.shared_files", fromlist=["received"]).received.values()))
    assert all(len(paths) == 1 and "wrt-scene-" in paths[0] for paths in places.values())


def test_a_worker_that_is_killed(scene, client, executor, tmp_path):
    generated = wrt.batches.GeneratedRays(Once(tmp_path / "mark", die), COUNT)
    found = scene.count_blocks(generated, memory=MEMORY, executor=executor).result()
    np.testing.assert_array_equal(found, scene.count(*by_number(0, COUNT)))
    assert not (tmp_path / "mark").exists()
    wait_for_workers(client)


def test_a_worker_that_dies_while_its_answer_is_fetched(scene, rays, executor, monkeypatch):
    """The answer is there and its task is being repeated: Dask's own future raises then."""
    gather = distributed.Client._gather

    async def gather_and_lose(self, futures, *args, **kwargs):
        answers = await gather(self, futures, *args, **kwargs)
        for future in futures:
            future._state.lose()
        return answers

    monkeypatch.setattr(distributed.Client, "_gather", gather_and_lose)
    with pytest.raises(ValueError, match="unpack"):
        executor.submit(np.ones, 7).result()
    found = scene.count_blocks(*rays, memory=MEMORY, executor=executor).result()
    np.testing.assert_array_equal(found, scene.count(*rays))


def test_an_executor_that_was_shut_down(scene, rays, client):
    """Takes nothing more; what it was given is cancelled."""
    own = client.get_executor()
    task = submit_to_dask(own, sleep, 2.0)
    own.shutdown(wait=False)
    with pytest.raises(BaseException, match=r"(?i)cancel"):
        task.result(timeout=20)
    with pytest.raises(RuntimeError, match="shut down"):
        scene.count_blocks(*rays, memory=MEMORY, executor=own).result()


def test_a_worker_that_is_out_of_memory(scene, client, executor, tmp_path):
    """Its nanny ends it; the block goes to another one."""
    generated = wrt.batches.GeneratedRays(Once(tmp_path / "mark", fill_memory), COUNT)
    found = scene.count_blocks(generated, memory=MEMORY, executor=executor).result()
    np.testing.assert_array_equal(found, scene.count(*by_number(0, COUNT)))
    assert not (tmp_path / "mark").exists()
    wait_for_workers(client)


def test_a_block_that_kills_every_worker(scene, client, executor, tmp_path):
    """Ends the batch, with advice."""

    def deadly(first, count):
        if first <= COUNT // 2 < first + count:
            os.kill(os.getpid(), signal.SIGKILL)
        return by_number(first, count)

    workers = wrt.cluster.Workers(executor, retries=0)
    with pytest.raises(RuntimeError, match="lower `memory`"):
        scene.count_blocks(wrt.batches.GeneratedRays(deadly, COUNT), memory=MEMORY, executor=workers).result()
    wait_for_workers(client)


class Slow:
    """Rays by number that take their time."""

    def __call__(self, first: int, count: int):
        if count == ROWS:
            sleep(0.1)
        return by_number(first, count)


CLIENT = """
import sys
sys.path[:0] = {paths!r}
import warp as wp
wp.config.log_level, wp.config.cpu_compiler_flags = wp.LOG_ERROR, {flags!r}
import wrt
from distributed import Client
from tests.cluster.test_dask_cluster import COUNT, MEMORY, Slow
scene = wrt.Scene.load({scene!r}, device="cpu")
with Client({address!r}) as client:
    blocks = scene.occluded_blocks(wrt.batches.GeneratedRays(Slow(), COUNT), memory=MEMORY, executor=client.get_executor())
    wrt.cluster.Job({folder!r}, blocks).run()
"""


def test_a_client_that_is_killed_and_another_one(scene, client, executor, tmp_path):
    """While a client runs a job, another one is refused; when it is killed, that one goes on with what workers wrote."""
    scene.save(tmp_path / "scene.npz")
    folder = JobFolder(tmp_path / "job")
    given = {"scene": str(tmp_path / "scene.npz"), "folder": str(folder.path), "address": client.scheduler.address}
    (tmp_path / "client.py").write_text(CLIENT.format(paths=PATHS, flags=wp.config.cpu_compiler_flags, **given))
    other = subprocess.Popen([sys.executable, str(tmp_path / "client.py")])
    try:
        end = monotonic() + 120.0
        while len(folder.done()) < 2:
            assert other.poll() is None
            assert monotonic() < end
            sleep(0.01)
        job = wrt.cluster.Job(
            folder.path, scene.occluded_blocks(wrt.batches.GeneratedRays(Slow(), COUNT), memory=MEMORY, executor=executor)
        )
        with pytest.raises(RuntimeError, match=f"being run by process {other.pid} on"):
            job.run()
    finally:
        other.kill()
        other.wait()
    times = {number: folder.chunk_path(number).stat().st_mtime_ns for number in folder.done()}
    assert 2 <= len(times) < COUNT // ROWS
    np.testing.assert_array_equal(job.run().result(), scene.occluded(*by_number(0, COUNT)))
    assert times.items() <= {number: folder.chunk_path(number).stat().st_mtime_ns for number in folder.done()}.items()
    folder.chunk_path(1).write_bytes(b"damaged")
    np.testing.assert_array_equal(job.result(), scene.occluded(*by_number(0, COUNT)))


def test_arrays_of_dask_and_xarray(scene, rays, client):
    da = pytest.importorskip("dask.array")
    xarray = pytest.importorskip("xarray")
    hits = scene.intersect(*rays)
    origins = da.from_array(rays[0], chunks=(700, 2))
    for name in ("t", "primitive_id", "uv", "normal"):
        lazy = wrt.cluster.map_rays(scene, origins, rays[1], name, client=client)
        assert (lazy.shape, lazy.dtype) == (getattr(hits, name).shape, getattr(hits, name).dtype)
        np.testing.assert_array_equal(lazy.compute(), getattr(hits, name))
    shaded = wrt.cluster.map_rays(scene, origins[:, None], rays[1][:40], "occluded").sum(axis=1)
    np.testing.assert_array_equal(shaded.compute(), scene.occluded(rays[0][:, None], rays[1][:40]).sum(axis=1))
    labelled = xarray.DataArray(origins, dims=["point", "xyz"], coords={"point": np.arange(COUNT) * 2})
    count = wrt.cluster.map_rays(scene, labelled, [0.0, 0.0, 1.0], "count", t_max=5.0)
    assert count.dims == ("point",)
    np.testing.assert_array_equal(
        count.sel(point=[8, 800]).compute(), scene.count(rays[0][[4, 400]], [0.0, 0.0, 1.0], t_max=5.0)
    )
    with pytest.raises(TypeError, match="array of Dask"):
        wrt.cluster.map_rays(scene, *rays)
    with pytest.raises(ValueError, match="'depth'; choose from t"):
        wrt.cluster.map_rays(scene, origins, rays[1], "depth")
    with pytest.raises(ValueError, match=r"shape \(..., 3\)"):
        wrt.cluster.map_rays(scene, origins[:, :2], rays[1])

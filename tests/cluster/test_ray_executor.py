"""Ray: its tasks as an executor of a few lines, as the guide on clusters shows it."""

from __future__ import annotations

import os
import signal
from concurrent.futures import Executor, Future
from pathlib import Path

import numpy as np
import pytest
from support.hits import mixed_rays

import wrt
from wrt.query.blocks import BYTES_PER_RAY

ray = pytest.importorskip("ray", reason="Ray is not installed: pip install ray")

COUNT = 2000
MEMORY = 400 * BYTES_PER_RAY
PATHS = [str(Path(__file__).parents[2]), str(Path(__file__).parents[1])]


class RayExecutor(Executor):
    """Tasks of Ray, two at a time; Ray itself does not repeat them."""

    _max_workers = 2

    def submit(self, function, /, *args, **keywords) -> Future:
        return ray.remote(max_retries=0)(function).remote(*args, **keywords).future()


@pytest.fixture(scope="module")
def executor():
    """Two workers of one thread. Ray reports nothing, and writes no token to the user's folder."""
    variables = {"PYTHONPATH": os.pathsep.join([*PATHS, os.environ.get("PYTHONPATH", "")]), "WRT_NUM_THREADS": "1"}
    quiet = {"include_dashboard": False, "log_to_driver": False, "object_store_memory": 100_000_000}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_AUTH_MODE", "disabled")
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        ray.init(num_cpus=2, _node_ip_address="127.0.0.1", runtime_env={"env_vars": variables}, **quiet)
        yield RayExecutor()
        ray.shutdown()


@pytest.fixture(scope="module")
def scene() -> wrt.Scene:
    return wrt.Scene(wrt.scenes.build("teapot", level=4), device="cpu")


def around(first: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    number = np.arange(first, first + count)[:, None]
    return np.float64([0.1, 0.2, 3.0]), np.sin(number * [1.0, 1.7, 2.3] + 0.5)


class DyingOnce:
    """Rays by number; the process that is the first to make those of the middle dies."""

    def __init__(self, mark: Path) -> None:
        mark.touch()
        self.mark = str(mark)

    def __call__(self, first: int, count: int) -> tuple[np.ndarray, np.ndarray]:
        if first <= COUNT // 2 < first + count:
            try:
                os.unlink(self.mark)
            except FileNotFoundError:
                return around(first, count)
            os.kill(os.getpid(), signal.SIGKILL)
        return around(first, count)


def test_same_bits(scene, executor):
    rays = mixed_rays(scene.meshes[0], COUNT, seed=4)
    whole = scene.intersect(*rays)
    answers = [hits for _, hits in scene.intersect_blocks(*rays, memory=MEMORY, executor=executor)]
    for name in ("t", "primitive_id", "uv", "position", "normal"):
        np.testing.assert_array_equal(np.concatenate([getattr(one, name) for one in answers]), getattr(whole, name))
    dark = scene.occluded_blocks(*rays, memory=MEMORY, reduce="sum", executor=executor).result()
    assert dark == scene.occluded(*rays).sum()


def test_a_worker_that_is_killed(scene, executor, tmp_path):
    """Its block is submitted again: the error by which Ray says so was not known."""
    generated = wrt.batches.GeneratedRays(DyingOnce(tmp_path / "mark"), COUNT)
    found = scene.count_blocks(generated, memory=MEMORY, executor=executor).result()
    np.testing.assert_array_equal(found, scene.count(*around(0, COUNT)))
    assert not (tmp_path / "mark").exists()
    generated = wrt.batches.GeneratedRays(DyingOnce(tmp_path / "mark"), COUNT)
    once = wrt.cluster.Workers(executor, retries=0)
    with pytest.raises(Exception, match="died"):
        scene.count_blocks(generated, memory=MEMORY, executor=once).result()

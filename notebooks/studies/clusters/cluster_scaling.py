"""How a batch gains from processes: sun hours of a town, by one process and by several, in turn, and what a task costs.

Each process has one thread, or one GPU. What the same number of processes answers in a round is compared with one process in
that round. The cost of a task is the time of tasks of one ray, by their number: with one process, all that is done for a task.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

from studies.clusters.town import ground_points, sun_directions
from wrt.query.batches.workers import ProcessPool
from wrt.query.blocks import BYTES_PER_RAY, Blocks
from wrt.scene.scene import Scene

TINY_TASKS = 300
"""Tasks of one ray, by which the cost of a task is measured."""


@dataclass(frozen=True)
class Scaling:
    """What was measured of a number of processes.

    Attributes:
        name: of the executor.
        workers: number of processes.
        seconds: median of the rounds.
        gain: time of one process / their time in the same round, median of the rounds.
        task_seconds: of a task of one ray, by the time of all and their number.
    """

    name: str
    workers: int
    seconds: float
    gain: float
    task_seconds: float


@contextmanager
def process_pool(workers: int, devices: Sequence[str]) -> Iterator[Any]:
    """Processes of this machine, each with one thread, or with a device of its own."""
    with ProcessPool(workers, threads=1, devices=devices[:workers] or None) as pool:
        yield pool


@contextmanager
def dask_cluster(workers: int, devices: Sequence[str]) -> Iterator[Any]:
    """Workers of Dask on this machine; with GPUs, all tasks of a worker go to the device of its number."""
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0") as cluster,
        Client(cluster) as client,
    ):
        yield client.get_executor()


EXECUTORS = {"processes": process_pool, "dask": dask_cluster}


def sun_blocks(scene: Scene, points: np.ndarray, suns: np.ndarray, task_rays: int, executor: Any = None) -> Blocks:
    """Numbers of directions from which each point has no sun, in tasks of about this many rays."""
    rows = max(1, task_rays // len(suns))
    memory = rows * len(suns) * BYTES_PER_RAY
    return scene.occluded_blocks(points[:, None], suns, memory=memory, reduce="sum", axis=1, executor=executor)


def measure(
    scene: Scene,
    counts: Sequence[int],
    names: Sequence[str],
    points: int,
    suns: int,
    task_rays: int,
    rounds: int,
    devices: Sequence[str],
    on_turn: Callable[[str], None],
) -> tuple[list[Scaling], bool]:
    """Times numbers of processes in turn; also says whether all gave the same bits.

    Args:
        scene: the town.
        counts: numbers of processes, of which the first is what others are compared with.
        names: of `EXECUTORS`.
        points, suns: numbers of points and of directions.
        task_rays: rays of a task.
        rounds: how often each is measured.
        devices: of the processes; empty for the CPU.
        on_turn: called with the name of each turn.
    """
    where, directions = ground_points(scene.meshes[0], points), sun_directions(suns)
    times: dict[tuple[str, int], list[float]] = {}
    answers, tasks = [], {}
    with ExitStack() as stack:
        pools = {(name, count): stack.enter_context(EXECUTORS[name](count, devices)) for name in names for count in counts}
        for key, pool in pools.items():  # workers load the scene and their kernels
            for _ in range(3):
                sun_blocks(scene, where[: 64 * key[1]], directions, max(task_rays // 16, 8 * suns), pool).result()
            tasks[key] = task_cost(scene, where, pool)
        for _ in range(rounds):
            for key, pool in pools.items():
                on_turn(f"{key[1]} {key[0]}")
                start = perf_counter()
                answers.append(sun_blocks(scene, where, directions, task_rays, pool).result())
                times.setdefault(key, []).append(perf_counter() - start)
    rows = []
    for (name, count), seconds in times.items():
        gains = [one / own for one, own in zip(times[name, counts[0]], seconds, strict=True)]
        rows.append(Scaling(name, count, median(seconds), median(gains), tasks[name, count]))
    return rows, all(np.array_equal(answers[0], one) for one in answers)


def task_cost(scene: Scene, points: np.ndarray, pool: Any) -> float:
    """Seconds of a task of one ray: of many, by their number."""
    few = points[np.arange(TINY_TASKS) % len(points)]
    start = perf_counter()
    scene.occluded_blocks(few, [0.0, 0.0, 1.0], memory=BYTES_PER_RAY, reduce="sum", executor=pool).result()
    return (perf_counter() - start) / TINY_TASKS

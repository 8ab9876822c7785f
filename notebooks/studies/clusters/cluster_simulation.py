"""A model of time and bytes of a batch on 1 to 1,000 workers, and a simulation of it, event by event.

Assumed: the client takes a fixed time for each task (submit, receive), one after the other; a task takes a fixed overhead of
its worker and the time of its rays, which differs from task to task by a lognormal factor; messages take a fixed time each way;
workers are alike and have a core of their own; no more than the window's number of tasks are submitted at a time; the network
carries the scene once to each worker through one link (not where files are shared), and the bytes of tasks and answers. Not
modelled: other load, a scheduler that is slow by itself, file systems under load, and failures.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ClusterModel:
    """What a batch costs.

    Attributes:
        rays: of the batch.
        rays_a_second: of a worker.
        rays_a_task: of a block.
        client_seconds: of the client, for each task.
        task_seconds: of a worker, for each task beside its rays.
        latency: seconds of a message.
        spread: standard deviation of the logarithm of a task's time.
        start_seconds: of a worker, to load the scene.
        scene_bytes, task_bytes, answer_bytes: of the scene's file, a task and its answer.
        link: bytes a second of the client's network.
    """

    rays: float
    rays_a_second: float
    rays_a_task: float
    client_seconds: float = 0.002
    task_seconds: float = 0.001
    latency: float = 0.0005
    spread: float = 0.2
    start_seconds: float = 1.0
    scene_bytes: float = 1e8
    task_bytes: float = 2000.0
    answer_bytes: float = 1000.0
    link: float = 1.25e9

    @property
    def tasks(self) -> int:
        """Number of tasks."""
        return max(1, int(np.ceil(self.rays / self.rays_a_task)))

    def bound(self, workers: int) -> float:
        """Seconds by the formula: the start, and what takes longer, the workers' share or the client's time for all tasks."""
        each = self.rays_a_task / self.rays_a_second + self.task_seconds
        share = np.ceil(self.tasks / workers) * each
        return self.start(workers) + max(share, self.tasks * self.client_seconds) + 2 * self.latency

    def start(self, workers: int) -> float:
        """Seconds until the workers have the scene, if it comes through the client's link."""
        return self.start_seconds + workers * self.scene_bytes / self.link

    def bytes(self, workers: int) -> float:
        """Bytes that the network carries."""
        return workers * self.scene_bytes + self.tasks * (self.task_bytes + self.answer_bytes)


def simulate(model: ClusterModel, workers: int, seed: int = 0) -> float:
    """Seconds of a batch, event by event.

    Args:
        model: what things cost.
        workers: their number; the window is twice as large, and two.
        seed: of the tasks' times.
    """
    rng = np.random.default_rng(seed)
    factors = rng.lognormal(-(model.spread**2) / 2, model.spread, model.tasks)
    seconds = factors * (model.rays_a_task / model.rays_a_second) + model.task_seconds
    free = [model.start(workers)] * workers
    under_way: list[float] = []
    clock, submitted = 0.0, 0
    while submitted < model.tasks or under_way:
        if submitted < model.tasks and len(under_way) < 2 * workers + 2:
            clock += model.client_seconds
            begun = max(clock + model.latency, heapq.heappop(free))
            done = begun + seconds[submitted]
            heapq.heappush(free, done)
            heapq.heappush(under_way, done + model.latency)
            submitted += 1
        else:
            clock = max(clock, heapq.heappop(under_way))
    return clock

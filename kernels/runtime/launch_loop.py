"""Loops of kernel launches that depend on numbers in memory, such as the levels of a tree; on the CPU they run without Python.

On the CPU the launches are chained jobs of the thread pool (`wrt.kernels.runtime.job_queue`, programs). The number of items of
a job, and whether the loop continues, are read from memory when the previous job has ended. A step therefore costs a few
microseconds besides its work (notebooks/records/2026-11-22-launches.md). On CUDA, and with one thread, Python runs the loop.
"""

import ctypes
import itertools
from collections.abc import Container, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from wrt.kernels.runtime import pool as native
from wrt.kernels.runtime.argument_packing import PackedKernel
from wrt.kernels.runtime.launch import get_num_threads, launch, load
from wrt.kernels.runtime.schedules import DEFAULT_SCHEDULE, SCHEDULES


@dataclass(frozen=True)
class Step:
    """A launch in a loop of launches.

    Attributes:
        kernel, inputs: as in `launch`.
        count: number of items; None if it is read from the loop's numbers.
        number: index of the number of items among the loop's numbers.
    """

    kernel: wp.Kernel
    inputs: Sequence[Any]
    count: int | None = None
    number: int = 0

    def items(self, numbers: np.ndarray) -> int:
        """Current number of items of the step."""
        return int(numbers[self.number]) if self.count is None else self.count


class LaunchLoop:
    """A loop in native code, packed for repeated runs with one number of threads; arguments as in `launch_loop`."""

    def __init__(self, turns: Sequence[Sequence[Step]], numbers: wp.array, device: wp.Device) -> None:
        self.numbers = numbers
        threads, schedule = get_num_threads(), SCHEDULES[DEFAULT_SCHEDULE]
        self._packed, self._jobs, self._memory = [], [], []
        for steps in turns:
            for step in steps:
                packed = PackedKernel(step.kernel, [0, *step.inputs], device)
                job, used = native.new_job(
                    packed, step.count or 0, max_chunk=1, min_chunk=1, threads=threads, schedule=schedule
                )
                if step.count is None:
                    job.count_at = numbers.ptr + 4 * step.number
                self._packed.append(packed)
                self._jobs.append(job)
                self._memory.append(used)
            self._jobs[-1].while_at = numbers.ptr
        for job, following in zip(self._jobs, [*self._jobs[1:], self._jobs[0]], strict=True):
            job.following = ctypes.addressof(following)

    def update(self, turns: Sequence[Sequence[Step]]) -> None:
        """Replaces the arguments of the same steps; `PackedKernel.update`."""
        for packed, step in zip(self._packed, itertools.chain.from_iterable(turns), strict=True):
            packed.update([0, *step.inputs])

    def forget(self, but: Container[int]) -> None:
        """`PackedKernel.forget`."""
        for packed in self._packed:
            packed.forget(but)

    def run(self) -> None:
        """Runs the loop."""
        native.the_pool().run(self._jobs[0], (self._jobs, self._memory, self.numbers))


def has_native_loop(device: wp.Device) -> bool:
    """Whether the calling thread's loops on a device run in native code."""
    return device.is_cpu and get_num_threads() > 1 and native.is_available()


def launch_loop(turns: Sequence[Sequence[Step]], numbers: wp.array, device: wp.Device) -> None:
    """Runs the steps of each turn in order, and cycles through the turns until the first element of `numbers` is 0.

    On the CPU no Python runs between steps; elsewhere the host reads `numbers` before each turn. Every item is a chunk.

    Args:
        turns: at least one turn, each of at least one step.
        numbers: (N,) int32, changed by the steps.
        device: device of the arrays.
    """
    load([step.kernel for steps in turns for step in steps], device)
    if has_native_loop(device):
        LaunchLoop(turns, numbers, device).run()
        return
    for steps in itertools.cycle(turns):
        now = numbers.numpy()
        if now[0] == 0:
            return
        for step in steps:
            launch(step.kernel, step.items(now), step.inputs, device=device, chunk=1)

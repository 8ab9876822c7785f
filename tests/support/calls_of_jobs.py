"""Valid arguments of threads, jobs, workers and reductions."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import wrt
from support.call_objects import Call, rays, scene


def job_calls() -> Iterator[Call]:
    yield Call("set_num_threads", with_threads, {"count": 2})
    yield Call("show_compiling", with_shown, {"show": False})
    yield Call("Job.run", run_job, {"most": 1})
    yield Call("Workers", lambda **o: wrt.cluster.Workers(executor(), **o), {"threads": 2, "window": 2, "retries": 1})
    yield Call("ProcessPool", pool, {"workers": 2, "threads": 2})
    yield Call("Histogram", wrt.batches.Histogram, {"edges": [0.0, 1.0, 2.0]})


def with_threads(count: Any) -> int:
    before = wrt.get_num_threads()
    try:
        wrt.set_num_threads(count)
        return wrt.get_num_threads()
    finally:
        wrt.set_num_threads(before)


def with_shown(show: Any) -> None:
    try:
        wrt.device.show_compiling(show)
    finally:
        wrt.device.show_compiling(None)


def run_job(most: Any) -> int:
    with tempfile.TemporaryDirectory() as path:
        job = wrt.cluster.Job(Path(path) / "job", scene().occluded_blocks(*rays(), memory=1))
        return job.run(most).status.done


@cache
def executor() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1)


def pool(**options: Any) -> str:
    with wrt.cluster.ProcessPool(**options) as made:
        return repr(made)

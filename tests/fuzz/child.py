"""The process that runs cases and may crash: `python -m tests.fuzz.child '{"what": "meshes", "seed": 1, ...}'`.

It tells how far it is through a small file that the driver reads, whatever becomes of the process, and writes what fails to a
folder. Standard error goes to a log, with the traceback of a crash.
"""

from __future__ import annotations

import faulthandler
import json
import logging
import resource
import sys
import time
import traceback
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np

from .cases import Case

MODULES = {"meshes": "building", "rays": "tracing", "files": "files", "loaders": "loaders"}
"""Where the cases of each kind are made and run."""

FIELDS = ("number", "running", "done", "refused", "failed", "ready")
"""What the progress file tells: the case's number, whether it is under way, counts, and whether kernels are loaded."""

MEMORY = 6 << 30
"""Bytes of addresses that a process may take beyond what it has when it begins: a file that asks for more is a failure."""

REPEATS = 20
"""Failures of a job that are kept."""


@dataclass(frozen=True)
class Job:
    """What a child does.

    Attributes:
        what: "meshes", "rays", "files" or "loaders".
        seed: of all cases.
        first, step: numbers of its cases.
        cases: how many at most.
        seconds: for how long at most.
        threads: of builds; with more than one, builders divide their work as they do for large meshes.
        folder: where the progress and what fails are written.
        replay: paths of cases to run instead.
        compiler_flags: for kernels on the CPU; None for those of users.
    """

    what: str
    seed: int
    first: int
    step: int
    cases: int
    seconds: float
    threads: int
    folder: str
    replay: tuple[str, ...] = ()
    compiler_flags: str | None = None

    def text(self) -> str:
        """As the child takes it."""
        return json.dumps(asdict(self))


def case_of(what: str, seed: int, number: int) -> Case:
    """The case of that number."""
    return module_of(what).make_case(np.random.default_rng([seed, list(MODULES).index(what), number]))


def module_of(what: str) -> ModuleType:
    """Where its cases are made and run."""
    return import_module(f".{MODULES[what]}", __package__)


def prepare(what: str, threads: int, compiler_flags: str | None = None) -> None:
    """Guards memory, and makes builders cut small meshes into parts."""
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    if compiler_flags is not None:
        wp.config.cpu_compiler_flags = compiler_flags
    wp.init()
    from wrt.kernels.runtime.launch import set_num_threads

    from .guards import GuardedAllocator

    logging.disable(logging.CRITICAL)  # readers of files log what is wrong with them
    set_num_threads(threads)
    GuardedAllocator.install()
    if what == "meshes":
        module_of(what).open_doors()
    if threads > 1:
        share_small_work()


def share_small_work() -> None:
    """Makes what only large meshes meet happen with small ones: levels that threads split together, chunks, cells."""
    from wrt.builders.bvh import binned_bvh as bvh
    from wrt.builders.classics.kdtree import streaming
    from wrt.builders.core import levels as levels_engine
    from wrt.builders.kdtree import binned
    from wrt.builders.kdtree.lazy import lazy_kdtree as lazy
    from wrt.builders.kdtree.lazy import triangle_clusters as clusters

    bvh.MIN_LARGE, bvh.MIN_CHUNK, bvh.TASKS_PER_THREAD = 8, 4, 8
    streaming.EXACT, clusters.MIN_CHUNK, clusters.TRIANGLES_PER_CELL = 12, 16, 1
    lazy.LARGE = levels_engine.CHUNK = 12
    for name in ("LARGE", "MIN_LARGE"):
        if hasattr(binned, name):
            setattr(binned, name, 12)


def run(job: Job) -> None:
    """Runs the job's cases."""
    progress = np.memmap(Path(job.folder) / "progress", dtype=np.int64, mode="r+", shape=(len(FIELDS),))
    count = dict.fromkeys(FIELDS, 0)

    def tell(**values: int) -> None:
        count.update(values)
        progress[:] = [count[name] for name in FIELDS]

    prepare(job.what, job.threads, job.compiler_flags)
    grown = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() if sys.platform == "linux" else 0
    if grown:
        resource.setrlimit(resource.RLIMIT_AS, (grown + MEMORY, grown + MEMORY))
    end = time.monotonic() + job.seconds
    numbers = range(len(job.replay)) if job.replay else range(job.first, job.first + job.cases * job.step, job.step)
    for number in numbers:
        if time.monotonic() > end:
            break
        tell(number=number, running=1, ready=1)
        case = Case.load(Path(job.replay[number])) if job.replay else case_of(job.what, job.seed, number)
        try:
            outcome = module_of(case.what).run_case(case)
        except Exception as error:  # whatever it is, it is what is looked for
            count["failed"] += 1
            if count["failed"] <= REPEATS:
                keep(case, Path(job.folder) / f"{case.what}-{job.seed}-{number}.npz", f"{type(error).__name__}: {error}")
        else:
            count["refused"] += outcome == "refused"
        tell(running=0, done=count["done"] + 1)
    tell(running=0)


def keep(case: Case, path: Path, reason: str) -> None:
    """Writes a case that failed, and why."""
    case.save(path)
    path.with_suffix(".txt").write_text(f"{reason}\n\n{case.options}\n\n{traceback.format_exc()}")


if __name__ == "__main__":
    faulthandler.enable()
    run(Job(**json.loads(sys.argv[1])))

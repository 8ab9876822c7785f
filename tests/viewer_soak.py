"""Browsers that come and leave at every stage: threads, memory, sessions and connections must stay flat.

    python -m tests.viewer_soak --count 10000

Clients are real websockets to a viewer in this process, several at a time. Each leaves at a stage that follows from its
number and the seed: before the handshake, within it, without waiting for its end, before its first camera, with it, while
its pictures are made, without an answer for a picture, or without a word. What is left is counted after every hundredth of
the run, when all have gone.

The process ends with 1 if anything of a browser stayed, or memory grew. Results go to a dated record.
"""

from __future__ import annotations

import sys
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import numpy as np

import wrt
from tests.records import write_record
from tests.soak import resident_bytes
from wrt import scenes

sys.path.insert(0, str(Path(__file__).parent))  # for support
from support.viewer_page import STAGES, leave_at, left_over

TOGETHER = 8
"""Clients at a time."""

MAX_MEMORY_GROWTH = 0.05
"""Of the last tenth of a run over its second."""

SETTLED = 30.0
"""Seconds in which all that browsers held must have gone."""


@dataclass
class Tally:
    """What a run has seen."""

    stages: Counter[str] = field(default_factory=Counter)
    rows: list[tuple[int, float, int, int]] = field(default_factory=list)
    """(clients so far, seconds, threads, bytes of memory)."""
    failures: list[str] = field(default_factory=list)

    def growth(self) -> float:
        """Memory of the last tenth of the run, relative to the second."""
        sizes = [size for *_, size in self.rows]
        part = max(len(sizes) // 10, 1)
        return float(np.mean(sizes[-part:]) / np.mean(sizes[part : 2 * part] or sizes[:1]) - 1.0)


def settle(viewer: wrt.pictures.Viewer) -> dict[str, int]:
    """Waits until nothing of browsers is there; what still is after `SETTLED` seconds."""
    end = time.monotonic() + SETTLED
    while (left := left_over(viewer)) and time.monotonic() < end:
        time.sleep(0.02)
    return left


def run(count: int, seed: int, tell: Any) -> Tally:
    """So many clients; tell(clients so far, tally) is called after each part."""
    tally, rng, begin = Tally(), np.random.default_rng(seed), time.monotonic()
    scene = wrt.Scene(scenes.build("teapot", level=4), device="cpu")
    camera = wrt.PinholeCamera(80, 60, **scenes.BUILTIN_SCENES["teapot"].camera)
    options = {"ambient": {"ambient_samples": 2}}
    part = max(count // 100, TOGETHER)
    with (
        wrt.view(scene, block=False, port=0, camera=camera, samples=64, options=options) as viewer,
        ThreadPoolExecutor(TOGETHER) as clients,
    ):
        for first in range(0, count, part):
            number = min(part, count - first)
            stages, pauses = rng.integers(len(STAGES), size=number), rng.choice([0.0, 0.0, 0.002, 0.02], size=number)
            jobs = [
                clients.submit(leave_at, viewer, camera, int(stage), float(pause))
                for stage, pause in zip(stages, pauses, strict=True)
            ]
            for job in jobs:
                if (error := job.exception()) is not None:
                    tally.failures.append(f"a client failed: {type(error).__name__}: {error}")
            tally.stages.update(STAGES[stage] for stage in stages)
            if left := settle(viewer):
                tally.failures.append(f"after {first + number:,} clients there were still {left}")
            tally.rows.append((first + number, time.monotonic() - begin, threading.active_count(), resident_bytes()))
            tell(first + number, tally)
    return tally


@click.command(help=__doc__.splitlines()[0])
@click.option("--count", type=int, default=10_000, show_default=True, help="How many browsers come.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the stages at which they leave.")
@click.option("--record", type=click.Path(path_type=Path), default=None, help="Where to write [default: notebooks/records].")
def main(count: int, seed: int, record: Path | None) -> None:
    """Exit status 1 if anything stayed or grew."""
    import warp as wp
    from rich.console import Console
    from rich.progress import Progress

    wp.config.log_level = wp.LOG_WARNING
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("browsers", total=count)

        def tell(done: int, tally: Tally) -> None:
            _, _, threads, size = tally.rows[-1]
            text = f"{done:,} browsers, {threads} threads, {size / 2**20:.0f} MiB, {len(tally.failures)} failures"
            bar.update(task, completed=done, description=text)

        tally = run(count, seed, tell)
    growth, threads = tally.growth(), [row[2] for row in tally.rows]
    failed = bool(tally.failures) or growth > MAX_MEMORY_GROWTH
    every = max(1, len(tally.rows) // 20)
    lines = [
        f"`python -m tests.viewer_soak --count {count} --seed {seed}`: {count:,} browsers came and left, {TOGETHER} at a time, "
        f"in {tally.rows[-1][1]:,.0f} s; {len(tally.failures)} failures.",
        "",
        f"Threads of the process: {min(threads)} to {max(threads)}. Memory: {tally.rows[-1][3] / 2**20:.0f} MiB at the end; "
        f"the last tenth of the run had {100 * growth:+.1f} % more than the second, in the mean.",
        "",
        *(f"* {failure}" for failure in tally.failures[:20]),
        "| browsers | s | threads | MiB |",
        "| ---: | ---: | ---: | ---: |",
        *(f"| {n:,} | {at:.0f} | {k} | {size / 2**20:.0f} |" for n, at, k, size in tally.rows[::every]),
        "",
        "| left | browsers |",
        "| --- | ---: |",
        *(f"| {stage} | {tally.stages[stage]:,} |" for stage in STAGES),
    ]
    path = write_record("viewer-soak", "Browsers that come and leave", lines, record)
    click.echo(f"{'FAILED' if failed else 'all well'}; written to {path}")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()

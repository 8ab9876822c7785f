"""Ctrl-C at random moments, again and again: `python -m tests.interrupts --count 100000`.

Child processes ask queries, build and update in a circle while a timer interrupts them as Ctrl-C does, after a random time.
After every interrupt the next answers are compared with the first ones. What must hold: no wrong answer, no crash, no hang, no
slot of the thread pool lost.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import click

from .records import write_record

LONGEST_WAIT = 0.03
"""Seconds after which an interrupt comes at the latest."""

AGAIN = 0.5
"""Seconds after which an interrupt is repeated: Python drops one that comes while an object is deleted."""

LONGEST_SILENCE = 120.0
"""Seconds after which a child that does not end counts as hung, beside what its interrupts take."""


def child(count: int, seed: int) -> None:
    """Takes so many interrupts; exit status 0 if all that was asked was answered right."""
    import random

    import numpy as np
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    import wrt
    from wrt.kernels.runtime import pool as pools

    wrt.set_num_threads(3)
    moments = random.Random(seed)
    mesh = wrt.scenes.build("teapot", level=3)
    rays = np.random.default_rng(seed).normal(size=(20_000, 3)).astype(np.float32)
    scene, kdtree, moving = (
        wrt.Scene(mesh, device="cpu"),
        wrt.Scene(mesh, "kdtree", device="cpu"),
        wrt.Scene(mesh, device="cpu"),
    )
    asked = {
        "closest": lambda: scene.intersect(rays * 9, -rays).t,
        "few": lambda: scene.intersect(rays[:50] * 9, -rays[:50]).t,
        "any": lambda: kdtree.occluded(rays * 9, -rays),
        "count": lambda: scene.count(rays[:4000] * 9, -rays[:4000]),
        "all": lambda: kdtree.intersect_all(rays[:2000] * 9, -rays[:2000]).t,
        "build": lambda: wrt.Scene(mesh, "kdtree", device="cpu").intersect(rays[:2000] * 9, -rays[:2000]).t,
        "moved": lambda: moving.intersect(rays[:2000] * 9, -rays[:2000]).t,
    }
    expected = {name: ask() for name, ask in asked.items()}
    moving.update(0, vertices=mesh.vertices)
    signal.signal(signal.SIGALRM, signal.default_int_handler)
    interrupts, others = 0, []
    while interrupts < count:
        try:
            signal.setitimer(signal.ITIMER_REAL, moments.uniform(1e-5, LONGEST_WAIT), AGAIN)
            while True:
                for name, ask in asked.items():
                    answer = ask()
                    if not np.array_equal(answer, expected[name]):
                        os.write(2, f"wrong after {interrupts} interrupts: {name}\n".encode())
                        os._exit(1)
                moving.update(0, vertices=mesh.vertices)
        except KeyboardInterrupt:
            interrupts += 1
        except (RuntimeError, ValueError, TypeError, SystemError) as error:
            interrupts += 1  # libraries that catch everything make another error of it
            others.append(f"{type(error).__name__}: {error}")
    signal.setitimer(signal.ITIMER_REAL, 0)
    lost = pools.layout.SLOTS - 1 - len(pools.the_pool()._free)
    print(len(others), *sorted(set(others)), sep="\n")
    sys.exit(f"{lost} slots of the thread pool are lost" if lost else 0)


@click.command(help=__doc__.splitlines()[0])
@click.option("--count", type=int, default=2000, show_default=True, help="Interrupts in all.")
@click.option("--processes", type=int, default=os.cpu_count(), show_default=True, help="Children at a time.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of rays and of moments.")
@click.option("--record", type=click.Path(path_type=Path), default=None, help="Where to write [default: notebooks/records].")
@click.option("--child", "is_child", is_flag=True, hidden=True)
def main(count: int, processes: int, seed: int, record: Path | None, is_child: bool) -> None:
    """Exit status 1 if a child failed."""
    if is_child:
        child(count, seed)
        return
    each, begin = -(-count // processes), time.monotonic()
    command = [sys.executable, "-W", "ignore", "-m", "tests.interrupts", "--child", "--count", str(each), "--seed"]
    children = [
        subprocess.Popen([*command, str(seed + n)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for n in range(processes)
    ]
    failures, others, sorts = [], 0, set()
    for number, process in enumerate(children):
        try:
            printed, said = process.communicate(timeout=LONGEST_SILENCE + each * 10 * LONGEST_WAIT)
        except subprocess.TimeoutExpired:
            process.kill()
            printed, said = "", "hung"
        counted, *kinds = printed.splitlines() or ["0"]
        others, sorts = others + int(counted), sorts | set(kinds)
        if process.returncode:
            failures.append(f"seed {seed + number}: exit status {process.returncode}: {said.strip()[-500:]}")
    lines = [
        f"`python -m tests.interrupts --count {count} --processes {processes} --seed {seed}`: {each * processes:,} interrupts "
        f"in {time.monotonic() - begin:,.0f} s, {len(failures)} of {processes} processes failed.",
        "",
        *(f"* {failure}" for failure in failures),
        f"{others} of them came out as another error than KeyboardInterrupt, from libraries that catch everything:",
        "",
        *(f"* {sort}" for sort in sorted(sorts)),
    ]
    path = write_record("interrupts", "Interrupts at random moments", lines, record)
    click.echo("\n".join([lines[0], *failures, f"written to {path}"]))
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()

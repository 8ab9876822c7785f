"""Mixed load for an hour, or however long: `python -m tests.soak --minutes 60`.

Four threads ask scenes of every kind all queries, build, update, save, load and pickle, and compare every answer with that of
the first round. Memory is read every few seconds. What must hold: no wrong answer, no error, and memory that is as high at the
end as after the first tenth of the run.
"""

from __future__ import annotations

import pickle
import random
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import click
import numpy as np

import wrt

from .records import write_record

THREADS = 4
MAX_MEMORY_GROWTH = 0.02
"""Share of the memory after the first tenth by which the last tenth may be higher: what an allocator does not give back."""


@dataclass
class Load:
    """What a run has done.

    Attributes:
        done: how often each job ran.
        errors: what went wrong.
        memory: (seconds, bytes resident) over time.
    """

    done: Counter[str] = field(default_factory=Counter)
    errors: list[str] = field(default_factory=list)
    memory: list[tuple[float, int]] = field(default_factory=list)

    def growth(self) -> float:
        """Mean memory of the last tenth of the run over that of the second tenth, less 1."""
        seconds, resident = np.array(self.memory).T
        tenths = seconds / seconds[-1]
        return float(resident[tenths >= 0.9].mean() / resident[(tenths >= 0.1) & (tenths < 0.2)].mean() - 1.0)


def resident_bytes() -> int:
    """Memory of this process."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) * 1024
    raise OSError("no VmRSS in /proc/self/status")


def jobs(folder: Path, number: int) -> dict[str, Callable[[], list[np.ndarray]]]:
    """What a thread does, by name; each returns answers that are always the same."""
    rng = np.random.default_rng(number)
    mesh = wrt.scenes.build("teapot", level=3)
    soup = wrt.scenes.build("random_triangles", count=700, size=0.4, seed=3)
    low, high = mesh.bounds
    origins = rng.uniform(low - 0.2, high + 0.2, (3000, 3)).astype(np.float32)
    directions = rng.normal(size=(3000, 3)).astype(np.float32)
    camera = wrt.PinholeCamera.framing(mesh, 96, 64)
    scenes = {"bvh": wrt.Scene(mesh, "bvh"), "kdtree": wrt.Scene([mesh, soup], "kdtree")}
    copies = wrt.Scene([wrt.Instance(mesh), wrt.Instance(soup, np.diag([0.5, 0.5, 2.0, 1.0]))])
    moving, path = wrt.Scene(mesh), folder / f"scene-{number}.npz"

    def closest(scene: wrt.Scene) -> list[np.ndarray]:
        hits = scene.intersect(origins, directions)
        return [hits.t, hits.primitive_id, hits.uv, hits.position, hits.normal]

    def everything(scene: wrt.Scene) -> list[np.ndarray]:
        lists = scene.intersect_all(origins, directions)
        return [lists.t, lists.primitive_id, lists.offsets]

    def updated() -> list[np.ndarray]:
        moving.update(0, vertices=mesh.vertices * 1.5)
        there = closest(moving)
        moving.update(0, vertices=mesh.vertices)
        return there + closest(moving)

    def stored() -> list[np.ndarray]:
        scenes["bvh"].save(path)
        return closest(wrt.Scene.load(path))

    work: dict[str, Callable[[], list[np.ndarray]]] = {}
    for name, scene in {**scenes, "instances": copies}.items():
        work |= {
            f"{name}: closest": lambda s=scene: closest(s),
            f"{name}: few": lambda s=scene: [s.intersect(origins[7], directions[7]).t, s.occluded(origins[:9], directions[:9])],
            f"{name}: any": lambda s=scene: [s.occluded(origins, directions)],
            f"{name}: count": lambda s=scene: [s.count(origins, directions)],
            f"{name}: all": lambda s=scene: everything(s),
            f"{name}: view": lambda s=scene: [s.intersect(camera.rays()).t],
            f"{name}: picture": lambda s=scene: [wrt.render(s, camera)],
            f"{name}: inside": lambda s=scene: [s.contains(origins)],
            f"{name}: visible": lambda s=scene: [s.visible(origins[:40, None], origins[:40])],
            f"{name}: blocks": lambda s=scene: [h.t for _, h in s.intersect_blocks(origins, directions, memory="64 kB")],
        }
    build = {"build bvh": "bvh", "build kdtree": "kdtree"}
    work |= {name: lambda kind=kind: closest(wrt.Scene(mesh, kind)) for name, kind in build.items()}
    work |= {
        "update": updated,
        "save and load": stored,
        "pickle": lambda: closest(pickle.loads(pickle.dumps(scenes["bvh"]))),
        "skip": lambda: [scenes["bvh"].intersect(origins, directions, skip=scenes["bvh"].intersect(origins, directions)).t],
        "precise": lambda: [scenes["bvh"].intersect(origins[:300], directions[:300], precise=True).t],
    }
    return work


def run(minutes: float, seed: int, tell: Callable[[float, Load], None]) -> Load:
    """Runs all threads for that time; tell: called with the seconds so far."""
    load, end, begin = Load(), threading.Event(), time.monotonic()

    def work(number: int, folder: Path) -> None:
        try:
            mine, order = jobs(folder, number), random.Random(seed * THREADS + number)
            expected = {name: job() for name, job in mine.items()}
            left = list(mine)  # every job once, however short the run
            while left or not end.is_set():
                name = left.pop() if left else order.choice(list(mine))
                answers = mine[name]()
                load.done[name] += 1
                if not all(np.array_equal(a, b, equal_nan=True) for a, b in zip(answers, expected[name], strict=True)):
                    load.errors.append(f"{name}: another answer than at first")
        except Exception as error:
            load.errors.append(f"{type(error).__name__}: {error}")

    with tempfile.TemporaryDirectory() as folder:
        threads = [threading.Thread(target=work, args=(number, Path(folder))) for number in range(THREADS)]
        for thread in threads:
            thread.start()
        try:
            while (elapsed := time.monotonic() - begin) < 60.0 * minutes and not load.errors:
                load.memory.append((elapsed, resident_bytes()))
                tell(elapsed, load)
                time.sleep(min(5.0, 0.6 * minutes))
        finally:
            end.set()
            for thread in threads:
                thread.join()
    return load


@click.command(help=__doc__.splitlines()[0])
@click.option("--minutes", type=float, default=60.0, show_default=True, help="For how long.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the order of jobs.")
@click.option("--record", type=click.Path(path_type=Path), default=None, help="Where to write [default: notebooks/records].")
def main(minutes: float, seed: int, record: Path | None) -> None:
    """Exit status 1 if an answer was wrong, something failed, or memory grew."""
    import warp as wp
    from rich.console import Console
    from rich.progress import Progress

    wp.config.log_level = wp.LOG_WARNING
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("mixed load", total=60.0 * minutes)

        def tell(elapsed: float, load: Load) -> None:
            text = f"{sum(load.done.values()):,} jobs, {load.memory[-1][1] / 2**20:.0f} MiB"
            bar.update(task, completed=elapsed, description=text)

        load = run(minutes, seed, tell)
    growth = load.growth()
    failed = bool(load.errors) or growth > MAX_MEMORY_GROWTH
    count, kinds = sum(load.done.values()), len(load.done)
    lines = [
        f"`python -m tests.soak --minutes {minutes:g} --seed {seed}`: {count:,} jobs of {kinds} kinds by {THREADS} threads, "
        f"{len(load.errors)} errors.",
        "",
        f"Memory: {load.memory[-1][1] / 2**20:.0f} MiB at the end. The last tenth of the run had {100 * growth:+.1f} % more "
        "than the second, in the mean.",
        "",
        *(f"* {error}" for error in load.errors),
        "| minute | MiB |",
        "| ---: | ---: |",
        *(f"| {at / 60:.1f} | {size / 2**20:.0f} |" for at, size in load.memory[:: max(1, len(load.memory) // 20)]),
        "",
        "| job | runs |",
        "| --- | ---: |",
        *(f"| {name} | {count:,} |" for name, count in sorted(load.done.items())),
    ]
    click.echo(f"{'FAILED' if failed else 'all well'}; written to {write_record('soak', 'Mixed load', lines, record)}")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()

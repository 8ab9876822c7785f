"""Rays at edges and vertices of hostile closed bodies, over all trees and traversals: none may pass between triangles.

    python -m tests.leaks --rays 1e9

Rays go in batches, each at a body, on a tree and by a traversal that follow from its number and the seed: a run repeats, and
one that ends early has seen a little of everything. What holds of a batch:

    from inside    The closest hit is not missed, and the surface is crossed an odd number of times.
    from outside   Aimed at a feature from beyond it, through the body's inside, rays cross the surface an even number of times,
                   at least twice; just twice, but for bodies that rounding to float32 leaves closed, not convex.
    a part of it   The hits are those of brute force, to the bit, and so are the counts.

The process ends with 1 if one of these failed. Results go to a dated record, by tree and by body.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path

import click
import numpy as np

import wrt
from wrt.bench.core.benchmark_results import machine
from wrt.builders.bvh import BVH_BUILDERS
from wrt.builders.kdtree import KDTREE_BUILDERS, BuilderCapabilities
from wrt.engine.facts.query_kinds import CLOSEST, COUNT
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.capabilities import Capabilities

sys.path.insert(0, str(Path(__file__).parent))  # for support
from support.hostile_bodies import Body, bodies

RECORDS = Path(__file__).resolve().parents[1] / "notebooks" / "records"
BATCH = 1 << 17
"""Rays of a batch."""

BRUTE = 1 << 21
"""Pairs of a ray and a triangle of a batch that are tested by brute force, besides."""

UNEVEN = ("graded box", "rod", "needle", "lens", "fans", "poles")
"""Bodies that float32 leaves closed, but not convex."""


@dataclass
class Tally:
    """What a run has seen."""

    rays: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)

    def note(self, keys: tuple[str, ...], rays: int, failed: dict[str, int], where: str) -> None:
        """Counts the rays of a batch under each key, and notes how many of them failed which check."""
        for key in ("all", *keys):
            self.rays[key] += rays
        self.failures += [f"{number} of {rays}: {what}; {where}" for what, number in failed.items() if number]


def trees(triangles: int) -> dict[str, wrt.KdTree | wrt.Bvh]:
    """Every kind of tree for so many triangles."""
    found: dict[str, wrt.KdTree | wrt.Bvh] = {f"bvh {name}": wrt.Bvh(builder=name) for name in BVH_BUILDERS}
    found["bvh of width 4"] = wrt.Bvh(width=4)
    for name, builder in KDTREE_BUILDERS.items():
        if triangles <= builder.max_triangles:
            found[f"kdtree {name}"] = wrt.KdTree(builder=name)
            if BuilderCapabilities.CLIPS in builder.capabilities:
                found[f"kdtree {name}, clipped"] = wrt.KdTree(builder=name, split_clipping=True)
    return found


def traversals(scene: wrt.Scene, query: str) -> list[str]:
    """Those that answer a query on the scene's tree."""
    kind, lazy = scene.accelerator.kind, scene.state.lazy_tree is not None
    able = {n: way for n, way in TRAVERSALS.items() if kind in way.trees and way.supports(query, kind)}
    refused = Capabilities.SHARED_ORIGIN | (Capabilities.WIDE_FORM if lazy else Capabilities.NONE)
    return [n for n, way in able.items() if not way.capabilities & refused and way.width in (None, scene.state.width)]


def check_inside(scene: wrt.Scene, body: Body, rng: np.random.Generator, count: int, ways: tuple[str, str]) -> dict[str, int]:
    """How many rays from inside fail each check."""
    origins = body.inner_points(rng, count)
    directions = body.features(rng, count) - origins
    hits = scene.intersect(origins, directions, traversal=ways[0])
    counts = scene.count(origins, directions, traversal=ways[1])
    return {
        "missed from inside": int((~hits.is_hit).sum()),
        "crossed an even number of times from inside": int((counts % 2 == 0).sum()),
        **check_brute(scene, origins, directions, hits, counts),
    }


def check_outside(scene: wrt.Scene, body: Body, rng: np.random.Generator, count: int, ways: tuple[str, str]) -> dict[str, int]:
    """How many rays from outside, through the inside, fail each check."""
    through = body.inner_points(rng, count)
    far = np.minimum(rng.choice([0.05, 1.0, 10.0, 1000.0], (count, 1)), body.farthest)
    origins = through + (1.0 + far) * (body.features(rng, count) - through)
    directions = through - origins
    hits = scene.intersect(origins, directions, traversal=ways[0])
    counts = scene.count(origins, directions, traversal=ways[1])
    odd_or_none = (counts % 2 == 1) | (counts < 2)
    even = not any(name in body.name for name in UNEVEN)
    return {
        "missed from outside": int((~hits.is_hit).sum()),
        "crossed an odd number of times, or never, from outside": int(odd_or_none.sum()),
        "not crossed twice": int((counts != 2).sum()) if even else 0,
        **check_brute(scene, origins, directions, hits, counts),
    }


def check_brute(
    scene: wrt.Scene, origins: np.ndarray, directions: np.ndarray, hits: wrt.Hits, counts: np.ndarray
) -> dict[str, int]:
    """How many of the first rays have other hits by brute force, or other counts."""
    part = slice(max(64, BRUTE // scene.triangle_count))
    brute = scene.intersect(origins[part], directions[part], traversal="brute")
    other = hits.t[part].view(np.int32) != brute.t.view(np.int32)
    other |= hits.primitive_id[part] != brute.primitive_id
    other |= (hits.uv[part].view(np.int32) != brute.uv.view(np.int32)).any(axis=-1)
    expected = scene.count(origins[part], directions[part], traversal="brute")
    return {"other hits than brute force": int(other.sum()), "another count": int((counts[part] != expected).sum())}


def run_batches(rays: float, seed: int, tally: Tally, advance) -> None:
    """Traces so many rays; advance: called with how many were traced."""
    everything = list(bodies())
    turn = 0
    while tally.rays["all"] < rays:
        order = np.random.default_rng([seed, turn]).permutation(len(everything))
        for number in order:
            body, rng = everything[number], np.random.default_rng([seed, turn, number])
            kinds = trees(body.mesh.triangle_count)
            tree = list(kinds)[(turn + int(number)) % len(kinds)]
            scene = wrt.Scene(body.mesh, kinds[tree], device="cpu")
            for check in (check_inside, check_outside):
                ways = tuple(str(rng.choice(traversals(scene, query))) for query in (CLOSEST, COUNT))
                where = f"{body.name}; {tree}, by {ways[0]}, counted by {ways[1]}; turn {turn}, body {number}"
                tally.note((tree, body.name, ways[0]), BATCH, check(scene, body, rng, BATCH, ways), where)
                advance(BATCH)
            if tally.rays["all"] >= rays:
                return
        turn += 1


def write_record(path: Path, tally: Tally, seconds: float, seed: int) -> None:
    """What ran, where, and what came out."""
    from wrt.kernels.runtime.launch import as_device
    from wrt.kernels.simd.lanes import native_width

    host, rays = machine("cpu"), tally.rays["all"]
    lines = [
        f"# Rays at edges and vertices, {datetime.now(timezone.utc):%Y-%m-%d}",
        "",
        f"`python -m tests.leaks --rays {rays:g} --seed {seed}`: {rays:,} rays, each asked for its closest hit and its count, "
        f"in {seconds:,.0f} s ({rays / seconds / 1e6:.2f} million a second).",
        "",
        f"{host['cpu']}, {wrt.get_num_threads()} threads, W = {native_width(as_device('cpu'))}, {host['system']}; "
        + ", ".join(f"{name} {version}" for name, version in host["versions"].items()),
        "",
        f"**{len(tally.failures)} batches with failures.**",
        *(f"* {failure}" for failure in tally.failures),
        "",
        "| tree, body or traversal of closest hits | rays |",
        "| --- | ---: |",
        *(f"| {key} | {count:,} |" for key, count in sorted(tally.rays.items()) if key != "all"),
        "",
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines), encoding="utf-8")


@click.command(help=__doc__.splitlines()[0])
@click.option("--rays", type=float, default=1e7, show_default=True, help="How many rays to trace.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of bodies' order and of rays.")
@click.option("--record", type=click.Path(path_type=Path), default=None, help="Where to write [default: notebooks/records].")
def main(rays: float, seed: int, record: Path | None) -> None:
    """Runs the batches; an interrupted run is recorded too."""
    import warp as wp
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    wp.config.log_level = wp.LOG_WARNING
    console, tally, start = Console(stderr=True), Tally(), time.perf_counter()
    columns = [BarColumn(), TextColumn("{task.percentage:3.0f} %"), TimeElapsedColumn(), TimeRemainingColumn()]
    try:
        with Progress(TextColumn("{task.description}"), *columns, console=console) as progress:
            task = progress.add_task("rays", total=rays)

            def advance(count: int) -> None:
                rate = tally.rays["all"] / (time.perf_counter() - start) / 1e6
                text = f"{tally.rays['all']:.3g} rays, {rate:.2f} M/s, {len(tally.failures)} failures"
                progress.update(task, advance=count, description=text)

            run_batches(rays, seed, tally, advance)
    except KeyboardInterrupt:
        console.print("interrupted")
    path = record or RECORDS / f"{datetime.now(timezone.utc):%Y-%m-%d}-leaks.md"
    write_record(path, tally, time.perf_counter() - start, seed)
    console.print(f"{tally.rays['all']:,} rays, {len(tally.failures)} batches with failures; written to {path}")
    sys.exit(1 if tally.failures else 0)


if __name__ == "__main__":
    main()

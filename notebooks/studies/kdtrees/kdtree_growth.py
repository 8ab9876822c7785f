"""How time and memory of kd-tree builders grow with the mesh: teapots of a thousand triangles, of ten thousand, and so on.

A build is a scene made of a mesh in memory; where rays build what they need, it is the build's beginning. Builders take turns,
size after size; one that has used up its seconds sits out the rounds that are left, and one that would not end is not asked.
What is reported is the least time of the rounds, and the memory per triangle.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import log2
from time import perf_counter

from wrt import scenes
from wrt.accelerators.tree_descriptions import KdTree
from wrt.bench.comparisons.build_comparison import BUDGET, SMALL
from wrt.bench.core.paired_timing import Contender, take_turns
from wrt.builders.kdtree import KDTREE_BUILDERS
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

LEAST = 1_000
"""Triangles of the smallest teapot, about."""

PATCH_TRIANGLES = 64
"""A teapot of level l has about this many times l * l triangles: 32 patches of l * l squares."""


@dataclass
class Growth:
    """How a builder's time and memory grow.

    Attributes:
        builder: key in `KDTREE_BUILDERS`.
        triangles: of each mesh.
        seconds: of each build, least of the rounds.
        tree_bytes, peak_bytes: memory per triangle at each size, of the tree and during the build.
    """

    builder: str
    triangles: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    tree_bytes: list[float] = field(default_factory=list)
    peak_bytes: list[float] = field(default_factory=list)

    @property
    def per_n_log_n(self) -> list[float]:
        """seconds / (n log2 n), as multiples of the first: constant if the time grows like that."""
        ratios = [seconds / n_log_n(n) for seconds, n in zip(self.seconds, self.triangles, strict=True)]
        return [ratio / ratios[0] for ratio in ratios]

    def add(self, seconds: float, scene: Scene) -> None:
        """Notes what a build took and what it made."""
        count, stats = scene.triangle_count, scene.tree.stats
        self.triangles.append(count)
        self.seconds.append(seconds)
        self.tree_bytes.append(scene.tree.bytes / count)
        self.peak_bytes.append(stats.peak_bytes / count)


def n_log_n(n: int) -> float:
    """n log2 n."""
    return n * log2(n)


def growth_sizes(most: int) -> list[int]:
    """A thousand triangles, ten times as many, and so on; `most` is the last."""
    sizes = []
    size = LEAST
    while size < most:
        sizes.append(size)
        size *= 10
    return [*sizes, most]


def growth_turns(builders: Sequence[str], sizes: Sequence[int], rounds: int) -> int:
    """How often `measure_growth` tells of a turn, at most."""
    return sum((1 + rounds) * len(builders_for(builders, size)) for size in sizes)


def builders_for(builders: Sequence[str], triangles: int) -> list[str]:
    """Those that can be waited for."""
    return [name for name in builders if triangles <= KDTREE_BUILDERS[name].max_triangles]


def make_teapot(triangles: int) -> TriangleMesh:
    """A teapot of about this many triangles."""
    return scenes.build("teapot", level=max(1, round((triangles / PATCH_TRIANGLES) ** 0.5)))


def measure_growth(
    builders: Sequence[str],
    sizes: Sequence[int],
    *,
    rounds: int = 3,
    threads: int = 1,
    clock: Callable[[], float] = perf_counter,
    on_turn: Callable[[str], None] = lambda name: None,
) -> list[Growth]:
    """Builds teapots of about this many triangles; those whom no size suits are left out.

    Args:
        builders: keys in `KDTREE_BUILDERS`.
        sizes: triangles, ascending.
        rounds: number of rounds per builder at each size, for which it has `BUDGET` seconds.
        threads: CPU threads.
        clock: seconds; `time.thread_time` with one thread on a machine that others use.
        on_turn: told the size and the builder before each warm-up and each turn.
    """
    grown = {name: Growth(name) for name in builders}
    for size in sizes:
        mesh = make_teapot(size)
        small = TriangleMesh(mesh.vertices, mesh.faces[:SMALL])
        built: dict[str, Scene] = {}

        def build(name: str, mesh: TriangleMesh, built: dict[str, Scene] = built) -> None:
            built.pop(name, None)
            built[name] = Scene(mesh, KdTree(builder=name), device="cpu", num_threads=threads)

        contenders = [
            Contender(
                name,
                lambda name=name, mesh=mesh, build=build: build(name, mesh),
                warm_up=lambda name=name, small=small, build=build: build(name, small),
            )
            for name in builders_for(builders, mesh.triangle_count)
        ]
        label = f"{mesh.triangle_count:,} triangles"
        timings = take_turns(
            contenders, rounds, budget=BUDGET, clock=clock, on_turn=lambda name, label=label: on_turn(f"{label}: {name}")
        )
        for name, timing in timings.items():
            grown[name].add(min(timing.times), built[name])
    return [growth for growth in grown.values() if growth.triangles]

"""How much faster threads make builds, updates of groups, and rays: the factors that the survey quotes.

    build_growth    Popov et al. 2006 (streaming), Shevtsov et al. 2007 (binned), Choi et al. 2010 (nested, in place)
    group_growth    Kang et al. 2013: kd-trees of groups, built again for a frame in which all groups move
    ray_growth      Parker et al. 1999: views; and random rays

Numbers of threads take turns, in wall time, each after untimed calls that wake its threads. More threads than the process may
run on are left out.

References: rahikainen-2013 (sections 4.1, 4.2 and 5); popov-2006; shevtsov-2007-kdtree; choi-2010; kang-2013; parker-1999.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import cycle
from typing import Any

from wrt.accelerators.tree_descriptions import KdTree
from wrt.bench.core.paired_timing import Contender, take_turns
from wrt.bench.core.workloads import WorkloadMaker
from wrt.kernels.compilation.cores import available_cores
from wrt.kernels.runtime.launch import use_threads
from wrt.meshes.mesh import TriangleMesh
from wrt.moving.grouped_scene import GroupedScene
from wrt.scene.scene import Scene
from wrt.scenes import atrium
from wrt.scenes.animations import walking_figure

Row = dict[str, Any]

THREADS = (2, 4, 6, 16)
"""Compared with one. The papers have 2, 4, 6, 20, 24 and 128."""

BUILDERS = ("binned", "streaming", "nested", "in_place")

GROUPS = 16
"""That move, beside the court, which rests."""

SETTLE, WARM = 0.1, 0.05
"""Calls that take less than the first are preceded by untimed ones, for as long as the second, in seconds."""


def thread_growth(mesh: TriangleMesh, *, rounds: int = 5, size: int = 1024) -> list[Row]:
    """All three, as rows: what, threads, seconds, speed (the time of one thread / its own, median of the rounds)."""
    return [*build_growth(mesh, rounds=rounds), *group_growth(rounds=rounds), *ray_growth(mesh, size=size, rounds=rounds)]


def build_growth(mesh: TriangleMesh, *, rounds: int = 5) -> list[Row]:
    """Rows as above of whole builds with each of `BUILDERS`."""
    rows = []
    for builder in BUILDERS:
        tree = KdTree(builder=builder)
        rows += growth(builder, lambda tree=tree: Scene(mesh, tree, device="cpu"), rounds)
    return rows


def group_growth(*, rounds: int = 5, groups: int = GROUPS, detail: int = 16) -> list[Row]:
    """Rows as above of a frame in which all groups move and every tree of a group is built again."""
    figure = walking_figure(4, detail)
    places = [figure.moved((0.0, 1.2 * number, 0.0)) for number in range(groups)]
    scene = GroupedScene([atrium(), *(place.mesh(0) for place in places)], "kdtree", device="cpu")
    frames = cycle(range(len(figure)))

    def update() -> None:
        frame = next(frames)
        scene.update({1 + k: place.frames[frame] for k, place in enumerate(places)}, rebuild="always")

    return growth("groups", update, rounds)


def ray_growth(mesh: TriangleMesh, *, size: int = 1024, rounds: int = 5) -> list[Row]:
    """Rows as above of closest hits: size x size rays of a view ("view") and as many random ones ("random")."""
    scene = Scene(mesh, "bvh", device="cpu")
    far, random = WorkloadMaker(mesh, size=size).make(["far", "random"])
    named = (("view", far.rays), ("random", random.rays))
    return [row for name, rays in named for row in growth(name, lambda rays=rays: scene.intersect(rays), rounds)]


def growth(what: str, run: Callable[[], Any], rounds: int, threads: Sequence[int] = THREADS) -> list[Row]:
    """The rows of one call, whose threads are those of `use_threads`."""

    def with_threads(count: int) -> Callable[[], None]:
        def call() -> None:
            with use_threads(count):
                run()

        return call

    counts = [1, *(count for count in threads if count <= available_cores())]
    timings = take_turns([Contender(str(count), with_threads(count)) for count in counts], rounds, settle=SETTLE, warm=WARM)
    one = timings["1"]
    return [
        {"what": what, "threads": name, "seconds": timing.median, "speed": 1.0 / timing.ratio_to(one)}
        for name, timing in timings.items()
    ]

"""Packets against single rays, for a view of the atrium (Rahikainen 2016, section 3.2)."""

from __future__ import annotations

from time import thread_time

from wrt.bench.core.paired_timing import Contender, take_turns
from wrt.bench.core.workloads import WorkloadMaker
from wrt.kernels.runtime.launch import use_threads
from wrt.scene.scene import Scene
from wrt.scenes import build

TRAVERSALS = ("single", "packet")


def packet_speeds(size: int, rounds: int) -> list[dict[str, str | float]]:
    """Rows: traversal, tree ("bvh", "kdtree"), and speed, how many times as fast as single rays are, on one thread.

    Args:
        size: width and height of the view in pixels.
        rounds: in which the traversals take turns.
    """
    mesh, rows = build("atrium"), []
    (view,) = WorkloadMaker(mesh, size=size).make(["far"])
    for tree in ("bvh", "kdtree"):
        scene = Scene(mesh, tree, device="cpu", num_threads=1)
        ways = [
            Contender(name, lambda scene=scene, name=name: scene.intersect(view.rays, traversal=name).t, len(view))
            for name in TRAVERSALS
        ]
        with use_threads(1):
            timings = take_turns(ways, rounds, clock=thread_time)
        rows += [{"traversal": name, "tree": tree, "speed": timings["single"].ratio_to(timings[name])} for name in TRAVERSALS]
    return rows

"""Packets of several sizes through a kd-tree and a BVH: does a combination of both trees pay?

Cadet and Lecussan (2007) combine a BVH, for wide packets, with a kd-tree, for small ones. That pays only if the kd-tree is the
faster of the two for small packets or for single rays, to which a packet is reduced near the leaves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from studies.kdtrees.entry_point_tiles import morton_view
from wrt.bench.core.single_thread_timing import ratios, timed
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

WIDTHS = (16, 64, 256)
"""Rays of a packet, multiples of 16."""


def compare_widths(
    mesh: TriangleMesh, *, size: int = 256, widths: Sequence[int] = WIDTHS, rounds: int = 7
) -> list[dict[str, Any]]:
    """Time of a view by packets of several sizes, and by single rays, through both kinds of tree.

    Args:
        mesh: what is seen.
        size: the view has size x size pixels, a power of 2, in Morton's order.
        widths: rays of a packet.
        rounds: how often each has its turn.

    Returns:
        A row for each size: packet (1 for single rays), bvh, kdtree (seconds), ratio (kd-tree's time over the BVH's), least,
        greatest.
    """
    rays = morton_view(mesh, size)
    runs: dict[tuple[str, int], Callable[[], Any]] = {}
    for tree in ("bvh", "kdtree"):
        scene = Scene(mesh, tree, num_threads=1, device="cpu")
        plan = scene.explain(rays, traversal="packet")
        runs[tree, 1] = partial(scene.intersect, rays, traversal="single")
        for width in widths:
            runs[tree, width] = partial(scene.intersect, rays, traversal=replace(plan, packet=width, culling="vertex"))
    timings, rows = timed(runs, rounds), []
    for width in (1, *widths):
        found = ratios(timings["kdtree", width], timings["bvh", width])
        row = {"packet": width, "bvh": timings["bvh", width].median, "kdtree": found.pop("seconds")}
        rows.append({**row, **found})
    return rows

"""Queries of every kind from several threads at a time."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

import wrt
from support.hits import mixed_rays

THREADS = 8


def queries(scene: wrt.Scene) -> dict[str, Callable[[], list[np.ndarray]]]:
    """All queries, for few and many rays; tests with records for one origin, for several origins."""
    mesh = scene.meshes[0]
    origins, directions = mixed_rays(mesh, 900, seed=2)
    few = origins[:20], directions[:20]
    points = mesh.vertices[::40]
    eyes = np.float32([[3, 1, 2], [-2, 4, 1], [1, -3, 2]])

    def closest(*rays: np.ndarray, **options: str) -> list[np.ndarray]:
        hits = scene.intersect(*rays, **options)
        return [hits.t, hits.primitive_id, hits.geometry_id, hits.uv, hits.position, hits.normal, hits.is_hit]

    def everything(*rays: np.ndarray) -> list[np.ndarray]:
        lists = scene.intersect_all(*rays)
        return [lists.t, lists.primitive_id, lists.offsets, lists.count, lists.ray_id]

    asked = {
        "closest": lambda: closest(origins, directions),
        "closest of few": lambda: closest(*few),
        "spawn": lambda: [scene.intersect(*few).spawn(few[1])],
        "occluded": lambda: [scene.occluded(origins, directions)],
        "occluded of one": lambda: [scene.occluded(few[0][3], few[1][3])],
        "count": lambda: [scene.count(origins, directions)],
        "all hits": lambda: everything(origins, directions),
        "contains": lambda: [scene.contains(origins)],
        "visible": lambda: [scene.visible(points[:, None], points)],
        "blocks": lambda: [hits.t for _, hits in scene.intersect_blocks(origins, directions, memory="64 kB")],
    }
    for number, eye in enumerate(eyes):
        asked[f"eye {number}"] = lambda eye=eye: closest(eye, directions[:200], triangle_test="komatsu", traversal="single")
    return asked


def from_threads(work: Callable[[int], None], count: int = THREADS) -> None:
    """Calls `work` with the number of each thread, all at a time; raises what any of them raises."""
    barrier, errors = threading.Barrier(count), []

    def run(number: int) -> None:
        try:
            barrier.wait(timeout=60)
            work(number)
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=run, args=(number,)) for number in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if errors:
        raise errors[0]

"""One scene, asked by many Python threads at a time: every query gives what it gives alone."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable

import numpy as np
import pytest
from conftest import mixed_rays

import wrt

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


@pytest.mark.parametrize("kind", ["bvh", "kdtree"])
@pytest.mark.parametrize("num_threads", [1, 3])
def test_all_queries_at_a_time(kind, num_threads, device):
    teapot = wrt.scenes.build("teapot", level=3)
    geometry = [teapot, wrt.TriangleMesh(teapot.vertices + 0.4, teapot.faces)]
    expected = {name: query() for name, query in queries(wrt.Scene(geometry, kind, device=device)).items()}
    asked = queries(wrt.Scene(geometry, kind, device=device, num_threads=num_threads))

    def work(number: int) -> None:
        names = list(asked)
        for turn in range(3 * len(names)):
            name = names[(number + turn) % len(names)]
            for answer, right in zip(asked[name](), expected[name], strict=True):
                np.testing.assert_array_equal(answer, right, err_msg=name)

    from_threads(work)


def test_first_queries_at_a_time():
    """In a new process nothing is imported or loaded yet, and each thread begins with another query.

    This failed: packages whose parts import one another were entered from two ends at once, and two threads made the same
    kernel, with structs that did not fit.
    """
    code = (
        "import warp as wp; wp.config.log_level = wp.LOG_WARNING\n"
        "import sys, wrt; sys.setswitchinterval(1e-6)\n"
        "from test_threads import from_threads, queries\n"
        "asked = list(queries(wrt.Scene(wrt.scenes.build('teapot', level=3), device='cpu')).values())\n"
        "from_threads(lambda number: asked[number + 1]())\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})

"""Two ideas for tests that project along an axis: Shevtsov's flag of axis-aligned triangles, and axes by shifts.

`compare_flag`: with and without the flag (`wrt.kernels.classics.studies.variants.axis_flag`). `compare_selections`: Wald's test
without a tree, with axes found in four ways (`wrt.kernels.classics.studies.variants.axis_selection`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from studies.kdtrees.entry_point_tiles import morton_view
from studies.triangles.isolated_tests import Beams, Run, Soup, closest
from studies.triangles.volume_search import random_soup
from wrt.bench.core.single_thread_timing import ratios, timed
from wrt.engine.rays.rays import Rays
from wrt.kernels.classics.studies.variants.axis_flag import TEST as FLAGGED
from wrt.kernels.classics.studies.variants.axis_selection import SELECTIONS
from wrt.kernels.simd.lanes import native_width
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

NAMES = ("shevtsov", FLAGGED.name)
"""Without and with the flag."""


@contextmanager
def flag_in_table() -> Iterator[None]:
    """Lets scenes take the flagged test by its name, for the time of a `with` block."""
    TRIANGLE_TESTS[FLAGGED.name] = FLAGGED
    try:
        yield
    finally:
        del TRIANGLE_TESTS[FLAGGED.name]


def compare_flag(
    mesh: TriangleMesh, rays: Rays | None = None, *, size: int = 512, triangles: int = 2048, rounds: int = 15
) -> list[dict[str, Any]]:
    """Time of Shevtsov's test with its flag over that without.

    Args:
        mesh: what is seen.
        rays: those of the packets; by default a view of size x size pixels, in Morton's order.
        size: a power of 2; 0 leaves the packets out.
        triangles: number of the mesh's triangles, picked at random, that are tested without a tree.
        rounds: how often each has its turn.

    Returns:
        A row for each way: way (packets: the view through a BVH; frusta: 64 rays of one origin at a time, without a tree; one
        by one: single rays and triangles, without a tree), seconds (with the flag), ratio, least, greatest.

    Raises:
        RuntimeError: results with the flag differ in a bit.
    """
    rng = np.random.default_rng(7)
    picked = rng.choice(mesh.triangle_count, min(triangles, mesh.triangle_count), replace=False)
    soup = Soup(mesh.vertices[mesh.faces[picked]] - mesh.bounds.mean(axis=0))
    beams = Beams(np.zeros((1, 3)), rng.normal(size=(4 * triangles, 3)))
    tests = dict(zip(NAMES, (TRIANGLE_TESTS[NAMES[0]], FLAGGED), strict=True))
    runs: dict[tuple[str, str], Run] = {}
    if size or rays is not None:
        scene = Scene(mesh, num_threads=1, device="cpu")
        seen = morton_view(mesh, size) if rays is None else rays
        runs |= {("packets", name): partial(view, scene, seen, name) for name in NAMES}
    with flag_in_table():
        for name, test in tests.items():
            runs["frusta", name] = closest(test, soup, beams, frustum=64, width=native_width(wp.get_device("cpu")))
            runs["one by one", name] = closest(test, soup, beams, frustum=0, width=0)
        ways = list(dict.fromkeys(way for way, _ in runs))
        for way in ways:
            check_same(way, runs[way, NAMES[0]](), runs[way, NAMES[1]]())
        timings = timed(runs, rounds)
    return [{"way": way, **ratios(timings[way, NAMES[1]], timings[way, NAMES[0]])} for way in ways]


def view(scene: Scene, rays: Rays, test: str) -> tuple[np.ndarray, ...]:
    """Traces a view in packets: t, ids and weights."""
    hits = scene.intersect(rays, traversal="packet", triangle_test=test)
    return hits.t, hits.primitive_id, hits.uv


def compare_selections(
    *, triangles: int = 2048, rays: int = 1024, widths: Sequence[int] = (0, 16), rounds: int = 7
) -> list[dict[str, Any]]:
    """Time of Wald's test on random triangles with each way to find the axes.

    Args:
        triangles: number of triangles.
        rays: number of single rays.
        widths: triangles at once; 0: one by one.
        rounds: how often each has its turn.

    Returns:
        A row for each width and way: width, way, seconds, ratio (to `selects`), least, greatest.

    Raises:
        RuntimeError: results of a way differ from those of `selects`.
    """
    soup, beams = random_soup(triangles, rays)
    runs = {
        (width, way): closest(test, soup, beams, frustum=0, width=width) for width in widths for way, test in SELECTIONS.items()
    }
    for width, way in runs:
        check_same(way, runs[width, "selects"](), runs[width, way]())
    timings = timed(runs, rounds)
    return [
        {"width": width, "way": way, **ratios(timing, timings[width, "selects"])} for (width, way), timing in timings.items()
    ]


def check_same(way: str, results: Sequence[np.ndarray], others: Sequence[np.ndarray]) -> None:
    """Raises a RuntimeError if two answers differ in a bit."""
    for one, two in zip(results, others, strict=True):
        differ = np.ascontiguousarray(one).view(np.uint32) != np.ascontiguousarray(two).view(np.uint32)
        if differ.any():
            raise RuntimeError(f"{way}: {np.count_nonzero(differ)} of {differ.size} numbers differ")

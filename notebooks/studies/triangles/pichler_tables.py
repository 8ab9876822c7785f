"""The tables of Pichler 2018, measured again: Ferko and Ferko's test by its variants, and against others.

    pruning_tests   Table 6.1: comparisons that each variant of pruning makes
    pruning_times   Table 6.2: the variants' times beside the unit triangle's
    times           Table 6.3: whole queries with Woop's, Baldwin and Weber's, the unit triangle's and the hybrid test
    errors          Table 6.4: error of a picture at equal time

Each returns a list of plain dicts. The thesis' program, PBRT, tests one ray against one triangle at a time in the leaves of a
BVH. "alone" is that: single rays, triangles one by one, every exit a branch. "lanes" is how single rays go here: a block of
triangles at once. A query is a view of the scene (closest hits) and the ambient rays from what it sees (any hits), on one
thread. Contenders take turns; "ratio" is the median over the rounds of time / the reference's time of that round, "least"
and "greatest" are those of a round. The clock is the processor time of the thread.

References: pichler-2018.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from studies.triangles.leaf_queries import leaf_query
from wrt.bench.core.single_thread_timing import ratios, timed
from wrt.bench.core.workloads import Workload, WorkloadMaker
from wrt.engine.facts.query_kinds import ANY, CLOSEST
from wrt.engine.rays.device_rays import to_device
from wrt.engine.rays.rays import Rays
from wrt.imaging.cameras import PinholeCamera
from wrt.imaging.integrators.rendering_call import render
from wrt.kernels.classics.studies.pruning_counts import Pruned, make_kernel
from wrt.kernels.classics.triangle.ferko import VARIANTS
from wrt.kernels.classics.triangle.ferko.record_part import join
from wrt.kernels.classics.triangle.ferko.variant import Variant
from wrt.kernels.runtime.launch import launch
from wrt.kernels.triangle.support.block_packing import pack_blocks
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene
from wrt.scenes import build

Row = dict[str, Any]


def needles() -> TriangleMesh:
    """A soup of slender triangles, a twentieth as wide as long: most rays that meet their boxes miss them."""
    soup = build("random_triangles", count=8000, size=0.3, seed=2)
    corners = soup.vertices[soup.faces].copy()
    corners[:, 2] = corners[:, 1] + 0.05 * (corners[:, 2] - corners[:, 1])
    return TriangleMesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


SCENES: dict[str, Callable[[], TriangleMesh]] = {
    "needles": needles,
    "teapot": lambda: build("teapot", level=12, ground=False),
    "stadium": lambda: build("teapot_in_stadium", level=8),
    "wood": lambda: build("wood", trees=4),
    "atrium": lambda: build("atrium"),
    "soup": lambda: build("random_triangles", count=8000, size=0.15, seed=1),
}
"""Meshes whose tests are hit seldom and often. Views fit a mesh's box: a ground under the teapot would be all that they see."""

LABELS = {
    "ferko_prune3": "3x",
    "ferko_prune3_probability": "3x, p.es.",
    "ferko_prune3_weights": "3x, p.es., w.",
    "ferko_prune4": "4x",
    "ferko_prune4_probability": "4x, p.es.",
    "ferko_prune4_weights": "4x, p.es., w.",
    "ferko_prune3_no_circle": "3x, p.es., w., bb.",
    "ferko_prune4_no_circle": "4x, p.es., bb.",
}
"""The paper's names of the variants, in its order."""

CIRCLED = {"3x, circle": Variant(fold=3, circle=True), "4x, circle": Variant(fold=4, circle=True)}
"""Not in the paper: the circle without an order. What remains between it and "p.es." is what the order saves."""

RIVALS = ("woop", "baldwin_weber", "ferko_utm", "ferko_hybrid")
"""Of Table 6.3; the first is the reference."""

ROUNDS = 7
MODES = ("alone", "lanes")

RATED, MOST = 1 << 10, 1 << 16
"""Rays of a kind by which the hit rate is told, and by which comparisons are counted, at most."""


class Case:
    """A scene and its rays.

    Args:
        name: key in `SCENES`.
        size: the view has size x size pixels, a multiple of 4.
    """

    def __init__(self, name: str, size: int) -> None:
        self.name = name
        self.mesh = SCENES[name]()
        self.scene = Scene(self.mesh, "bvh", num_threads=1, device="cpu")
        self.workloads: tuple[Workload, ...] = tuple(WorkloadMaker(self.mesh, size=size).make(("far", "ao")))

    def query(self, triangle_test: str, mode: str) -> Callable[[], int]:
        """A function that traces all rays with a test and returns the number of hits."""
        view, ambient = self.workloads
        scalar_test = mode == "alone"
        trace_view = leaf_query(self.scene, view.rays, triangle_test, CLOSEST, scalar_test=scalar_test)
        trace_ambient = leaf_query(self.scene, ambient.rays, triangle_test, ANY, scalar_test=scalar_test)

        def ask() -> int:
            return int((trace_view().primitive.numpy() >= 0).sum() + trace_ambient().occluded.numpy().sum())

        return ask

    @cached_property
    def hit_rate(self) -> float:
        """Share of the pairs that must be tested (`count_comparisons`) in which the ray meets the triangle, of some rays."""
        counts = self.count(Variant(fold=3), RATED)
        return counts["kept"] / max(counts["tests"], 1)

    def count(self, variant: Variant, rays: int = MOST) -> dict[str, int]:
        """`count_comparisons` of the view and of the ambient rays, at most this many of each, evenly picked."""
        parts = [count_comparisons(self.scene, workload.thinned(rays).rays, variant) for workload in self.workloads]
        return {name: sum(part[name] for part in parts) for name in parts[0]}


def count_comparisons(scene: Scene, rays: Rays, variant: Variant) -> dict[str, int]:
    """Tests, points that reach the pruning, comparisons and hits, of all rays: `wrt.kernels.classics.studies.pruning_counts`.

    Args:
        scene: triangles; all are looked at for each ray.
        rays: rays; a triangle is tested if its box is met before the ray's closest hit.
        variant: one that prunes.
    """
    from wrt.kernels.traversal.brute_force import AllTriangles

    if not variant.fold:
        raise ValueError("variant does not prune; give one whose fold is 3 or 4")
    buffers = to_device(rays, scene.device, scene.center)
    closest = wp.array(scene.intersect(rays, triangle_test="woop").t.ravel(), dtype=float, device=scene.device)
    count = scene.triangle_count
    tree = AllTriangles()
    tree.count, tree.low, tree.high = count, scene.tree.low, scene.tree.high
    ids = wp.array(np.arange(count, dtype=np.int32), dtype=int, device=scene.device)
    mesh = scene.state.device_mesh
    blocks = pack_blocks(join(variant.parts), mesh.vertices, mesh.faces, ids, 1)
    counts = wp.zeros(buffers.batch.count, dtype=Pruned, device=scene.device)
    inputs = [tree, blocks, buffers.batch, closest, counts]
    launch(make_kernel(variant, 1), buffers.batch.count, inputs, device=scene.device, chunk=16)
    values = counts.numpy()
    return {name: int(values[name].sum(dtype=np.int64)) for name in values.dtype.names}


def pruning_tests(scenes: Sequence[str] = tuple(SCENES), *, size: int = 48) -> list[Row]:
    """Table 6.1.

    Returns:
        A row for each scene and variant: scene, variant (the paper's name), comparisons, percent (of the comparisons of the
        same fold without circle and order), points (tests that reach the pruning), tests, hit_rate.
    """
    rows = []
    for name in scenes:
        case, plain = Case(name, size), {}
        for label, variant in {**{label: VARIANTS[key] for key, label in LABELS.items()}, **CIRCLED}.items():
            counts = case.count(variant)
            plain.setdefault(variant.fold, counts["comparisons"])
            percent = 100.0 * counts["comparisons"] / max(plain[variant.fold], 1)
            rows.append({"scene": name, "variant": label, **counts, "percent": percent, "hit_rate": case.hit_rate})
    return rows


def pruning_times(
    scenes: Sequence[str] = tuple(SCENES), *, size: int = 128, rounds: int = ROUNDS, modes: Sequence[str] = MODES
) -> list[Row]:
    """Table 6.2: rows of `compare` for the unit triangle, the reference, and all variants of pruning."""
    return compare(scenes, ("ferko_utm", *LABELS), size=size, rounds=rounds, modes=modes)


def times(scenes: Sequence[str] = tuple(SCENES), *, size: int = 128, rounds: int = ROUNDS) -> list[Row]:
    """Table 6.3: rows of `compare` for Woop's test, the reference, and the paper's other three, by rising hit rate."""
    return sorted(compare(scenes, RIVALS, size=size, rounds=rounds), key=lambda row: row["hit_rate"])


def compare(scenes: Sequence[str], tests: Sequence[str], *, size: int, rounds: int, modes: Sequence[str] = MODES) -> list[Row]:
    """Times of whole queries.

    Args:
        scenes: keys in `SCENES`.
        tests: keys in `TRIANGLE_TESTS`; the first is the reference.
        size: views have size x size pixels.
        rounds: how often each test has its turn.
        modes: "alone", "lanes" or both.

    Returns:
        A row for each scene, mode and test: scene, hit_rate, mode, test, seconds (median of the rounds), ratio, least,
        greatest, hits.
    """
    rows = []
    for name in scenes:
        case = Case(name, size)
        for mode in modes:
            timings = timed({test: case.query(test, mode) for test in tests}, rounds)
            for test in tests:
                row = {"scene": name, "hit_rate": case.hit_rate, "mode": mode, "test": test}
                rows.append({**row, **ratios(timings[test], timings[tests[0]]), "hits": timings[test].result})
    return rows


def errors(
    scenes: Sequence[str] = ("stadium", "wood"),
    *,
    tests: Sequence[str] = RIVALS,
    size: int = 48,
    samples: int = 12,
    reference_samples: int = 256,
    rounds: int = 5,
    seeds: int = 4,
) -> list[Row]:
    """Table 6.4: how far a picture is from one with many samples, if each test has the time that the first one needs.

    The time of a sample is measured with the tests in turn; each then gets as many samples as fit. Rendering is wrt's own
    (`wrt.render`: a point light, ambient occlusion), by single rays.

    Args:
        scenes: keys in `SCENES`.
        tests: keys in `TRIANGLE_TESTS`; the first sets the time, and makes the reference.
        size: pictures have size x size pixels.
        samples: of the first test's picture.
        reference_samples: of the reference's.
        rounds: of timing.
        seeds: pictures of each test over which the error is averaged.

    Returns:
        A row for each scene and test: scene, test, samples, seconds (of a sample), error (mean squared, of the encoded
        picture), deviation (of the error, between seeds), bias (mean squared difference between the test's picture and the
        first one's with the same samples: what the test itself contributes).
    """
    rows = []
    for name in scenes:
        mesh = SCENES[name]()
        scene = Scene(mesh, "bvh", num_threads=1, device="cpu")
        camera = camera_of(mesh, size)

        def draw(test: str, count: int, seed: int, scene: Scene = scene, camera: PinholeCamera = camera) -> np.ndarray:
            options = {"samples": count, "ambient_samples": 1, "seed": seed, "traversal": "single", "triangle_test": test}
            return render(scene, camera, **options).astype(np.float64)

        truth = draw(tests[0], reference_samples, seeds + 1)
        timings = timed({test: lambda test=test: draw(test, 4, 0) for test in tests}, rounds)
        for test in tests:
            ratio = ratios(timings[test], timings[tests[0]])
            count = max(1, round(samples / ratio["ratio"]))
            off = [float(((draw(test, count, seed) - truth) ** 2).mean()) for seed in range(seeds)]
            bias = float(((draw(test, samples, 0) - draw(tests[0], samples, 0)) ** 2).mean())
            row = {"scene": name, "test": test, "samples": count, "seconds": ratio["seconds"] / 4}
            rows.append({**row, "error": float(np.mean(off)), "deviation": float(np.std(off)), "bias": bias})
    return rows


def camera_of(mesh: TriangleMesh, size: int) -> PinholeCamera:
    """The eye of the workload `far`."""
    view = next(WorkloadMaker(mesh, size=4).make(("far",)))
    return PinholeCamera(size, size, fov=45.0, position=view.origins[0], look_at=mesh.center, up=(0.0, 1.0, 0.0))

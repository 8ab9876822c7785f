"""What Pichler 2018 tried and gave up: ways to make the transform, spheres, when to compare t; and rivals of chapter 3.

    replays             5.3, 5.5, 6.1: time of a test at a tree's share of hits, and where tests end, by the forms of
                        `wrt.kernels.classics.studies.pichler_2018`
    edge_planes         3.1: Amanatides and Choi's two tests; the second was 35 % faster in their paper
    squared_errors      3.1: Havel and Herout's comparison of three tests by the mean squared error of the hit, for all tests
    subdivision         3.1: Dammertz and Keller's test, of which Woop et al. say that it is watertight and slow
    leak_counts         7.2: whether the prunings are watertight
    watertight_pruning  7.2: what a pruning costs that is

Each returns a list of plain dicts. Scenes are those of `pichler_tables`. The clock is the processor time of one thread,
contenders take turns; "ratio" is the median over the rounds of time / the reference's time of that round.

References: pichler-2018; havel-herout-2010.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp

from studies.triangles.isolated_tests import Beams, Soup, closest, pairs
from studies.triangles.pichler_tables import ROUNDS, SCENES, Case
from studies.triangles.triangle_precision import leaks, solve
from wrt.bench.core.single_thread_timing import ratios, timed
from wrt.engine.rays.device_rays import to_device
from wrt.kernels.classics.studies.dammertz_keller import TEST as DAMMERTZ_KELLER
from wrt.kernels.classics.studies.pichler_2018 import STUDIED, UNIT_RAY
from wrt.kernels.classics.studies.replayed_tests import make_kernel, make_lists
from wrt.kernels.classics.studies.variants.watertight_pruning import PRUNED, UNPRUNED
from wrt.kernels.runtime.launch import launch
from wrt.kernels.traversal.brute_force import AllTriangles
from wrt.kernels.triangle import TRIANGLE_TESTS

Row = dict[str, Any]

KEPT = "range_delayed"
"""The thesis's final configuration: `utm_free_rows`, the near end of the range after the plane, the far end last."""

RAYS = 1 << 14
"""Rays of a kind whose tests are replayed, at most."""

HAVEL_HEROUT = ("wald", "shevtsov", "havel_herout")
"""The three tests of their comparison: they found Shevtsov's the most accurate and Wald's the least, with little between."""

FORMS = {form.name: form for form in (*STUDIED.values(), UNIT_RAY, PRUNED, UNPRUNED, TRIANGLE_TESTS["ferko_prune3"])}
"""What can be replayed."""

LEAKING = ("woop", "pluecker", "ferko_utm", "ferko_prune3", "ferko_prune4")
"""Tests whose leaks are counted; of the first none is known. Orders and circles change no hit of the prunings."""


class Replay:
    """The pairs of a ray and a triangle that any tree would have to test in a scene.

    Args:
        case: a scene with its view and its ambient rays.
        rays: at most this many of each.
    """

    def __init__(self, case: Case, rays: int = RAYS) -> None:
        scene, mesh = case.scene, case.mesh
        self.soup = Soup(mesh.vertices[mesh.faces] - scene.center)
        parts = [self._lists(case, workload.thinned(rays).rays) for workload in case.workloads]
        origins, directions, counts, slots = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        self.count, self.tests = len(counts), len(slots)
        self.origins = wp.array(origins, dtype=wp.vec3, device="cpu")
        self.directions = wp.array(directions, dtype=wp.vec3, device="cpu")
        self.begin = wp.array(np.concatenate([[0], np.cumsum(counts)]), dtype=int, device="cpu")
        self.slot = wp.array(slots, dtype=int, device="cpu")

    def _lists(self, case: Case, rays: Any) -> tuple[np.ndarray, ...]:
        """Origins, directions, numbers of triangles, and the triangles themselves, nearest boxes first."""
        scene, record = case.scene, TRIANGLE_TESTS["woop"].record
        buffers = to_device(rays, scene.device, scene.center)
        near = wp.array(scene.intersect(rays, triangle_test="woop").t.ravel(), dtype=float, device="cpu")
        tree = AllTriangles()
        tree.count, tree.low, tree.high = scene.triangle_count, scene.tree.low, scene.tree.high
        kernel, records, number = make_lists(record.components), self.soup.records(record, 1), buffers.batch.count
        counts, none = wp.zeros(number, dtype=int, device="cpu"), wp.empty(0, dtype=int, device="cpu")
        inputs = [tree, records, buffers.batch, near, none, counts, none, wp.empty(0, dtype=float, device="cpu")]
        launch(kernel, number, inputs, device=scene.device, chunk=16)
        total = int(counts.numpy().sum())
        begin = wp.array(np.cumsum(counts.numpy()) - counts.numpy(), dtype=int, device="cpu")
        slot, entry = wp.empty(total, dtype=int, device="cpu"), wp.empty(total, dtype=float, device="cpu")
        inputs[4], inputs[6], inputs[7] = begin, slot, entry
        launch(kernel, number, inputs, device=scene.device, chunk=16)
        order = np.lexsort((entry.numpy(), np.repeat(np.arange(number), counts.numpy())))
        shape = (*rays.shape, 3)
        places = np.broadcast_to(rays.origins, shape).reshape(-1, 3) - scene.center
        ways = np.broadcast_to(rays.directions, shape).reshape(-1, 3)
        return places.astype(np.float32), ways.astype(np.float32), counts.numpy(), slot.numpy()[order]

    def run(self, name: str, counted: bool = False) -> Callable[[], np.ndarray]:
        """A function that tests all pairs with a form of `FORMS`.

        It returns (rays,) the nearest hit, infinite if there is none or if the form does not read the ray's range; or,
        `counted`, (exits + 1,) how many tests ended at each exit, the hits last.
        """
        form = FORMS[name]
        far = wp.empty(self.count, dtype=float, device="cpu")
        ends = wp.zeros((self.count, len(form.lanes.exits) + 1 if counted else 1), dtype=int, device="cpu")
        records = self.soup.records(form.record, 1)
        inputs = [records, self.origins, self.directions, self.begin, self.slot, far, ends]
        kernel = make_kernel(form, counted)

        def test_all() -> np.ndarray:
            launch(kernel, self.count, inputs, device=wp.get_device("cpu"), chunk=64)
            return ends.numpy().sum(axis=0, dtype=np.int64) if counted else far.numpy()

        return test_all


def replays(
    scenes: Sequence[str] = tuple(SCENES),
    forms: Sequence[str] = tuple(STUDIED),
    reference: str = KEPT,
    *,
    size: int = 128,
    rounds: int = ROUNDS,
) -> list[Row]:
    """Time of a test one by one, every exit a branch, and where tests end.

    Args:
        scenes: keys in `SCENES`.
        forms: keys in `FORMS`; the reference is added.
        reference: key in `FORMS`, of the form to whose times ratios refer.
        size: views have size x size pixels.
        rounds: number of rounds per form.

    Returns:
        A row for each scene and form: scene, form, tests (pairs), bytes (that a test reads), hit_rate, exits (share of the
        tests that end at each, by its name), nanoseconds (a test), seconds, ratio, least, greatest.
    """
    rows = []
    for scene in scenes:
        replay = Replay(Case(scene, size))
        names = tuple(dict.fromkeys((*forms, reference)))
        timings = timed({name: replay.run(name) for name in names}, rounds)
        for name in names:
            form, ends = FORMS[name], replay.run(name, counted=True)()
            shares = dict(zip(form.lanes.exits, (ends[:-1] / ends.sum()).tolist(), strict=True))
            row = {"scene": scene, "form": name, "tests": replay.tests, "bytes": form.record.test_bytes}
            row |= {"hit_rate": float(ends[-1] / ends.sum()), "exits": shares} | ratios(timings[name], timings[reference])
            rows.append(row | {"nanoseconds": 1e9 * timings[name].median / replay.tests})
    return rows


def watertight_pruning(scenes: Sequence[str] = tuple(SCENES), *, size: int = 128, rounds: int = ROUNDS) -> list[Row]:
    """Rows of `replays` for the pruning that leaks and for that which does not; reference: the latter without pruning."""
    return replays(scenes, ("ferko_prune3", PRUNED.name), UNPRUNED.name, size=size, rounds=rounds)


def isolated(contenders: dict[str, Any], scenes: Sequence[str], *, size: int, rounds: int, rays: int) -> list[Row]:
    """Rays of views against all triangles, one by one; ratios refer to the first contender.

    Returns:
        A row for each scene and contender: scene, test, tests, found (rays that hit), nanoseconds (a test), seconds, ratio,
        least, greatest.
    """
    rows = []
    for scene in scenes:
        case = Case(scene, size)
        view = case.workloads[0].thinned(rays)
        shape, center = (*view.rays.shape, 3), case.scene.center
        origins = np.broadcast_to(view.rays.origins, shape).reshape(-1, 3) - center
        beams = Beams(origins, np.broadcast_to(view.rays.directions, shape).reshape(-1, 3))
        soup = Soup(case.mesh.vertices[case.mesh.faces] - center)
        runs = {name: closest(test, soup, beams, frustum=0, width=0) for name, test in contenders.items()}
        timings, tests = timed(runs, rounds), beams.count * len(soup)
        for name, timing in timings.items():
            row = {"scene": scene, "test": name, "tests": tests, "found": int((timing.result[1] >= 0).sum())}
            row |= ratios(timing, next(iter(timings.values())))
            rows.append(row | {"nanoseconds": 1e9 * timing.median / tests})
    return rows


def edge_planes(scenes: Sequence[str] = tuple(SCENES), *, size: int = 64, rounds: int = ROUNDS, rays: int = 256) -> list[Row]:
    """Rows of `isolated` for Amanatides and Choi's edge planes, and by signed volumes, the reference."""
    contenders = {"volumes": TRIANGLE_TESTS["pluecker"], "edge planes": STUDIED["edge_planes"]}
    return isolated(contenders, scenes, size=size, rounds=rounds, rays=rays)


def subdivision(scenes: Sequence[str] = tuple(SCENES), *, size: int = 64, rounds: int = 3, rays: int = 64) -> list[Row]:
    """Rows of `isolated` for Dammertz and Keller's test and Woop's, the reference."""
    contenders = {"woop": TRIANGLE_TESTS["woop"], "dammertz_keller": DAMMERTZ_KELLER}
    return isolated(contenders, scenes, size=size, rounds=rounds, rays=rays)


def squared_errors(
    scenes: Sequence[str] = tuple(SCENES), tests: Sequence[str] = tuple(TRIANGLE_TESTS), *, size: int = 128
) -> list[Row]:
    """Havel and Herout's comparison: each ray of a view against the triangle that it hits, and the same in float64.

    The rays start at one point, the scene's centre is the origin, and hits within a hundredth of an edge are left out.

    Returns:
        A row for each scene and test, Dammertz and Keller's last: scene, test, hits, missed (share), t (mean squared relative
        error), uv (mean squared error of u and v), point (mean squared distance of origin + t direction from the hit, in
        squares of the scene's diagonal).
    """
    rows = []
    for scene in scenes:
        case = Case(scene, size)
        view, center = case.workloads[0].rays, case.scene.center
        hits = case.scene.intersect(view)
        found = hits.is_hit.ravel()
        shape = (*view.shape, 3)
        origin = (np.broadcast_to(view.origins, shape).reshape(-1, 3)[0] - center).astype(np.float32)
        directions = np.broadcast_to(view.directions, shape).reshape(-1, 3)[found].astype(np.float32)
        corners = (case.mesh.vertices[case.mesh.faces][hits.primitive_id.ravel()[found]] - center).astype(np.float32)
        exact = solve(corners, origin, directions)
        kept = np.minimum(np.minimum(exact[:, 1], exact[:, 2]), 1.0 - exact[:, 1] - exact[:, 2]) > 0.01
        corners, directions, exact = corners[kept], directions[kept], exact[kept]
        soup, beams = Soup(corners, origin), Beams(origin[None], directions)
        for name in (*tests, DAMMERTZ_KELLER.name):
            test = TRIANGLE_TESTS.get(name, DAMMERTZ_KELLER)
            got = pairs(test, soup, beams).astype(np.float64)
            hit = ~np.isnan(got[:, 0])
            off = (got - exact)[hit]
            length = np.linalg.norm(directions[hit].astype(np.float64), axis=1)
            row = {"scene": scene, "test": name, "hits": len(exact), "missed": float(1.0 - hit.mean())}
            row |= {"t": float(((off[:, 0] / exact[hit, 0]) ** 2).mean()), "uv": float((off[:, 1:] ** 2).mean())}
            rows.append(row | {"point": float(((off[:, 0] * length / case.mesh.extent) ** 2).mean())})
    return rows


def leak_counts(tests: Sequence[str] = LEAKING, *, origins: int = 8, subdivisions: int = 4) -> list[Row]:
    """Rays from inside closed bodies, at edges and vertices, that hit nothing.

    Args:
        tests: keys in `TRIANGLE_TESTS` or in `FORMS`.
        origins, subdivisions: as in `studies.triangles.triangle_precision.leaks`.

    Returns:
        A row for each test and "edges" or "vertices": test, at, rays, leaked, per_million.
    """
    rows = []
    for name in tests:
        test = TRIANGLE_TESTS[name] if name in TRIANGLE_TESTS else FORMS[name]
        for at, counts in leaks(test, origins=origins, subdivisions=subdivisions).items():
            rows.append({"test": name, "at": at, **counts})
    return rows

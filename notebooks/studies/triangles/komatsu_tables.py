"""The tables and figures of Komatsu et al. 2008, measured again: frusta of rays from one eye against triangles.

    table_1         operations and bytes                    exit_shares     Table 3: where tests end
    contenders      Table 2, Fig. 6: time without a tree    early_exits     Fig. 7: precomputation and exits, one by one
    resolutions     Fig. 8: from 128 to 1024 pixels         frustum_sizes   from single rays to 16 x 16
    with_tree       Table 4, Fig. 9: with a SAH-BVH         foreseen        what exits are worth if branches are foreseen
    depth_limits    Table 4's large models: trees of depth 12 and 10

Each returns a list of plain dicts. Without a tree a picture costs rays x triangles tests: of the frusta of a picture as many
are measured, evenly picked, as make some `TESTS` tests, and `seconds` is that time scaled up to the whole picture. The clock
is the processor time of one thread, contenders take turns, ratios are taken round by round: "ratio" is the median of time /
the reference's time, "least" and "greatest" are those of a round.

What an exit is worth: each is a branch, and one that a half or a quarter of all vectors take is hard to foresee. `foreseen`
sorts triangles so that the processor foresees every branch, which tells the arithmetic that exits save from what wrong guesses
cost.

References: komatsu-2008.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from time import thread_time
from typing import Any

import numpy as np

from studies.evidence import papers
from studies.triangles.isolated_tests import Beams, Soup, closest, exits
from studies.triangles.triangle_test_comparison import ratios
from wrt.accelerators.tree_descriptions import KdTree
from wrt.bench.core.paired_timing import Contender, Timing, take_turns
from wrt.bench.core.workloads import WorkloadMaker
from wrt.kernels.classics.studies.derivation_counts import count_derivation
from wrt.kernels.classics.studies.komatsu_2008 import PUBLISHED
from wrt.kernels.runtime.launch import use_threads
from wrt.kernels.simd.lanes import native_width
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.kernels.triangle.support.triangle_contract import TestForm
from wrt.meshes.mesh import TriangleMesh
from wrt.scene.scene import Scene

Row = dict[str, Any]

TESTS = 1 << 24
"""Pairs of a ray and a triangle in a call."""

LANES = 4
"""Of the paper's processor; frusta of 2 x 2 rays fill them."""

CONTENDERS: dict[str, TestForm] = {
    "Möller": PUBLISHED["moeller"],
    "Projection": PUBLISHED["projection"],
    "Pluecker": PUBLISHED["pluecker"],
    "Proposed": PUBLISHED["proposed"],
}
"""By the paper's names."""

NOT_COUNTED = 3
"""Operations of the other tests that the paper leaves out: u and v are divided here, and one subtraction finds a bad t."""

PAPER_TABLE_1 = {name: tuple(map(int, row)) for name, row in papers.KOMATSU_1.rows.items()}
"""Precomputation, test, bytes."""

PAPER_TABLE_2 = {name: papers.KOMATSU_2.row(name) for name in papers.KOMATSU_2.rows}
"""Seconds, without a tree; the paper's dragon has more triangles than the one of lower resolution."""

PAPER_TABLE_3 = {name: tuple(value for value in row if value is not None) for name, row in papers.KOMATSU_3.rows.items()}
"""Per cent of the tests that are no hits, exit by exit."""

PAPER_TABLE_4 = papers.KOMATSU_4.ratio("Möller", "Proposed")
"""Speeds with a SAH-BVH, by model."""


def table_1() -> list[Row]:
    """Operations and bytes beside the paper's.

    Those of a test are counted in the steps that are compiled, those of the precomputation while the derivation of the records
    runs on counting numbers: "precomputation" for an origin, as in the paper, and "triangle" once for a triangle.
    """
    rows, corners, origin = [], ((0.0, 0.0, 0.0), (1.0, 0.0, 0.5), (0.0, 1.0, 0.25)), (0.25, 0.5, 3.0)
    for name, form in CONTENDERS.items():
        counted = sum(step.arithmetic for step in form.lanes.operations) - (0 if name == "Projection" else NOT_COUNTED)
        derived = count_derivation(form.record, corners, origin)
        row = {"algorithm": name, "triangle": derived.per_triangle.arithmetic, "precomputation": derived.per_origin.arithmetic}
        row |= {"test": counted, "bytes": form.record.test_bytes}
        rows.append(row | dict(zip(("paper_precomputation", "paper_test", "paper_bytes"), PAPER_TABLE_1[name], strict=True)))
    return rows


def frusta(mesh: TriangleMesh, *, pixels: int, edge: int, tests: int = TESTS) -> tuple[Soup, Beams]:
    """The triangles of a mesh, and frusta of edge x edge rays evenly picked from a view of it.

    Raises:
        ValueError: pixels is not a multiple of edge.
    """
    if pixels % edge:
        raise ValueError(f"pixels is {pixels}; a view of frusta of {edge} x {edge} needs a multiple of {edge}")
    (view,) = WorkloadMaker(mesh, size=pixels, order="rows").make(["far"])
    across = pixels // edge
    tiles = view.directions.reshape(across, edge, across, edge, 3).transpose(0, 2, 1, 3, 4).reshape(-1, edge * edge, 3)
    count = max(1, min(len(tiles), tests // (edge * edge * mesh.triangle_count)))
    chosen = np.linspace(0, len(tiles) - 1, count + 2).astype(int)[1:-1] if count < len(tiles) else np.arange(len(tiles))
    origin = view.origins[0] - mesh.center
    return Soup(mesh.vertices[mesh.faces] - mesh.center, origin), Beams(origin[None], tiles[chosen].reshape(-1, 3))


def timed(
    mesh: TriangleMesh,
    forms: Mapping[str, TestForm],
    *,
    pixels: int = 256,
    edge: int = 2,
    width: int = LANES,
    tests: int = TESTS,
    rounds: int = 5,
) -> list[Row]:
    """Times frusta without a tree; ratios refer to the first of the forms.

    Args:
        mesh: any.
        forms: by the names that rows get.
        pixels: of the view, each way.
        edge: frusta have edge x edge rays.
        width: lanes, at most the rays of a frustum.
        tests: pairs of a ray and a triangle a call.
        rounds: turns.
    """
    soup, rays = frusta(mesh, pixels=pixels, edge=edge, tests=tests)
    common = {"pixels": pixels, "edge": edge, "width": width}
    return timed_on(soup, rays, forms, rounds, whole=pixels * pixels * len(soup), **common)


def timed_on(soup: Soup, rays: Beams, forms: Mapping[str, TestForm], rounds: int, whole: int, **common: Any) -> list[Row]:
    """Times frusta of given rays; `common`: "edge", "width" and whatever else all rows have."""
    pairs, frustum = rays.count * len(soup), common["edge"] ** 2
    with use_threads(1):
        contenders = [
            Contender(name, closest(form, soup, rays, frustum=frustum, width=common["width"]), pairs)
            for name, form in forms.items()
        ]
        timings = take_turns(contenders, rounds, clock=thread_time)
    return rows_of(timings, next(iter(forms)), whole, **common)


def rows_of(timings: dict[str, Timing], reference: str, whole: int, **common: Any) -> list[Row]:
    """A row a contender; `whole`: items that "seconds" stands for."""
    found = ratios(timings, reference)
    return [
        {"contender": name, **common, **asdict(ratio), "ratio": ratio.median, "seconds": ratio.nanoseconds * 1e-9 * whole}
        for name, ratio in found.items()
    ]


def without_exits(form: TestForm) -> TestForm:
    """The same test in one step: everything is computed, then decided."""
    return replace(form, lanes=form.lanes.joined(len(form.lanes.steps)))


def one_exit(form: TestForm) -> TestForm:
    """The same test with the exit that nearly all take, before the divisions of a hit."""
    return replace(form, lanes=form.lanes.joined(len(form.lanes.steps) - 1, 1))


def contenders(mesh: TriangleMesh, **options: Any) -> list[Row]:
    """Table 2 and Fig. 6: the four tests as published; options as those of `timed`."""
    return timed(mesh, CONTENDERS, **options)


def with_and_without_exits() -> dict[str, TestForm]:
    """Each of the tests that the paper prints without exits, with all of them, and with one."""
    forms = {}
    for name in ("Möller", "Pluecker", "Proposed"):
        form = CONTENDERS[name]
        forms |= {f"{name}, no exits": without_exits(form), f"{name}, exits": form, f"{name}, one exit": one_exit(form)}
    return forms


def early_exits(mesh: TriangleMesh, **options: Any) -> list[Row]:
    """Fig. 7, with the cases that the paper leaves out; ratios refer to Möller's test without exits."""
    return timed(mesh, with_and_without_exits(), **options)


def foreseen(mesh: TriangleMesh, *, rounds: int = 5, tests: int = TESTS) -> list[Row]:
    """The same for one frustum of 2 x 2 rays over and over, its triangles in three orders.

    "order": "file", as the mesh has them; "tree", neighbours in space one after the other; "exit", by the exit at which they
    end, so that the processor foresees every branch. Ratios refer to Möller's test without exits in the same order.
    """
    (view,) = WorkloadMaker(mesh, size=1024, order="rows").make(["far"])
    middle = view.directions.reshape(1024, 1024, 3)[511:513, 511:513].reshape(4, 3)
    origin, corners = view.origins[0] - mesh.center, mesh.vertices[mesh.faces] - mesh.center
    rays = Beams(origin[None], np.tile(middle, (max(1, tests // (4 * len(corners))), 1)))
    leaves = Scene(mesh, "bvh", device="cpu").tree.primitive.numpy()
    orders = {"file": slice(None), "tree": leaves[leaves >= 0], "exit": exit_order(corners - origin, middle.mean(axis=0))}
    rows, forms = [], with_and_without_exits()
    for name, order in orders.items():
        soup = Soup(corners[order], origin)
        rows += timed_on(soup, rays, forms, rounds, rays.count * len(soup), edge=2, width=LANES, order=name)
    return rows


def exit_order(corners: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Indices of triangles, relative to the eye, by the exit at which the test of a ray ends."""
    a, b, c = np.moveaxis(corners.astype(np.float64), 1, 0)
    facing, u, v = (np.cross(p, q) @ direction for p, q in ((b - a, c - a), (a, c), (b, a)))
    ends = np.argmin(np.stack([facing < 0, u >= 0, v >= 0, u + v <= -facing, np.zeros(len(a), bool)]), axis=0)
    return np.argsort(ends, kind="stable")


def tessellated(mesh: TriangleMesh, times: int) -> TriangleMesh:
    """The same surface with every triangle divided into four, `times` times; triangles share no vertices."""
    corners = mesh.vertices[mesh.faces]
    for _ in range(times):
        a, b, c = np.moveaxis(corners, 1, 0)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        corners = np.concatenate([np.stack(part, axis=1) for part in parts])
    return TriangleMesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), name=f"{mesh.name} x {4**times}")


def depth_limits(
    mesh: TriangleMesh, *, limits: Sequence[int | None] = (None, 12, 10), pixels: int = 256, rounds: int = 5
) -> list[Row]:
    """Table 4's two large models: rows of `with_tree` by the depth of the tree, "limit"; None is a whole BVH."""
    rows = []
    for limit in limits:
        rows += [
            row | {"limit": str(limit).lower()}
            for row in with_tree(mesh, pixels=pixels, rounds=rounds, max_depth=limit, records=False)
        ]
    return rows


def exit_shares(mesh: TriangleMesh, *, pixels: int = 256, edge: int = 2, tests: int = TESTS >> 3) -> list[Row]:
    """Table 3: of the tests that are no hits, the share that ends at each exit; and of vectors of edge x edge tests."""
    soup, rays = frusta(mesh, pixels=pixels, edge=edge, tests=tests)
    rows = []
    for name, form in CONTENDERS.items():
        found = exits(form, soup, rays, group_rays=edge * edge)
        for number, exit_name in enumerate(found.names[:-1]):
            counts = {"tests": found.tests, "vectors": found.vectors}
            shares = {key: value[number] / sum(value[:-1]) for key, value in counts.items()}
            paper = PAPER_TABLE_3[name][number] / 100 if number < len(PAPER_TABLE_3[name]) else None
            rows.append({"contender": name, "exit": exit_name, **shares, "paper": paper, "hit_rate": found.hit_rate})
    return rows


def resolutions(mesh: TriangleMesh, pixels: Sequence[int] = (128, 256, 512, 1024), **options: Any) -> list[Row]:
    """Fig. 8: the proposed test against Möller's, as published, for views of more and more pixels."""
    forms = {name: CONTENDERS[name] for name in ("Möller", "Proposed")}
    return [row for count in pixels for row in timed(mesh, forms, pixels=count, **options)]


def frustum_sizes(mesh: TriangleMesh, edges: Sequence[int] = (1, 2, 4, 8, 16), **options: Any) -> list[Row]:
    """Frusta of 1 to 16 x 16 rays in lanes as wide as they fill: Möller's and the proposed test with one exit."""
    forms = {name: one_exit(CONTENDERS[name]) for name in ("Möller", "Proposed")}
    return [row for edge in edges for row in timed(mesh, forms, edge=edge, width=min(edge * edge, 16), **options)]


def with_tree(
    mesh: TriangleMesh, *, pixels: int = 256, rounds: int = 9, max_depth: int | None = None, records: bool = True
) -> list[Row]:
    """Table 4 and Fig. 9: a view through a SAH-BVH, by the engine's tests; packets with the same culling, and single rays.

    Args:
        mesh: any.
        pixels: of the view, each way.
        rounds: number of rounds per test.
        max_depth: None for a BVH; else that of a kd-tree, as leaves of our BVHs hold 63 triangles at most and those of the
            paper's deepest trees, of depth 12 and 10, hold thousands.
        records: whether making the records is timed, too.

    Returns:
        Rows of `timed`, with "traversal" and "records": what making the records takes, as a share of the reference's time for
        a view, once an origin for Komatsu's.
    """
    (view,) = WorkloadMaker(mesh, size=pixels).make(["far"])
    tree = "bvh" if max_depth is None else KdTree(max_depth=max_depth)
    scene, rows = Scene(mesh, tree, device="cpu", num_threads=1), []
    soup = Soup(mesh.vertices[mesh.faces] - mesh.center, view.origins[0] - mesh.center)
    width = native_width(scene.device)
    for traversal, culling in (("packet", "interval"), ("single", "")):
        runs = []
        for name in ("moeller_trumbore", "komatsu", "woop"):
            plan = replace(scene.explain(view.rays, traversal=traversal, triangle_test=name), culling=culling)
            runs.append(Contender(name, lambda plan=plan: scene.intersect(view.rays, traversal=plan).t, len(view)))
        with use_threads(1):
            packed = [
                Contender(f"{run.name} records", lambda test=run.name: soup.pack(TRIANGLE_TESTS[test].record, width), len(view))
                for run in (runs if records else ())
            ]
            timings = take_turns([*runs, *packed], rounds, clock=thread_time, settle=0.2)
        traced = {run.name: timings[run.name] for run in runs}
        for row in rows_of(traced, "moeller_trumbore", len(view), traversal=traversal, pixels=pixels):
            if records:
                row["records"] = timings[f"{row['contender']} records"].ratio_to(timings["moeller_trumbore"])
            rows.append(row)
    return rows

"""Plücker's frustum test with the test of the edges first, which the survey expects to explain Komatsu et al.'s 21 %.

Benthin 2006 ends 52 to 68 % of the tests at the edges and 18 % at the distance. Komatsu et al. report 21 % at the first exit of
their test, whose listing asks first whether the triangle faces the origin. The survey calls that order a misunderstanding. Both
orders are measured here without a tree, on the same frusta: where tests end, and their time against Möller's.

References: rahikainen-2013 (section 2.1); komatsu-2008; benthin-2006.
"""

from __future__ import annotations

from typing import Any

from studies.triangles.isolated_tests import exits
from studies.triangles.komatsu_tables import CONTENDERS, frusta, timed
from wrt.kernels.classics.studies.komatsu_2008 import DISTANCE, FACING, derive_pluecker, ray_form
from wrt.kernels.classics.triangle.published import FINITE
from wrt.kernels.triangle.support.record_blocks import Record
from wrt.kernels.triangle.support.triangle_contract import TestForm
from wrt.kernels.triangle.support.vectors import dotted, names
from wrt.meshes.mesh import TriangleMesh

EDGES = (
    "outside an edge",
    f"const float gamma = {dotted('d', 't0')}, rest = {dotted('d', 't1')}, alpha = {dotted('d', 't2')};",
    "((alpha >= 0.0f) & (rest >= 0.0f) & (gamma >= 0.0f)) | ((alpha <= 0.0f) & (rest <= 0.0f) & (gamma <= 0.0f))",
)
"""Either all signs are positive, or all negative: whether the triangle is turned away is asked afterwards."""


def make_inside_first() -> TestForm:
    """The published test with its first two exits exchanged."""
    last = ("no distance", f"const float beta = gamma;{DISTANCE}", FINITE)
    triangle = (*names("n"), *names("t0"), *names("t1"), *names("t2"), "f2")
    return ray_form("pluecker_inside_first", Record(13, derive_pluecker, per_origin=True), triangle, EDGES, FACING, last)


def compare_orders(mesh: TriangleMesh, *, tests: int = 1 << 21, rounds: int = 5) -> list[dict[str, Any]]:
    """Where both orders end tests that are no hits, and their time against Möller's test.

    Args:
        mesh: any.
        tests: pairs of a ray and a triangle a call.
        rounds: number of rounds per order.

    Returns:
        A row for each order and exit: order, exit, tests and vectors (shares), hit_rate, ratio (time / Möller's).
    """
    forms = {"Möller": CONTENDERS["Möller"], "facing first": CONTENDERS["Pluecker"], "inside first": make_inside_first()}
    ratio = {row["contender"]: row["ratio"] for row in timed(mesh, forms, tests=tests, rounds=rounds)}
    soup, rays = frusta(mesh, pixels=256, edge=2, tests=tests)
    rows, hit_rates = [], set()
    for order in ("facing first", "inside first"):
        found = exits(forms[order], soup, rays, group_rays=4)
        hit_rates.add(round(found.hit_rate, 12))
        for number, name in enumerate(found.names[:-1]):
            shares = {
                key: counts[number] / sum(counts[:-1]) for key, counts in (("tests", found.tests), ("vectors", found.vectors))
            }
            rows.append({"order": order, "exit": name, **shares, "hit_rate": found.hit_rate, "ratio": ratio[order]})
    if len(hit_rates) > 1:
        raise ValueError(f"both orders must find the same hits; shares of hits are {sorted(hit_rates)}")
    return rows

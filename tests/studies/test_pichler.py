"""The tables of Pichler's thesis: rows are complete, and what they count and draw is consistent. Times are not checked."""

from __future__ import annotations

import numpy as np
import pytest

from studies.triangles import pichler_tables as pichler
from wrt.kernels.classics.triangle.ferko.variant import Variant

pytestmark = pytest.mark.classics


def test_counts_of_variants():
    """Three-fold: an order of its own is the plain order, so what lowers the number is the circle. Bounds lose no hit."""
    rows = {row["variant"]: row for row in pichler.pruning_tests(("needles",), size=12)}
    assert set(rows) == set(pichler.LABELS.values()) | set(pichler.CIRCLED)
    assert len({row["tests"] for row in rows.values()}) == 1
    assert len({row["kept"] for row in rows.values()}) == 1
    assert rows["3x, p.es."]["comparisons"] == rows["3x, p.es., w."]["comparisons"] == rows["3x, circle"]["comparisons"]
    assert rows["3x, p.es., w., bb."]["comparisons"] == rows["3x"]["comparisons"] > rows["3x, circle"]["comparisons"]
    assert rows["4x, p.es."]["comparisons"] <= rows["4x, circle"]["comparisons"] < rows["4x"]["comparisons"]
    assert rows["3x"]["percent"] == rows["4x"]["percent"] == 100.0
    assert 0.0 < rows["3x"]["hit_rate"] < 0.1


def test_views_see_what_the_scene_is_named_after():
    """The teapot stood on a ground of 200 x 200 units: the view, which fits the box, saw nothing of the pot, and all variants
    made the same number of comparisons."""
    case = pichler.Case("teapot", 24)
    hits = case.scene.intersect(case.workloads[0].rays)
    normals = hits.normal[hits.is_hit]
    assert len(normals) >= 50
    assert len(np.unique(np.round(normals, 3), axis=0)) >= 20, "it is curved"
    rows = {row["variant"]: row["percent"] for row in pichler.pruning_tests(("teapot",), size=24)}
    assert rows["3x, p.es."] == rows["3x, circle"] < 90.0
    assert rows["4x, p.es."] < rows["4x, circle"] < 90.0


def test_a_variant_that_does_not_prune_is_refused():
    with pytest.raises(ValueError, match="fold is 3 or 4"):
        pichler.Case("needles", 4).count(Variant())


def test_times():
    """All tests find the same hits, alone and in lanes."""
    rows = pichler.compare(("needles",), ("woop", "ferko_hybrid"), size=8, rounds=2)
    assert [(row["mode"], row["test"]) for row in rows] == [(m, t) for m in pichler.MODES for t in ("woop", "ferko_hybrid")]
    assert len({row["hits"] for row in rows}) == 1
    assert all(0.0 < row["least"] <= row["ratio"] <= row["greatest"] for row in rows)
    assert rows[0]["ratio"] == 1.0


def test_errors():
    """More samples are nearer to the truth; the tests' own share of the error is rounding."""
    size = {"size": 8, "reference_samples": 64, "rounds": 1, "seeds": 3}
    rows = pichler.errors(("stadium",), tests=("woop", "ferko_hybrid"), samples=4, **size)
    few = pichler.errors(("stadium",), tests=("woop",), samples=1, **size)
    assert rows[0]["error"] < few[0]["error"]
    assert max(row["bias"] for row in rows) < 1e-4
    assert all(np.isfinite(row["error"]) and row["samples"] >= 1 for row in rows)

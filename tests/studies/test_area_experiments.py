"""More of Falcone's experiments: octrees that decide by their leaves, queues and stacks, axes tried."""

from __future__ import annotations

import numpy as np
import pytest

import wrt
from studies.known_rays import area_experiments as experiments
from studies.known_rays import area_pictures as pictures
from studies.known_rays import area_tables
from studies.known_rays.ray_cases import SCENES, Case
from studies.known_rays.ray_distribution import average, scene_of, unclipped
from studies.known_rays.ray_scenes import head
from wrt.known_rays.tree_analysis import analyse

SMALL = wrt.scenes.random_triangles(count=300, size=0.2)
CASE = Case("random", SMALL, "plane", "15 degrees")


def test_walks_find_what_the_engine_finds():
    """The closest hits of all orders, with a range of t; and, without an end at hits, the counts of the engine's traversal."""
    cast = CASE.rays(400)
    scene = scene_of(CASE, "PAH + SPFH")
    expected = scene.intersect(cast, triangle_test="woop").t
    assert 50 < np.isfinite(expected).sum() < 400
    counted = analyse(scene, CASE.area, cast).passing
    for order in experiments.ORDERS:
        found = experiments.walk(scene, cast, order)
        np.testing.assert_allclose(found["t"], expected, rtol=1e-6)
        through = experiments.walk(scene, cast, order, stops=False)
        meets = through["boxes"] > 0
        assert meets.sum() == pytest.approx(counted.rays, abs=2)
        assert through["boxes"][meets].mean() == pytest.approx(counted.boxes, rel=0.01)
        assert through["triangles"][meets].mean() == pytest.approx(counted.triangles, rel=0.01)
        assert (found["boxes"] <= through["boxes"]).all()
        assert (through["most"] >= found["most"]).all()


def test_orders():
    """Nearest first needs the least; without an end at hits all orders need the same."""
    rows = experiments.walk_orders([CASE], rays=256)
    assert len(rows) == 2 * 3
    cost = average(rows, "cost", "tree", "order")
    for tree in ("SAH + LSPH", "PAH + SPFH"):
        assert cost[tree, "sorted"] < min(cost[tree, "queue"], cost[tree, "stack"])
        assert len({row["passing"] for row in rows if row["tree"] == tree}) == 1


def test_octree_levels():
    """With levels fewer rays go to trees of areas in which they do not begin; those that begin there always go."""
    rows = experiments.octree_levels([CASE], (1, 3), areas=6, rays=512)
    assert [row["depth"] for row in rows] == [1, 3, None]
    assert rows[0]["sent"] > rows[1]["sent"] > rows[2]["sent"] > 20
    assert rows[0]["strangers"] > rows[1]["strangers"] > rows[2]["strangers"] == 0.0
    for row in rows:
        assert row["fallback"] >= row["local"] > 0.0
        assert row["sent"] * (1.0 - row["strangers"]) == pytest.approx(rows[2]["sent"])


def test_axes_tried():
    """SPFH tries more than LSPH, which mostly tries the longest."""
    tried = average(experiments.axes_tried([CASE]), "tried", "axes")
    assert 1.0 <= tried["LSPH",] < tried["SPFH",] <= 3.0


def test_scenes_of_the_thesis_kinds():
    """A low-poly head in one closed surface a part, and a court of more triangles than any other scene."""
    counts = {name: make().triangle_count for name, make in SCENES.items()}
    assert 800 < counts["head"] < 1200
    assert head().is_closed
    assert counts["palace"] == max(counts.values())


@pytest.mark.parametrize("kind", ["plane", "point"])
def test_polygons_of_boxes(kind):
    """Hulls have the projected areas of the analysis, and share what siblings overlap by, but for what the window cuts off."""
    case = Case("random", SMALL, kind, "oblique")
    area = unclipped(case.area)
    found = analyse(scene_of(case, "PAH + LSPH"), area)
    boxes = found.boxes
    for box in range(0, len(boxes.level), 37):
        seen = pictures.polygon_area(pictures.projected(area, boxes.low[box], boxes.high[box]))
        assert seen == pytest.approx(boxes.area[box], rel=1e-3)
    chosen = pictures.uneven_node(found)
    first, second = (pictures.projected(area, boxes.low[box], boxes.high[box]) for box in (chosen.small, chosen.big))
    both = pictures.polygon_area(pictures.shared(first, second))
    assert both == pytest.approx(boxes.overlap_area[chosen.node], rel=1e-3)
    smaller = min(map(pictures.polygon_area, (first, second)))
    assert both / smaller == pytest.approx(boxes.overlap[chosen.node], rel=1e-3)
    assert chosen.triangles[0] < chosen.triangles[1]
    assert sum(chosen.triangles) == pictures.triangles_below(found)[chosen.node]
    assert pictures.triangles_below(found)[0] == 300
    apart = pictures.shared(first, first + 1e3)
    assert pictures.polygon_area(apart) == 0.0


def test_rays_that_leave_an_area():
    """With the area's end more rays hit within it; behind it are those that the whole scene's tree finds."""
    shares = []
    for reach in (0.4, 0.6, 1.0):
        across, state, share = pictures.missed(CASE, reach, 512)
        assert across.shape == (512, 2)
        assert share == pytest.approx((state == 0).mean())
        shares.append(share)
    assert shares == sorted(shares)
    assert (state == 1).sum() == 0 < (state == 2).sum()


def test_rays_over_caps_are_estimated_worse_by_the_circular_one():
    """Its rays keep away from the corners of the window, which the estimate counts in."""
    rows = experiments.cap_errors([Case("head", SCENES["head"](), "point", "oblique")], rays=256)
    errors = {row["cap"]: row["error"] for row in rows}
    assert errors.keys() == {"square", "circular"}
    assert 0.0 < errors["square"] < errors["circular"] < 1.0


def test_gains_are_means_over_scenes_of_the_work_that_is_spared(monkeypatch):
    """Half the reference's work is a gain of 100 %; the reference has no row of its own."""
    work = {"SAH + LSPH": (6.0, 3.0), "PAH + SPFH": (3.0, 2.0)}
    rows = [
        {"scene": scene, "kind": "plane", "way": "oblique", "tree": tree, "cost": cost}
        for tree, costs in work.items()
        for scene, cost in zip("ab", costs, strict=True)
    ]
    monkeypatch.setattr(area_tables, "costs", lambda rays: rows)
    assert area_tables.gains() == [{"tree": "PAH + SPFH", "kind": "plane", "way": "oblique", "percent": pytest.approx(75.0)}]

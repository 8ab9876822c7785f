"""The break-even estimate: its formula, and that it counts what rays cost with areas and without."""

from __future__ import annotations

import numpy as np
import pytest
from support.meshes import SCENES

import wrt
from wrt.known_rays.area_break_even import AREA_LOOKUP_COST, break_even_share


def test_share():
    """At the break-even share both ways cost the same; the thesis' form without a cost of its own for misses."""
    rng = np.random.default_rng(0)
    for cost_local, cost_global, cost_miss in rng.uniform(0.1, 9.0, (100, 3)):
        share = break_even_share(cost_local, cost_global, cost_miss)
        assert cost_local + (1 - share) * cost_miss == pytest.approx(cost_global)
        assert break_even_share(cost_local, cost_global, cost_global) == pytest.approx(cost_local / cost_global)
    assert break_even_share(1.0, 2.0, 0.0) == 0.0
    assert break_even_share(2.0, 1.0, 0.0) == np.inf
    with pytest.raises(ValueError, match="cost_miss is nan"):
        break_even_share(1.0, 1.0, np.nan)


def test_break_even_of_an_area():
    """A sun over half of the scene, by the counters of queries; no area; a lamp that no ray runs to."""
    mesh = SCENES["random_triangles"]()
    sun = wrt.known_rays.PlaneInfluenceArea(position=(0.5, 0.5, 2), direction=(0, 0, -1), width=3, height=3, depth=1.5)
    lamp = wrt.known_rays.PointInfluenceArea(position=(0.5, 3, 0.5), direction=(0, -1, 0), fov=(30, 30), near=0.1, far=9)
    areas = wrt.known_rays.RayAwareBvh(areas=[sun, lamp], local=wrt.Bvh())
    scene, plain = (wrt.Scene(mesh, accelerator, device="cpu") for accelerator in (areas, "bvh"))
    down = wrt.known_rays.PlaneCaster(position=(0.5, 0.5, 1.9), direction=(0, 0, -1), width=1, height=1).rays(600)
    rng = np.random.default_rng(0)
    origins = np.concatenate([down.origins, rng.uniform(0, 1, (200, 3))])
    directions = np.concatenate([down.directions, rng.normal(size=(200, 3))])
    report = wrt.known_rays.break_even(scene, origins, directions)
    (area,) = report.areas
    assert (area.area, area.share, report.unassigned_share, report.rays) == (sun, 0.75, 0.25, 800)
    hits = plain.intersect(down, traversal="single", counters=True)
    cost = plain.accelerator.config(scene.tree.width).cost
    expected = cost.traversal * hits.counters["nodes"] + cost.block * hits.counters["triangles"] / scene.tree.width
    assert area.cost_global == pytest.approx(expected.mean())
    low, high = plain.bounds[:, :2]
    beside = ((down.origins[:, :2] < low - 1e-3) | (down.origins[:, :2] > high + 1e-3)).any(axis=1)
    assert (hits.t <= 1.4).mean() <= area.settled <= ((hits.t <= 1.4) | beside).mean()
    with_areas = scene.intersect(down, traversal="single", counters=True).counters
    total = cost.traversal * with_areas["nodes"] + cost.block * with_areas["triangles"] / scene.tree.width
    assert area.cost_local + (1 - area.settled) * area.cost_miss == pytest.approx(AREA_LOOKUP_COST + total.mean())
    assert area.pays == (area.ratio > 1.0) == report.pays
    assert report.ratio == pytest.approx(area.ratio)
    text = str(report)
    assert ("do not pay" in text) != report.pays
    assert "PlaneInfluenceArea with 75.0% of the rays" in text
    assert "25.0% of the rays belong to no area" in text


def test_scenes_without_areas():
    mesh = SCENES["random_triangles"]()
    with pytest.raises(ValueError, match="no influence areas with triangles"):
        wrt.known_rays.break_even(wrt.Scene(mesh, device="cpu"), [0, 0, 0], [0, 0, 1])


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [({"query": "all"}, ValueError, "query 'all' is unknown"), ({"samples": 0}, ValueError, "samples is 0")],
)
def test_bad_arguments(options, error, message):
    sun = wrt.known_rays.PlaneInfluenceArea(position=(0.5, 0.5, 2), direction=(0, 0, -1), width=3, height=3, depth=1.5)
    scene = wrt.Scene(SCENES["random_triangles"](), wrt.known_rays.RayAwareBvh(areas=[sun], local=wrt.Bvh()), device="cpu")
    with pytest.raises(error, match=message):
        wrt.known_rays.break_even(scene, [0, 0, 0], [0, 0, 1], **options)

"""Valid arguments of `wrt.known_rays`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any
from unittest import mock

import numpy as np
import pytest

import wrt
from support.call_objects import AIM, Call, area, hits, known_scene, rays, scene
from wrt.known_rays import influence_areas


def known_ray_calls() -> Iterator[Call]:
    origins, directions = rays()
    plane = {**AIM, "width": 4.0, "height": 2.0, "depth": 8.0}
    yield Call("PlaneInfluenceArea", wrt.known_rays.PlaneInfluenceArea, plane)
    point = {**AIM, "fov": (64.0, 32.0), "near": 1.0, "far": 8.0}
    yield Call("PointInfluenceArea", wrt.known_rays.PointInfluenceArea, point)
    radial = wrt.known_rays.PointInfluenceArea(**point)
    for one in (area(), radial):
        yield Call("_Area.affine", lambda one=one, **o: one.affine(origins, directions, **o), {"tolerance": 2.0})
    yield Call("PlaneCaster", wrt.known_rays.PlaneCaster, {**AIM, "width": 4.0, "height": 2.0, "tolerance": 2.0})
    yield Call("PlaneCaster.of", lambda **o: wrt.known_rays.PlaneCaster.of(area(), **o), {"tolerance": 2.0})
    yield Call("CircularCapCaster", wrt.known_rays.CircularCapCaster, {**AIM, "angle": 32.0})
    yield Call("SquareCapCaster", wrt.known_rays.SquareCapCaster, {**AIM, "fov": (64.0, 32.0)})
    casters = (
        wrt.known_rays.PlaneCaster.of(area()),
        wrt.known_rays.SquareCapCaster.of(radial),
        wrt.known_rays.CircularCapCaster(**AIM, angle=32),
    )
    for one in casters:
        yield Call(f"{type(one).__name__}.rays", lambda one=one, **o: one.rays(**o), {"count": 4, "seed": 1})
    options = {"bounds": [(-9.0, -9.0, -9.0), (9.0, 9.0, 9.0)], "tolerance": 2.0, "least_share": 0.5, "samples": 20, "seed": 1}
    lines = np.zeros((30, 3)), np.random.default_rng(0).normal(size=(30, 3))
    yield Call("InfluenceAreas.from_rays", lambda **o: found_areas(lines, o), options)
    costs = {"box_cost": 1.0, "triangle_cost": 2.0}
    yield Call("analyse", lambda **o: wrt.known_rays.analyse(scene(), **o).expected_cost, costs)
    yield Call(
        "analyse_areas", lambda **o: [one.expected_cost for one in wrt.known_rays.analyse_areas(known_scene(), **o)], costs
    )
    yield Call("break_even", lambda **o: wrt.known_rays.break_even(known_scene(), origins, directions, **o), {"samples": 4})
    yield Call(
        "directional_shadow_rays",
        lambda **o: wrt.known_rays.directional_shadow_rays(hits(), **o),
        {"direction": (0.0, 1.0, -1.0)},
    )
    yield Call("point_shadow_rays", lambda **o: wrt.known_rays.point_shadow_rays(hits(), **o), {"position": (0.0, 1.0, 9.0)})


def found_areas(lines: tuple[np.ndarray, np.ndarray], options: dict[str, Any]) -> str:
    pytest.importorskip("sklearn", reason="scikit-learn is not installed: pip install 'wrt[test-all]'")
    with mock.patch.object(influence_areas, "PAIRS", 50):  # whose clusters take most of the time
        return repr(wrt.known_rays.InfluenceAreas.from_rays(*lines, **options))

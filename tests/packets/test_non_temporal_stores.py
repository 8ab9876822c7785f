"""Hits that packets write by non-temporal stores: their bits, and the plans that have them."""

from __future__ import annotations

import numpy as np
import pytest
from support.hits import assert_same_hits
from support.meshes import SCENES
from support.packet_rays import beams, packet_plan
from support.selection import slow

import wrt
import wrt.engine.memory
import wrt.engine.plan.planner
from wrt.engine.plan.plan import Plan


@pytest.mark.width
@pytest.mark.parametrize("vectors", [4, *slow(2)])
def test_hits(vectors, monkeypatch, device):
    """Whole lines in the middle, and what is left over; through pictures, whose tiles are no lines; with other queries."""
    monkeypatch.setattr(wrt.engine.memory, "MIN_BYTES", 1 << 12)  # smaller arrays do not begin with a cache line
    mesh = SCENES["teapot"]()
    scene = wrt.Scene(mesh, device=device)
    eye, directions = beams(mesh, 90, False)
    for count in (4 * 16 * 20, 4 * 16 * 20 + 37):
        for rays in (wrt.Rays(eye, directions[:count]), wrt.Rays(eye, directions[:1280].reshape(32, 40, 3))):
            plan = packet_plan(scene, rays, "woop", packet=vectors * scene.state.width, non_temporal=True)
            expected = scene.intersect(rays, traversal="brute")
            for _ in range(2):  # the second answer is of a query that was prepared
                assert_same_hits(scene.intersect(rays, traversal=plan), expected)
            np.testing.assert_array_equal(scene.occluded(rays, traversal=plan), expected.is_hit)


def test_plans(monkeypatch):
    """For closest hits that fill half of the last cache, on a CPU that has such stores, in one level, not by tiles."""
    mesh = SCENES["teapot"]()
    directions = beams(mesh, 64, False)[1]

    def plan(query: str = "closest", instances: bool = False, shape: tuple[int, ...] = (), **choice: str) -> Plan:
        scene = wrt.Scene([wrt.Instance(mesh)] if instances else mesh, device="cpu")  # anew: a scene keeps its plans
        rays = wrt.Rays([0.1, 0.2, 9.0], directions.reshape(*shape, -1, 3))
        return scene.explain(rays, query=query, **{"traversal": "packet", **choice})

    def machine(name: str, cache_bytes: int) -> None:
        monkeypatch.setattr(wrt.engine.plan.planner.platform, "machine", lambda: name)
        monkeypatch.setattr(wrt.engine.plan.planner, "l3_bytes", lambda: cache_bytes)

    machine("x86_64", 2 * 16 * len(directions))
    assert plan().non_temporal
    assert "non-temporal stores" in str(plan())
    assert not plan(traversal="single").non_temporal
    assert not plan("any").non_temporal
    assert not plan(instances=True).non_temporal
    assert not plan(shape=(64,)).non_temporal
    machine("x86_64", 2 * 16 * len(directions) + 1)
    assert not plan().non_temporal
    machine("arm64", 1)
    assert not plan().non_temporal

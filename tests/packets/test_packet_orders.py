"""Packet orders: who shares a packet, and that no order shows in the hits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.hits import assert_same_hits, brute_force, mixed_rays

import wrt
from wrt.classics.packet_arrangement import arrange_rays
from wrt.kernels.query.ordering.packet_orders import PACKET_ORDERS

PACKET = 8


def tags(count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Types, properties and camera rays with gaps."""
    rng = np.random.default_rng(seed)
    kinds, groups = rng.integers(0, 3, count), np.repeat(rng.integers(0, 5, -(-count // 7)), 7)[:count]
    return {"kinds": kinds, "groups": groups, "sources": np.cumsum(rng.integers(0, 3, count))}


def expected_packets(order: str, kinds: np.ndarray, groups: np.ndarray, sources: np.ndarray) -> list[list[int]]:
    """The same by lists: what each order means, ray after ray."""
    count = len(kinds)
    keys = {
        "blind": lambda i: 0,
        "group": lambda i: groups[i],
        "runs": lambda i: kinds[i],
        "types": lambda i: kinds[i],
    }[order]
    packets: list[list[int]] = []
    for i in sorted(range(count), key=keys):
        last = packets[-1][-1] if packets else None
        goes_on = last is not None and keys(last) == keys(i) and len(packets[-1]) < PACKET
        if goes_on and order == "runs":
            goes_on = groups[last] == groups[i] and abs(sources[i] - sources[last]) <= 1
        packets = packets if goes_on else [*packets, []]
        packets[-1].append(i)
    return packets


@pytest.mark.parametrize("order", PACKET_ORDERS)
@pytest.mark.parametrize("count", [1, 8, 9, 1000])
def test_packets_hold_what_the_order_says(order, count, device):
    known = tags(count)
    rays = wrt.Rays(np.zeros((count, 3), np.float32), np.ones((count, 3), np.float32))
    arranged = arrange_rays(rays, order, PACKET, **known, device=device)
    packets = [[int(i) for i in row if i >= 0] for row in arranged.places.reshape(-1, PACKET)]
    assert packets == expected_packets(order, *known.values())
    np.testing.assert_array_equal(np.sort(arranged.places[arranged.places >= 0]), np.arange(count))
    assert arranged.usage == count / len(arranged.places)
    np.testing.assert_array_equal(arranged.restore(np.maximum(arranged.places, 0)), np.arange(count))


@pytest.mark.parametrize("order", PACKET_ORDERS)
def test_orders_never_show(order, device):
    """All that a ray can have of its own, or share, with bad rays among them."""
    mesh = wrt.scenes.build("teapot", level=3)
    scene = wrt.Scene(mesh, "bvh", device=device)
    origins, directions = mixed_rays(mesh, 2000)
    t_max = np.linspace(0.1, 3.0, 2000, dtype=np.float32)
    for rays in (wrt.Rays(origins, directions, 0.0, t_max), wrt.Rays(origins[0], directions, t_max / 4, 2.0)):
        expected = brute_force(scene, rays)
        assert expected.is_hit.any()
        plan = scene.explain(rays, traversal="packet")
        arranged = arrange_rays(rays, order, plan.packet, **tags(2000), device=device)
        plan = replace(plan, shared_origin=False)
        hits = scene.intersect(arranged.rays, traversal=plan)
        for name in ("t", "primitive_id", "uv"):
            np.testing.assert_array_equal(arranged.restore(getattr(hits, name)), getattr(expected, name))
        dark = scene.occluded(arranged.rays, traversal=plan)
        np.testing.assert_array_equal(arranged.restore(dark), expected.is_hit)


def test_sorting_by_cells_in_packets(device):
    """Sorting by origin and direction before packets are made (Månsson et al. 2007)."""
    mesh = wrt.scenes.build("teapot", level=3)
    scene = wrt.Scene(mesh, "bvh", device=device)
    rays = wrt.Rays(*mixed_rays(mesh, 3000))
    plan = replace(scene.explain(rays, traversal="packet"), reorder="cells")
    expected = brute_force(scene, rays)
    assert_same_hits(scene.intersect(rays, traversal=plan), expected)
    np.testing.assert_array_equal(scene.occluded(rays, traversal=plan), expected.is_hit)


def test_no_rays():
    arranged = arrange_rays(wrt.Rays(np.zeros((0, 3)), np.zeros((0, 3))), "types", 16)
    assert len(arranged.places) == 0
    assert arranged.usage == 1.0
    assert arranged.restore(np.zeros((0, 2))).shape == (0, 2)


def test_misuse():
    rays = wrt.Rays(np.zeros((4, 3)), np.ones((4, 3)))
    with pytest.raises(ValueError, match=r"order 'kinds' is unknown; choose from blind, group, runs, types"):
        arrange_rays(rays, "kinds", 16)
    with pytest.raises(ValueError, match="packet is 0"):
        arrange_rays(rays, "types", 0)
    with pytest.raises(TypeError, match="kinds must be integers"):
        arrange_rays(rays, "types", 16, kinds=np.zeros(4))
    with pytest.raises(ValueError, match="groups has the shape"):
        arrange_rays(rays, "types", 16, groups=np.zeros(3, int))
    with pytest.raises(ValueError, match="sources must be from 0"):
        arrange_rays(rays, "types", 16, sources=np.full(4, -1))
    with pytest.raises(ValueError, match="places"):
        arrange_rays(rays, "types", 16).restore(np.zeros(3))

"""Packets whose traversal is abandoned because their rays take different ways: their rays keep what the packet has found.

A cloud of tiny triangles, and packets of rays that fan out into all of it: a packet would visit every leaf. It is abandoned,
and its rays go on alone. A ray that has found an occluder by then searches no more, and must not lose it.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import trimesh
from support.hits import assert_same_hits, brute_force

import wrt
from wrt.kernels.traversal.packet.core.packet_bvh import MAX_STEPS_UNSPLIT

TRIANGLES, RAYS = 40_000, 512


@cache
def cloud() -> wrt.TriangleMesh:
    """Tiny triangles anywhere in a unit cube, which hide about half of what is behind it."""
    rng = np.random.default_rng(0)
    corners = rng.random((TRIANGLES, 1, 3)) + rng.normal(size=(TRIANGLES, 3, 3)) * 0.004
    return wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(3 * TRIANGLES).reshape(-1, 3))


def fan(own_origins: bool) -> wrt.Rays:
    """Upward rays from below the cloud: two axes have both signs. Their origins are one point, or close together."""
    rng = np.random.default_rng(1)
    directions = rng.uniform(0.0, 1.0, (RAYS, 3)) - (0.5, 0.5, -0.1)
    if not own_origins:
        return wrt.Rays(np.float32([0.5, 0.5, -0.1]), directions.astype(np.float32))
    origins = (0.5, 0.5, -0.1) + rng.normal(size=(RAYS, 3)) * 1e-4
    return wrt.Rays(origins.astype(np.float32), directions.astype(np.float32))


def test_rays_from_one_point_keep_what_their_packet_found():
    """Such packets are not split."""
    scene, rays = wrt.Scene(cloud(), "bvh", device="cpu"), fan(own_origins=False)
    expected = brute_force(scene, rays)
    assert 0.2 < expected.is_hit.mean() < 0.8
    plan = scene.explain(rays, traversal="packet")
    assert plan.shared_origin
    hits = scene.intersect(rays, traversal="packet", counters=True)
    assert_same_hits(hits, expected)
    np.testing.assert_array_equal(scene.occluded(rays, traversal="packet"), expected.is_hit)
    steps = (hits.counters["nodes"] + hits.counters["leaves"]).reshape(-1, plan.packet)
    assert (steps[:, 0] > MAX_STEPS_UNSPLIT * plan.packet).all()
    assert ((steps[:, 1:] > 0).sum(axis=1) > plan.packet // 2).all()  # those that went on alone


def test_so_do_rays_that_diverge_inside_an_instance():
    """A turned cloud beside another one. Packets are split by their rays' origins, here in vain."""
    turned = trimesh.transformations.rotation_matrix(0.3, (1.0, 2.0, 3.0), (0.5, 0.5, 0.5))
    beside = trimesh.transformations.translation_matrix([1.1, 0.0, 0.0])
    scene = wrt.Scene([wrt.Instance(cloud(), turned), wrt.Instance(cloud(), beside)], "bvh", device="cpu")
    rays = fan(own_origins=True)
    expected = scene.intersect(rays, traversal="single")
    assert 0.2 < expected.is_hit.mean() < 0.8
    assert_same_hits(scene.intersect(rays, traversal="packet"), expected)
    np.testing.assert_array_equal(scene.occluded(rays, traversal="packet"), expected.is_hit)

"""Packets in scenes so large that they fetch children ahead."""

from __future__ import annotations

import numpy as np
import pytest
from support.hits import assert_same_hits

import wrt
from wrt.kernels.traversal.packet.core.packet_bvh import MIN_FETCHED
from wrt.kernels.triangle import TRIANGLE_TESTS


@pytest.mark.width
def test_large_scenes(device):
    """Packets fetch children ahead in scenes of so many triangles; single rays do not."""
    side = 350
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, side + 1), np.linspace(-1.0, 1.0, side + 1), indexing="ij")
    points = np.stack([x, y, 0.1 * np.sin(9.0 * x) * np.cos(7.0 * y)], axis=-1).reshape(-1, 3)
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).reshape(-1, 1, 1)
    faces = (corner + np.array([[0, side + 1, 1], [1, side + 1, side + 2]])).reshape(-1, 3)
    scene = wrt.Scene(wrt.TriangleMesh(points.astype(np.float32), faces), "bvh", device=device)
    rays = wrt.PinholeCamera(128, 96, position=(0.4, -2.0, 1.2), look_at=(0.0, 0.0, 0.0)).rays()
    plan = scene.explain(rays, traversal="packet")
    assert len(scene.state.tree.primitive) * TRIANGLE_TESTS["woop"].record.components >= MIN_FETCHED
    hits = scene.intersect(rays, traversal=plan)
    assert 0.3 < hits.is_hit.mean() < 1.0
    assert_same_hits(hits, scene.intersect(rays, traversal="single"))

"""Packets whose origins are far apart are split before they are traced."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from support.hits import assert_same_hits
from support.packet_loops import OPTIONS
from support.packet_rays import packet_plan
from support.selection import slow

import wrt
from wrt.kernels.traversal.packet.core.packet_splitting import MIN_WIDE, forget_extent, is_wide
from wrt.kernels.traversal.packet.rays.packet_bounds import PacketBounds
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout

WIDTH = 8
LAYOUT = PacketLayout(32, WIDTH, False, "woop")
SIZE, ASK, FORGET = LAYOUT.size, is_wide(LAYOUT), forget_extent(LAYOUT)
SCENE = 10.0
"""Edge of the scene's box."""


@wp.kernel(**OPTIONS)
def ask_in_turn(extents: wp.array(dtype=float), whole: wp.array(dtype=int), edge: float, wide: wp.array(dtype=int)):
    """Whether packets, or parts of them (0), are wide, one after the other; before some of them (2) all are forgotten."""
    packet = wp.zeros(shape=(SIZE,), dtype=float)
    for i in range(extents.shape[0]):
        if whole[i] == 2:
            FORGET(packet)
        bounds = PacketBounds()
        bounds.origin_high = wp.vec3(extents[i], 0.0, 0.0)
        if ASK(packet, bounds, wp.vec3(0.0, 0.0, 0.0), wp.vec3(edge, edge, edge), whole[i] != 0):
            wide[i] = 1


def answers(extents: list[float], parts: tuple[int, ...] = (), forgetting: tuple[int, ...] = ()) -> list[int]:
    """Whether each packet is wide; parts: numbers of those that are parts of another; forgetting: of the first ones of another
    instance."""
    whole = np.ones(len(extents), dtype=np.int32)
    whole[list(parts)] = 0
    whole[list(forgetting)] = 2
    wide = wp.zeros(len(extents), dtype=int, device="cpu")
    given = [wp.array(extents, dtype=float, device="cpu"), wp.array(whole, dtype=int, device="cpu"), SCENE, wide]
    wp.launch(ask_in_turn, 1, given, device="cpu")
    return wide.numpy().tolist()


def test_compared_with_the_packets_before():
    assert answers([1.0, 1.0, 1.1, 5.0, 1.0, 5.0]) == [0, 0, 0, 1, 0, 1]
    assert answers([5.0, 1.0, 5.0]) == [0, 0, 0]  # the first is what is usual at first
    assert answers([5.0] + 20 * [1.0] + [5.0]) == [*21 * [0], 1]
    assert answers([1.0, 2.0, 4.0, 8.0]) == [0, 0, 1, 1]
    assert answers([1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0]) == 9 * [0]  # grows little by little


def test_parts_are_compared_and_change_nothing():
    assert answers([1.0, 5.0, 4.0, 1.0, 5.0], parts=(2, 3)) == [0, 1, 1, 0, 1]
    assert answers([1.0, *20 * [2.9], 3.5], parts=tuple(range(1, 21))) == [0, *20 * [0], 1]


def test_nothing_is_usual_in_another_instance():
    assert answers([1.0, 5.0, 5.0, 5.0, 1.0, 5.0], forgetting=(2,)) == [0, 1, 0, 0, 0, 0]


def test_small_packets_are_not_wide():
    small = MIN_WIDE * 3.0 * SCENE
    assert answers([0.1 * small, 0.9 * small, 1.1 * small]) == [0, 0, 1]
    assert answers([0.0, 0.0, 2.0 * small, 2.0 * small]) == [0, 0, 0, 0]  # of rays from one point nothing is usual


@pytest.mark.parametrize("culling", ["leaf_boxes", *slow("transient_frustum")])
@pytest.mark.parametrize("surfaces", [2, 5, 12])
def test_hits(culling, surfaces, device):
    """Rays from floors far apart, in strips of a few pixels, to a lamp above triangles; more floors than a packet has
    parts."""
    rng = np.random.default_rng(6)
    corners = rng.uniform(-6.0, 6.0, (800, 1, 3)) * (1.0, 1.0, 0.15) + (0.0, 0.0, 6.0)
    vertices = (corners + rng.normal(size=(800, 3, 3)) * 0.4).reshape(-1, 3)
    mesh = wrt.TriangleMesh(vertices, np.arange(2400).reshape(-1, 3))
    scene = wrt.Scene(mesh, device=device)
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-5.0, 5.0, 96), np.linspace(-5.0, 5.0, 96)))
    number = np.arange(len(x))
    height = np.where(number // 64 % 4 == 3, -4.0 * (number // 9 % surfaces), 0.0)  # mostly one floor: what is usual
    origins = np.stack([x, y, height], axis=1).astype(np.float32)
    directions = (np.array([1.0, -2.0, 12.0]) - origins).astype(np.float32)
    directions[rng.random(len(x)) < 0.01] = np.nan
    rays = wrt.Rays(origins, directions, 0.0, 1.0)
    expected = scene.intersect(rays, traversal="brute")
    assert 0.1 < expected.is_hit.mean() < 0.9
    plan = packet_plan(scene, rays, "woop", packet=4 * scene.state.width, culling=culling)
    np.testing.assert_array_equal(scene.occluded(rays, traversal=plan), expected.is_hit)
    assert_same_hits(scene.intersect(rays, traversal=plan), expected)

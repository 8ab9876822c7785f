"""What following a motion costs: rows are complete, and figures change in the direction that they must."""

from __future__ import annotations

import numpy as np
import pytest

import wrt
from studies.moving import motion_costs
from studies.moving.animation_comparison import Stage

CAMERA = wrt.PinholeCamera(32, 32, fov=40, position=(-3.0, -3.0, 1.6), look_at=(0.0, 0.0, 1.0), up=(0.0, 0.0, 1.0))
FLOOR = wrt.scenes.build("teapot", level=2)


def test_scattered_triangles_keep_their_shapes():
    mesh = wrt.scenes.walking_figure(1, 4).mesh(0)
    flight = motion_costs.scattered(mesh, 3, 2.0)
    corners = flight.frames[:, flight.faces]
    np.testing.assert_allclose(corners[0], mesh.vertices[mesh.faces], atol=1e-6)
    edges = np.diff(corners, axis=2)
    np.testing.assert_allclose(edges, np.broadcast_to(edges[0], edges.shape), atol=1e-12)
    assert 1.0 < np.abs(corners[2] - corners[0]).max() <= 2.0


def test_old_boxes_become_worse_for_scattered_triangles():
    flight = motion_costs.scattered(wrt.scenes.walking_figure(1, 6).mesh(0), 3, 2.0)
    rows = motion_costs.drift(flight, "bvh", CAMERA.rays(), rounds=1)
    assert [row["frame"] for row in rows] == [0, 1, 2]
    assert (rows[0]["cost"], rows[0]["tests"]) == pytest.approx((1.0, 1.0))
    assert rows[2]["cost"] > 2.0
    assert rows[2]["tests"] > 2.0


def test_old_planes_become_worse_for_a_figure():
    """Planes fit the limbs of the first frame; scattered triangles are anywhere, and any planes do."""
    rows = motion_costs.drift(wrt.scenes.walking_figure(4, 8), "kdtree", CAMERA.rays(), rounds=1)
    assert (rows[0]["cost"], rows[0]["tests"]) == pytest.approx((1.0, 1.0))
    assert max(row["cost"] for row in rows) > 1.1
    assert max(row["tests"] for row in rows) > 1.5


def test_fuzzy_boxes_grow_with_frames_and_shrink_with_clusters():
    rows = motion_costs.fuzzy_growth(wrt.scenes.walking_figure(5, 4), (1, 5), CAMERA.rays(), clusters=8, rounds=1)
    area = {(row["frames"], row["clusters"]): row["area"] for row in rows}
    assert [area[1, kind] for kind in ("one cluster", "found", "bones")] == pytest.approx([1.0] * 3, rel=0.05)
    assert area[5, "one cluster"] > 3 * area[5, "found"]
    assert area[5, "found"] > 1.0
    assert area[5, "bones"] > 1.0


def test_groups_and_copies():
    rows = motion_costs.group_updates(FLOOR, wrt.scenes.walking_figure(2, 3), 2, (1, 2), rounds=1)
    assert [(row["moving"], row["way"]) for row in rows] == [(k, row["way"]) for k in (1, 2) for row in rows[:4]]
    view = wrt.PinholeCamera(32, 32, fov=40, position=(-8.0, -8.0, 6.0), look_at=(0.0, 0.0, 1.0), up=(0.0, 0.0, 1.0))
    rows = motion_costs.rigid_motion(wrt.scenes.walking_figure(1, 3).mesh(0), (3,), view, rounds=1)
    assert [row["way"] for row in rows] == ["built", "refitted", "instances"]
    assert rows[1]["same"] == 1.0
    assert rows[2]["same"] > 0.98


def test_split_threads_see_the_same():
    rows = motion_costs.thread_splits(Stage(FLOOR, wrt.scenes.walking_figure(2, 4)), [CAMERA], rounds=1)
    assert [(row["accelerator"], row["rays"], row["same"]) for row in rows] == [("bvh", 1024, 1.0), ("kdtree", 1024, 1.0)]

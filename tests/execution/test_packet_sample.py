"""Samples of packets: what they count, and that "auto" follows them."""

from __future__ import annotations

import numpy as np
import pytest

import wrt
from wrt.engine.facts.wide_trees import wide_tree
from wrt.engine.plan import choices, planner
from wrt.engine.plan.packet_sample import measure_overlap
from wrt.engine.rays.device_rays import to_device
from wrt.engine.rays.rays import Rays
from wrt.kernels.query.ordering.packet_overlap import SAMPLED_RAYS
from wrt.kernels.traversal.traversal_scores import Overlap


@pytest.fixture(scope="module")
def teapot() -> wrt.TriangleMesh:
    return wrt.scenes.build("teapot", level=8, ground=False)


@pytest.fixture(scope="module")
def scene(teapot) -> wrt.Scene:
    return wrt.Scene(teapot, wrt.Bvh(), device="cpu")


def sample(scene: wrt.Scene, origins: np.ndarray, directions: np.ndarray, query: str = "closest") -> Overlap:
    state = scene.state
    rays = to_device(Rays(origins.astype(np.float32), directions.astype(np.float32)), state.device, state.center)
    return measure_overlap(state, rays.sample(), 2 * state.width, query)


def equal_rays(scene: wrt.Scene, count: int = 1200) -> tuple[np.ndarray, np.ndarray]:
    """One ray, again and again, that hits."""
    center = scene.bounds.mean(axis=0)
    eye = center + np.array([0.3, 7.0, 2.0])
    return np.tile(eye, (count, 1)), np.tile(center + np.array([0.1, 0.0, 0.1]) - eye, (count, 1))


@pytest.mark.parametrize("query", ["closest", "any"])
def test_equal_rays_share_all_steps(scene, query):
    origins, directions = equal_rays(scene)
    assert scene.intersect(origins[:1], directions[:1]).is_hit.all()
    assert sample(scene, origins, directions, query).share == 1 / SAMPLED_RAYS


def test_steps_are_those_of_a_single_ray(scene):
    """Nodes and leaves, as the counters of a query count them."""
    origins, directions = equal_rays(scene)
    work = scene.intersect(origins[:1], directions[:1], traversal="single", counters=True).counters
    assert sample(scene, origins, directions).steps == int(work["nodes"][0]) + int(work["leaves"][0])


def test_random_rays_part(scene):
    rng = np.random.default_rng(0)
    origins = rng.uniform(*scene.bounds, (3000, 3))
    assert 0.5 < sample(scene, origins, rng.normal(size=origins.shape)).share <= 1.0


def test_bad_rays_have_no_steps(scene):
    origins, directions = equal_rays(scene)
    assert sample(scene, origins, np.full_like(directions, np.nan)) == Overlap(1.0, 0.0)


def test_an_instance_shares_as_its_mesh_does(scene, teapot):
    """One placement, turned: the upper tree adds one node and one leaf to each ray's steps, all of them shared."""
    turn = np.eye(4)
    turn[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    placed = wrt.moving.InstancedScene([wrt.Instance(teapot, turn)], device="cpu")
    origins, directions = equal_rays(scene)
    alone = sample(scene, origins, directions)
    both = sample(placed, origins @ turn[:3, :3].T, directions @ turn[:3, :3].T)
    assert both.share == alone.share == 1 / SAMPLED_RAYS
    assert both.steps == alone.steps + 2


def test_kdtrees_are_sampled_through_their_wide_form(teapot):
    """The steps are those of a packet of equal rays through it."""
    scene = wrt.Scene(teapot, wrt.KdTree(), device="cpu")
    origins, directions = equal_rays(scene)
    found = sample(scene, origins, directions)
    assert found.share == 1 / SAMPLED_RAYS
    work = scene.intersect(origins[:1], directions[:1], traversal="wide_packet", counters=True).counters
    assert found.steps == int(work["nodes"][0]) + int(work["leaves"][0])


def statue(teapot: wrt.TriangleMesh) -> wrt.TriangleMesh:
    """A small teapot of many triangles in a corner of a large box, which nearly all rays from the middle meet."""
    corners = np.array([[i, j, k] for i in (-20, 20) for j in (-20, 20) for k in (-20, 20)], dtype=np.float64)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))]
    room = wrt.TriangleMesh(corners.astype(np.float32), np.array(faces, dtype=np.int32))
    fine = wrt.TriangleMesh((teapot.vertices + np.array([15.0, 15.0, -15.0])).astype(np.float32), teapot.faces)
    return wrt.TriangleMesh.concatenate([room, fine])


def test_a_scan_of_a_room_with_a_fine_statue_goes_in_packets():
    """A lidar scan was traced in streams wherever a scene had more than 8 triangles a ray, although hardly any ray met them."""
    fine = wrt.scenes.build("teapot", level=24, ground=False)
    azimuth, elevation = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False), np.linspace(-0.4, 0.4, 64))
    level = np.cos(elevation)
    directions = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1)
    scan = wrt.Rays((0.0, 0.0, 0.0), directions)
    room = wrt.Scene(statue(fine), wrt.Bvh(), device="cpu")
    assert room.triangle_count > 8 * directions[..., 0].size
    assert room.explain(scan).traversal == "packet"
    view = wrt.PinholeCamera.framing(fine, 64, 64).rays()
    assert wrt.Scene(fine, wrt.Bvh(), device="cpu").explain(view).traversal != "packet"


@pytest.mark.parametrize("tree", [wrt.Bvh, wrt.KdTree])
def test_a_sample_serves_many_queries(monkeypatch, tree):
    """Its choice is kept, and made again now and then, since a camera moves; of a kd-tree once it has its wide form."""
    mesh = wrt.scenes.random_triangles(count=40_000, size=0.02)
    scene = wrt.Scene(mesh, tree(), device="cpu")
    if tree is wrt.KdTree:
        wide_tree(scene.state)
    samples = []
    monkeypatch.setattr(planner, "measure_overlap", lambda *args: samples.append(args) or Overlap(1.0, 8.0))
    view = wrt.PinholeCamera.framing(mesh, 64, 64).rays()
    for _ in range(choices.CHOICE_USES + 1):
        assert "packet" not in scene.explain(view).traversal
    assert len(samples) == 1
    scene.explain(view)
    assert len(samples) == 2

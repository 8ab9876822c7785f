"""Rigs: several sensors on one body measure as each of them does alone."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import wrt
from wrt.sensors import BrownConrady, Camera, Lidar, LidarPattern, Rig, Trajectory
from wrt.sensors.rigs.rig import ARC_ERROR, mounted

BALL = wrt.TriangleMesh.from_trimesh(trimesh.creation.icosphere(2, 0.5))
GROUND = wrt.TriangleMesh([[-40, -40, -1], [40, -40, -1], [40, 40, -1], [-40, 40, -1]], [[0, 1, 2], [0, 2, 3]])
LIDAR = Lidar(pattern=LidarPattern.spinning(np.linspace(15, -25, 8), 64, rate=10.0), range_noise=0.01)
CAMERA = Camera(24, 16, BrownConrady(20.0, 20.0, 11.5, 7.5), line_delay=1e-3)
NAMES = {"roof": ("range", "position", "instance_id"), "rear": ("range", "point"), "front": ("depth", "semantic_id")}


def at(x: float, y: float, z: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


MOUNTS = {"roof": at(0.0, 0.0, 0.6), "rear": at(-0.7, 0.1, 0.2), "front": wrt.sensors.look_at([0.5, 0, 0.3], [3, 0, 0])}
RIG = Rig({"roof": (LIDAR, MOUNTS["roof"]), "rear": (LIDAR, MOUNTS["rear"]), "front": (CAMERA, MOUNTS["front"])})
SCENE = wrt.Scene([wrt.Instance(GROUND), wrt.Instance(BALL, at(2.0, 0.3, 0.0))], device="cpu")


def alone(pose, seed, time=0.0):
    """What each sensor measures by itself."""
    found = {}
    for number, name in enumerate(("roof", "rear")):
        own = None if seed is None else (seed + number) % (1 << 64)
        found[name] = LIDAR.scan(SCENE, mounted(pose, MOUNTS[name]), labels=[4, 7], seed=own, time=time)
    found["front"] = CAMERA.capture(SCENE, mounted(pose, MOUNTS["front"]), labels=[4, 7], layers=("depth", "semantic_id"))
    return found


@pytest.mark.parametrize("seed", [None, 5, (1 << 64) - 1])
def test_rigs_measure_as_each_sensor_alone(seed):
    pose = at(0.2, -0.1, 0.1)
    seen = RIG.measure(SCENE, pose, labels=[4, 7], seed=seed, each={"front": {"layers": ("depth", "semantic_id")}})
    expected = alone(wrt.sensors.placed.device_poses.as_poses(pose), seed)
    assert list(seen) == ["roof", "rear", "front"]
    for name, layers in NAMES.items():
        for layer in layers:
            np.testing.assert_array_equal(getattr(seen[name], layer), getattr(expected[name], layer), err_msg=f"{name} {layer}")
    assert (seen["roof"].instance_id == 1).any()
    with pytest.raises(ValueError, match="chosen"):
        _ = seen["front"].normal


def test_many_bodies_have_one_rig():
    poses = np.array([at(0.0, 0.0, 0.0), at(0.3, 0.2, 0.0)])
    seen = RIG.measure(SCENE, poses)
    for number, pose in enumerate(poses):
        single = RIG.measure(SCENE, pose)
        np.testing.assert_array_equal(seen["roof"].range[number], single["roof"].range)
        np.testing.assert_array_equal(seen["front"].depth[number], single["front"].depth)


def test_mounted_sensors_follow_the_arc():
    """A body that turns about z by 2.5 radians: a sensor beside it is on a circle, at all times."""
    half = 1.25
    drive = Trajectory([0.0, 1.0], [(1.0, 2.0, 0.0)] * 2, [(0, 0, 0, 1), (0, 0, np.sin(half), np.cos(half))])
    times = np.linspace(0.0, 1.0, 777)
    poses = mounted(drive, at(2.0, 0.0, 0.5)).at(times)
    angle = 2.0 * half * times
    exact = np.stack([1.0 + 2.0 * np.cos(angle), 2.0 + 2.0 * np.sin(angle), np.full_like(angle, 0.5)], axis=1)
    off = np.linalg.norm(poses[:, :3, 3] - exact, axis=1)
    assert ARC_ERROR / 50 < off.max() < 1.05 * ARC_ERROR
    np.testing.assert_allclose(poses[:, 0, 0], np.cos(angle), atol=1e-12)
    seen = Rig({"side": (LIDAR, at(2.0, 0.0, 0.5))}).measure(SCENE, drive, time=0.5)["side"]
    begin = seen.trajectory.at(seen.time)[..., :3, 3]
    angle = 2.0 * half * seen.time
    np.testing.assert_allclose(begin[..., 0], 1.0 + 2.0 * np.cos(angle), atol=2 * ARC_ERROR)


def test_rigs_refuse_what_is_wrong():
    with pytest.raises(TypeError, match="pair"):
        Rig({"roof": LIDAR})
    with pytest.raises(TypeError, match="dict"):
        Rig([LIDAR])
    with pytest.raises(ValueError, match="at least one"):
        Rig({})
    with pytest.raises(ValueError, match="mount of sensors\\['roof'\\]"):
        Rig({"roof": (LIDAR, np.diag([2.0, 2.0, 2.0, 1.0]))})
    with pytest.raises(ValueError, match="roof"):
        RIG.measure(SCENE, np.eye(4), each={"left": {}})
    with pytest.raises(ValueError, match="depth"):
        RIG.measure(SCENE, np.eye(4), each={"roof": {"layers": ("depth",)}})
    with pytest.raises(TypeError, match="albedo"):
        RIG.measure(SCENE, np.eye(4), each={"roof": {"albedo": True}})

"""Many sensors in one call, each in its environment, and time slices that are traced at once."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import trimesh
import warp as wp

import wrt
from wrt.meshes.instance import rotation_matrices
from wrt.sensors import BrownConrady, Camera, Lidar, LidarPattern, Trajectory, trajectory
from wrt.sensors.trajectory import StillPoses

BALL = wrt.TriangleMesh.from_trimesh(trimesh.creation.icosphere(2, 0.5))
GROUND = wrt.TriangleMesh([[-40, -40, -1], [40, -40, -1], [40, 40, -1], [-40, 40, -1]], [[0, 1, 2], [0, 2, 3]])
PATTERN = LidarPattern.spinning(np.linspace(15, -25, 8), 64, rate=10.0)
LIDAR = Lidar(pattern=PATTERN, range_noise=0.01)


def move(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def worlds(count: int) -> wrt.Scene:
    """A ground for all, and a ball for each world, in another place."""
    balls = [wrt.Instance(BALL, move(2.0 + 0.3 * k, 0.2 * k), environment=10 * k) for k in range(count)]
    return wrt.Scene([wrt.Instance(GROUND), *balls], device="cpu")


def test_scans_are_pickled():
    """Of one sensor that moves, and of many at rest."""
    scene, drive = worlds(1), Trajectory([0.0, 1.0], [(0, 0, 0), (1, 0, 0)])
    for poses in (drive, np.array([move(0.1 * k) for k in range(2)])):
        scan = LIDAR.scan(scene, poses, labels=[3, 4], seed=1)
        again = pickle.loads(pickle.dumps(scan))
        for frame in ("sensor", "world", "start"):
            np.testing.assert_array_equal(again.to_structured(frame), scan.to_structured(frame))
        for name in ("normal", "radial_velocity", "semantic_id", "time", "ring"):
            np.testing.assert_array_equal(getattr(again, name), getattr(scan, name))


def test_many_sensors_measure_as_one_by_one():
    """Ranges, ids and positions of each are its own; only the noise is another one for each."""
    scene, poses = worlds(6), np.array([[move(0.1 * k), move(0, 0.1 * k)] for k in range(6)])
    numbers = 10 * np.arange(6)[:, None]
    scans = LIDAR.scan(scene, poses, environment=numbers)
    assert scans.range.shape == (6, 2, *PATTERN.shape) == scans.time.shape
    for k in range(6):
        for s in range(2):
            alone = LIDAR.scan(scene, poses[k, s], environment=10 * k)
            for name in ("range", "position", "point", "intensity", "instance_id", "primitive_id", "normal"):
                np.testing.assert_array_equal(getattr(scans, name)[k, s], getattr(alone, name), err_msg=name)
    seen = scans.instance_id
    assert all(set(np.unique(seen[k]).tolist()) <= {-1, 0, k + 1} and (seen[k] == k + 1).any() for k in range(6))
    noisy = LIDAR.scan(scene, poses[:, 0], environment=numbers[:, 0], seed=1)
    assert noisy.range.shape == (6, *PATTERN.shape)
    assert (noisy.range != scans.range[:, 0]).any()
    assert len(noisy.to_structured()) == np.isfinite(noisy.range).sum()
    np.testing.assert_array_equal(noisy.deskewed(), noisy.point)


def test_many_cameras_see_as_one_by_one():
    scene, lens = worlds(3), BrownConrady.from_matrix([[20, 0, 16], [0, 20, 12], [0, 0, 1]])
    poses = np.array([wrt.sensors.look_at([0.0, -0.2 * k, 0.5], [2.0, 0.1 * k, 0.0]) for k in range(3)])
    images = Camera(32, 24, lens).capture(scene, poses, environment=[0, 10, 20])
    assert images.depth.shape == (3, 24, 32)
    for k in range(3):
        alone = Camera(32, 24, lens).capture(scene, poses[k], environment=10 * k)
        np.testing.assert_array_equal(images.instance_id[k], alone.instance_id)
        for name in ("depth", "position", "camera_normal"):
            np.testing.assert_allclose(getattr(images, name)[k], getattr(alone, name), atol=1e-6, err_msg=name)


@pytest.mark.parametrize("bundle", [1, 4])
def test_slices_at_once_are_slices_one_by_one(bundle, monkeypatch):
    """A scene with environments is traced slice by slice; hits are the same up to the rounding of another scene centre."""
    still = [wrt.Instance(GROUND), wrt.Instance(BALL, move(0.0, 3.0))]
    moving = [wrt.Instance(BALL, move(2.0)), wrt.Instance(BALL, move(-3.0, 1.0))]
    motions = {
        2: Trajectory([0.0, 0.1], [[2, -2, 0], [2, 2, 0]], [[0, 0, 0, 1], [0, 0, 0.6, 0.8]]),
        3: Trajectory([0.0, 0.1], [[-3, 1, 0], [-3, -1, 0.5]]),
    }
    lidar = LIDAR.replace(bundle=bundle, divergence=0.02, returns=1 if bundle == 1 else 2)
    drive = Trajectory([0.0, 0.1], [[0, 0, 0], [0.5, 0, 0]])
    scenes = [wrt.Scene([*still, *moving, *more], device="cpu") for more in ([], [wrt.Instance(BALL, environment=5)])]
    whole, parts = (
        lidar.scan(scene, drive, motions=motions, slices=7, environment=number)
        for scene, number in zip(scenes, (None, 3), strict=True)
    )
    assert len(set(whole.instance_id[np.isfinite(whole.range)].tolist())) == 4
    np.testing.assert_array_equal(whole.instance_id, parts.instance_id)
    for name in ("range", "position", "normal", "intensity", "radial_velocity"):
        np.testing.assert_allclose(getattr(whole, name), getattr(parts, name), rtol=1e-4, atol=1e-4, err_msg=name)
    assert whole.motion_error == parts.motion_error > 0.0
    monkeypatch.setattr("wrt.sensors.time_slices.MAX_TOGETHER", 7)
    many = lidar.scan(scenes[0], drive, motions=motions, slices=7)
    np.testing.assert_array_equal(many.instance_id, whole.instance_id)
    assert scenes[0].instances[2].transform.tolist() == moving[0].transform.tolist()


WRONG = {
    "scale": (lambda s: LIDAR.scan(s, np.array([np.eye(4), 2 * np.eye(4)])), ValueError, "pose 1 does more"),
    "shape": (lambda s: LIDAR.scan(s, np.zeros((2, 3, 3))), ValueError, r"\(\.\.\., 4, 4\)"),
    "environments": (
        lambda s: LIDAR.scan(s, np.array([np.eye(4)] * 2), environment=[1, 2, 3]),
        ValueError,
        "one for each sensor",
    ),
    "one sensor": (lambda s: LIDAR.scan(s, np.eye(4), environment=[1, 2]), ValueError, "one for each sensor"),
    "range": (lambda s: LIDAR.scan(s, np.eye(4), mask=-1), ValueError, "mask must be from 0"),
    "type": (lambda s: LIDAR.scan(s, np.eye(4), environment=0.5), TypeError, "environment must hold integers"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_sensors_are_refused(case):
    call, kind, message = WRONG[case]
    with pytest.raises(kind, match=message):
        call(worlds(1))


def test_a_kernel_reads_poses_as_numpy_does(monkeypatch):
    """Quaternions to the bit, whichever component is the largest, and which matrices are refused."""
    turns = np.random.default_rng(0).normal(size=(500, 4))
    turns[:16] = np.concatenate([np.eye(4), -np.eye(4), np.eye(4)[[1, 2, 3, 0]] + np.eye(4), 1e-9 + np.eye(4)])
    poses = np.tile(np.eye(4), (500, 1, 1))
    poses[:, :3, :3] = rotation_matrices(turns / np.linalg.norm(turns, axis=1, keepdims=True))
    poses[:, :3, 3] = turns[:, 1:]
    cpu, off = wp.get_device("cpu"), poses.copy()
    path, known = (StillPoses(poses, device).path(cpu) for device in (cpu, None))
    for name in ("rotations", "positions", "times"):
        np.testing.assert_array_equal(getattr(path, name).numpy(), getattr(known, name).numpy())
    for number in range(490):
        row, column = number % 4, number // 4 % (3 if number % 4 < 3 else 4)
        off[number, row, column] += (1e-9, 4e-7, 6e-7, 1e-5, 1.0)[number % 5]
    off[490:, 2] *= -1.0
    for number in range(1, 5):
        off[490 + number, :3] *= number
    rigid = trajectory.taken(off, cpu)[0]
    np.testing.assert_array_equal(rigid, trajectory.are_rigid(off))
    assert 100 < rigid.sum() < 300
    scene, each = worlds(3), np.arange(500) % 4 * 10
    scans = []
    for least in (1, 501):
        monkeypatch.setattr(trajectory, "MIN_BY_KERNEL", least)
        scans.append(LIDAR.scan(scene, poses, environment=each).range)
        with pytest.raises(ValueError, match=f"pose {int(rigid.argmin())} does more than move and turn"):
            LIDAR.scan(scene, off)
    np.testing.assert_array_equal(*scans)

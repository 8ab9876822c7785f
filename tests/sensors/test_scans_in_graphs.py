"""Scans and images whose poses are on the device: as those of poses on the host, and captured in graphs."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import warp as wp

import wrt
from wrt.sensors import BrownConrady, Camera, Lidar, LidarPattern, Rig, Trajectory

BALL = wrt.TriangleMesh.from_trimesh(trimesh.creation.icosphere(2, 0.5))
GROUND = wrt.TriangleMesh([[-40, -40, -1], [40, -40, -1], [40, 40, -1], [-40, 40, -1]], [[0, 1, 2], [0, 2, 3]])
PATTERN = LidarPattern.spinning(np.linspace(15, -25, 8), 64, rate=10.0)


def move(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """The (4, 4) matrix of a translation."""
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


LIDAR = Lidar(pattern=PATTERN, range_noise=0.01, angle_noise=0.001, dropout=0.1)
CAMERA = Camera(32, 24, BrownConrady.from_matrix([[20, 0, 16], [0, 20, 12], [0, 0, 1]]))
MOUNT = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 0.5], [0, 0, 0, 1]])
RIG = Rig({"roof": (LIDAR, move(0, 0, 0.3)), "front": (CAMERA, MOUNT), "low": (LIDAR.replace(returns=2, bundle=3), move(0.1))})
BODIES = 3


def scene_on(device: str) -> wrt.Scene:
    """A ground for all and a ball for each of the environments."""
    balls = [wrt.Instance(BALL, move(2.0 + 0.3 * k, 0.2 * k), environment=k) for k in range(BODIES)]
    return wrt.Scene([wrt.Instance(GROUND), *balls], "bvh", device=device)


def bodies(seed: int) -> np.ndarray:
    """(BODIES, 7) float32: positions, and quaternions of any length."""
    rng = np.random.default_rng(seed)
    turns = np.array([0.0, 0.0, 0.0, 1.0]) + rng.normal(0, 0.1, (BODIES, 4))
    return np.concatenate([rng.uniform(-0.3, 0.3, (BODIES, 3)), rng.uniform(0.5, 2.0) * turns], axis=1).astype(np.float32)


def on(device: str, values: np.ndarray, dtype: type) -> wp.array:
    return wp.array(values, dtype=dtype, device=device)


def layers_of(scan) -> dict[str, np.ndarray]:
    names = ("range", "intensity", "point") if hasattr(scan, "range") else ("depth", "camera_normal")
    found = {name: getattr(scan, name) for name in (*names, "position", "normal", "instance_id", "semantic_id")}
    return {name: values.numpy() if isinstance(values, wp.array) else values for name, values in found.items()}


def test_poses_on_the_device_are_those_of_the_host(device):
    """To the bit, once the host has them; what sensors of one pose see is what they see alone."""
    scene, given = scene_on(device), on(device, bodies(0), wp.transformf)
    options = {"environment": np.arange(BODIES), "labels": [7, 1, 2, 3]}
    seen = RIG.measure(scene, given, seed=5, **options)
    for name, scan in seen.items():
        sensor, poses = RIG.sensors[name], scan.trajectory.poses
        np.testing.assert_allclose(poses @ np.linalg.inv(RIG.mounts[name]), as_matrices(bodies(0)), atol=1e-6)
        own = {"seed": 5 + ("roof", "low").index(name)} if isinstance(sensor, Lidar) else {}
        measure = sensor.scan if isinstance(sensor, Lidar) else sensor.capture
        expected = layers_of(measure(scene, poses, **options, **own))
        assert isinstance(scan.position, wp.array)
        for layer, values in layers_of(scan).items():
            np.testing.assert_allclose(values, expected[layer], atol=2e-5, err_msg=f"{name}.{layer}")
    assert len(seen["roof"].to_structured("world")) == np.isfinite(seen["roof"].range.numpy()).sum()


def as_matrices(values: np.ndarray) -> np.ndarray:
    return np.stack([trimesh.transformations.quaternion_matrix(np.roll(q, 1)) + move(*p) - np.eye(4) for p, q in split(values)])


def split(values: np.ndarray) -> zip:
    return zip(values[:, :3].astype(float), values[:, 3:].astype(float), strict=True)


def test_a_pose_that_is_none_sees_nothing(device):
    values = bodies(0)
    values[0, 3:], values[1, 2] = 0.0, np.nan
    found = LIDAR.scan(scene_on(device), on(device, values, wp.transformf), layers=("range",)).range.numpy()
    assert np.isinf(found[:2]).all()
    assert np.isfinite(found[2]).any()


def test_graphs_measure_from_where_things_are(device):
    """Captured once: each launch is the call of that moment, with noise of its own."""
    scene, twin = scene_on(device), scene_on(device)
    given, seed = on(device, bodies(0), wp.transformf), on(device, [40], wp.uint64)
    worlds, labels = on(device, np.arange(BODIES), wp.int32), on(device, [7, 1, 2, 3], wp.int32)
    moving = on(device, placed(0), wp.transformf)

    def step(of: wrt.Scene, start: wp.array) -> dict:
        if of.device.is_cuda:
            of.update(range(BODIES + 1), transform=moving)
        seen = RIG.measure(of, given, environment=worlds, labels=labels, seed=start, each={"front": {"miss": -1.0}})
        return seen | {"masked": LIDAR.scan(of, given, mask=1, layers=("range", "instance_id"))}

    step(scene, wp.clone(seed))
    with wp.ScopedCapture(device) as capture:
        seen = step(scene, seed)
    for number in range(3):
        given.assign(on(device, bodies(number), wp.transformf))
        moving.assign(on(device, placed(number), wp.transformf))
        wp.capture_launch(capture.graph)
        expected = step(twin, on(device, [40 + 2 * number], wp.uint64))
        for name, scan in seen.items():
            if name == "masked":
                np.testing.assert_array_equal(scan.range.numpy(), expected[name].range.numpy())
                continue
            for layer, values in layers_of(expected[name]).items():
                np.testing.assert_array_equal(layers_of(scan)[layer], values, err_msg=f"{number}: {name}.{layer}")
    assert seed.numpy().tolist() == [46]


def placed(seed: int) -> np.ndarray:
    """(BODIES + 1, 7) float32: where the ground and the balls are."""
    at = np.array([[0, 0, 0], *([2.0 + 0.3 * k, 0.2 * k, 0.05 * seed] for k in range(BODIES))])
    return np.concatenate([at, np.tile([0.0, 0, 0, 1], (BODIES + 1, 1))], axis=1).astype(np.float32)


HOST = {
    "results in NumPy": lambda scene, given: LIDAR.scan(scene, given, to_warp=False),
    "those of many": lambda scene, given: CAMERA.capture(scene, np.tile(np.eye(4), (2, 1, 1)), to_warp=True),
    "poses that change": lambda scene, given: LIDAR.scan(scene, Trajectory([0, 1], np.eye(3)[:2]), to_warp=True),
    "trajectories of inst": lambda scene, given: LIDAR.scan(scene, given, motions={1: Trajectory([0.0], [(0, 0, 0)])}),
    "albedo": lambda scene, given: CAMERA.capture(scene, given, albedo=True),
    "environment must be": lambda scene, given: LIDAR.scan(scene, given, environment=[0, 1, 2]),
    "labels must be": lambda scene, given: CAMERA.capture(scene, given, labels=[1, 2, 3, 4]),
    "reflectance must be": lambda scene, given: LIDAR.scan(scene, given, reflectance=[1.0, 2.0, 3.0, 4.0]),
}


@pytest.mark.parametrize("what", HOST)
def test_what_is_on_the_host_is_refused(what, device):
    scene, given = scene_on(device), on(device, bodies(0), wp.transformf)
    LIDAR.scan(scene, given)
    CAMERA.capture(scene, given)
    with wp.ScopedCapture(device), pytest.raises(RuntimeError, match=f"{what}.*before"):
        HOST[what](scene, given)


def test_reflectances_and_seeds_on_the_device(device):
    scene, given = scene_on(device), on(device, bodies(0), wp.transformf)
    values = np.array([0.5, 1.0, 2.0, 3.0], dtype=np.float32)
    found = [LIDAR.scan(scene, given, reflectance=one).intensity.numpy() for one in (values, on(device, values, float))]
    np.testing.assert_array_equal(*found)
    with pytest.raises(ValueError, match="seed must be"):
        LIDAR.scan(scene, given, seed=on(device, [1, 2], wp.uint64))
    with pytest.raises(ValueError, match="at least one transform"):
        LIDAR.scan(scene, wp.empty(0, dtype=wp.transformf, device=device))

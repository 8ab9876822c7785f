"""Time of every beam: trajectories, moving sensors and instances, de-skew, radial velocity; against closed forms."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import warp as wp
from support.sensed_scenes import cone, exact, wall

import wrt
from wrt.sensors import Lidar, LidarPattern, Trajectory, deskew

TIMES = np.linspace(0.0, 0.1, 16)


def turned(axis, angle):
    """A (4, 4) rotation about an axis."""
    axis = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    matrix = np.eye(4)
    matrix[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return matrix


# -- trajectories ------------------------------------------------------------------------------------------------------


def test_interpolation():
    """Translation is linear, rotation about one axis is proportional to time; velocities are constant."""
    axis, ends = [1.0, 2.0, -0.5], [turned([1, 0, 0], 0.3), turned([1, 2, -0.5], 1.7) @ turned([1, 0, 0], 0.3)]
    ends[0][:3, 3], ends[1][:3, 3] = [1, 2, 3], [4, 0, 5]
    path = Trajectory.from_matrices([2.0, 4.0], ends)
    shares = np.linspace(0, 1, 11)
    for share, pose in zip(shares, path.at(2.0 + 2.0 * shares), strict=True):
        expected = turned(axis, 1.7 * share) @ turned([1, 0, 0], 0.3)
        expected[:3, 3] = (1 - share) * ends[0][:3, 3] + share * ends[1][:3, 3]
        np.testing.assert_allclose(pose, expected, atol=1e-13)
    velocity, spin = path.velocities(shares + 2.5)
    np.testing.assert_allclose(velocity, np.broadcast_to([1.5, -1, 1], (11, 3)), atol=1e-13)
    np.testing.assert_allclose(spin, np.broadcast_to(0.85 * np.array(axis) / np.linalg.norm(axis), (11, 3)), atol=1e-13)


def test_small_and_large_turns():
    """Slerp loses no digits for tiny angles, and takes the shorter way whatever the sign of the quaternions."""
    tiny = Trajectory.from_matrices([0, 1], [np.eye(4), turned([0, 0, 1], 1e-9)])
    assert tiny.at(0.5)[1, 0] == pytest.approx(5e-10, rel=1e-6)
    flipped = Trajectory([0, 1], np.zeros((2, 3)), [[0, 0, 0, 1], [0, 0, -np.sin(0.4), -np.cos(0.4)]])
    assert flipped.at(0.5)[1, 0] == pytest.approx(np.sin(0.4))


def test_matrices_with_scale():
    """Scale, shear and mirroring of a body are kept, whatever its rotation."""
    stretch = np.array([[2.0, 0.3, 0], [0, -1, 0], [0, 0, 0.5]])
    given = []
    for angle in (0.0, 1.0, 2.0):
        matrix = turned([1, 1, 0], angle)
        matrix[:3, :3] = matrix[:3, :3] @ stretch
        matrix[:3, 3] = angle
        given.append(matrix)
    path = Trajectory.from_matrices([0, 1, 2], given)
    np.testing.assert_allclose(path.matrices, given, atol=1e-12)
    middle = turned([1, 1, 0], 0.5)
    middle[:3, :3] = middle[:3, :3] @ stretch
    middle[:3, 3] = 0.5
    np.testing.assert_allclose(path.at(0.5), middle, atol=1e-12)
    assert not path.is_rigid
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(path)).matrices, path.matrices)


@pytest.mark.parametrize("seed", range(4))
def test_quaternions_of_any_rotation(seed):
    """Half turns, too, where three of the four components are small."""
    rng = np.random.default_rng(seed)
    given = [turned(rng.normal(size=3), angle) for angle in (np.pi, np.pi - 1e-9, 1e-9, *rng.uniform(-6, 6, 20))]
    path = Trajectory.from_matrices(np.arange(len(given)), given)
    np.testing.assert_allclose(path.matrices, given, atol=1e-12)


WRONG = [
    (lambda: Trajectory([0, 0], np.zeros((2, 3))), "ascend"),
    (lambda: Trajectory([0, 1], np.zeros((3, 3))), "positions"),
    (lambda: Trajectory([0], [[0, 0, 0]], [[0, 0, 0, 0]]), "length 0"),
    (lambda: Trajectory([0, 1], [[0, 0, 0], [0, 0, np.inf]]), "finite"),
    (lambda: Trajectory.from_matrices([0, 1], [np.eye(4), 2 * np.eye(4) - np.diag([0, 0, 0, 1])]), "different scales"),
    (lambda: Trajectory.from_matrices([0], [np.diag([1, 1, 0, 1])]), "singular"),
    (lambda: Trajectory([0, 1], np.zeros((2, 3))).at(1.5), "poses from 0 to 1"),
]


@pytest.mark.parametrize("case", range(len(WRONG)))
def test_wrong_trajectories(case):
    call, message = WRONG[case]
    with pytest.raises(ValueError, match=message):
        call()


# -- a sensor that moves -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def moving():
    """A sensor that drives and turns in front of a wall at 10 m."""
    ends = [np.eye(4), turned([0.2, 0.3, 1], 0.4)]
    ends[1][:3, 3] = [1.0, 0.5, 0.2]
    path = Trajectory.from_matrices([0.0, 0.2], ends)
    pattern = LidarPattern(cone(0.5), TIMES)
    return {"scene": wrt.Scene(wall(10.0), device="cpu"), "path": path, "lidar": Lidar(pattern=pattern)}


def test_every_beam_has_its_own_pose(moving):
    """Ranges to a plane are those from each beam's own pose, in float64."""
    scan = moving["lidar"].scan(moving["scene"], moving["path"], time=0.05)
    poses = moving["path"].at(scan.time)
    axis = np.einsum("...ij,...j->...i", poses[..., :3, :3], exact(scan.pattern))
    origin = poses[..., :3, 3]
    np.testing.assert_allclose(scan.range, (10 - origin[..., 0]) / axis[..., 0], rtol=2e-6)
    np.testing.assert_allclose(scan.position[..., 0], 10.0, atol=2e-5)
    np.testing.assert_allclose(scan.position, origin + scan.range[..., None] * axis, atol=2e-5)
    np.testing.assert_array_equal(scan.time[0], 0.05 + TIMES)
    assert np.ptp(scan.point[0, :, 0]) > 0.1


def test_deskew(moving):
    """Points of all beams, in the frame of one time, are the wall again; a given trajectory replaces the true one."""
    scan = moving["lidar"].scan(moving["scene"], moving["path"], time=0.05)
    for time in (None, 0.12):
        pose = moving["path"].at(0.05 if time is None else time)
        world = scan.deskewed(time) @ pose[:3, :3].T + pose[:3, 3]
        np.testing.assert_allclose(world, scan.position, atol=1e-12)
    still = scan.deskewed(0.1, trajectory=Trajectory([0.0], [[0.0, 0, 0]]))
    np.testing.assert_allclose(still, scan.point, atol=1e-12)
    own = deskew(wp.array(scan.point.astype(np.float32), dtype=wp.vec3, device="cpu"), scan.time, moving["path"], 0.05)
    np.testing.assert_allclose(own.numpy(), scan.deskewed(), atol=1e-5)
    table = scan.to_structured("start")
    assert (np.diff(table["time"]) >= 0).all()
    with pytest.raises(ValueError, match="poses from"):
        scan.deskewed(0.3)


def test_radial_velocity_of_a_moving_sensor(moving):
    """The rate of the range to the plane's material point: towards the wall, minus the speed along the beam; the turn of the
    sensor moves the start of a beam with an offset."""
    path = Trajectory([0.0, 1.0], [[0.0, 0, 0], [3.0, 0, 0]])
    scan = moving["lidar"].scan(moving["scene"], path)
    np.testing.assert_allclose(scan.radial_velocity, -3.0 * exact(scan.pattern)[..., 0], rtol=1e-5)
    spin = Trajectory.from_matrices([0.0, 1.0], [np.eye(4), turned([0, 0, 1], 2.0)])
    beam = Lidar(pattern=LidarPattern([[1.0, 0, 0]], offsets=[[0.0, -0.5, 0]]))
    assert beam.scan(moving["scene"], spin).radial_velocity == pytest.approx(-1.0)  # 2 rad/s at 0.5 m, forward


def test_trajectory_must_cover_the_scan(moving):
    with pytest.raises(ValueError, match=r"0\.15 to 0\.25 s, but the trajectory has poses from 0 to 0\.2 s"):
        moving["lidar"].scan(moving["scene"], moving["path"], time=0.15)


# -- instances that move -----------------------------------------------------------------------------------------------


def moving_wall(speed: float = 20.0) -> tuple[wrt.Scene, dict]:
    scene = wrt.Scene([wrt.Instance(wall(0.0)), wrt.Instance(wall(50.0))], device="cpu")
    return scene, {0: Trajectory([0.0, 1.0], [[10.0, 0, 0], [10.0 + speed, 0, 0]])}


def test_moving_plane():
    """As many slices as times: the wall is where it is at each beam's time, but for half a slice; the error is bounded, and
    halved by twice as many slices. The scene itself is left as it was."""
    scene, motions = moving_wall()
    before = [instance.transform for instance in scene.instances]
    pattern = LidarPattern(cone(0.5, columns=64), np.linspace(0, 0.1, 64))
    bounds = []
    for slices in (1, 4, 16, 32):
        scan = Lidar(pattern=pattern).scan(scene, np.eye(4), motions=motions, slices=slices)
        true = (10.0 + 20.0 * pattern.times) / exact(pattern)[..., 0]
        error = np.abs(scan.position[..., 0] - (10.0 + 20.0 * pattern.times))
        assert scan.motion_error == pytest.approx(20.0 * 0.1 / slices / 2)
        assert error.max() <= scan.motion_error + 1e-5
        np.testing.assert_allclose(scan.range, true, atol=scan.motion_error / np.cos(0.5) + 1e-4)
        np.testing.assert_allclose(scan.radial_velocity, 20.0 * exact(pattern)[..., 0], rtol=1e-5)
        bounds.append(error.max())
    assert bounds[0] > 1.8 * bounds[1] > 3 * bounds[2]
    for instance, transform in zip(scene.instances, before, strict=True):
        np.testing.assert_array_equal(instance.transform, transform)


def test_slices_agree_with_scans_of_frozen_scenes():
    """Each beam's range is that of a scene in which all instances were placed for its slice; bodies turn and have scale."""
    import trimesh

    body = wrt.TriangleMesh.from_trimesh(trimesh.creation.box((1.0, 2.0, 1.5)))
    keys, ends = [0.0, 0.1], []
    for angle in (0.0, 0.9):
        matrix = turned([0.1, 0.2, 1.0], angle)
        matrix[:3, :3] *= 0.8
        matrix[:3, 3] = [5.0 + angle, angle, 0.1]
        ends.append(matrix)
    motion = Trajectory.from_matrices(keys, ends)
    scene = wrt.Scene([wrt.Instance(wall(20.0)), wrt.Instance(body)], device="cpu")
    pattern = LidarPattern(cone(0.3, rows=12, columns=50), np.linspace(0.0, 0.1, 50))
    scan = Lidar(pattern=pattern).scan(scene, np.eye(4), motions={1: motion}, slices=5)
    assert (scan.instance_id == 1).any()
    speed = scan.motion_error / (0.02 / 2)
    assert speed >= 9.0 * 0.8 * np.linalg.norm([1, 2, 1.5]) / 2
    for number in range(5):
        placed = wrt.Scene([wrt.Instance(wall(20.0)), wrt.Instance(body, motion.at(0.02 * number + 0.01))], device="cpu")
        own = np.minimum((pattern.times[0] / 0.1 * 5).astype(int), 4) == number
        expected = placed.intersect(np.zeros(3), pattern.directions[:, own]).t
        np.testing.assert_allclose(scan.range[:, own], expected, rtol=1e-6)


def test_radial_velocity_of_a_turning_body():
    """By finite differences of the position of the material point that was hit."""
    scene = wrt.Scene([wrt.Instance(wall(0.0, -1.0, 1.0))], device="cpu")
    ends = [turned([0, 0, 1], 0.0), turned([0.3, 0.1, 1], 0.5)]
    ends[0][:3, 3], ends[1][:3, 3] = [5, 0, 0], [5.2, 0.1, 0]
    motion = Trajectory.from_matrices([0.0, 0.2], ends)
    pattern = LidarPattern(cone(0.1), np.full(16, 0.1))
    scan = Lidar(pattern=pattern).scan(scene, np.eye(4), motions={0: motion})
    local = np.linalg.inv(motion.at(0.1))
    step = 1e-5
    points = scan.position @ local[:3, :3].T + local[:3, 3]
    ranges = []
    for time in (0.1 - step, 0.1 + step):
        pose = motion.at(time)
        ranges.append(np.linalg.norm(points @ pose[:3, :3].T + pose[:3, 3], axis=-1))
    np.testing.assert_allclose(scan.radial_velocity, (ranges[1] - ranges[0]) / (2 * step), rtol=1e-4, atol=1e-5)
    assert np.ptp(scan.radial_velocity) > 0.1


def test_slices_of_any_pattern():
    """Beams in random order of time, as a list: each lies in its slice."""
    rng = np.random.default_rng(3)
    scene, motions = moving_wall()
    pattern = LidarPattern(cone(0.4).reshape(-1, 3), rng.uniform(0.0, 0.1, 144))
    scan = Lidar(pattern=pattern, bundle=4, divergence=1e-4, returns=2).scan(scene, np.eye(4), motions=motions, slices=7)
    error = np.abs(scan.position[:, 0, 0] - (10.0 + 20.0 * pattern.times))
    assert error.max() <= scan.motion_error + 1e-3
    assert np.isinf(scan.range[:, 1]).all()


@pytest.mark.parametrize(
    ("motions", "slices", "error", "message"),
    [
        ({5: Trajectory([0], [[0, 0, 0]])}, 1, ValueError, "index is 5"),
        ({0: np.eye(4)}, 1, TypeError, "Trajectory"),
        ({0: Trajectory([0, 0.01], [[0, 0, 0], [1, 0, 0]])}, 1, ValueError, r"motions\[0\]"),
        ([1], 1, TypeError, "dict"),
        ({0: Trajectory([0], [[10, 0, 0]])}, 0, ValueError, "slices is 0"),
        ({0: Trajectory([0], [[10, 0, 0]])}, 2.5, TypeError, "slices"),
    ],
)
def test_wrong_motions(motions, slices, error, message):
    scene, _ = moving_wall()
    with pytest.raises(error, match=message):
        Lidar(pattern=LidarPattern(cone(0.5), TIMES)).scan(scene, np.eye(4), motions=motions, slices=slices)

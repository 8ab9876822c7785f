"""Poses over time: key poses, between which the position is interpolated linearly and the rotation by slerp.

The angle between two unit quaternions is taken from the arc tangent of their quotient, which is exact to rounding for small
angles, too. Between two keys, the linear velocity is constant in the world, and the angular velocity is constant.

References: shoemake-1985.
"""

from functools import cache

import warp as wp

from wrt.kernels.runtime.options import exact_kernel, specialised_kernel

SMALL = wp.constant(wp.float64(1e-14))

UNEVEN = wp.constant(wp.float64(1e-6))
"""How far the rows of a rotation may differ from length 1 and from right angles."""


@wp.struct
class PosePath:
    """Key poses in float64, ordered by time; or, with one time, the poses of S sensors at rest; or, without times, one pose."""

    times: wp.array(dtype=wp.float64)
    """(K,) ascending, in seconds; (0,) for one pose."""
    positions: wp.array(dtype=wp.vec3d)
    """(K,) or (S,) in the world."""
    rotations: wp.array(dtype=wp.quatd)
    """(K,) or (S,) unit quaternions from the moving frame to the world; neighbours have a scalar product >= 0."""
    position: wp.vec3d
    """Of the one pose, which needs no memory on the device."""
    rotation: wp.quatd


@wp.struct
class Pose:
    """A pose and its velocity."""

    position: wp.vec3d
    rotation: wp.quatd
    velocity: wp.vec3d
    """Of the frame's origin, in the world."""
    spin: wp.vec3d
    """Angular velocity in the world, in radians a second."""


@wp.func
def pose_at(path: PosePath, time: wp.float64):
    """The pose at a time; beyond the keys, that of the nearest key, at rest."""
    pose = Pose()
    low = int(0)
    high = path.times.shape[0] - 1
    if high < 0:
        pose.position = path.position
        pose.rotation = path.rotation
    elif high == 0 or time < path.times[0] or time > path.times[high]:
        at = wp.where(time > path.times[high], high, 0)
        pose.position = path.positions[at]
        pose.rotation = path.rotations[at]
    else:
        while high - low > 1:
            middle = (low + high) / 2
            if path.times[middle] <= time:
                low = middle
            else:
                high = middle
        duration = path.times[low + 1] - path.times[low]
        share = (time - path.times[low]) / duration
        way = path.positions[low + 1] - path.positions[low]
        pose.position = path.positions[low] + share * way
        pose.velocity = way / duration
        start = path.rotations[low]
        turn = wp.quat_inverse(start) * path.rotations[low + 1]
        axis = wp.vec3d(turn[0], turn[1], turn[2])
        sine = wp.length(axis)
        pose.rotation = start
        if sine > SMALL:
            half = wp.atan2(sine, turn[3])
            axis = axis / sine
            part = wp.sin(share * half) * axis
            pose.rotation = start * wp.quatd(part[0], part[1], part[2], wp.cos(share * half))
            pose.spin = (wp.float64(2.0) * half / duration) * wp.quat_rotate(start, axis)
    return pose


@wp.func
def pose_of(path: PosePath, sensor: int, time: wp.float64):
    """The pose of one of many sensors at a time; they are at rest if there are several."""
    pose = Pose()
    if path.times.shape[0] == 1:
        pose.position = path.positions[sensor]
        pose.rotation = path.rotations[sensor]
    else:
        pose = pose_at(path, time)
    return pose


@exact_kernel
def poses_at(
    first: int,
    path: PosePath,
    times: wp.array(dtype=wp.float64),
    positions: wp.array(dtype=wp.vec3d),
    rotations: wp.array(dtype=wp.quatd),
    velocities: wp.array(dtype=wp.vec3d),
    spins: wp.array(dtype=wp.vec3d),
):
    """Writes the pose at a time, and its velocities. Item: a time."""
    i = first + wp.tid()
    pose = pose_at(path, times[i])
    positions[i] = pose.position
    rotations[i] = pose.rotation
    velocities[i] = pose.velocity
    spins[i] = pose.spin


@exact_kernel
def points_to_world(
    first: int,
    path: PosePath,
    times: wp.array(dtype=wp.float64),
    points: wp.array(dtype=wp.vec3d),
    moved: wp.array(dtype=wp.vec3d),
):
    """Transforms a point from the moving frame at its time to the world. Item: a point."""
    i = first + wp.tid()
    pose = pose_at(path, times[i])
    moved[i] = pose.position + wp.quat_rotate(pose.rotation, points[i])


@exact_kernel
def points_to_frame(
    first: int,
    path: PosePath,
    time: wp.float64,
    points: wp.array(dtype=wp.vec3d),
    moved: wp.array(dtype=wp.vec3d),
):
    """Transforms a point from the world to the moving frame at one time. Item: a point."""
    i = first + wp.tid()
    pose = pose_at(path, time)
    moved[i] = wp.quat_rotate_inv(pose.rotation, points[i] - pose.position)


@wp.func
def quaternion_of(m: wp.mat33d):
    """A rotation as a unit quaternion, the numbers of `wrt.sensors.trajectory.quaternions`."""
    one = wp.float64(1.0)
    trace = (m[0, 0] + m[1, 1]) + m[2, 2]
    largest = int(0)
    for row in range(1, 3):
        if m[row, row] > m[largest, largest]:
            largest = row
    found = wp.quatd(m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], one + trace)
    if m[largest, largest] >= trace:
        i = largest
        j = (i + 1) % 3
        k = (i + 2) % 3
        found[i] = ((one + m[i, i]) - m[j, j]) - m[k, k]
        found[j] = m[j, i] + m[i, j]
        found[k] = m[k, i] + m[i, k]
        found[3] = m[k, j] - m[j, k]
    length = wp.sqrt(((found[0] * found[0] + found[1] * found[1]) + found[2] * found[2]) + found[3] * found[3])
    return wp.quatd(found[0] / length, found[1] / length, found[2] / length, found[3] / length)


@wp.func
def row_product(m: wp.mat44d, one: int, other: int):
    """The scalar product of two rows of the linear part."""
    return (m[one, 0] * m[other, 0] + m[one, 1] * m[other, 1]) + m[one, 2] * m[other, 2]


@wp.func
def is_rigid(m: wp.mat44d):
    """Whether a finite matrix moves and turns only, up to rounding."""
    rigid = m[3, 0] == wp.float64(0.0) and m[3, 1] == wp.float64(0.0) and m[3, 2] == wp.float64(0.0)
    rigid = rigid and m[3, 3] == wp.float64(1.0)
    for row in range(3):
        rigid = rigid and wp.abs(row_product(m, row, row) - wp.float64(1.0)) <= UNEVEN
        rigid = rigid and wp.abs(row_product(m, row, (row + 1) % 3)) <= UNEVEN
    x = m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1])
    y = m[0, 1] * (m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2])
    return rigid and (x + y) + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]) > wp.float64(0.0)


@exact_kernel
def take_matrices(first: int, given: wp.array(dtype=wp.mat44d), path: PosePath, rigid: wp.array(dtype=wp.bool)):
    """Writes the pose of a sensor, and whether its matrix is one. Item: a sensor."""
    i = first + wp.tid()
    m = given[i]
    path.positions[i] = wp.vec3d(m[0, 3], m[1, 3], m[2, 3])
    linear = wp.mat33d(m[0, 0], m[0, 1], m[0, 2], m[1, 0], m[1, 1], m[1, 2], m[2, 0], m[2, 1], m[2, 2])
    path.rotations[i] = quaternion_of(linear)
    rigid[i] = is_rigid(m)


@cache
def make_take_poses(dtype: type) -> wp.Kernel:
    """The kernel that takes the poses of sensors from an array of `wp.transformf` or `wp.transformd`."""

    def take_poses(first: int, given: wp.array(dtype=dtype), arm: wp.vec3d, turn: wp.quatd, path: PosePath):
        """Writes the pose of a sensor. Item: a sensor.

        given: (S,) poses of bodies. arm, turn: from the sensor's frame to the body's. path: with times (1,).
        """
        i = first + wp.tid()
        pose = given[i]
        body = wp.quatd(wp.float64(pose[3]), wp.float64(pose[4]), wp.float64(pose[5]), wp.float64(pose[6]))
        scale = wp.float64(1.0) / wp.sqrt(((body[0] * body[0] + body[1] * body[1]) + body[2] * body[2]) + body[3] * body[3])
        body = wp.quatd(body[0] * scale, body[1] * scale, body[2] * scale, body[3] * scale)  # NaN if it is 0
        at = wp.vec3d(wp.float64(pose[0]), wp.float64(pose[1]), wp.float64(pose[2]))
        path.positions[i] = at + wp.quat_rotate(body, arm)
        path.rotations[i] = body * turn
        if i == 0:
            path.times[0] = wp.float64(0.0)

    return specialised_kernel(take_poses)

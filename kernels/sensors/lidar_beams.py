"""Rays of a lidar's beams: each starts at the pose that the sensor has when the beam is fired.

A beam of light widens. It is a bundle of rays around its axis, spread over a disk of directions; with one ray, it is the axis.
"""

import warp as wp

from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.sensors.pose_paths import Pose, PosePath, pose_of


@wp.struct
class Beams:
    """N beams of a scan in the sensor's frame. Of S sensors, sensor s has the beams s N .. (s + 1) N - 1."""

    directions: wp.array(dtype=wp.vec3)
    """(N,) unit vectors."""
    offsets: wp.array(dtype=wp.vec3)
    """(N,) start of each beam; (0,) if all start at the sensor's origin."""
    times: wp.array(dtype=wp.float64)
    """(N,) firing time in seconds after the start of the scan."""
    order: wp.array(dtype=int)
    """(S N,) beams in the order in which they are traced; (0,) if in the order of their numbers."""
    spread: wp.array(dtype=wp.vec2)
    """(R,) directions of a bundle's rays: tangents of their angles to the axis, along two axes across it."""
    start: wp.float64
    """Time of the scan's start."""


@wp.func
def beam_at(beams: Beams, place: int):
    """The beam that is traced at a place."""
    beam = place
    if beams.order.shape[0] > 0:
        beam = beams.order[place]
    return beam


@wp.struct
class Place:
    """A beam of one of the sensors."""

    sensor: int
    beam: int
    """Its number in the pattern."""


@wp.func
def place_of(beams: Beams, number: int):
    """Sensor and beam of a number among the beams of all sensors; without a division for the first sensor."""
    place = Place()
    place.beam = number
    if number >= beams.directions.shape[0]:
        place.sensor = number / beams.directions.shape[0]
        place.beam = number - place.sensor * beams.directions.shape[0]
    return place


@wp.func
def beam_offset(beams: Beams, beam: int):
    """Start of a beam in the sensor's frame."""
    offset = wp.vec3d()
    if beams.offsets.shape[0] > 0:
        offset = wp.vec3d(beams.offsets[beam])
    return offset


@wp.func
def across(axis: wp.vec3d):
    """A unit vector perpendicular to a unit vector: horizontal, unless the axis is vertical."""
    side = wp.vec3d(-axis[1], axis[0], wp.float64(0.0))
    if wp.length_sq(side) < wp.float64(1e-12):
        side = wp.vec3d(wp.float64(0.0), wp.float64(1.0), wp.float64(0.0))
    return wp.normalize(side)


@native.func_native("sensor_rays.h", "wrt::turn_axes<wp::vec3d>(axes.data, turn, begin, end, turned.data + first);")
def turn_axes(axes: wp.array(dtype=wp.vec3), turn: wp.quatd, begin: int, end: int, first: int, turned: wp.array(dtype=wp.vec3)):
    """Writes the directions of axes begin .. end - 1, normalised and turned; axis 0 is that of direction number `first`."""


@wp.struct
class FiredRays:
    """Where rays are written."""

    origins: wp.array(dtype=wp.vec3d)
    """(N,) in the world; (1,) if all rays share it; (0,) if it is not needed in float64."""
    center: wp.vec3d
    relative: wp.array(dtype=wp.vec3)
    """The same relative to the centre, in float32; (0,) if that is not needed."""
    directions: wp.array(dtype=wp.vec3)
    """(N,)."""


@wp.func
def write_origin(rays: FiredRays, i: int, origin: wp.vec3d):
    """Writes the origin of a ray, where it is needed."""
    if i < rays.origins.shape[0]:
        rays.origins[i] = origin
    if i < rays.relative.shape[0]:
        rays.relative[i] = wp.vec3(origin - rays.center)


@wp.func
def fire_still(beams: Beams, path: PosePath, rays: FiredRays, begin: int, end: int):
    """Writes a range of rays of sensors at rest, each from one point: rays of the axes, in the order of their numbers."""
    own = beams.directions.shape[0]
    i = int(begin)
    while i < end:
        sensor = i / own
        stop = wp.min(end, (sensor + 1) * own)
        pose = pose_of(path, sensor, beams.start)
        turn_axes(beams.directions, pose.rotation, i - sensor * own, stop - sensor * own, sensor * own, rays.directions)
        origin = pose.position + wp.quat_rotate(pose.rotation, wp.vec3d())
        for k in range(i, wp.min(stop, wp.max(rays.origins.shape[0], rays.relative.shape[0]))):
            write_origin(rays, k, origin)
        i = stop


@exact_kernel
def fire_beams(first: int, block: int, count: int, beams: Beams, path: PosePath, rays: FiredRays):
    """Writes rays in the world. Item: a block of rays; R neighbours belong to a beam."""
    begin = (first + wp.tid()) * block
    end = wp.min(begin + block, count)
    bundle = beams.spread.shape[0]
    if path.times.shape[0] <= 1 and beams.order.shape[0] == 0 and beams.offsets.shape[0] == 0 and bundle == 1:
        fire_still(beams, path, rays, begin, end)
        return
    pose = Pose()
    sensor = int(-1)
    for i in range(begin, end):
        item = i
        ray = int(0)
        if bundle > 1:
            item = i / bundle
            ray = i - item * bundle
        place = place_of(beams, beam_at(beams, item))
        beam = place.beam
        if place.sensor != sensor or path.times.shape[0] > 1:
            pose = pose_of(path, place.sensor, beams.start + beams.times[beam])
            sensor = place.sensor
        axis = wp.normalize(wp.vec3d(beams.directions[beam]))
        if bundle > 1:
            side = across(axis)
            tangents = wp.vec2d(beams.spread[ray])
            axis = wp.normalize(axis + tangents[0] * side + tangents[1] * wp.cross(axis, side))
        rays.directions[i] = wp.vec3(wp.quat_rotate(pose.rotation, axis))
        if i < wp.max(rays.origins.shape[0], rays.relative.shape[0]):
            write_origin(rays, i, pose.position + wp.quat_rotate(pose.rotation, beam_offset(beams, beam)))

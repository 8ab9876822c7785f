"""Layers of a scan: what is known of returns that were measured, each computed when it is asked for.

An array (0,) is not asked for.
"""

import warp as wp

from wrt.kernels.query.hit_attributes import SceneMesh, hit_normal
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.sensors.lidar_beams import Beams, across, beam_at, beam_offset, place_of
from wrt.kernels.sensors.lidar_returns import Detector, Motions, Noise, Returns, Traced, is_noisy, keyed
from wrt.kernels.sensors.philox import normal_pair, philox
from wrt.kernels.sensors.pose_paths import Pose, PosePath, pose_of
from wrt.kernels.sensors.surface_ids import SurfaceIds, surface_ids, write_ids


@wp.struct
class ReturnLayers:
    """Layers of all returns."""

    point: wp.array(dtype=wp.vec3d)
    position: wp.array(dtype=wp.vec3d)
    normal: wp.array(dtype=wp.vec3)
    instance: wp.array(dtype=int)
    geometry: wp.array(dtype=int)
    primitive: wp.array(dtype=int)
    semantic: wp.array(dtype=int)
    radial_velocity: wp.array(dtype=float)


@wp.struct
class OneReturn:
    """A return, and what its ray met."""

    beam: int
    """Among those of all sensors."""
    at: int
    """Its place among the returns."""
    primitive: int
    """-1 for a miss."""
    t: float
    """Its range without noise."""


@wp.func
def return_at(beams: Beams, traced: Traced, detector: Detector, returns: Returns, i: int):
    """A return by its number in the order of tracing."""
    found = OneReturn()
    if returns.ray.shape[0] == 0:
        found.beam = beam_at(beams, traced.place + i)
        found.at = found.beam
        found.primitive = traced.primitive[i]
        found.t = traced.t[i]
    else:
        place = i / detector.returns
        found.beam = beam_at(beams, traced.place + place)
        found.at = found.beam * detector.returns + i % detector.returns
        found.t = returns.mean[found.at]
        ray = wp.max(returns.ray[found.at], 0)
        found.primitive = traced.primitive[place * beams.spread.shape[0] + ray]
    if not returns.distance[found.at] < wp.float64(wp.inf):
        found.primitive = int(-1)
    return found


@native.func_native(
    "sensor_rays.h",
    """wrt::write_points(
        noise, beams.directions.data + beam, returns.distance.data, pose, begin, end,
        begin < layers.point.shape[0] ? layers.point.data : nullptr,
        begin < layers.position.shape[0] ? layers.position.data : nullptr);""",
)
def write_points(
    beams: Beams, noise: Noise, pose: Pose, beam: int, begin: int, end: int, returns: Returns, layers: ReturnLayers
):
    """Writes the points of returns begin .. end - 1 of one sensor at rest, the first of them that of a beam."""


@exact_kernel
def fill_points(
    first: int,
    block: int,
    count: int,
    beams: Beams,
    path: PosePath,
    given: Noise,
    kept: int,
    returns: Returns,
    layers: ReturnLayers,
):
    """Writes the points of returns. Item: a block of returns. `given`: their noise; `kept`: returns of each beam."""
    noise = keyed(given)
    begin = (first + wp.tid()) * block
    end = wp.min(begin + block, count)
    nan = wp.float64(wp.nan)
    pose = Pose()
    sensor = int(-1)
    place = place_of(beams, begin)
    plain = kept == 1 and beams.offsets.shape[0] == 0 and path.times.shape[0] <= 1
    if plain and place.beam + end - begin <= beams.directions.shape[0]:
        pose = pose_of(path, place.sensor, beams.start)
        write_points(beams, noise, pose, place.beam, begin, end, returns, layers)
        end = begin
    for at in range(begin, end):
        point = wp.vec3d(nan, nan, nan)
        position = point
        distance = returns.distance[at]
        if distance < wp.float64(wp.inf):
            number = at
            if kept > 1:
                number = at / kept
            place = place_of(beams, number)
            shown = wp.normalize(wp.vec3d(beams.directions[place.beam]))
            if is_noisy(noise):
                others = philox(wp.vec4ui(wp.uint32(at), wp.uint32(1), wp.uint32(0), wp.uint32(0)), noise.key)
                turns = noise.angle * normal_pair(others[0], others[1])
                side = across(shown)
                shown = wp.normalize(shown + turns[0] * side + turns[1] * wp.cross(shown, side))
            point = beam_offset(beams, place.beam) + distance * shown
            if at < layers.position.shape[0]:
                if place.sensor != sensor or path.times.shape[0] > 1:
                    pose = pose_of(path, place.sensor, beams.start + beams.times[place.beam])
                    sensor = place.sensor
                position = pose.position + wp.quat_rotate(pose.rotation, point)
        if at < layers.point.shape[0]:
            layers.point[at] = point
        if at < layers.position.shape[0]:
            layers.position[at] = position


@exact_kernel
def fill_ids(
    first: int,
    block: int,
    count: int,
    beams: Beams,
    traced: Traced,
    mesh: SceneMesh,
    labels: wp.array(dtype=int),
    detector: Detector,
    returns: Returns,
    layers: ReturnLayers,
):
    """Writes what returns come from. Item: a block of returns, in the order of tracing. `labels`: (I,), or (0,)."""
    begin = (first + wp.tid()) * block
    ids = SurfaceIds()
    for i in range(begin, wp.min(begin + block, count)):
        found = return_at(beams, traced, detector, returns, i)
        ids = surface_ids(mesh, ids, found.primitive)
        write_ids(layers, found.at, labels, ids)


@exact_kernel
def fill_normals(
    first: int,
    block: int,
    count: int,
    beams: Beams,
    traced: Traced,
    mesh: SceneMesh,
    detector: Detector,
    returns: Returns,
    layers: ReturnLayers,
):
    """Writes the normals of the surfaces of returns. Item: a block of returns, in the order of tracing."""
    begin = (first + wp.tid()) * block
    before = int(-1)
    normal = wp.vec3()
    for i in range(begin, wp.min(begin + block, count)):
        found = return_at(beams, traced, detector, returns, i)
        if found.primitive != before:  # neighbours often meet one triangle
            normal = hit_normal(mesh, found.primitive)
            before = found.primitive
        layers.normal[found.at] = normal


@wp.func
def surface_velocity(motions: Motions, instance: int, point: wp.vec3d):
    """Velocity of a point of an instance."""
    velocity = wp.vec3d()
    if motions.pivot.shape[0] > 0:
        velocity = motions.velocity[instance] + wp.cross(motions.spin[instance], point - motions.pivot[instance])
    return velocity


@exact_kernel
def fill_velocities(
    first: int,
    block: int,
    count: int,
    beams: Beams,
    path: PosePath,
    traced: Traced,
    mesh: SceneMesh,
    motions: Motions,
    detector: Detector,
    returns: Returns,
    layers: ReturnLayers,
):
    """Writes the radial velocities of returns. Item: a block of returns, in the order of tracing."""
    begin = (first + wp.tid()) * block
    pose = Pose()
    sensor = int(-1)
    ids = SurfaceIds()
    for i in range(begin, wp.min(begin + block, count)):
        found = return_at(beams, traced, detector, returns, i)
        speed = wp.float32(wp.nan)
        if found.primitive >= 0:
            place = place_of(beams, found.beam)
            if place.sensor != sensor or path.times.shape[0] > 1:
                pose = pose_of(path, place.sensor, beams.start + beams.times[place.beam])
                sensor = place.sensor
            axis = wp.quat_rotate(pose.rotation, wp.normalize(wp.vec3d(beams.directions[place.beam])))
            origin = pose.position + wp.quat_rotate(pose.rotation, beam_offset(beams, place.beam))
            ids = surface_ids(mesh, ids, found.primitive)
            against = surface_velocity(motions, ids.instance, origin + wp.float64(found.t) * axis)
            against = against - pose.velocity - wp.cross(pose.spin, origin - pose.position)
            speed = wp.float32(wp.dot(axis, against))
        layers.radial_velocity[found.at] = speed

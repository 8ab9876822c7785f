"""Layers of a scan: what is known of returns that were measured, each computed when it is asked for.

An array (0,) is not asked for.
"""

import warp as wp

from wrt.kernels.query.hit_attributes import SceneMesh, hit_normal
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.sensors.lidar_beams import Beams, across, beam_at, beam_offset, place_of
from wrt.kernels.sensors.lidar_returns import Detector, Motions, Noise, Returns, Traced, keyed, measure_rays
from wrt.kernels.sensors.philox import normal_pair, philox
from wrt.kernels.sensors.pose_paths import Pose, PosePath, pose_of
from wrt.kernels.sensors.surface_ids import SurfaceIds, label_of, surface_ids


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
    if not returns.range[found.at] < wp.inf:
        found.primitive = int(-1)
    return found


@native.func_native(
    "sensor_rays.h",
    """wrt::write_points(
        noise, beams.directions.data + beam, returns.range.data, returns.distance.data, pose, begin, end,
        begin < layers.point.shape[0] ? layers.point.data : nullptr,
        begin < layers.position.shape[0] ? layers.position.data : nullptr);""",
)
def write_points(
    beams: Beams, noise: Noise, pose: Pose, beam: int, begin: int, end: int, returns: Returns, layers: ReturnLayers
):
    """Writes the points of returns begin .. end - 1 of one sensor at rest, the first of them that of a beam."""


@wp.func
def points_of_returns(
    beams: Beams, path: PosePath, noise: Noise, kept: int, begin: int, end: int, returns: Returns, layers: ReturnLayers
):
    """Writes the points of returns begin .. end - 1. `kept`: returns of each beam."""
    nan = wp.float64(wp.nan)
    pose = Pose()
    sensor = int(-1)
    place = place_of(beams, begin)
    plain = kept == 1 and beams.offsets.shape[0] == 0 and path.times.shape[0] <= 1
    left = int(begin)
    if plain and place.beam + end - begin <= beams.directions.shape[0]:
        pose = pose_of(path, place.sensor, beams.start)
        write_points(beams, noise, pose, place.beam, begin, end, returns, layers)
        left = end
    for at in range(left, end):
        point = wp.vec3d(nan, nan, nan)
        position = point
        if returns.range[at] < wp.inf:
            distance = wp.float64(returns.range[at])
            if returns.distance.shape[0] > 0:
                distance = returns.distance[at]
            number = at
            if kept > 1:
                number = at / kept
            place = place_of(beams, number)
            shown = wp.normalize(wp.vec3d(beams.directions[place.beam]))
            if noise.angle > wp.float64(0.0):
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
def fill_points(
    first: int,
    block: int,
    count: int,
    beams: Beams,
    path: PosePath,
    noise: Noise,
    kept: int,
    returns: Returns,
    layers: ReturnLayers,
):
    """Writes the points of returns. Item: a block of returns. `kept`: returns of each beam."""
    begin = (first + wp.tid()) * block
    points_of_returns(beams, path, keyed(noise), kept, begin, wp.min(begin + block, count), returns, layers)


@native.func_native(
    "sensor_rays.h",
    """wrt::write_ids(
        mesh, labels, traced.primitive.data, returns.range.data, begin, end, traced.place,
        {layers.instance.data, layers.geometry.data, layers.primitive.data, layers.semantic.data});""",
)
def write_ids(
    traced: Traced,
    mesh: SceneMesh,
    labels: wp.array(dtype=int),
    begin: int,
    end: int,
    returns: Returns,
    layers: ReturnLayers,
):
    """Writes what the rays begin .. end - 1 met, one of each beam, in the order of their numbers."""


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
    end = wp.min(begin + block, count)
    if returns.ray.shape[0] == 0 and beams.order.shape[0] == 0:
        write_ids(traced, mesh, labels, begin, end, returns, layers)
        end = begin
    ids = SurfaceIds()
    for i in range(begin, end):
        found = return_at(beams, traced, detector, returns, i)
        ids = surface_ids(mesh, ids, found.primitive)
        if found.at < layers.instance.shape[0]:
            layers.instance[found.at] = ids.instance
        if found.at < layers.geometry.shape[0]:
            layers.geometry[found.at] = ids.geometry
        if found.at < layers.primitive.shape[0]:
            layers.primitive[found.at] = ids.primitive
        if found.at < layers.semantic.shape[0]:
            layers.semantic[found.at] = label_of(labels, ids)


@exact_kernel
def fill_single(
    first: int,
    block: int,
    count: int,
    beams: Beams,
    path: PosePath,
    traced: Traced,
    mesh: SceneMesh,
    labels: wp.array(dtype=int),
    noise: Noise,
    detector: Detector,
    returns: Returns,
    layers: ReturnLayers,
):
    """Writes all that is asked for of what is measured by one ray and one return a beam: returns, and their points and ids.

    Item: a block of beams, in the order of tracing. With an order, only returns are written, without noise.
    """
    begin = (first + wp.tid()) * block
    end = wp.min(begin + block, count)
    own = keyed(noise)
    measure_rays(beams, traced, mesh, own, detector, begin, end, returns)
    if beams.order.shape[0] == 0:
        if layers.point.shape[0] + layers.position.shape[0] > 0:
            points_of_returns(beams, path, own, 1, traced.place + begin, traced.place + end, returns, layers)
        if layers.instance.shape[0] + layers.geometry.shape[0] + layers.primitive.shape[0] + layers.semantic.shape[0] > 0:
            write_ids(traced, mesh, labels, begin, end, returns, layers)


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

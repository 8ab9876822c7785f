"""Returns of a lidar: from the hits of a beam's rays to ranges, intensities, points and what was hit.

**Power.** A ray of a bundle that meets a surface at range r returns the power

    weight x reflectance x cos(angle of incidence) x (reference_range / r)^exponent x exp(-2 extinction r),

the link budget of a diffuse surface that fills the ray (Wagner et al. 2006). The weights of a bundle add up to 1, so a white
surface at the reference range, met at a right angle, has the intensity 1.

**Returns.** The rays of a beam that hit are taken by range. A gap longer than the range resolution ends a return. The range of
a return is the mean of its rays' ranges, weighted by power; its intensity is the sum of their powers; what it says about the
surface is that of its strongest ray. Returns weaker than the threshold are not detected. A surface nearer than the least range
blocks the ray, but is not detected.

**Noise** is that of a return which was detected: misses remain misses. It is a function of seed, beam and place among the
beam's returns (`wrt.kernels.sensors.philox`).

References: wagner-2006.
"""

import warp as wp

from wrt.kernels.query.hit_attributes import SceneMesh, geometry_of, hit_normal
from wrt.kernels.runtime.options import exact_module
from wrt.kernels.sensors.lidar_beams import Beams, across, beam_at, beam_offset
from wrt.kernels.sensors.philox import normal_pair, philox, uniform
from wrt.kernels.sensors.pose_paths import PosePath, pose_of

exact_module(__name__)

STRONGEST = wp.constant(0)
FIRST = wp.constant(1)
LAST = wp.constant(2)


@wp.struct
class Detector:
    """What a lidar detects."""

    min_range: float
    max_range: float
    resolution: float
    """Longest gap between the rays of a return, along the beam."""
    exponent: float
    reference_range: float
    extinction: float
    """Per unit of length."""
    threshold: float
    """Least power of a return."""
    returns: int
    """Number of returns kept for each beam."""
    keep: int
    """Which: STRONGEST, FIRST or LAST, in this order."""
    reflectance: wp.array(dtype=float)
    """(I,) of each instance, or (1,) of all."""


@wp.struct
class Traced:
    """Hits of the rays of some beams."""

    place: int
    """Place of the first of these beams in the order of tracing."""
    directions: wp.array(dtype=wp.vec3)
    """(beams S,) of the rays, in the world."""
    t: wp.array(dtype=float)
    primitive: wp.array(dtype=int)


@wp.struct
class Motions:
    """Velocities of the instances while these beams are traced; arrays (0,) if all are at rest."""

    pivot: wp.array(dtype=wp.vec3d)
    """(I,) a point of the instance."""
    velocity: wp.array(dtype=wp.vec3d)
    """(I,) of that point."""
    spin: wp.array(dtype=wp.vec3d)
    """(I,) angular velocity, in radians a second."""


@wp.struct
class Returns:
    """Returns of all N beams, R for each."""

    range: wp.array(dtype=float)
    intensity: wp.array(dtype=float)
    ray: wp.array(dtype=int)
    """The strongest ray of a return, counted within its beam; -1 for none."""
    point: wp.array(dtype=wp.vec3d)
    position: wp.array(dtype=wp.vec3d)
    normal: wp.array(dtype=wp.vec3)
    instance: wp.array(dtype=int)
    geometry: wp.array(dtype=int)
    primitive: wp.array(dtype=int)
    radial_velocity: wp.array(dtype=float)


@wp.struct
class Noise:
    """Standard deviations of the noise."""

    range: wp.float64
    angle: wp.float64
    """Of the reported direction, along each of two axes across the beam, in radians."""
    dropout: wp.float64
    """Share of the returns that are lost."""
    key: wp.vec2ui


@wp.func
def returned_power(mesh: SceneMesh, detector: Detector, primitive: int, normal: wp.vec3, direction: wp.vec3, t: float):
    """Power that a ray with all of a beam's light returns."""
    power = detector.reflectance[0]
    if detector.reflectance.shape[0] > 1:
        power = detector.reflectance[geometry_of(mesh, primitive)]
    power = power * wp.abs(wp.dot(normal, direction))
    ratio = detector.reference_range / t
    if detector.exponent == 2.0:
        power = power * ratio * ratio
    elif detector.exponent != 0.0:
        power = power * wp.pow(ratio, detector.exponent)
    if detector.extinction != 0.0:
        power = power * wp.exp(-2.0 * detector.extinction * t)
    return power


@wp.func
def rank(detector: Detector, distance: float, power: float):
    """Smaller for returns that are kept first."""
    value = -power
    if detector.keep == FIRST:
        value = distance
    elif detector.keep == LAST:
        value = -distance
    return value


@wp.func
def insert_return(detector: Detector, returns: Returns, begin: int, distance: float, power: float, ray: int):
    """Inserts a return among those of a beam, which are ordered; the last one falls out."""
    if power >= detector.threshold:
        own = rank(detector, distance, power)
        place = begin + detector.returns
        moving = int(1)
        while moving == 1 and place > begin:
            before = place - 1
            if returns.ray[before] >= 0 and rank(detector, returns.range[before], returns.intensity[before]) <= own:
                moving = 0
            else:
                if place < begin + detector.returns:
                    returns.range[place] = returns.range[before]
                    returns.intensity[place] = returns.intensity[before]
                    returns.ray[place] = returns.ray[before]
                place = before
        if place < begin + detector.returns:
            returns.range[place] = distance
            returns.intensity[place] = power
            returns.ray[place] = ray


@wp.kernel
def gather_returns(first: int, beams: Beams, traced: Traced, mesh: SceneMesh, detector: Detector, returns: Returns):
    """Groups the hits of a beam's rays to returns. Item: a beam, in the order of tracing."""
    i = first + wp.tid()
    rays = beams.spread.shape[0]
    begin = beam_at(beams, traced.place + i) * detector.returns
    for place in range(begin, begin + detector.returns):
        returns.range[place] = wp.inf
        returns.intensity[place] = 0.0
        returns.ray[place] = -1
    base = i * rays
    share = 1.0 / float(rays)
    before = float(-1.0)
    ray = int(-1)
    power = float(0.0)
    moment = float(0.0)
    strongest = float(-1.0)
    which = int(-1)
    searching = int(1)
    while searching == 1:
        t = float(wp.inf)
        following = int(-1)
        for s in range(rays):  # the next hit by range, then by number
            other = traced.t[base + s]
            detected = traced.primitive[base + s] >= 0 and other >= detector.min_range and other <= detector.max_range
            if detected and other < t and (other > before or (other == before and s > ray)):
                t = other
                following = s
        if which >= 0 and (following < 0 or t - before > detector.resolution):
            mean = before
            if power > 0.0:
                mean = moment / power
            insert_return(detector, returns, begin, mean, power, which)
            power = 0.0
            moment = 0.0
            strongest = -1.0
            which = -1
        if following < 0:
            searching = 0
        else:
            primitive = traced.primitive[base + following]
            normal = hit_normal(mesh, primitive)
            own = share * returned_power(mesh, detector, primitive, normal, traced.directions[base + following], t)
            power = power + own
            moment = moment + own * t
            if own > strongest:
                strongest = own
                which = following
            before = t
            ray = following


@wp.func
def clear_return(returns: Returns, i: int):
    """Writes what a miss is."""
    nan = wp.float64(wp.nan)
    returns.range[i] = wp.inf
    returns.intensity[i] = 0.0
    returns.ray[i] = -1
    returns.point[i] = wp.vec3d(nan, nan, nan)
    returns.position[i] = wp.vec3d(nan, nan, nan)
    returns.normal[i] = wp.vec3()
    returns.instance[i] = -1
    returns.geometry[i] = -1
    returns.primitive[i] = -1
    returns.radial_velocity[i] = wp.nan


@wp.func
def surface_velocity(motions: Motions, instance: int, point: wp.vec3d):
    """Velocity of a point of an instance."""
    velocity = wp.vec3d()
    if motions.pivot.shape[0] > 0:
        velocity = motions.velocity[instance] + wp.cross(motions.spin[instance], point - motions.pivot[instance])
    return velocity


@wp.struct
class FoundReturn:
    """A return and the triangle from which it comes."""

    beam: int
    at: int
    """Its place among the returns."""
    primitive: int
    """-1 for a miss."""
    normal: wp.vec3


@wp.func
def describe_return(
    beams: Beams, path: PosePath, mesh: SceneMesh, motions: Motions, noise: Noise, found: FoundReturn, returns: Returns
):
    """Writes point and surface of a return, with noise, from its range and the triangle."""
    at = found.at
    primitive = found.primitive
    beam = found.beam % beams.directions.shape[0]
    axis = wp.normalize(wp.vec3d(beams.directions[beam]))
    distance = wp.float64(returns.range[at])
    detected = primitive >= 0
    shift = wp.float64(0.0)
    shown = axis
    if detected and (noise.range > wp.float64(0.0) or noise.angle > wp.float64(0.0) or noise.dropout > wp.float64(0.0)):
        words = philox(wp.vec4ui(wp.uint32(at), wp.uint32(0), wp.uint32(0), wp.uint32(0)), noise.key)
        others = philox(wp.vec4ui(wp.uint32(at), wp.uint32(1), wp.uint32(0), wp.uint32(0)), noise.key)
        detected = uniform(words[2]) >= noise.dropout
        shift = noise.range * normal_pair(words[0], words[1])[0]
        turns = noise.angle * normal_pair(others[0], others[1])
        side = across(axis)
        shown = wp.normalize(axis + turns[0] * side + turns[1] * wp.cross(axis, side))
    if detected:
        pose = pose_of(path, found.beam / beams.directions.shape[0], beams.start + beams.times[beam])
        offset = beam_offset(beams, beam)
        origin = pose.position + wp.quat_rotate(pose.rotation, offset)
        axis = wp.quat_rotate(pose.rotation, axis)
        instance = geometry_of(mesh, primitive)
        against = surface_velocity(motions, instance, origin + distance * axis)
        against = against - pose.velocity - wp.cross(pose.spin, origin - pose.position)
        distance = wp.max(distance + shift, wp.float64(0.0))
        point = offset + distance * shown
        returns.range[at] = wp.float32(distance)
        returns.point[at] = point
        returns.position[at] = pose.position + wp.quat_rotate(pose.rotation, point)
        returns.normal[at] = found.normal
        returns.instance[at] = instance
        returns.geometry[at] = instance
        if mesh.placements.shape[0] > 0:
            returns.geometry[at] = mesh.placements[instance].geometry
        returns.primitive[at] = primitive - mesh.geometry_first[instance]
        returns.radial_velocity[at] = wp.float32(wp.dot(axis, against))
    else:
        clear_return(returns, at)


@wp.kernel
def describe_returns(
    first: int,
    beams: Beams,
    path: PosePath,
    traced: Traced,
    mesh: SceneMesh,
    motions: Motions,
    noise: Noise,
    detector: Detector,
    returns: Returns,
):
    """Writes points and surfaces of the returns that were gathered. Item: a return, in the order of tracing."""
    i = first + wp.tid()
    place = i / detector.returns
    beam = beam_at(beams, traced.place + place)
    found = FoundReturn()
    found.beam = beam
    found.at = beam * detector.returns + i % detector.returns
    found.primitive = -1
    if returns.ray[found.at] >= 0:
        found.primitive = traced.primitive[place * beams.spread.shape[0] + returns.ray[found.at]]
    found.normal = hit_normal(mesh, found.primitive)
    describe_return(beams, path, mesh, motions, noise, found, returns)


@wp.kernel
def single_returns(
    first: int,
    beams: Beams,
    path: PosePath,
    traced: Traced,
    mesh: SceneMesh,
    motions: Motions,
    noise: Noise,
    detector: Detector,
    returns: Returns,
):
    """`gather_returns` and `describe_returns` for one ray and one return a beam. Item: a beam, in the order of tracing."""
    i = first + wp.tid()
    beam = beam_at(beams, traced.place + i)
    t = traced.t[i]
    primitive = traced.primitive[i]
    normal = hit_normal(mesh, primitive)
    if primitive >= 0:
        power = returned_power(mesh, detector, primitive, normal, traced.directions[i], t)
        returns.range[beam] = t
        returns.intensity[beam] = power
        returns.ray[beam] = 0
        if t < detector.min_range or t > detector.max_range or power < detector.threshold:
            primitive = int(-1)
    found = FoundReturn()
    found.beam = beam
    found.at = beam
    found.primitive = primitive
    found.normal = normal
    describe_return(beams, path, mesh, motions, noise, found, returns)

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

What is known of a return beside range and intensity is computed when it is asked for (`wrt.kernels.sensors.return_layers`).

References: wagner-2006.
"""

import warp as wp

from wrt.kernels.query.hit_attributes import SceneMesh, geometry_of, triangle_normal, triangle_of
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.sensors.lidar_beams import Beams, beam_at

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
    """What is measured of all N beams, R returns for each."""

    range: wp.array(dtype=float)
    """inf for a miss."""
    intensity: wp.array(dtype=float)
    """(0,) if it is not asked for."""
    distance: wp.array(dtype=wp.float64)
    """The range before it was rounded; inf for a miss. (0,) if that is the range: one ray, one return, no noise."""
    ray: wp.array(dtype=int)
    """The strongest ray of a return, counted within its beam; -1 for none. (0,) for one ray and one return a beam."""
    mean: wp.array(dtype=float)
    """The range without noise; (0,) like `ray`, as it is that of the ray."""


@wp.struct
class Noise:
    """Standard deviations of the noise."""

    range: wp.float64
    angle: wp.float64
    """Of the reported direction, along each of two axes across the beam, in radians."""
    dropout: wp.float64
    """Share of the returns that are lost."""
    key: wp.vec2ui
    """The seed, in two words."""
    taken: wp.array(dtype=wp.uint64)
    """(1,) the seed, if it is on the device (`take_seed`); (0,) if `key` is."""


@wp.struct
class Surface:
    """What the power of a ray depends on."""

    primitive: int
    """-1 for none."""
    normal: wp.vec3
    reflectance: float


@wp.func
def surface_of(mesh: SceneMesh, detector: Detector, before: Surface, primitive: int):
    """The surface of a triangle; neighbours often meet that of the ray before."""
    surface = before
    if primitive != before.primitive:
        triangle = triangle_of(mesh, primitive)
        surface.primitive = primitive
        surface.normal = triangle_normal(mesh, triangle)
        surface.reflectance = detector.reflectance[0]
        if detector.reflectance.shape[0] > 1:
            instance = triangle.instance
            if instance < 0:
                instance = geometry_of(mesh, primitive)
            surface.reflectance = detector.reflectance[instance]
    return surface


@wp.func
def returned_power(detector: Detector, surface: Surface, direction: wp.vec3, t: float):
    """Power that a ray with all of a beam's light returns."""
    power = surface.reflectance * wp.abs(wp.dot(surface.normal, direction))
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
            if returns.ray[before] >= 0 and rank(detector, returns.mean[before], returns.intensity[before]) <= own:
                moving = 0
            else:
                if place < begin + detector.returns:
                    returns.mean[place] = returns.mean[before]
                    returns.intensity[place] = returns.intensity[before]
                    returns.ray[place] = returns.ray[before]
                place = before
        if place < begin + detector.returns:
            returns.mean[place] = distance
            returns.intensity[place] = power
            returns.ray[place] = ray


@exact_kernel
def gather_returns(first: int, beams: Beams, traced: Traced, mesh: SceneMesh, detector: Detector, returns: Returns):
    """Groups the hits of a beam's rays to returns. Item: a beam, in the order of tracing."""
    i = first + wp.tid()
    rays = beams.spread.shape[0]
    begin = beam_at(beams, traced.place + i) * detector.returns
    for place in range(begin, begin + detector.returns):
        returns.mean[place] = wp.inf
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
    surface = Surface()
    surface.primitive = -1
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
            surface = surface_of(mesh, detector, surface, primitive)
            own = share * returned_power(detector, surface, traced.directions[base + following], t)
            power = power + own
            moment = moment + own * t
            if own > strongest:
                strongest = own
                which = following
            before = t
            ray = following


@exact_kernel
def take_seed(first: int, seed: wp.array(dtype=wp.uint64), taken: wp.array(dtype=wp.uint64)):
    """Copies a seed, and leaves the next number in its place. Item: the seed."""
    taken[0] = seed[0]
    seed[0] = seed[0] + wp.uint64(1)


@wp.func
def keyed(given: Noise):
    """The noise with its key, wherever the seed is."""
    noise = Noise()
    noise.range = given.range
    noise.angle = given.angle
    noise.dropout = given.dropout
    noise.key = given.key
    if given.taken.shape[0] > 0:
        seed = given.taken[0]
        noise.key = wp.vec2ui(wp.uint32(seed), wp.uint32(seed >> wp.uint64(32)))
    return noise


@native.func_native(
    "sensor_noise.h",
    """wrt::write_ranges(
        noise, begin, end, returns.range.data, returns.intensity.data, returns.distance.data);""",
)
def write_ranges(noise: Noise, begin: int, end: int, returns: Returns):
    """Writes the ranges of returns with noise, given those without, and takes out those that are lost."""


@exact_kernel
def add_noise(first: int, block: int, count: int, noise: Noise, returns: Returns):
    """Writes what is measured of returns that are known without noise. Item: a block of returns."""
    begin = (first + wp.tid()) * block
    end = wp.min(begin + block, count)
    if returns.mean.shape[0] > 0:
        for at in range(begin, end):
            returns.range[at] = returns.mean[at]
    write_ranges(keyed(noise), begin, end, returns)


@native.func_native("sensor_rays.h", "return wrt::end_of_run(primitive.data, begin, end);")
def end_of_run(primitive: wp.array(dtype=int), begin: int, end: int) -> int:
    """The end of the neighbours that met one triangle."""


@native.func_native(
    "sensor_rays.h",
    """wrt::write_returns(
        detector, detector.exponent == 2.0f, traced.t.data, traced.directions.data, surface.normal, surface.reflectance,
        beams.order.shape[0] ? beams.order.data : nullptr, traced.place, begin, end, returns.range.data,
        returns.intensity.data);""",
)
def write_run(beams: Beams, traced: Traced, detector: Detector, surface: Surface, begin: int, end: int, returns: Returns):
    """Writes ranges and intensities of neighbours that met one surface, without noise, by a simple range law."""


@native.func_native(
    "sensor_rays.h",
    """wrt::write_distances(
        detector, traced.t.data, traced.primitive.data, beams.order.shape[0] ? beams.order.data : nullptr, traced.place, begin,
        end, returns.range.data);""",
)
def write_distances(beams: Beams, traced: Traced, detector: Detector, begin: int, end: int, returns: Returns):
    """Writes ranges without noise, whatever power returns have."""


@wp.func
def measure_power(beams: Beams, traced: Traced, mesh: SceneMesh, detector: Detector, begin: int, end: int, returns: Returns):
    """Writes ranges and intensities without noise."""
    simple = (detector.exponent == 2.0 or detector.exponent == 0.0) and detector.extinction == 0.0
    surface = Surface()
    surface.primitive = -1
    i = int(begin)
    while i < end:
        primitive = traced.primitive[i]
        following = end_of_run(traced.primitive, i, end)
        if primitive >= 0:
            surface = surface_of(mesh, detector, surface, primitive)
        else:
            surface.primitive = -1
            surface.reflectance = -1.0
        if simple or primitive < 0:
            write_run(beams, traced, detector, surface, i, following, returns)
        else:
            for ray in range(i, following):
                t = traced.t[ray]
                power = returned_power(detector, surface, traced.directions[ray], t)
                at = beam_at(beams, traced.place + ray)
                detected = not (t < detector.min_range or t > detector.max_range or power < detector.threshold)
                returns.range[at] = wp.where(detected, t, wp.inf)
                returns.intensity[at] = wp.where(detected, power, 0.0)
        i = following


@wp.func
def measure_rays(
    beams: Beams, traced: Traced, mesh: SceneMesh, noise: Noise, detector: Detector, begin: int, end: int, returns: Returns
):
    """Writes what is measured by rays begin .. end - 1, one of each beam: with noise, unless an order is given.

    Surfaces are looked up for intensities, and for a threshold, which the returns of all surfaces pass if it is 0.
    """
    if returns.intensity.shape[0] == 0 and detector.threshold == 0.0:
        write_distances(beams, traced, detector, begin, end, returns)
    else:
        measure_power(beams, traced, mesh, detector, begin, end, returns)
    if beams.order.shape[0] == 0:
        write_ranges(noise, traced.place + begin, traced.place + end, returns)

"""Ray casters: rays of a known distribution, from a rectangle or from a point through a cap of the unit sphere.

Ray i uses point i of the scrambled Sobol sequence of the seed (`wrt.kernels.shading.sampling`). A ray therefore does not depend
on the number of rays, and the points are more evenly spread than independent random numbers. All arithmetic is float64; results
are rounded once.

**Circular cap** of half angle g. A circle at angle y around the axis has a length proportional to sin y, so the fraction of the
cap within it is (1 - cos y) / (1 - cos g). The inverse is 1 - cos y = u (1 - cos g). (Falcone 2024, appendix B, has the same
density but divides it by an approximation of its integral, 2.85 g^1.81; the exact integral is 2 pi (1 - cos g).)

**Square cap**: the part of the sphere that is visible through a window |x| <= a, |y| <= b at depth 1. An element dx dy of the
window covers a solid angle of dx dy (1 + x^2 + y^2)^(-3/2). Integrated over y, then up to x, this gives 2 atan(T) with T = b x
/ sqrt(1 + b^2 + x^2), which is solved for x. For fixed x, the integral up to y is proportional to y / sqrt(1 + x^2 + y^2),
which is solved for y. Equal areas of the unit square map to equal areas of the sphere (Urena, Fajardo and King 2013 do this for
any rectangle).

References: urena-2013; falcone-2024 (section 5.6.2, appendix B).
"""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.shading.sampling import TWO_PI, mix, spread_point

SECOND = wp.constant(wp.uint32(0x51ED27))
"""Turns a seed into the seed of a second, independent pair of numbers."""


@wp.struct
class Aim:
    """Origin, frame and extent of a ray caster."""

    position: wp.vec3d
    right: wp.vec3d
    up: wp.vec3d
    forward: wp.vec3d
    """`right`, `up` and `forward` are an orthonormal frame."""
    half: wp.vec2d
    """Half sizes of the rectangle, or of the window at depth 1."""
    rise: wp.float64
    """1 - cos g of a circular cap of half angle g."""


@wp.func
def in_scene(aim: Aim, x: wp.float64, y: wp.float64, z: wp.float64):
    """Transforms a vector from the frame of the caster to the scene."""
    return x * aim.right + y * aim.up + z * aim.forward


@wp.func
def in_circular_cap(aim: Aim, u: wp.float64, v: wp.float64):
    """Maps [0, 1)^2 to unit directions, uniformly over the cap."""
    rise = u * aim.rise
    radius = wp.sqrt(rise * (wp.float64(2.0) - rise))
    angle = wp.float64(TWO_PI) * v
    return in_scene(aim, radius * wp.cos(angle), radius * wp.sin(angle), wp.float64(1.0) - rise)


@wp.func
def in_square_cap(aim: Aim, u: wp.float64, v: wp.float64):
    """Maps [0, 1)^2 to unit directions, uniformly over the part of the sphere inside the window."""
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    a = aim.half[0]
    b = aim.half[1]
    tangent = wp.tan((two * u - one) * wp.atan(a * b / wp.sqrt(one + a * a + b * b)))
    x = tangent * wp.sqrt((one + b * b) / (b * b - tangent * tangent))
    sine = (two * v - one) * b / wp.sqrt(one + x * x + b * b)
    y = sine * wp.sqrt((one + x * x) / (one - sine * sine))
    return wp.normalize(in_scene(aim, x, y, one))


@exact_kernel
def cast_plane(first: int, aim: Aim, seed: wp.uint32, origins: wp.array(dtype=wp.vec3d), directions: wp.array(dtype=wp.vec3)):
    """Writes a ray from the rectangle, parallel to `forward` or within a circular cap around it. Item: a ray."""
    i = first + wp.tid()
    place = spread_point(i, seed)
    turn = spread_point(i, mix(seed, SECOND))
    x = (wp.float64(2.0) * wp.float64(place[0]) - wp.float64(1.0)) * aim.half[0]
    y = (wp.float64(2.0) * wp.float64(place[1]) - wp.float64(1.0)) * aim.half[1]
    origins[i] = aim.position + in_scene(aim, x, y, wp.float64(0.0))
    directions[i] = wp.vec3(in_circular_cap(aim, wp.float64(turn[0]), wp.float64(turn[1])))


@exact_kernel
def cast_circular_cap(first: int, aim: Aim, seed: wp.uint32, directions: wp.array(dtype=wp.vec3)):
    """Writes a direction of a circular cap. Item: a ray."""
    i = first + wp.tid()
    place = spread_point(i, seed)
    directions[i] = wp.vec3(in_circular_cap(aim, wp.float64(place[0]), wp.float64(place[1])))


@exact_kernel
def cast_square_cap(first: int, aim: Aim, seed: wp.uint32, directions: wp.array(dtype=wp.vec3)):
    """Writes a direction of a square cap. Item: a ray."""
    i = first + wp.tid()
    place = spread_point(i, seed)
    directions[i] = wp.vec3(in_square_cap(aim, wp.float64(place[0]), wp.float64(place[1])))

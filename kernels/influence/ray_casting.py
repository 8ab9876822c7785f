"""Rays of a known distribution: from a rectangle, or from a point through a cap of the sphere around it.

Ray number i takes point i of the scrambled Sobol sequence that belongs to the seed (`wrt.kernels.shading.sampling`): the same
whatever else is cast, and more even than independent numbers. All is computed in float64 and rounded once.

**Circular cap** of half angle g. A circle of angle y about the axis is as long as sin y, so the share of the cap within it is
(1 - cos y) / (1 - cos g), which inverts as it is: 1 - cos y = u (1 - cos g). (Falcone 2024, appendix B, has the same
density, but divides it by an approximation of its integral, 2.85 g^1.81; the integral is 2 pi (1 - cos g).)

**Square cap**, what a window |x| <= a, |y| <= b at depth 1 shows of the sphere. A piece dx dy of the window shows
dx dy (1 + x^2 + y^2)^(-3/2) of it. Integrated over y, then up to x, that is 2 atan(T) with T = b x / sqrt(1 + b^2 + x^2),
which is solved for x; given x, the integral up to y is proportional to y / sqrt(1 + x^2 + y^2), which is solved for y. So equal
parts of the unit square become equal parts of the sphere (Urena, Fajardo, King 2013 do so for any rectangle).

References:
    C. Urena, M. Fajardo, A. King: An area-preserving parametrization for spherical rectangles. Computer Graphics Forum
        32(4) (Eurographics Symposium on Rendering), 2013.
    L. Falcone: Ray distribution aware heuristics for BVHs construction in ray tracing. MSc thesis, Politecnico di Milano,
        2024: section 5.6.2, appendix B.
"""

import warp as wp

from wrt.kernels.shading.sampling import TWO_PI, mix, spread_point

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

SECOND = wp.constant(wp.uint32(0x51ED27))
"""Makes of a seed that of a second, independent pair of numbers."""


@wp.struct
class Aim:
    """Where rays start and what they run towards."""

    position: wp.vec3d
    right: wp.vec3d
    up: wp.vec3d
    forward: wp.vec3d
    """Orthogonal unit vectors."""
    half: wp.vec2d
    """Of the rectangle, or of the window at depth 1."""
    rise: wp.float64
    """1 - cos g of a circular cap."""


@wp.func
def in_scene(aim: Aim, x: wp.float64, y: wp.float64, z: wp.float64):
    """A vector right, up and forward."""
    return x * aim.right + y * aim.up + z * aim.forward


@wp.func
def in_circular_cap(aim: Aim, u: wp.float64, v: wp.float64):
    """Maps [0, 1)^2 to unit directions, evenly over the cap."""
    rise = u * aim.rise
    radius = wp.sqrt(rise * (wp.float64(2.0) - rise))
    angle = wp.float64(TWO_PI) * v
    return in_scene(aim, radius * wp.cos(angle), radius * wp.sin(angle), wp.float64(1.0) - rise)


@wp.func
def in_square_cap(aim: Aim, u: wp.float64, v: wp.float64):
    """Maps [0, 1)^2 to unit directions, evenly over the part of the sphere that the window shows."""
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    a = aim.half[0]
    b = aim.half[1]
    tangent = wp.tan((two * u - one) * wp.atan(a * b / wp.sqrt(one + a * a + b * b)))
    x = tangent * wp.sqrt((one + b * b) / (b * b - tangent * tangent))
    sine = (two * v - one) * b / wp.sqrt(one + x * x + b * b)
    y = sine * wp.sqrt((one + x * x) / (one - sine * sine))
    return wp.normalize(in_scene(aim, x, y, one))


@wp.kernel
def cast_plane(first: int, aim: Aim, seed: wp.uint32, origins: wp.array(dtype=wp.vec3d), directions: wp.array(dtype=wp.vec3)):
    """Item: a ray. From the rectangle, forward but for a circular cap."""
    i = first + wp.tid()
    place = spread_point(i, seed)
    turn = spread_point(i, mix(seed, SECOND))
    x = (wp.float64(2.0) * wp.float64(place[0]) - wp.float64(1.0)) * aim.half[0]
    y = (wp.float64(2.0) * wp.float64(place[1]) - wp.float64(1.0)) * aim.half[1]
    origins[i] = aim.position + in_scene(aim, x, y, wp.float64(0.0))
    directions[i] = wp.vec3(in_circular_cap(aim, wp.float64(turn[0]), wp.float64(turn[1])))


@wp.kernel
def cast_circular_cap(first: int, aim: Aim, seed: wp.uint32, directions: wp.array(dtype=wp.vec3)):
    """Item: a ray."""
    i = first + wp.tid()
    place = spread_point(i, seed)
    directions[i] = wp.vec3(in_circular_cap(aim, wp.float64(place[0]), wp.float64(place[1])))


@wp.kernel
def cast_square_cap(first: int, aim: Aim, seed: wp.uint32, directions: wp.array(dtype=wp.vec3)):
    """Item: a ray."""
    i = first + wp.tid()
    place = spread_point(i, seed)
    directions[i] = wp.vec3(in_square_cap(aim, wp.float64(place[0]), wp.float64(place[1])))

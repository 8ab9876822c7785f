"""Lights as arrays.

A light is an entry of the table. All emissive triangles of the scene together are one entry, and so is the sky. A path chooses
an entry by power; it need not choose the sky. Lights of the table other than emissive triangles are not part of the scene: rays
pass through them, and collect their radiance on the way.
"""

import warp as wp

from wrt.kernels.shading.emitters.environment import Environment

POINT = wp.constant(0)
SPOT = wp.constant(1)
DIRECTIONAL = wp.constant(2)
PARALLELOGRAM = wp.constant(3)
TRIANGLE = wp.constant(4)
SPHERE = wp.constant(5)
TRIANGLES = wp.constant(6)
"""All emissive triangles of the scene."""
SKY = wp.constant(7)


@wp.struct
class Lights:
    """L lights."""

    count: int
    kind: wp.array(dtype=int)
    position: wp.array(dtype=wp.vec3)
    """(L,) a point, a corner or a centre, relative to the scene's centre."""
    axis: wp.array(dtype=wp.vec3)
    """(L,) unit vector along which light travels: of spot lights, directional lights, and normal of flat lights."""
    edge1: wp.array(dtype=wp.vec3)
    edge2: wp.array(dtype=wp.vec3)
    radiance: wp.array(dtype=wp.vec3)
    """(L,) radiance; of points intensity, of directional lights irradiance."""
    shape: wp.array(dtype=wp.vec4)
    """(L,) cosines at which a spot begins to fade and ends; area or radius; whether both sides emit."""
    sums: wp.array(dtype=float)
    """(L + 1,) cumulative probability, from 0 to 1. That of a sky may be 0: it is then found by scattering alone."""
    areas: int
    """Number of flat and round lights that are not part of the scene; they come first in the table."""
    far: float
    """Length of rays to the sky and to directional lights: they end outside the scene."""
    triangle: wp.array(dtype=int)
    """(E,) numbers of the emissive triangles in the scene."""
    triangle_sums: wp.array(dtype=float)
    """(E + 1,) cumulative probability by area and luminance."""
    triangle_power: float
    """Sum of area times luminance of the emissive triangles."""
    triangle_entry: int
    """The entry of the emissive triangles; -1 for none."""
    triangle_low: wp.vec3
    """A box that holds the emissive triangles, relative to the scene's centre, with room for rounding."""
    triangle_high: wp.vec3
    sky: Environment
    sky_entry: int
    """-1 for none."""


@wp.func
def entry_probability(lights: Lights, entry: int):
    """Probability with which a path chooses a light."""
    return lights.sums[entry + 1] - lights.sums[entry]

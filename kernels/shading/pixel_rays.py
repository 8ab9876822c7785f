"""Camera rays of an image's pixels.

Pixels are numbered row by row from the top left. Everything is computed in float64 and rounded once, so a camera far from the
origin, or with a narrow field of view, loses no precision.
"""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel


@wp.struct
class View:
    """A camera in kernels."""

    width: int
    height: int
    offset: wp.vec2d
    """Position of the ray within its pixel, in [0, 1)^2 from the top left corner."""
    position: wp.vec3d
    forward: wp.vec3d
    """Unit vector."""
    right: wp.vec3d
    """To the right edge of the image: at distance 1 for a pinhole camera, in scene units for an orthographic one."""
    up: wp.vec3d
    """To the upper edge of the image, in the same units."""


@wp.func
def on_picture(view: View, pixel: int):
    """Vector from the image's centre to the point through which a pixel's ray passes."""
    column = wp.float64(pixel % view.width) + view.offset[0]
    row = wp.float64(pixel / view.width) + view.offset[1]
    two = wp.float64(2.0)
    one = wp.float64(1.0)
    x = two * column / wp.float64(view.width) - one
    y = one - two * row / wp.float64(view.height)
    return x * view.right + y * view.up


@exact_kernel
def pinhole_directions(first: int, view: View, first_pixel: int, directions: wp.array(dtype=wp.vec3)):
    """Item: a pixel of a tile. Writes the unit direction of its ray."""
    i = first + wp.tid()
    directions[i] = wp.vec3(wp.normalize(view.forward + on_picture(view, first_pixel + i)))


@exact_kernel
def orthographic_origins(first: int, view: View, first_pixel: int, origins: wp.array(dtype=wp.vec3d)):
    """Item: a pixel of a tile. Writes the origin of its ray, in the plane through the camera's position."""
    i = first + wp.tid()
    origins[i] = view.position + on_picture(view, first_pixel + i)

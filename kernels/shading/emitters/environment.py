"""Light from the sky: radiance by direction from an image, and directions sampled by brightness.

The radiance is an image in longitude and latitude (equirectangular), interpolated bilinearly; the top row is the zenith. The
sampling density is constant within the cells of a grid that divides longitude and the *height* on the unit sphere evenly. By
Archimedes, cells of such a grid have equal solid angles, so the density is the cell's weight over the mean weight, divided by
4 pi, and a constant sky is sampled uniformly.

References: pharr-2016 (section 14.2.4, infinite area lights).
"""

import warp as wp

from wrt.kernels.shading.bsdf.ggx import PI
from wrt.kernels.shading.sampling import TWO_PI, direction_of


@wp.struct
class Environment:
    """A sky."""

    width: int
    height: int
    """0 for a black sky."""
    texels: wp.array(dtype=wp.vec3)
    """(height * width,) radiance, row by row from the zenith."""
    east: wp.vec3
    """Unit vector at longitude 0: the middle of the image."""
    north: wp.vec3
    up: wp.vec3
    columns: int
    rows: int
    row_sums: wp.array(dtype=float)
    """(rows + 1,) cumulative share of the rows, from 0 to 1; row 0 is at the zenith."""
    cell_sums: wp.array(dtype=float)
    """(rows * (columns + 1),) cumulative share of the cells of each row."""
    density: wp.array(dtype=float)
    """(rows * columns,) per solid angle."""


@wp.func
def longitude(sky: Environment, direction: wp.vec3):
    """Position across the image, in [0, 1]."""
    angle = wp.atan2(wp.dot(direction, sky.north), wp.dot(direction, sky.east))
    return wp.clamp(0.5 + angle / TWO_PI, 0.0, 1.0)


@wp.func
def sky_radiance(sky: Environment, direction: wp.vec3):
    """Radiance from a unit direction."""
    result = wp.vec3()
    if sky.width == 1 and sky.height == 1:
        result = sky.texels[0]
    elif sky.height > 0:
        height = wp.clamp(wp.dot(direction, sky.up), -1.0, 1.0)
        x = float(0.0)
        if sky.width > 1:  # a gradient has one column
            x = longitude(sky, direction) * float(sky.width) - 0.5
        y = wp.clamp(wp.acos(height) / PI * float(sky.height) - 0.5, 0.0, float(sky.height) - 1.0)
        column = int(wp.floor(x))
        row = wp.min(int(y), wp.max(sky.height - 2, 0))
        lower_row = wp.min(row + 1, sky.height - 1)
        across = x - float(column)
        down = wp.clamp(y - float(row), 0.0, 1.0)
        left = (column + sky.width) % sky.width
        right = (column + 1) % sky.width
        upper = (1.0 - across) * sky.texels[row * sky.width + left] + across * sky.texels[row * sky.width + right]
        lower = (1.0 - across) * sky.texels[lower_row * sky.width + left] + across * sky.texels[lower_row * sky.width + right]
        result = (1.0 - down) * upper + down * lower
    return result


@wp.func
def sky_density(sky: Environment, direction: wp.vec3):
    """Density per solid angle with which `sample_sky` chooses a direction."""
    density = float(1.0) / (4.0 * PI)
    if sky.rows > 1 or sky.columns > 1:
        height = wp.clamp(wp.dot(direction, sky.up), -1.0, 1.0)
        row = wp.min(int((0.5 - 0.5 * height) * float(sky.rows)), sky.rows - 1)
        column = wp.min(int(longitude(sky, direction) * float(sky.columns)), sky.columns - 1)
        density = sky.density[row * sky.columns + column]
    return density


@wp.func
def find_interval(sums: wp.array(dtype=float), first: int, count: int, value: float):
    """The last interval of `count` whose lower bound is at most `value`."""
    low = int(0)
    high = wp.where(count > 0, count, 1)  # declared this way, it may change
    while high - low > 1:
        middle = (low + high) / 2
        if sums[first + middle] <= value:
            low = middle
        else:
            high = middle
    return low


@wp.func
def within(sums: wp.array(dtype=float), at: int, value: float):
    """Position of a value in the interval that begins at element `at`, in [0, 1)."""
    size = sums[at + 1] - sums[at]
    return wp.clamp((value - sums[at]) / wp.max(size, 1e-20), 0.0, 0.999999)


@wp.func
def sample_sky(sky: Environment, point: wp.vec2):
    """Maps [0, 1)^2 to a unit direction, with the density `sky_density`."""
    row = find_interval(sky.row_sums, 0, sky.rows, point[1])
    down = (float(row) + within(sky.row_sums, row, point[1])) / float(sky.rows)
    begin = row * (sky.columns + 1)
    column = find_interval(sky.cell_sums, begin, sky.columns, point[0])
    across = (float(column) + within(sky.cell_sums, begin + column, point[0])) / float(sky.columns)
    height = 1.0 - 2.0 * down
    turn = direction_of(across - 0.5)
    radius = wp.sqrt(wp.max(0.0, 1.0 - height * height))
    return radius * (turn[0] * sky.east + turn[1] * sky.north) + height * sky.up

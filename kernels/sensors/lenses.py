"""Lenses of cameras: from points to pixels, and from pixels to rays.

The camera's frame is the optical frame: x to the right, y down, z forward. Pixels are OpenCV's: the centre of the first pixel
is at (0, 0), so an image of W columns spans -0.5 to W - 0.5. Everything is float64. Where a lens sees no point or a pixel has
no ray, the result is NaN.

Distortions without a closed inverse are inverted by Newton's method, on the branch that begins at the image centre: where the
distortion folds back, there is no ray.

References: brown-1966; kannala-brandt-2006; usenko-2018; opencv (documentation).
"""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel

BROWN_CONRADY = wp.constant(0)
KANNALA_BRANDT = wp.constant(1)
F_THETA = wp.constant(2)
DOUBLE_SPHERE = wp.constant(3)
EQUIRECTANGULAR = wp.constant(4)
ORTHOGRAPHIC = wp.constant(5)

COEFFICIENTS = 12
Coefficients = wp.types.vector(length=COEFFICIENTS, dtype=wp.float64)
STEPS = 50
ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))
TWO = wp.constant(wp.float64(2.0))
HALF = wp.constant(wp.float64(0.5))
CONVERGED = wp.constant(wp.float64(1e-12))
ACCEPTED = wp.constant(wp.float64(1e-9))


@wp.struct
class Lens:
    """A lens and the image behind it."""

    model: int
    fx: wp.float64
    fy: wp.float64
    cx: wp.float64
    cy: wp.float64
    skew: wp.float64
    """Pixels to the right for each unit of y on the image plane; 0 where columns are at right angles to rows."""
    c: Coefficients
    """BROWN_CONRADY: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4; KANNALA_BRANDT: k1 k2 k3 k4; F_THETA: factors of angle, angle^2 ...;
    DOUBLE_SPHERE: xi, alpha."""
    max_angle: wp.float64
    """Largest angle to the optical axis, in radians."""


@wp.struct
class LensRay:
    """The ray of a pixel in the camera's frame."""

    origin: wp.vec3d
    direction: wp.vec3d
    """Unit vector."""


@wp.func
def nan2():
    """The pixel of a point that is not seen."""
    return wp.vec2d(wp.float64(wp.nan), wp.float64(wp.nan))


@wp.func
def brown_conrady(c: Coefficients, p: wp.vec2d):
    """The distorted point of a point on the plane z = 1."""
    r2 = wp.dot(p, p)
    radial = ONE + r2 * (c[0] + r2 * (c[1] + r2 * c[4]))
    radial = radial / (ONE + r2 * (c[5] + r2 * (c[6] + r2 * c[7])))
    xy = TWO * p[0] * p[1]
    x = p[0] * radial + c[2] * xy + c[3] * (r2 + TWO * p[0] * p[0]) + r2 * (c[8] + r2 * c[9])
    y = p[1] * radial + c[2] * (r2 + TWO * p[1] * p[1]) + c[3] * xy + r2 * (c[10] + r2 * c[11])
    return wp.vec2d(x, y)


@wp.func
def brown_conrady_slope(c: Coefficients, p: wp.vec2d):
    """The matrix of derivatives of `brown_conrady`."""
    r2 = wp.dot(p, p)
    above = ONE + r2 * (c[0] + r2 * (c[1] + r2 * c[4]))
    below = ONE + r2 * (c[5] + r2 * (c[6] + r2 * c[7]))
    three = wp.float64(3.0)
    above_slope = c[0] + r2 * (TWO * c[1] + r2 * three * c[4])
    below_slope = c[5] + r2 * (TWO * c[6] + r2 * three * c[7])
    radial = above / below
    slope = TWO * (above_slope * below - above * below_slope) / (below * below)
    prism_x = TWO * (c[8] + TWO * c[9] * r2)
    prism_y = TWO * (c[10] + TWO * c[11] * r2)
    mixed = slope * p[0] * p[1] + TWO * (c[2] * p[0] + c[3] * p[1])
    six = wp.float64(6.0)
    xx = radial + slope * p[0] * p[0] + TWO * c[2] * p[1] + six * c[3] * p[0] + prism_x * p[0]
    yy = radial + slope * p[1] * p[1] + six * c[2] * p[1] + TWO * c[3] * p[0] + prism_y * p[1]
    return wp.mat22d(xx, mixed + prism_x * p[1], mixed + prism_y * p[0], yy)


@wp.func
def undistort(c: Coefficients, q: wp.vec2d):
    """The point on the plane z = 1 whose distorted point is q; NaN if there is none on the branch of the centre."""
    p = q
    searching = int(1)
    step = int(0)
    while searching == 1 and step < STEPS:
        error = brown_conrady(c, p) - q
        move = wp.inverse(brown_conrady_slope(c, p)) * error
        longest = HALF * (ONE + wp.length(p))  # of a step, so that it does not leave the branch
        if wp.length(move) > longest:
            move = move * (longest / wp.length(move))
        p = p - move
        step = step + 1
        if wp.length(move) <= CONVERGED * (ONE + wp.length(p)):
            searching = 0
    left = wp.length(brown_conrady(c, p) - q)
    if not (left <= ACCEPTED * (ONE + wp.length(q)) and wp.determinant(brown_conrady_slope(c, p)) > ZERO):
        p = nan2()
    return p


@wp.func
def image_radius(lens: Lens, angle: wp.float64):
    """Distance from the image centre and its derivative, for an angle to the axis: of the models KANNALA_BRANDT and F_THETA."""
    c = lens.c
    radius = wp.float64(0.0)
    slope = wp.float64(0.0)
    if lens.model == KANNALA_BRANDT:
        a2 = angle * angle
        radius = angle * (ONE + a2 * (c[0] + a2 * (c[1] + a2 * (c[2] + a2 * c[3]))))
        high = wp.float64(7.0) * c[2] + a2 * wp.float64(9.0) * c[3]
        slope = ONE + a2 * (wp.float64(3.0) * c[0] + a2 * (wp.float64(5.0) * c[1] + a2 * high))
    else:
        for i in range(COEFFICIENTS):
            at = COEFFICIENTS - 1 - i
            slope = slope * angle + wp.float64(at + 1) * c[at]
            radius = (radius + c[at]) * angle
    return wp.vec2d(radius, slope)


@wp.func
def angle_of_radius(lens: Lens, radius: wp.float64):
    """The angle to the axis whose image is at a distance from the image centre; NaN if there is none up to the largest one.

    Newton's method within a bracket that shrinks, so that it converges for every monotonous lens.
    """
    low = wp.float64(0.0)
    high = lens.max_angle
    angle = wp.min(radius / image_radius(lens, ZERO)[1], high)
    searching = int(1)
    step = int(0)
    while searching == 1 and step < STEPS:
        now = image_radius(lens, angle)
        error = now[0] - radius
        if error > ZERO:
            high = angle
        else:
            low = angle
        following = angle - error / now[1]
        if not (following >= low and following <= high):
            following = HALF * (low + high)
        if wp.abs(following - angle) <= CONVERGED:
            searching = 0
        angle = following
        step = step + 1
    last = image_radius(lens, angle)
    if not (wp.abs(last[0] - radius) <= ACCEPTED * (ONE + radius) and last[1] > ZERO):
        angle = wp.float64(wp.nan)
    return angle


@wp.func
def limit_of_double_sphere(xi: wp.float64, alpha: wp.float64):
    """Least z / |p| of points that a double sphere lens projects, negated."""
    w = alpha / (ONE - alpha)
    if alpha > HALF:
        w = (ONE - alpha) / alpha
    return (w + xi) / wp.sqrt(TWO * w * xi + xi * xi + ONE)


@wp.func
def skewed(lens: Lens, y: wp.float64):
    """By how many pixels a point at this height on the image plane is moved to the right; 0 without skew, whatever y is."""
    shift = ZERO
    if lens.skew != ZERO:
        shift = lens.skew * y
    return shift


@wp.func
def project(lens: Lens, p: wp.vec3d):
    """The pixel of a point in the camera's frame; NaN if the lens does not see it."""
    flat = wp.length(wp.vec2d(p[0], p[1]))
    image = nan2()
    if lens.model == BROWN_CONRADY:
        if p[2] > ZERO:
            image = brown_conrady(lens.c, wp.vec2d(p[0] / p[2], p[1] / p[2]))
    elif lens.model == KANNALA_BRANDT or lens.model == F_THETA:
        angle = wp.atan2(flat, p[2])
        if angle <= lens.max_angle:
            image = wp.vec2d()
            if flat > ZERO:
                image = (image_radius(lens, angle)[0] / flat) * wp.vec2d(p[0], p[1])
    elif lens.model == DOUBLE_SPHERE:
        length = wp.length(p)
        shifted = lens.c[0] * length + p[2]
        if p[2] > -limit_of_double_sphere(lens.c[0], lens.c[1]) * length:
            below = lens.c[1] * wp.sqrt(flat * flat + shifted * shifted) + (ONE - lens.c[1]) * shifted
            image = wp.vec2d(p[0] / below, p[1] / below)
    elif lens.model == EQUIRECTANGULAR:
        image = wp.vec2d(wp.atan2(p[0], p[2]), wp.atan2(p[1], wp.length(wp.vec2d(p[0], p[2]))))
    elif p[2] >= ZERO:
        image = wp.vec2d(p[0], p[1])
    return wp.vec2d(lens.fx * image[0] + skewed(lens, image[1]) + lens.cx, lens.fy * image[1] + lens.cy)


@wp.func
def unproject(lens: Lens, pixel: wp.vec2d):
    """The ray of a pixel; NaN if it has none."""
    ray = LensRay()
    y = (pixel[1] - lens.cy) / lens.fy
    image = wp.vec2d((pixel[0] - lens.cx - skewed(lens, y)) / lens.fx, y)
    radius = wp.length(image)
    if lens.model == BROWN_CONRADY:
        point = undistort(lens.c, image)
        ray.direction = wp.vec3d(point[0], point[1], ONE)
    elif lens.model == KANNALA_BRANDT or lens.model == F_THETA:
        angle = angle_of_radius(lens, radius)
        ray.direction = wp.vec3d(ZERO, ZERO, ONE)
        if not radius <= ZERO:
            across = wp.sin(angle) / radius
            ray.direction = wp.vec3d(across * image[0], across * image[1], wp.cos(angle))
    elif lens.model == DOUBLE_SPHERE:
        xi = lens.c[0]
        alpha = lens.c[1]
        r2 = radius * radius
        z = (ONE - alpha * alpha * r2) / (alpha * wp.sqrt(ONE - (TWO * alpha - ONE) * r2) + ONE - alpha)
        factor = (z * xi + wp.sqrt(z * z + (ONE - xi * xi) * r2)) / (z * z + r2)
        ray.direction = wp.vec3d(factor * image[0], factor * image[1], factor * z - xi)
    elif lens.model == EQUIRECTANGULAR:
        ray.direction = wp.vec3d(wp.sin(image[0]) * wp.cos(image[1]), wp.sin(image[1]), wp.cos(image[0]) * wp.cos(image[1]))
        if wp.abs(image[0]) > wp.float64(wp.pi) or wp.abs(image[1]) > HALF * wp.float64(wp.pi):
            ray.direction = wp.vec3d(wp.float64(wp.nan), ZERO, ZERO)
    else:
        ray.direction = wp.vec3d(ZERO, ZERO, ONE)
        ray.origin = wp.vec3d(image[0], image[1], ZERO)
    ray.direction = ray.direction / wp.length(ray.direction)  # NaN stays NaN, which `wp.normalize` makes 0
    return ray


@exact_kernel
def project_points(first: int, lens: Lens, points: wp.array(dtype=wp.vec3d), pixels: wp.array(dtype=wp.vec2d)):
    """Writes the pixel of a point. Item: a point."""
    i = first + wp.tid()
    pixels[i] = project(lens, points[i])


@exact_kernel
def unproject_pixels(
    first: int,
    lens: Lens,
    pixels: wp.array(dtype=wp.vec2d),
    origins: wp.array(dtype=wp.vec3d),
    directions: wp.array(dtype=wp.vec3d),
):
    """Writes the ray of a pixel. Item: a pixel."""
    i = first + wp.tid()
    ray = unproject(lens, pixels[i])
    origins[i] = ray.origin
    directions[i] = ray.direction


@exact_kernel
def image_rays(
    first: int,
    lens: Lens,
    columns: int,
    line_delay: wp.float64,
    offsets: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    times: wp.array(dtype=wp.float64),
):
    """Writes the ray of a pixel of an image, and its time. Item: a pixel, row by row. `offsets` is (0,) for a lens with one
    centre.
    """
    i = first + wp.tid()
    row = i / columns
    ray = unproject(lens, wp.vec2d(wp.float64(i % columns), wp.float64(row)))
    directions[i] = wp.vec3(ray.direction)
    times[i] = line_delay * wp.float64(row)
    if offsets.shape[0] > 0:
        offsets[i] = wp.vec3(ray.origin)

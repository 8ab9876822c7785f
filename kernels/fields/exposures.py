"""How much light from given directions reaches the fronts of points: rays of a block of directions, and sums of what they find.

**Problem.** Half of all directions are behind a wall, and rays in the order of the points of a caller have nothing in common.

**Method.** Points are taken along a Morton curve, in tiles. For each direction and tile, the points that face the direction are
counted, and rays are written for these alone, direction by direction: neighbours are parallel rays from places near each other.
The sums go through the points in the same order, so that no place of a ray is stored.
"""

import warp as wp

from wrt.kernels.query.hit_attributes import SceneMesh, triangle_of
from wrt.kernels.query.spawn import footing, front_normal, meets_own, spawn_origin
from wrt.kernels.runtime.options import exact_kernel

TILE = wp.constant(256)
"""Points of a tile."""


@wp.struct
class LitPoints:
    """P points on triangles, and where rays leave their fronts."""

    mesh: SceneMesh
    primitive: wp.array(dtype=int)
    """(P,) triangles by their numbers in the scene; -1 for none."""
    uv: wp.array(dtype=wp.vec2)
    order: wp.array(dtype=int)
    """(P,) in which points are taken."""
    normal: wp.array(dtype=wp.vec3d)
    """(P,) unit normals of the fronts, in this order; 0 where nothing is lit."""
    origin: wp.array(dtype=wp.vec3d)
    """(P,) where rays leave the fronts, in this order, unless they meet their own triangle from there."""


@wp.struct
class LitRays:
    """Rays of a block of directions from a range of tiles."""

    direction: wp.array(dtype=wp.vec3)
    """(D,) unit vectors."""
    first_tile: int
    tiles: int
    begin: wp.array(dtype=int)
    """(D tiles,) number of the first ray of each direction and tile."""


@exact_kernel
def place_points(first: int, points: LitPoints):
    """Writes where rays leave a point. Item: a point, in the order in which they are taken."""
    i = first + wp.tid()
    at = points.order[i]
    primitive = points.primitive[at]
    normal = wp.vec3d()
    origin = wp.vec3d()
    if primitive >= 0:
        corners = triangle_of(points.mesh, primitive)
        normal = front_normal(points.mesh, corners)
        start = footing(points.mesh, corners, points.uv[at])
        origin = start.point + wp.float64(start.offset) * normal
    points.normal[i] = normal
    points.origin[i] = origin


@wp.func
def is_lit(points: LitPoints, i: int, way: wp.vec3d):
    """Whether a direction is in front of a point."""
    return wp.dot(points.normal[i], way) > wp.float64(0.0)


@exact_kernel
def count_lit(first: int, points: LitPoints, rays: LitRays, count: wp.array(dtype=int)):
    """Counts the points of a tile that a direction is in front of. Item: a direction and a tile."""
    item = first + wp.tid()
    way = wp.vec3d(rays.direction[item / rays.tiles])
    begin = (rays.first_tile + item % rays.tiles) * TILE
    found = int(0)
    for i in range(begin, wp.min(begin + TILE, points.order.shape[0])):
        found += wp.where(is_lit(points, i, way), 1, 0)
    count[item] = found


@exact_kernel
def write_lit(
    first: int, points: LitPoints, rays: LitRays, origins: wp.array(dtype=wp.vec3d), directions: wp.array(dtype=wp.vec3)
):
    """Writes the rays of a direction and a tile. Item: a direction and a tile."""
    item = first + wp.tid()
    direction = rays.direction[item / rays.tiles]
    way = wp.vec3d(direction)
    begin = (rays.first_tile + item % rays.tiles) * TILE
    ray = rays.begin[item]
    for i in range(begin, wp.min(begin + TILE, points.order.shape[0])):
        if is_lit(points, i, way):
            at = points.order[i]
            origin = points.origin[i]
            primitive = points.primitive[at]
            if meets_own(points.mesh, primitive, wp.vec3(origin - points.mesh.center), direction):
                origin = spawn_origin(points.mesh, primitive, points.uv[at], direction, 0)
            origins[ray] = origin
            directions[ray] = direction
            ray += 1


@exact_kernel
def add_lit(
    first: int,
    points: LitPoints,
    rays: LitRays,
    dark: wp.array(dtype=wp.bool),
    weights: wp.array2d(dtype=wp.float64),
    cosine: bool,
    part: wp.array2d(dtype=wp.float64),
    total: wp.array2d(dtype=wp.float64),
):
    """Adds the weights of what points see. Item: a tile.

    dark: whether each ray met something. weights: (D, G) of each direction, in each group. part: (P, G) 0, and 0 again at the
    end. total: (P, G), in the order of the caller.
    """
    tile = first + wp.tid()
    begin = (rays.first_tile + tile) * TILE
    end = wp.min(begin + TILE, points.order.shape[0])
    for d in range(rays.direction.shape[0]):
        way = wp.vec3d(rays.direction[d])
        ray = rays.begin[d * rays.tiles + tile]
        for i in range(begin, end):
            if is_lit(points, i, way):
                if not dark[ray]:
                    share = wp.float64(1.0)
                    if cosine:
                        share = wp.max(wp.dot(way, wp.vec3d(wp.vec3(points.normal[i]))), wp.float64(0.0))
                    for g in range(weights.shape[1]):
                        part[i, g] = part[i, g] + weights[d, g] * share
                ray += 1
    for i in range(begin, end):
        for g in range(weights.shape[1]):
            total[points.order[i], g] = total[points.order[i], g] + part[i, g]
            part[i, g] = wp.float64(0.0)

"""How much light from given directions reaches the fronts of points: rays of a block of directions, and sums of what they find.

**Problem.** Half of all directions are behind a wall, and rays in the order of the points of a caller have nothing in common.

**Method.** Points are taken along a Morton curve, in tiles. For each direction and tile, the points that face the direction are
counted, and rays are written for these alone, direction by direction: neighbours are parallel rays from places near each other.
Directions that follow each other closely, such as those of a sun, are taken in groups: the rays of a point to a group are
neighbours then, as packets need it. The sums go through the points in the same order, so that no place of a ray is stored. Of
a tile on a plane, all points face a direction or none. What a ray needs to be tested with its own triangle is prepared once,
for its point and for its direction.
"""

import warp as wp

from wrt.kernels.layout.ray_batch import FARTHEST, checked_ray
from wrt.kernels.query.hit_attributes import SceneMesh, triangle_of
from wrt.kernels.query.spawn import footing, front_normal, meets_own, spawn_origin
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.triangle.support.record_blocks import Corners
from wrt.kernels.triangle.watertight.woop import ShearedRay, intersect, permuted, prepare

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
    corners: wp.array(dtype=Corners)
    """(P,) the triangles of points, in this order, in float32; without elements in a scene of instances."""


@wp.struct
class LitRays:
    """Rays of a block of directions from a range of tiles."""

    direction: wp.array(dtype=wp.vec3)
    """(D,) unit vectors."""
    prepared: wp.array(dtype=ShearedRay)
    """(D,) rays to them, from the scene's centre."""
    group: int
    """Number of directions that are taken together; the last group may have fewer."""
    first_tile: int
    tiles: int
    begin: wp.array(dtype=int)
    """(groups tiles + 1,) number of the first ray of each group of directions and tile, and the number of rays."""


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
        if points.corners.shape[0] > 0:
            face = points.mesh.faces[primitive]
            own = Corners()
            own.a = points.mesh.vertices[face[0]]
            own.b = points.mesh.vertices[face[1]]
            own.c = points.mesh.vertices[face[2]]
            points.corners[i] = own
    points.normal[i] = normal
    points.origin[i] = origin


@exact_kernel
def prepare_ways(first: int, directions: wp.array(dtype=wp.vec3), prepared: wp.array(dtype=ShearedRay)):
    """Prepares rays to directions. Item: a direction."""
    i = first + wp.tid()
    prepared[i] = prepare(wp.vec3(), checked_ray(wp.vec3(), directions[i], 0.0, FARTHEST).direction)


@wp.func
def is_lit(points: LitPoints, i: int, way: wp.vec3d):
    """Whether a direction is in front of a point."""
    return wp.dot(points.normal[i], way) > wp.float64(0.0)


@wp.func
def meets_triangle(points: LitPoints, i: int, primitive: int, direction: wp.vec3, ray: ShearedRay):
    """`meets_own` of a ray from a point; ray: one of the direction, from anywhere."""
    origin = wp.vec3(points.origin[i] - points.mesh.center)
    if points.corners.shape[0] == 0:
        return meets_own(points.mesh, primitive, origin, direction)
    ray.origin = permuted(origin, ray.z)
    return intersect(ray, points.corners[i])[0] >= 0.0


@exact_kernel
def count_lit(first: int, points: LitPoints, rays: LitRays, count: wp.array(dtype=int)):
    """Counts the rays of a tile: directions that are in front of points. Item: a group of directions and a tile."""
    item = first + wp.tid()
    low = item / rays.tiles * rays.group
    begin = (rays.first_tile + item % rays.tiles) * TILE
    found = int(0)
    for d in range(low, wp.min(low + rays.group, rays.direction.shape[0])):
        way = wp.vec3d(rays.direction[d])
        for i in range(begin, wp.min(begin + TILE, points.order.shape[0])):
            found += wp.where(is_lit(points, i, way), 1, 0)
    count[item] = found


@exact_kernel
def write_lit(
    first: int, points: LitPoints, rays: LitRays, origins: wp.array(dtype=wp.vec3d), directions: wp.array(dtype=wp.vec3)
):
    """Writes the rays of a group of directions and a tile, point by point. Item: a group of directions and a tile."""
    item = first + wp.tid()
    low = item / rays.tiles * rays.group
    high = wp.min(low + rays.group, rays.direction.shape[0])
    begin = (rays.first_tile + item % rays.tiles) * TILE
    end = wp.min(begin + TILE, points.order.shape[0])
    ray = rays.begin[item]
    count = rays.begin[item + 1] - ray
    if count == 0:
        return
    for i in range(begin, end):
        at = points.order[i]
        primitive = points.primitive[at]
        for d in range(low, high):
            direction = rays.direction[d]
            if count == (end - begin) * (high - low) or is_lit(points, i, wp.vec3d(direction)):
                origin = points.origin[i]
                if meets_triangle(points, i, primitive, direction, rays.prepared[d]):
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
    weighted: wp.array(dtype=wp.vec2i),
    cosine: bool,
    part: wp.array2d(dtype=wp.float64),
    total: wp.array2d(dtype=wp.float64),
):
    """Adds the weights of what points see. Item: a tile.

    dark: whether each ray met something. weights: (D, G) of each direction, in each group of sums. weighted: (D,) the first and
    the end of the groups of sums in which a direction has weights other than 0. part: (P, G) 0, and 0 again at the
    end. total: (P, G), in the order of the caller.
    """
    tile = first + wp.tid()
    begin = (rays.first_tile + tile) * TILE
    end = wp.min(begin + TILE, points.order.shape[0])
    groups = weights.shape[1]
    low = int(0)
    while low < rays.direction.shape[0]:
        high = wp.min(low + rays.group, rays.direction.shape[0])
        item = low / rays.group * rays.tiles + tile
        ray = rays.begin[item]
        count = rays.begin[item + 1] - ray
        if count > 0:
            for i in range(begin, end):
                for d in range(low, high):
                    way = wp.vec3d(rays.direction[d])
                    if count == (end - begin) * (high - low) or is_lit(points, i, way):
                        if not dark[ray]:
                            share = wp.float64(1.0)
                            if cosine:
                                share = wp.max(wp.dot(way, wp.vec3d(wp.vec3(points.normal[i]))), wp.float64(0.0))
                            for g in range(weighted[d][0], weighted[d][1]):
                                part[i, g] = part[i, g] + weights[d, g] * share
                        ray += 1
        low = high
    for i in range(begin, end):
        for g in range(groups):
            total[points.order[i], g] = total[points.order[i], g] + part[i, g]
            part[i, g] = wp.float64(0.0)

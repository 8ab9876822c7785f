"""How much light from given directions reaches the fronts of points: rays of a block of directions, and sums of what they find.

**Problem.** Half of all directions are behind a wall, and rays in the order of the points of a caller have nothing in common.

**Method.** Points are taken along a Morton curve, in tiles. For each direction and tile, the points that face the direction are
counted, and rays are written for these alone, direction by direction: neighbours are parallel rays from places near each other.
Directions that follow each other closely, such as those of a sun, are taken in groups: the rays of a point to a group are
neighbours then, and packets stay together where points are far apart. The sums go through the points in the same order, so that
no place of a ray is stored. Of a tile on a plane, all points face a direction or none.

A ray is tested with its own triangle, which its origin may not meet (`wrt.kernels.query.spawn`): `LANES` points at a time, with
triangles that are stored relative to the points' origins. Hardly any ray meets its own.
"""

import warp as wp

from wrt.kernels.layout.ray_batch import FARTHEST, checked_ray
from wrt.kernels.query.hit_attributes import SceneMesh, triangle_of
from wrt.kernels.query.spawn import footing, front_normal, meets_own, spawn_origin
from wrt.kernels.runtime import native
from wrt.kernels.runtime.options import exact_kernel
from wrt.kernels.simd.lanes import lanes
from wrt.kernels.triangle.support.record_blocks import VERTEX_COMPONENTS
from wrt.kernels.triangle.watertight.woop import ShearedRay, block_test, prepare

TILE = wp.constant(256)
"""Points of a tile."""

GROUP = 8
"""Largest number of directions of a group, as in lit_points.h."""

LANES = wp.constant(16)
"""Points that are tested at a time with their own triangles."""

FLOATS = wp.constant(int(LANES) * VERTEX_COMPONENTS)
"""Floats of a block of triangles."""

Lanes = lanes(int(LANES))
test_own = block_test(int(LANES))


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
    own: wp.array(dtype=float)
    """The triangles of points, in this order, relative to the origins: blocks of `LANES` records, as in
    `wrt.kernels.triangle.support.record_blocks`; without elements in a scene of instances."""


@wp.struct
class LitRays:
    """Rays of a block of directions from a range of tiles."""

    direction: wp.array(dtype=wp.vec3)
    """(D,) unit vectors."""
    prepared: wp.array(dtype=ShearedRay)
    """(D,) rays to them, from 0."""
    groups: int
    """Number of groups of directions that are taken together, of equal sizes if possible."""
    center: wp.vec3d
    """What origins are relative to: the centre of the scene that is traced."""
    first_tile: int
    tiles: int
    begin: wp.array(dtype=int)
    """(groups tiles + 1,) number of the first ray of each group of directions and tile, and the number of rays."""


@exact_kernel
def find_near(first: int, points: LitPoints, near: wp.array(dtype=wp.vec3)):
    """Writes about where a point is, relative to the mesh's centre, which is where a miss is. Item: a point."""
    i = first + wp.tid()
    place = wp.vec3()
    if points.primitive[i] >= 0:
        corners = triangle_of(points.mesh, points.primitive[i])
        uv = points.uv[i]
        across = wp.float64(uv[0]) * (corners.b - corners.a) + wp.float64(uv[1]) * (corners.c - corners.a)
        place = wp.vec3(corners.a + across)
    near[i] = place


@exact_kernel
def place_points(first: int, points: LitPoints):
    """Writes where rays leave a point. Item: a point, in the order in which they are taken; if triangles are stored, also a
    lane of the last block without a point."""
    i = first + wp.tid()
    primitive = int(-1)
    if i < points.order.shape[0]:
        primitive = points.primitive[points.order[i]]
    if primitive < 0 and points.own.shape[0] > 0:
        slot = i / LANES * FLOATS + i % LANES
        for k in range(9):
            points.own[slot + k * LANES] = wp.nan
    if i >= points.order.shape[0]:
        return
    at = points.order[i]
    normal = wp.vec3d()
    origin = wp.vec3d()
    if primitive >= 0:
        corners = triangle_of(points.mesh, primitive)
        normal = front_normal(points.mesh, corners)
        start = footing(points.mesh, corners, points.uv[at])
        origin = start.point + wp.float64(start.offset) * normal
        if points.own.shape[0] > 0:
            face = points.mesh.faces[primitive]
            slot = i / LANES * FLOATS + i % LANES
            for k in range(3):
                corner = points.mesh.vertices[face[k]] - wp.vec3(origin - points.mesh.center)
                for a in range(3):
                    points.own[slot + (3 * k + a) * LANES] = corner[a]
    points.normal[i] = normal
    points.origin[i] = origin


@exact_kernel
def prepare_ways(first: int, directions: wp.array(dtype=wp.vec3), prepared: wp.array(dtype=ShearedRay)):
    """Prepares rays to directions. Item: a direction."""
    i = first + wp.tid()
    prepared[i] = prepare(wp.vec3(), checked_ray(wp.vec3(), directions[i], 0.0, FARTHEST).direction)


@wp.struct
class LitSums:
    """What is added up for points."""

    dark: wp.array(dtype=wp.bool)
    """Whether each ray met something."""
    weights: wp.array2d(dtype=wp.float64)
    """(D, G) of each direction, in each group of sums."""
    weighted: wp.array(dtype=wp.vec2i)
    """(D,) the first and the end of the groups of sums in which a direction has weights other than 0."""
    cosine: bool
    """Whether weights are multiplied by the cosine with the point's normal."""
    sums: wp.array2d(dtype=wp.float64)
    """(G, P), in the order of points."""
    is_first: bool
    """Whether nothing has been added yet, and sums are undefined."""


@wp.func
def is_lit(points: LitPoints, i: int, way: wp.vec3d):
    """Whether a direction is in front of a point."""
    return wp.dot(points.normal[i], way) > wp.float64(0.0)


@native.func_native(
    "lit_points.h",
    """
    const double* const normals = (const double*)&points.normal.data[begin];
    return wrt::count_in_front(normals, end - begin, (const float*)&rays.direction.data[d]);
    """,
)
def count_in_front(points: LitPoints, begin: int, end: int, rays: LitRays, d: int) -> int:
    """The number of points of a range that a direction is in front of."""


@native.func_native(
    "lit_points.h",
    """
    wrt::write_rays((const double*)&points.origin.data[begin], end - begin, (const float*)&rays.direction.data[ways.c[0]],
        ways.c[1] - ways.c[0], rays.center.c, (float*)&origins.data[ray], (float*)&directions.data[ray]);
    """,
)
def write_rays(
    points: LitPoints,
    begin: int,
    end: int,
    rays: LitRays,
    ways: wp.vec2i,
    ray: int,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
):
    """Writes all rays from a range of points to a range of directions, from number `ray` on."""


@native.func_native(
    "lit_points.h",
    f"""
    static_assert(wrt::LIT_TILE == {int(TILE)} && wrt::LIT_GROUP == {GROUP});
    const double* const normals = (const double*)&points.normal.data[begin];
    const float* const to = (const float*)&rays.direction.data[ways.c[0]];
    const int count = end - begin, group = ways.c[1] - ways.c[0], groups = lit.weights.shape[1];
    unsigned char seen[wrt::LIT_GROUP * wrt::LIT_TILE];
    wrt::sort_seen(normals, count, to, group, full, &lit.dark.data[ray], seen);
    wrt::add_seen(normals, count, to, group, seen, lit.cosine, &lit.weights.data[ways.c[0] * groups], groups,
        (const int*)&lit.weighted.data[ways.c[0]], &lit.sums.data[begin], lit.sums.shape[1]);
    """,
)
def add_group(
    points: LitPoints,
    begin: int,
    end: int,
    rays: LitRays,
    ways: wp.vec2i,
    full: bool,
    ray: int,
    lit: LitSums,
):
    """Adds the weights of what a range of points sees of a range of directions. full: whether each point has a ray to each,
    from number `ray` on."""


@native.func_native("lit_points.h", f"return wrt::some_ahead<{int(LANES)}>(mask, t.c);")
def some_ahead(mask: wp.uint32, t: Lanes) -> bool:
    """Whether some of the lanes of a mask have a t of 0 or more."""


@wp.func
def some_meet(points: LitPoints, block: int, rays: LitRays, directions: wp.vec2i):
    """Whether some rays to a range of directions may meet their own triangles, if they leave points of a block."""
    meet = points.own.shape[0] == 0
    if not meet:
        for d in range(directions[0], directions[1]):
            t = Lanes()
            u = Lanes()
            v = Lanes()
            mask = test_own(points.own, block, rays.prepared[d], t, u, v)
            meet = meet or some_ahead(mask, t)
    return meet


@wp.func
def directions_of(rays: LitRays, group: int):
    """The first of the directions of a group, and the end."""
    each = rays.direction.shape[0] / rays.groups
    longer = rays.direction.shape[0] - each * rays.groups
    low = group * each + wp.min(group, longer)
    return wp.vec2i(low, low + each + wp.where(group < longer, 1, 0))


@exact_kernel
def count_lit(first: int, points: LitPoints, rays: LitRays, count: wp.array(dtype=int)):
    """Counts the rays of a tile: directions that are in front of points. Item: a group of directions and a tile."""
    item = first + wp.tid()
    ends = directions_of(rays, item / rays.tiles)
    begin = (rays.first_tile + item % rays.tiles) * TILE
    end = wp.min(begin + TILE, points.order.shape[0])
    found = int(0)
    for d in range(ends[0], ends[1]):
        found += count_in_front(points, begin, end, rays, d)
    count[item] = found


@exact_kernel
def write_lit(
    first: int, points: LitPoints, rays: LitRays, origins: wp.array(dtype=wp.vec3), directions: wp.array(dtype=wp.vec3)
):
    """Writes the rays of a group of directions and a tile, point by point. Item: a group of directions and a tile."""
    item = first + wp.tid()
    ends = directions_of(rays, item / rays.tiles)
    begin = (rays.first_tile + item % rays.tiles) * TILE
    end = wp.min(begin + TILE, points.order.shape[0])
    ray = rays.begin[item]
    count = rays.begin[item + 1] - ray
    if count == 0:
        return
    full = count == (end - begin) * (ends[1] - ends[0])
    for low in range(begin, end, LANES):
        high = wp.min(low + LANES, end)
        meet = some_meet(points, low / LANES, rays, ends)
        if full and not meet:
            write_rays(points, low, high, rays, ends, ray, origins, directions)
            ray += (high - low) * (ends[1] - ends[0])
        else:
            for i in range(low, high):
                for d in range(ends[0], ends[1]):
                    direction = rays.direction[d]
                    if full or is_lit(points, i, wp.vec3d(direction)):
                        origin = points.origin[i]
                        at = points.order[i]
                        if meet and meets_own(
                            points.mesh, points.primitive[at], wp.vec3(origin - points.mesh.center), direction
                        ):
                            origin = spawn_origin(points.mesh, points.primitive[at], points.uv[at], direction, 0)
                        origins[ray] = wp.vec3(origin - rays.center)
                        directions[ray] = direction
                        ray += 1


@exact_kernel
def add_lit(
    first: int,
    points: LitPoints,
    rays: LitRays,
    lit: LitSums,
):
    """Adds the weights of what points see. Item: a tile."""
    tile = first + wp.tid()
    begin = (rays.first_tile + tile) * TILE
    end = wp.min(begin + TILE, points.order.shape[0])
    if lit.is_first:
        for share in range(lit.sums.shape[0]):
            for i in range(begin, end):
                lit.sums[share, i] = wp.float64(0.0)
    for group in range(rays.groups):
        ways = directions_of(rays, group)
        ray = rays.begin[group * rays.tiles + tile]
        count = rays.begin[group * rays.tiles + tile + 1] - ray
        if count > 0:
            full = count == (end - begin) * (ways[1] - ways[0])
            add_group(points, begin, end, rays, ways, full, ray, lit)


@exact_kernel
def spread_sums(first: int, points: LitPoints, lit: LitSums, found: wp.array2d(dtype=wp.float64)):
    """Writes the sums of a point, (P, G), where the caller has it. Item: a point, in the order in which they are taken."""
    i = first + wp.tid()
    at = points.order[i]
    for share in range(lit.sums.shape[0]):
        found[at, share] = lit.sums[share, i]

"""Kernels that ask Warp's own `wp.Mesh`: one thread a ray, as its documentation shows."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def mesh_closest(
    mesh: wp.uint64,
    origins: wp.array(dtype=wp.vec3),
    origin_stride: int,
    directions: wp.array(dtype=wp.vec3),
    t_max: float,
    t: wp.array(dtype=float),
    primitive: wp.array(dtype=int),
    uv: wp.array(dtype=wp.vec2),
):
    """Item: a ray. uv: weights of the second and third vertex, which Warp gives for the first and second."""
    i = wp.tid()
    hit = wp.mesh_query_ray(mesh, origins[i * origin_stride], directions[i], t_max)
    if hit.result:
        t[i] = hit.t
        primitive[i] = hit.face
        uv[i] = wp.vec2(hit.v, 1.0 - hit.u - hit.v)
    else:
        t[i] = wp.inf
        primitive[i] = -1
        uv[i] = wp.vec2()


@wp.kernel
def mesh_occluded(
    mesh: wp.uint64,
    origins: wp.array(dtype=wp.vec3),
    origin_stride: int,
    directions: wp.array(dtype=wp.vec3),
    t_max: float,
    occluded: wp.array(dtype=wp.bool),
):
    """Item: a ray."""
    i = wp.tid()
    occluded[i] = wp.mesh_query_ray_anyhit(mesh, origins[i * origin_stride], directions[i], t_max)


@wp.kernel
def mesh_nearest(mesh: wp.uint64, points: wp.array(dtype=wp.vec3), nearest: wp.array(dtype=wp.vec3)):
    """Item: a point, whose nearest point of the mesh is written."""
    i = wp.tid()
    found = wp.mesh_query_point_no_sign(mesh, points[i], 1.0e10)
    nearest[i] = wp.mesh_eval_position(mesh, found.face, found.u, found.v)


@wp.kernel
def nearest_of_bodies(
    mesh: wp.uint64,
    to_body: wp.array2d(dtype=wp.mat44),
    directions: wp.array(dtype=wp.vec3),
    t_max: float,
    t: wp.array2d(dtype=float),
):
    """Item: an environment and a ray from its origin. to_body: (environments, bodies), from the world to each body."""
    world, ray = wp.tid()
    nearest = t_max
    found = float(wp.inf)
    for body in range(to_body.shape[1]):
        matrix = to_body[world, body]
        start = wp.transform_point(matrix, wp.vec3())
        hit = wp.mesh_query_ray(mesh, start, wp.transform_vector(matrix, directions[ray]), nearest)
        if hit.result:
            nearest = hit.t
            found = hit.t
    t[world, ray] = found

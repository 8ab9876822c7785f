"""Mutations of spawned origins: their distance, corners, sides, and points on triangles."""

from tests.mutate.mutation import Mutation

_NEAR = "Spawned origins are within 6.7e-6 of the scene's reach of their hits"
_OWN = "`spawn` neither meets its own triangle again nor jumps across a wall"
_FRONT = "Surfaces are lit on their front only, by the recipes of the guides"

_BOUNDS = "tests/queries/test_spawn_bounds.py"
_NEAR_HITS = f"{_BOUNDS}::test_origins_are_near_their_hits"
_CORNERS = f"{_BOUNDS}::test_corners_keep_what_is_in_them"
_SIDES = "tests/queries/test_sides.py"

MUTATIONS = [
    Mutation(
        path="kernels/query/spawn.py",
        old="OFFSET = wp.constant(2.0**-21)",
        new="OFFSET = wp.constant(2.0**-23)",
        tests=(f"{_BOUNDS}::test_steep_rays_whose_rounding_adds_up", f"{_NEAR_HITS}[1.0-near]"),
        promise=_OWN,
    ),
    Mutation(
        path="kernels/query/spawn.py",
        old="DOUBLINGS = wp.constant(16)",
        new="DOUBLINGS = wp.constant(0)",
        tests=f"{_BOUNDS}::test_steep_rays_whose_rounding_adds_up",
        promise=_OWN,
    ),
    Mutation(
        path="kernels/query/spawn.py",
        old="offset = OFFSET * reach(wp.vec3(near), mesh.low, mesh.high)",
        new="offset = OFFSET * reach(wp.vec3(near), mesh.low, mesh.high)\n"
        "    found.offset += 2.4e-7 * wp.pow(float(wp.length(edge1)), 3.0) / float(wp.length(wp.cross(edge1, edge2)))",
        tests=f"{_NEAR_HITS}[1.0-near]",
        promise=_NEAR,
    ),
    Mutation(
        path="kernels/query/spawn.py",
        old="INSET = wp.constant(7.0)",
        new="INSET = wp.constant(4.0)",
        tests=_CORNERS,
        promise=_OWN,
    ),
    Mutation(
        path="kernels/query/spawn.py",
        old="result += wp.vec3d(wp.dot(c - b, step), wp.dot(a - c, step), wp.dot(b - a, step)) / area",
        new="result = wp.max(result, inset) / (wp.max(result, inset)[0] + wp.max(result, inset)[1] + wp.max(result, inset)[2])",
        tests=(f"{_NEAR_HITS}[1.0-near]", f"{_CORNERS}[10.0-100.0]"),
        promise=_NEAR,
    ),
    Mutation(
        path="kernels/query/spawn.py",
        old="(wp.min(wp.float64(INSET * offset), wp.float64(0.5) * radius) / area)",
        new="(wp.float64(INSET * offset) / area)",
        tests=f"{_BOUNDS}::test_needles_thinner_than_the_inset",
        promise=_NEAR,
    ),
    Mutation(
        path="kernels/query/spawn.py",
        old="        for _ in range(2):\n            missing",
        new="        for _ in range(1):\n            missing",
        tests=f"{_BOUNDS}::test_tips_of_triangles",
        promise=_OWN,
    ),
    Mutation(
        path="kernels/query/spawn.py",
        old="        ray = object_ray(placement, wp.vec3d(origin), ray, FARTHEST)\n",
        new="",
        tests=f"{_BOUNDS}::test_instances_that_are_stretched",
        promise=_OWN,
    ),
    Mutation(
        path="kernels/query/spawn.py",
        old="return winding(mesh, triangle) * wp.normalize(",
        new="return wp.normalize(",
        tests=f"{_SIDES}::test_faces_is_the_sign_of_the_cosine",
        promise=_FRONT,
    ),
    Mutation(
        path="kernels/query/spawn.py",
        old="wp.vec3d(direction)) > wp.float64(0.0)\n    return result",
        new="wp.vec3d(direction)) != wp.float64(0.0)\n    return result",
        tests=f"{_SIDES}::test_the_recipe_of_a_panel",
        promise=_FRONT,
    ),
    Mutation(
        path="kernels/query/spawn.py",
        old="origin = point - wp.float64(offset) * (side * normal + back)",
        new="origin = point - wp.float64(offset) * side * normal",
        tests=f"{_SIDES}::test_sides_of_spawn",
        promise=_FRONT,
    ),
    Mutation(
        path="wrt/query/points/surface_points.py",
        old="far = (number >= 0) & ~(distance <= TOLERANCE * longest)",
        new="far = (number >= 0) & (distance > 1e30)",
        tests=f"{_SIDES}::test_points_on_refuses",
        promise=_FRONT,
    ),
    Mutation(
        path="wrt/query/points/surface_points.py",
        old="    return np.where(is_given, first[own] + primitive, -1).astype(np.int32)",
        new="    return np.where(is_given, primitive, -1).astype(np.int32)",
        tests=f"{_SIDES}::test_points_on_instances",
        promise=_FRONT,
    ),
    Mutation(
        path="kernels/shading/shading_point.py",
        old="room = wp.min(INSET * offset, 0.5 / (inverse[0] + inverse[1] + inverse[2]))",
        new="room = 0.25 * INSET * offset",
        tests="tests/imaging/test_path_step_simd.py::test_lanes_near_edges",
        promise="Plain rays are shaded in lanes, with the bits of the scalar step",
    ),
]
